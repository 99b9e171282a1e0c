"""Lookahead contacts stop bodies exactly at the touch, neither earlier nor later, without reducing their speed.

Bodies that waited make up for the time, and the service looks where they go after the touch.
"""

from __future__ import annotations

import warnings
from typing import NamedTuple

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from worlds.small_scenes import ball, box, small_scene

from benchmarks.tunnelling import TIME_STEP, run_trial, scene_of
from fracture_collision.lockstep import Lockstep
from fracture_collision.records import ContactConstraintArray
from fracture_collision.simulation.catching_up import CATCH_UP, Waited, carried_contacts, extra_times
from fracture_collision.simulation.engine import BodyStates
from fracture_collision.simulation.scene.scene import Scene
from fracture_collision.simulation.solver.contact_solver import BodyPairs, SolverSettings
from fracture_collision.simulation.solver.side_by_side import Boxes, Motion, shares_side_by_side
from fracture_collision.simulation.solver.touch_ahead import StepContacts, Touches, shares_until_touch
from fracture_collision.world import Settings

REST, SPARE = 1e-4, 5e-4
LOSSLESS = {"density": 1000.0, "friction": 0.0, "restitution": 1.0}


def contacts(gaps: list[list[float]]) -> ContactConstraintArray:
    """Pairs (1, 2), (1, 3) ... with the given gaps along x."""
    counts, flat = [len(own) for own in gaps], np.array([gap for own in gaps for gap in own])
    n, zeros = len(flat), np.zeros(len(gaps))
    points = np.zeros((n, 3))
    points[:, 0] = flat
    return ContactConstraintArray(
        1, 0, 0, np.full(len(gaps), 1, np.uint32), np.arange(2, 2 + len(gaps), dtype=np.uint32),
        np.concatenate([[0], np.cumsum(counts)]).astype(np.uint32), zeros, zeros, zeros, np.zeros((n, 3)),
        points, np.tile([1.0, 0.0, 0.0], (n, 1)), flat, np.arange(n, dtype=np.uint64),
    )  # fmt: skip


class Ahead(NamedTuple):
    """Contacts ahead, one a row; bodies by their row, one beyond the last is static."""

    rows_a: list[int]
    rows_b: list[int]
    points_a: list
    points_b: list
    normals: list


def shares(ahead: Ahead, centers, velocities, is_turning=False, is_round=None) -> np.ndarray:
    """The share of a step of 10 ms that each body moves until it touches."""
    n, least = len(centers), np.full(len(ahead.rows_a), REST)
    places = (np.array(x, float) for x in (ahead.points_a, ahead.points_b, ahead.normals))
    touches = Touches(np.array(ahead.rows_a), np.array(ahead.rows_b), *places, least)
    spheres = np.zeros(n + 1, bool) if is_round is None else np.array(is_round)
    motion = Motion(np.array(centers, float), np.array(velocities, float), 0.01)
    return shares_until_touch(touches, motion, np.ones(n), is_turning, spheres)


def test_a_body_stops_behind_a_stopped_body() -> None:
    """The first body would never touch the second, but the second is stopped by a third: both stop."""
    points_a, points_b = [[0.0, 0.0, 0.0], [0.9, 0.0, 0.0]], [[0.85, 0.0, 0.0], [0.91, 0.0, 0.0]]
    ahead = Ahead([0, 1], [1, 2], points_a, points_b, [[1.0, 0.0, 0.0]] * 2)
    centers, moves = [[0.0] * 3, [0.9, 0.0, 0.0]], [[100.0, 0, 0, 0, 0, 0], [90.0, 0, 0, 0, 0, 0]]
    alone = shares(Ahead(*(column[:1] for column in ahead)), centers, moves)
    assert alone.tolist() == [1.0, 1.0]
    held = shares(ahead, centers, moves)
    gap = points_b[0][0] + 0.9 * held[1] - 1.0 * held[0]
    assert held[1] < 0.02 and gap >= 0.0


def test_rotating_points_stop_at_the_first_touch() -> None:
    """Against 10,000 times: a point of a body that rotates by about 4 radians stops where its path meets a wall."""
    random = np.random.default_rng(1)
    for _ in range(20):
        spin, move = random.normal(0.0, 250.0, 3), random.normal(0.0, 5.0, 3)
        point, normal = random.normal(0.0, 0.05, 3), random.normal(size=3)
        normal /= np.linalg.norm(normal)
        wall = point + random.uniform(0.01, 0.05) * normal
        own = shares(Ahead([0], [1], [point], [wall], [normal]), [[0.0] * 3], [[*move, *spin]])[0]
        moments = np.linspace(0.0, 1.0, 10001)
        path = Rotation.from_rotvec(0.01 * moments[:, None] * spin).apply(point) + 0.01 * moments[:, None] * move
        gaps = (wall - path) @ normal
        met = moments[np.argmax(gaps < REST)] if (gaps < REST).any() else 1.0
        assert own == pytest.approx(met, abs=2e-4)


@pytest.mark.parametrize("is_round", [True, False])
def test_contact_planes_rotate_with_their_body(is_round: bool) -> None:
    """A bar rotates by half a radian about its middle, and its face rotates with it into its neighbour.

    If that is a ball, the face is the bar's; otherwise it may belong to either, and the gap that closes first counts.
    """
    centers, moves = [[0.0] * 3, [0.1, 0.06, 0.0]], [[0, 0, 0, 0.0, 0.0, 50.0], [0.0] * 6]
    ahead = Ahead([0], [1], [[0.1, 0.01, 0.0]], [[0.1, 0.04, 0.0]], [[0.0, 1.0, 0.0]])
    own = shares(ahead, centers, moves, True, [False, is_round, False])
    angles = np.linspace(0.0, 0.5, 100001)
    point = 0.1 * np.cos(angles) - 0.01 * np.sin(angles), 0.1 * np.sin(angles) + 0.01 * np.cos(angles)
    gaps = -np.sin(angles) * (0.1 - point[0]) + np.cos(angles) * (0.04 - point[1])
    if not is_round:
        gaps = np.minimum(gaps, 0.04 - point[1])
    assert own == pytest.approx(np.full(2, angles[np.argmax(gaps < REST)] / 0.5), abs=1e-4)


def beside(
    shares: list[float], centers: list[list[float]], moves: np.ndarray, searched: np.ndarray | None = None
) -> np.ndarray:
    """Shares of the step for cubes of 4 cm, in a step of 2.5 ms."""
    count = len(shares)
    boxes = Boxes(np.tile(np.eye(3), (count, 1, 1)), np.full((count, 3), 0.02))
    motion = Motion(np.array(centers), moves, 0.0025)
    searched = moves if searched is None else searched
    return shares_side_by_side(np.array(shares), motion, searched, boxes, np.full(count, SPARE))


def test_bodies_beside_a_stopped_one_do_not_run_into_it() -> None:
    centers = [[0.0, 0.0, 0.0], [0.07, 0.0, 0.0], [0.14, 0.0, 0.0], [9.0, 0.0, 0.0], [0.0, 0.1, 0.0]]
    moves = np.zeros((5, 6))
    moves[:4, 0] = 20.0  # 5 cm a step; the last is at rest
    held = beside([1.0, 0.5, 0.1, 1.0, 1.0], centers, moves)
    assert held[2:].tolist() == [0.1, 1.0, 1.0] and (held[:2] > 0.2).all()
    gone = np.linspace(0.0, 1.0, 1001)
    paths = [at[0] + 0.05 * np.minimum(gone, share) for at, share in zip(centers, held, strict=True)]
    for behind, before in ((0, 1), (1, 2)):
        assert (paths[before] - paths[behind]).min() > 0.04 - SPARE


def test_a_body_does_not_run_into_one_that_a_blow_has_stopped() -> None:
    """The service knew that the first would move on before the second."""
    searched, moves = np.zeros((2, 6)), np.zeros((2, 6))
    searched[:, 0] = moves[1, 0] = 20.0
    held = beside([0.1, 1.0], [[0.07, 0.0, 0.0], [0.0, 0.0, 0.0]], moves, searched)
    assert 0.05 * held[1] < 0.03 + SPARE
    assert beside([1.0, 1.0], [[0.07, 0.0, 0.0], [0.0, 0.0, 0.0]], moves, searched).tolist() == [1.0, 1.0]


def test_bodies_that_move_away_from_or_past_a_stopped_one_are_not_stopped() -> None:
    away, past = np.zeros((2, 6)), np.zeros((2, 6))
    away[0, 0], away[1, :2] = 20.0, (-20.0, 5.0)
    past[:, 0] = 20.0
    assert beside([0.1, 1.0], [[0.07, 0.0, 0.0], [0.0, 0.0, 0.0]], away).tolist() == [0.1, 1.0]
    assert beside([0.1, 1.0], [[0.1, 0.12, 0.0], [0.0, 0.0, 0.0]], past).tolist() == [0.1, 1.0]


def test_bodies_rotate_by_the_published_angular_velocities() -> None:
    """By the angular velocities in the states, although a shard's spin axis precesses by a radian in a step."""
    with Lockstep(scene_of(10.0, 3, True), Settings(threads=1, lookahead=TIME_STEP)) as lockstep:
        told = [lockstep.step().states for _ in range(2)]
        told.append(lockstep.states())
    turns = [Rotation.from_quat(states.orientations[-1]) for states in told]
    gone = (turns[2] * turns[1].inv()).as_rotvec()
    np.testing.assert_allclose(gone, TIME_STEP * told[1].angular_velocities[-1], atol=1e-12)
    assert np.linalg.norm(told[1].angular_velocities[-1] - told[0].angular_velocities[-1]) > 0.1


@pytest.mark.parametrize("speed", [3.0, 30.0, 300.0])
def test_a_ball_bounces_off_a_thin_wall_at_its_speed(speed: float) -> None:
    wall = box("wall", [1.0, 0.005, 1.0], static=True)
    fast = ball("ball", 0.03, [0.0, -0.4, 0.0], linear_velocity=[0.0, speed, 0.0])
    duration = 0.0025 * (10 + int(0.8 / speed / 0.0025))
    scene = small_scene(LOSSLESS, wall, fast, gravity=0.0, duration=duration)
    farthest, moments = -1.0, []
    with Lockstep(scene) as lockstep:  # looks ahead by a time step unless told otherwise
        for exchange in lockstep:
            farthest = max(farthest, float(exchange.states.positions[-1, 1]))
            moments.append(exchange.report.kinetic_energy)
        velocity = exchange.states.linear_velocities[-1]
    assert -0.0335 < farthest <= -0.0325 + 1e-12  # it touches and goes no farther, up to rounding
    assert velocity == pytest.approx([0.0, -speed, 0.0], rel=1e-9, abs=1e-9)
    assert max(moments) <= moments[0] * (1.0 + 1e-12)


def test_a_shard_does_not_go_through_a_plate() -> None:
    scenes = [scene_of(50.0, seed, is_fixed) for seed in range(6) for is_fixed in (True, False)]
    ahead = [run_trial(scene, TIME_STEP) for scene in scenes]
    assert not any(trial.is_through for trial in ahead)
    assert max(trial.energy_gain for trial in ahead) < 1e-12
    assert sum(run_trial(scene, 0.0).is_through for scene in scenes) > 6


def test_a_service_that_does_not_look_ahead_by_a_step_is_warned_of_once_per_change() -> None:
    scene = scene_of(10.0, 3, True)
    with Lockstep(scene, Settings(threads=1, lookahead=0.5 * TIME_STEP)) as run:
        with pytest.warns(UserWarning, match=f"a lookahead of {0.5 * TIME_STEP:g} s, but .* its time step") as told:
            for _ in range(3):
                run.step()
        assert len(told) == 1 and f"Settings(lookahead={TIME_STEP:g})" in str(told[0].message)
        run.world.change_settings(Settings(threads=1, lookahead=2.0 * TIME_STEP))
        with pytest.warns(UserWarning, match="that do not come about within a step") as told:
            for _ in range(3):
                run.step()
        assert len(told) == 1
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            run.world.change_settings(Settings(threads=1, lookahead=1.0004 * TIME_STEP))  # written with few digits
            for _ in range(3):
                run.step()
        run.world.change_settings(Settings(threads=1))
        with pytest.warns(UserWarning, match="a lookahead of 0 s, .* fast bodies may pass through others"):
            run.step()


def test_a_simulation_that_does_not_count_on_a_lookahead_takes_any() -> None:
    with Lockstep(scene_of(10.0, 3, True), Settings(threads=1)) as run, warnings.catch_warnings():
        warnings.simplefilter("error")
        run.step()
        run.world.change_settings(Settings(threads=1, lookahead=0.5 * TIME_STEP))
        run.step()


STEP = 0.01
APART, RADIUS = 0.5, 0.03


def between_walls(speed: float, duration: float) -> Scene:
    """A ball that flies to and fro without loss, at first from x = 0 to the right."""
    right = 0.5 * APART + RADIUS + 0.05
    walls = [box(f"wall at {x}", [0.1, 1.0, 1.0], [x, 0.0, 0.0], static=True) for x in (-right, right)]
    thrown = ball("ball", RADIUS, linear_velocity=[speed, 0.0, 0.0])
    return small_scene(LOSSLESS, *walls, thrown, gravity=0.0, time_step=STEP, duration=duration)


@pytest.mark.parametrize("speed", [1.0, 3.0, 7.0])
def test_a_ball_between_walls_is_never_late_by_more_than_two_steps(speed: float) -> None:
    """And never early: its way to each touch is the same, with up to thirty touches."""
    with Lockstep(between_walls(speed, 2.2), Settings(threads=1, lookahead=STEP)) as run:
        x = np.array([run.simulation.dynamics.states().centers[0, 0] for _ in run])
    flown = np.cumsum(np.abs(np.diff(x, prepend=0.0)))  # but for what turns within a step: it waits at walls
    due = speed * STEP * np.arange(1, len(x) + 1)
    touches = due[-1] / APART
    late = due - flown
    assert touches > 4.0
    assert late.max() < 2.0 * speed * STEP + 1e-9
    assert late.min() > -1e-4 * touches  # it turns by the rest gap before each wall


def test_the_only_body_may_leave_while_it_waits() -> None:
    with Lockstep(between_walls(3.0, 1.0), Settings(threads=1, lookahead=STEP)) as run:
        while not (run.simulation.dynamics.shares < 1.0).any():
            run.step()
        run.simulation.take_out(3)
        run.step()
        assert not len(run.simulation.dynamics.states().masses)


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
    near = contacts([[0.0]] * 4), pairs([(0, 1), (3, 4), (2, 6), (5, 6)])
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
    extra, is_expected = extra_times(waited, own, none, (contacts([]), pairs([])), STEP)
    assert extra.tolist() == [0.001, 0.0, 0.001]
    assert not is_expected.any()  # nothing touches them: they fly on as they did


def test_contacts_of_earlier_steps_are_dropped_once_bodies_have_left_each_other() -> None:
    """One whose bodies open along the normal stays up to `ahead_gap`, one whose bodies have slid apart does not."""
    settings, own, none = SolverSettings(), states(4, [0.0] * 4), np.zeros(4, bool)
    most = settings.ahead_gap  # of bodies of 1 m
    earlier = contacts([[0.5 * most], [0.5 * most, -0.1]])
    earlier.points_b[1:, 1] = 2.0 * most
    rows = pairs([(0, 1), (0, 2)])
    rows = rows._replace(sizes=np.ones(2), rest_gaps=np.zeros(3))
    now = contacts([]), pairs([]), contacts([]), pairs([])
    waited = Waited(own, StepContacts(*now), (earlier, rows), none, none, none, np.zeros(4))
    kept, kept_rows = carried_contacts(waited, own, settings)
    assert kept.contact_ids.tolist() == [0]
    assert kept_rows.body_b.tolist() == [1]
