"""A robot in a live scene: it holds its posture, follows commands within its limits, and breaks what it hits."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
from worlds.served_scene import PlayedScene

from fracture_collision.simulation.actors.joint_goals import JointGoals, JointLimits
from fracture_collision.simulation.live import CommandRefused
from fracture_collision.simulation.scene.scene import load_scene

pytest.importorskip("pybullet")

STILL = 1e-4  # [rad] by which motors of limited gain let a joint sag


class Played(PlayedScene):
    def follow(self, count: int) -> tuple[list[int], np.ndarray]:
        """Number of fragments at each step, and joint angles (count, 7)."""
        fragments, angles = [], []
        for _ in range(count):
            fragments.append(self.step().fragments)
            angles.append(self.simulation.robot.joints().angles)
        return fragments, np.array(angles)


@pytest.fixture
def played() -> Iterator[Played]:
    made = Played("vase")
    yield made
    made.live.close()


def test_a_robot_follows_commands_within_its_limits(played: Played) -> None:
    still = played.follow(40)[1]
    assert np.ptp(still, axis=0).max() < STILL, "nobody swings but the person"
    plan, h = load_scene("vase").robot, 0.0025
    played.live.command_joints(["lbr_iiwa_joint_1", "lbr_iiwa_joint_4"], [-2.0, -1.0])
    angles = np.vstack((still[-1:], played.follow(400)[1]))
    goal = still[-1].copy()
    goal[[0, 3]] = -2.0, -1.0
    np.testing.assert_allclose(angles[-1], goal, atol=STILL)
    speeds = np.diff(angles, axis=0) / h
    assert np.abs(speeds).max() <= plan.speed_limit + 1e-3
    changes = np.abs(np.diff(np.vstack((np.zeros(7), speeds)), axis=0))
    assert changes.max() <= 1.5 * plan.acceleration_limit * h
    assert (np.sign(goal - still[-1]) * speeds)[:, [0, 3]].min() >= -0.01, "straight there"
    assert np.abs(played.live.simulation.robot.joints().speeds).max() < 1e-3


def test_joint_commands_break_the_vase_and_invalid_ones_are_rejected_with_an_explanation(played: Played) -> None:
    fragments, angles = played.follow(2)
    whole, before = fragments[-1], angles[-1]
    for names, positions, words in (
        ([], [0.0] * 6, "position: 6 values for 7 joints"),
        (["elbow"], [0.0], "no joint 'elbow'; there are lbr_iiwa_joint_1"),
        (["lbr_iiwa_joint_1"], [float("nan")], "lbr_iiwa_joint_1: nan is not finite"),
        (["lbr_iiwa_joint_2"], [2.2], "lbr_iiwa_joint_2: 2.2 rad is not between -2.094 and 2.094 rad"),
        (["lbr_iiwa_joint_1"] * 2, [0.1, 0.2], "a joint occurs twice"),
        (["lbr_iiwa_joint_1"], [], "position: 0 values for 1 joints"),
    ):
        with pytest.raises(CommandRefused, match=words):
            played.live.command_joints(names, positions)
        np.testing.assert_allclose(played.follow(5)[1][-1], before, atol=STILL)
    played.live.command_joints([], np.radians([-60.0, 60.0, 0.0, -80.0, 0.0, -50.0, 0.0]))
    assert set(played.follow(200)[0]) == {whole}
    played.live.command_joints(["lbr_iiwa_joint_1"], [1.0])
    assert played.follow(250)[0][-1] > whole + 10


def test_a_waiter_holds_its_posture_until_commanded() -> None:
    """Its tables are of velocities."""
    run = Played("waiter")
    try:
        assert np.abs(run.follow(200)[1]).max() < 1e-3
        run.live.command_joints(["lift"], [-0.3])
        np.testing.assert_allclose(run.follow(300)[1][-1], [0.0, -0.3, 0.0], atol=1e-3)
        with pytest.raises(CommandRefused, match="lift: .* rad is not between"):
            run.live.command_joints(["lift"], [9.0])
    finally:
        run.live.close()


def test_positions_of_a_sliding_joint_are_metres() -> None:
    limits = JointLimits(("slide",), np.array([0.0]), np.array([0.5]), np.array([1.0]), 5.0, ("m",))
    goals = JointGoals(np.zeros(1), np.zeros(1), np.zeros(1))
    with pytest.raises(ValueError, match="slide: 0.6 m is not between 0 and 0.5 m"):
        goals.commanded(limits, [], [0.6])
    assert goals.commanded(limits, [], [0.5]).ends.tolist() == [0.5]
