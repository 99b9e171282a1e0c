"""A robot arm in a scene: it follows commands, breaks what it hits, and never exceeds its force limit."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree

import numpy as np
import pybullet
import pybullet_data
import pytest
from scipy.spatial.transform import Rotation
from worlds.served_scene import PlayedScene

from fracture_collision.lockstep import Exchange, Lockstep
from fracture_collision.share import share_directory
from fracture_collision.simulation.actors.arm import (
    JOINTS,
    MOVING,
    PARTS,
    URDF,
    ArmKinematics,
    Part,
    link_frames,
    read_chain,
    require_within,
)
from fracture_collision.simulation.config.shapes import Shape
from fracture_collision.simulation.live import CommandRefused
from fracture_collision.simulation.rotations import from_euler_angles
from fracture_collision.simulation.scene.scene import Scene, SceneError, load_scene, parse_scene
from fracture_collision.world import Settings

ORIGIN, UPRIGHT = np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0])
TOOL = PARTS[-1].name
POSTURE = [0.0, 50.0, 0.0, -70.0, 0.0, -40.0, 0.0]
GROUND = {"name": "ground", "material": "metal", "static": True, "shape": {"plane": {"coefficients": [0, 0, 1, 0]}}}


def scene(swing, duration=1.0, bodies=(GROUND,), **arm) -> Scene:
    return parse_scene(
        {
            "time_step": 0.0025, "duration": duration, "materials": {"metal": {"density": 1000.0, "friction": 0.4}},
            "bodies": list(bodies), "arm": {"material": "metal", "swing": swing, **arm},
        },
        "armed",
    )  # fmt: skip


@pytest.fixture(scope="module")
def kinematics() -> ArmKinematics:
    return ArmKinematics(ORIGIN, UPRIGHT)


def places(what: Scene, states) -> np.ndarray:
    """Positions of the moving parts, (n, 3) [m]."""
    ids = [1 + [body.name for body in what.bodies].index(part.name) for part in MOVING]
    return states.positions.reshape(-1, 3)[np.searchsorted(states.fragment_ids, ids)]


class Smashed(NamedTuple):
    scene: Scene
    exchanges: tuple[Exchange, ...]
    lags: np.ndarray  # (steps,) [m] largest position error of a part
    asked: np.ndarray  # (steps, 7) [rad] commanded joint angles


@cache
def smashed() -> Smashed:
    """The package's scene, until 0.4 s after the impact."""
    what = load_scene("vase")
    exchanges, lags, asked = [], [], []
    kinematics = ArmKinematics(ORIGIN, UPRIGHT)
    with Lockstep(what._replace(duration=1.5), Settings(threads=1)) as run:
        for exchange in run:
            exchanges.append(exchange)
            asked.append(run.simulation.arm.angles)
            expected = kinematics.places(asked[-1])[0]
            lags.append(np.linalg.norm(places(what, run.states()) - expected, axis=1).max())
    return Smashed(what, tuple(exchanges), np.array(lags), np.array(asked))


# --- kinematics ------------------------------------------------------------------------------------------------------


def test_poses_of_the_arm_equal_those_of_bullet() -> None:
    """Bullet computes in single precision."""
    position, orientation = np.array([0.1, -0.2, 0.3]), from_euler_angles(np.array([0.3, -0.4, 2.0]))
    chain = read_chain(share_directory() / URDF)
    client = pybullet.connect(pybullet.DIRECT)
    try:
        arm = pybullet.loadURDF(
            str(share_directory() / URDF), position.tolist(), orientation.tolist(), useFixedBase=True,
            physicsClientId=client,
        )  # fmt: skip
        told = [pybullet.getJointInfo(arm, j, physicsClientId=client) for j in range(JOINTS)]
        for limits, column in zip(chain.limits, (1, 8, 9, 11), strict=True):
            assert list(limits) == [each.decode() if column == 1 else each for each in (row[column] for row in told)]
        for angles in np.random.default_rng(3).uniform(-2.0, 2.0, (5, JOINTS)):
            for j, angle in enumerate(angles.tolist()):
                pybullet.resetJointState(arm, j, angle, physicsClientId=client)
            states = pybullet.getLinkStates(arm, range(JOINTS), computeForwardKinematics=1, physicsClientId=client)
            origins, turns = link_frames(chain, position, orientation, angles)
            np.testing.assert_allclose(origins, [state[4] for state in states], atol=1e-6)
            expected = Rotation.from_quat([state[5] for state in states])
            assert (Rotation.from_quat(turns) * expected.inv()).magnitude().max() < 1e-6
            places = [origins[part.link - 1] + expected[part.link - 1].apply(part.center) for part in MOVING]
            np.testing.assert_allclose(ArmKinematics(position, orientation).places(angles)[0], places, atol=1e-6)
    finally:
        pybullet.disconnect(client)


def test_the_urdf_has_the_geometry_of_the_parts() -> None:
    """Once to be shown and once to collide, in the frames of its links."""
    links = ElementTree.parse(share_directory() / URDF).getroot().findall("link")
    for tag in ("visual", "collision"):
        found = []
        for number, link in enumerate(links):
            for element in link.findall(tag):
                origin, (shape,) = element.find("origin"), element.find("geometry")
                center = tuple(map(float, origin.get("xyz").split()))
                assert origin.get("rpy") == "0 0 0"
                size = tuple(map(float, shape.get("size").split())) if shape.tag == "box" else ()
                made = Shape(shape.tag, size=size, radius=float(shape.get("radius", 0.0)))
                found.append(Part(element.get("name"), number, center, made))
        assert tuple(found) == PARTS


def test_collision_parts_cover_the_meshes_of_the_links() -> None:
    for link in range(1, JOINTS + 1):
        file = Path(pybullet_data.getDataPath(), "kuka_iiwa", "meshes", f"link_{link}.obj")
        rows = [line.split()[1:4] for line in file.read_text().splitlines() if line.startswith("v ")]
        vertices = np.array(rows, np.float64)
        spheres = [part for part in MOVING if part.link == link and part.shape.kind == "sphere"]
        outside = [np.linalg.norm(vertices - part.center, axis=1) - part.shape.radius for part in spheres]
        assert np.min(outside, axis=0).max() < 0.035


def test_a_scene_places_the_arm(kinematics: ArmKinematics) -> None:
    what = scene([[0.0, *POSTURE]], position=[1.0, 2.0, 0.5], rotation=[0.0, 0.0, 90.0])
    here = {body.name: body for body in what.bodies}
    x, y, z = kinematics.places(np.radians(POSTURE))[0][-1]
    np.testing.assert_allclose(here[TOOL].position, [1.0 - y, 2.0 + x, 0.5 + z], atol=1e-9)
    np.testing.assert_allclose(here[PARTS[0].name].position, [1.0, 2.0, 0.579], atol=1e-9)
    assert [body.name for body in what.bodies if body.is_static] == ["ground", PARTS[0].name]


# --- a swing ---------------------------------------------------------------------------------------------------------


def test_the_vase_breaks_at_the_impact_and_not_before() -> None:
    run = smashed()
    vase = 1 + [body.name for body in run.scene.bodies].index("vase")
    arm = {1 + [body.name for body in run.scene.bodies].index(part.name) for part in MOVING}
    broken = next(i for i, each in enumerate(run.exchanges) if each.report.events)
    assert run.exchanges[broken].report.events[0].fragment_id == vase
    touching = [
        i
        for i, each in enumerate(run.exchanges[: broken + 1])
        for a, b in zip(each.contacts.fragment_a, each.contacts.fragment_b, strict=True)
        if (a == vase and b in arm) or (b == vase and a in arm)
    ]
    assert touching and 0 <= broken - touching[0] <= 3, "as soon as they touch"
    assert run.exchanges[-1].report.fragments > 12 + len(MOVING)


def test_the_arm_follows_its_swing_exactly_and_yields_by_millimetres_at_an_impact() -> None:
    run = smashed()
    broken = next(i for i, each in enumerate(run.exchanges) if each.report.events)
    assert run.lags[: broken - 2].max() < 1e-9
    assert 1e-4 < run.lags[broken:].max() < 0.03 and run.lags[-1] < 1e-6
    steps = np.diff(run.asked, axis=0) / run.scene.time_step
    assert np.abs(steps).max() <= run.scene.arm.settings.speed_limit + 1e-9


def test_energy_rises_by_no_more_than_the_work_of_the_arm() -> None:
    run = smashed()
    reports = [each.report for each in run.exchanges]
    energy = np.array([report.kinetic_energy + report.potential_energy for report in reports])
    rise = np.diff(energy) - [report.hand_energy + report.drift_energy for report in reports[1:]]
    broken = next(i for i, report in enumerate(reports) if report.events)
    assert np.ptp(energy[:broken]) > 5.0
    # once the vase has settled on its plinth
    assert np.abs(rise[5 : broken - 3]).max() < 1e-12 * energy.max(), "nothing is hit: it is just that"
    assert rise.max() < 2e-5 * energy.max()


def test_parts_of_the_arm_do_not_push_each_other() -> None:
    """They overlap by centimetres and the service reports it; at rest no energy is spent and nothing moves."""
    what = scene([[0.0, *POSTURE]], 0.2)
    with Lockstep(what, Settings(threads=1)) as run:
        exchanges = list(run)
        moved = places(what, run.states()) - places(what, exchanges[0].states)
    assert exchanges[-1].contacts.gaps.min() < -0.02 and exchanges[-1].report.deepest_gap == 0.0
    assert np.abs(moved).max() < 1e-12
    assert max(abs(each.report.hand_energy) for each in exchanges) < 1e-9


def test_an_obstructed_arm_presses_with_its_force_and_waits() -> None:
    """Against a wall in its way: no part lags by more than 1.5 times the limit, and the arm comes to rest."""
    wall = {"name": "wall", "material": "metal", "static": True, "position": [0.8, 0.2, 0.4],
            "shape": {"box": {"size": [0.8, 0.1, 0.8]}}}  # fmt: skip
    swing = [[0.0, -30.0, *POSTURE[1:]], [1.0, 60.0, *POSTURE[1:]]]
    what = scene(swing, 2.0, (GROUND, wall))
    with Lockstep(what, Settings(threads=1)) as run:
        reports = [each.report for each in run]
        asked = run.simulation.arm.angles
        tool = places(what, run.states())
    assert np.degrees(asked[0]) < 30.0, "it did not get through"
    kinematics = ArmKinematics(ORIGIN, UPRIGHT)
    lags = np.linalg.norm(tool - kinematics.places(asked)[0], axis=1)
    assert 1e-3 < lags.max() < 1.5 * what.arm.settings.lag_limit
    assert tool[:, 1].max() < 0.2 and min(report.deepest_gap for report in reports) > -0.02
    assert reports[-1].max_speed < 0.05


# --- commands --------------------------------------------------------------------------------------------------------


class Played(PlayedScene):
    def follow(self, count: int) -> tuple[list[int], np.ndarray]:
        """Number of fragments at each step, and joint angles (count, 7)."""
        fragments, angles = [], []
        for _ in range(count):
            fragments.append(self.step().fragments)
            angles.append(self.simulation.arm.angles)
        return fragments, np.array(angles)


@pytest.fixture(params=[True, False], ids=["looking ahead", "not looking ahead"])
def played(request: pytest.FixtureRequest) -> Iterator[Played]:
    made = Played("vase", request.param)
    yield made
    made.live.close()


def test_the_arm_follows_commands_within_its_limits(played: Played) -> None:
    still = played.follow(40)[1]
    assert np.ptp(still, axis=0).max() == 0.0, "nobody swings but the person"
    settings, h = load_scene("vase").arm.settings, 0.0025
    played.live.command_joints(["lbr_iiwa_joint_1", "lbr_iiwa_joint_4"], [-2.0, -1.0])
    angles = np.vstack((still[-1:], played.follow(400)[1]))
    goal = still[-1].copy()
    goal[[0, 3]] = -2.0, -1.0
    np.testing.assert_allclose(angles[-1], goal, atol=1e-9)
    speeds = np.diff(angles, axis=0) / h
    assert np.abs(speeds).max() <= settings.speed_limit + 1e-9
    changes = np.abs(np.diff(np.vstack((np.zeros(JOINTS), speeds)), axis=0))
    assert changes.max() <= 1.5 * settings.acceleration_limit * h
    assert (np.sign(goal - still[-1]) * speeds >= -1e-9).all(), "straight there"
    assert played.live.simulation.arm.speeds.max() == 0.0


def test_joint_commands_break_the_vase(played: Played) -> None:
    whole = played.follow(10)[0][-1]
    arm = played.live.simulation.arm
    played.live.command_joints([], np.radians([-60.0, 60.0, 0.0, -80.0, 0.0, -50.0, 0.0]))
    assert set(played.follow(200)[0]) == {whole}
    played.live.command_joints([arm.limits.names[0]], [1.0])
    assert played.follow(250)[0][-1] > whole + 10


@pytest.mark.parametrize(
    ("names", "positions", "words"),
    [
        ([], [0.0] * 6, "position: 6 values for 7 joints"),
        (["elbow"], [0.0], "no joint 'elbow'; there are lbr_iiwa_joint_1"),
        (["lbr_iiwa_joint_1"], [float("nan")], "lbr_iiwa_joint_1: nan is not finite"),
        (["lbr_iiwa_joint_2"], [2.2], "lbr_iiwa_joint_2: 2.2 rad is not between -2.094 and 2.094 rad"),
        (["lbr_iiwa_joint_1"] * 2, [0.1, 0.2], "a joint occurs twice"),
        (["lbr_iiwa_joint_1"], [], "position: 0 values for 1 joints"),
    ],
)
def test_invalid_arguments_are_rejected_with_an_explanation(played: Played, names, positions, words: str) -> None:
    before = played.follow(2)[1][-1]
    with pytest.raises(CommandRefused, match=words):
        played.live.command_joints(names, positions)
    assert np.array_equal(played.follow(5)[1][-1], before)


def row(time: float = 0.0, **angles: float) -> list[float]:
    return [time, *[angles.get(f"joint_{j}", 0.0) for j in range(1, JOINTS + 1)]]


@pytest.mark.parametrize(
    ("arm", "words"),
    [
        ({"swing": []}, "arm.swing: needs the name of a CSV file, or a list of rows"),
        ({"swing": [[0.0, 1.0]]}, r"arm.swing\[0\]: needs time, joint_1"),
        ({"swing": [[0.0]]}, r"arm.swing\[0\]: needs time, joint_1"),
        ({"swing": [{"time": 0.0}]}, r"arm.swing\[0\]: needs time, joint_1"),
        ({"swing": [row(joint_3=10**400)]}, r"arm.swing\[0\]: needs time, joint_1"),
        ({"swing": [row(), row()]}, r"arm.swing\[1\]: time 0.0 s does not follow 0.0 s"),
        ({"swing": [row(joint_3=float("inf"))]}, r"arm.swing\[0\]: needs finite numbers"),
        ({"swing": [row(joint_6=121.0)]}, r"arm.swing\[0\]: lbr_iiwa_joint_6: 2.112 rad is not between"),
        ({"swing": [row(), row(0.1, joint_1=90.0)]}, r"arm.swing: lbr_iiwa_joint_1 turns with .* more than 3 rad/s"),
        ({"swing": "nowhere.csv"}, "arm.swing: nowhere.csv: no such file"),
        ({"swing": [row()], "force_limit": 0.0}, "arm.force_limit: needs more than 0"),
        ({"swing": [row()], "colour": "orange"}, "arm.colour: unknown field"),
        ({"swing": [row()], "material": "butter"}, "arm.material: 'butter' is none of metal"),
    ],
)
def test_invalid_arms_are_rejected_with_an_explanation(arm, words: str) -> None:
    with pytest.raises(SceneError, match=words):
        scene(**arm)


def test_a_swing_may_be_read_from_a_file(tmp_path, kinematics: ArmKinematics) -> None:
    lines = ["# degrees", "time,joint_1,joint_2,joint_3,joint_4,joint_5,joint_6,joint_7", "0,0,50,0,-70,0,-40,0"]
    (tmp_path / "swing.csv").write_text("\n".join([*lines, "1,20,50,0,-70,0,-40,0"]) + "\n")
    content = {
        "time_step": 0.01, "duration": 1.0, "materials": {"metal": {"density": 1000.0, "friction": 0.4}},
        "bodies": [GROUND], "arm": {"material": "metal", "swing": "swing.csv"},
    }  # fmt: skip
    arm = parse_scene(content, "armed", folder=tmp_path).arm
    swing = arm.swing()
    np.testing.assert_allclose(np.degrees(swing(1.0)), [20.0, *POSTURE[1:]])
    np.testing.assert_allclose(np.degrees([swing(-1.0)[0], swing(0.5)[0], swing(9.0)[0]]), [0.0, 10.0, 20.0])
    require_within(kinematics.limits, swing(0.5))
