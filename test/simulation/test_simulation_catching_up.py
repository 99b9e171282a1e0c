"""Bodies that waited for a touch make up for the time, and the service looks where they go after it."""

from __future__ import annotations

import numpy as np
import pytest

from fracture_collision.lockstep import Lockstep
from fracture_collision.simulation.catching_up import CATCH_UP, Waited, extra_times
from fracture_collision.simulation.engine import BodyStates
from fracture_collision.simulation.scene.scene import Scene, parse_scene
from fracture_collision.simulation.solver.contact_solver import BodyPairs
from fracture_collision.world import Settings

STEP = 0.01
APART, RADIUS = 0.5, 0.03


def between_walls(speed: float, duration: float) -> Scene:
    """A ball that flies to and fro without loss, at first from x = 0 to the right."""
    material = {"density": 1000.0, "friction": 0.0, "restitution": 1.0}
    wall = {"material": "steel", "static": True, "shape": {"box": {"size": [0.1, 1.0, 1.0]}}}
    right = 0.5 * APART + RADIUS + 0.05
    return parse_scene(
        {
            "gravity": [0.0, 0.0, 0.0], "time_step": STEP, "duration": duration, "materials": {"steel": material},
            "bodies": [
                {"name": "left", "position": [-right, 0.0, 0.0], **wall},
                {"name": "right", "position": [right, 0.0, 0.0], **wall},
                {"name": "ball", "material": "steel", "shape": {"sphere": {"radius": RADIUS}},
                 "linear_velocity": [speed, 0.0, 0.0]},
            ],
        },
        "walls",
    )  # fmt: skip


@pytest.mark.parametrize("speed", [1.0, 3.0, 7.0])
def test_a_ball_between_walls_is_never_late_by_more_than_two_steps(speed: float) -> None:
    """And never early: its way to each touch is the same, with up to thirty touches."""
    with Lockstep(between_walls(speed, 2.2), Settings(threads=1, lookahead=STEP)) as run:
        x = np.array([run.simulation._engine.states().centers[0, 0] for _ in run])
    flown = np.cumsum(np.abs(np.diff(x, prepend=0.0)))  # but for what turns within a step: it waits at walls
    due = speed * STEP * np.arange(1, len(x) + 1)
    touches = due[-1] / APART
    late = due - flown
    assert touches > 4.0
    assert late.max() < 2.0 * speed * STEP + 1e-9
    assert late.min() > -1e-4 * touches  # it turns by the rest gap before each wall


def test_the_only_body_may_leave_while_it_waits() -> None:
    with Lockstep(between_walls(3.0, 1.0), Settings(threads=1, lookahead=STEP)) as run:
        while not (run.simulation.shares < 1.0).any():
            run.step()
        run.simulation.take_out(3)
        run.step()
        assert not len(run.simulation._engine.states().masses)


def states(count: int, spins: list[float]) -> BodyStates:
    angular = np.zeros((count, 3))
    angular[:, 2] = spins
    nothing, turns = np.zeros((count, 3)), np.tile([0.0, 0.0, 0.0, 1.0], (count, 1))
    ids = np.arange(1, count + 1, dtype=np.uint32)
    return BodyStates(ids, np.ones(count), np.tile(np.eye(3), (count, 1, 1)), nothing, nothing, angular, nothing, turns)


def pairs(rows: list[tuple[int, int]]) -> BodyPairs:
    a, b = np.array(rows, np.int64).reshape(-1, 2).T
    zeros = np.zeros(len(rows))
    return BodyPairs(a.copy(), b.copy(), zeros, zeros, zeros, zeros)


def test_bodies_near_each_other_make_up_for_the_same_time() -> None:
    """For that of the one that lost least, but for those at rest; the ground, row 6, connects none."""
    lost = np.array([0.001, 0.002, 0.0, 0.5, 0.0, 0.001])
    at_rest = np.array([False, False, False, False, True, False])
    own = states(6, [0.0] * 6)
    waited = Waited(own, None, None, np.zeros(6, bool), np.zeros(6, bool), at_rest, lost)
    near = pairs([(0, 1), (3, 4), (2, 6), (5, 6)])
    extra, is_expected = extra_times(waited, own, np.zeros(6, bool), near, STEP)
    most = CATCH_UP * STEP
    assert extra.tolist() == [0.001, 0.001, 0.0, most, most, 0.001]
    assert is_expected.tolist() == [True, True, False, True, True, True]
    pushed = np.array([False, True, False, True, False, False])
    extra, _ = extra_times(waited, own, pushed, near, STEP)
    assert extra.tolist() == [0.0, 0.0, 0.0, 0.0, 0.0, 0.001]


def test_bodies_that_turn_far_in_a_step_do_not_move_for_longer() -> None:
    """Spheres do: whichever way they turn, their surface stays where it is."""
    lost, none = np.full(3, 0.001), np.zeros(3, bool)
    own = states(3, [1.0, 10.0, 10.0])
    waited = Waited(own, None, None, np.array([False, False, True]), none, none, lost)
    extra, is_expected = extra_times(waited, own, none, pairs([]), STEP)
    assert extra.tolist() == [0.001, 0.0, 0.001]
    assert is_expected.all()
