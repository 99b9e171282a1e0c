"""Lookahead contacts: the slow twin advances in small steps and queries the contacts at each."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from worlds.fractured_worlds import FracturedWorld, fractured_world, with_settings
from worlds.hard_worlds import tetrahedral_body

from fracture_collision.core.lookahead.motion import Motion, put_pose, put_way
from fracture_collision.core.lookahead.staying_apart import least_gap_ahead
from fracture_collision.core.memory import kinds
from fracture_collision.core.memory.pools import SIZE, Pools
from fracture_collision.core.pair import narrow_phase
from fracture_collision.core.search.scratch import Scratch
from fracture_collision.core.separation.approach import WAY, nearer_along
from fracture_collision.geometry.generators import ball, brick, shell
from fracture_collision.records import (
    BOX,
    BUDGET_EXHAUSTED,
    SPHERE,
    CollisionBody,
    ContactConstraintArray,
    FragmentStates,
    SolidPrimitive,
)
from fracture_collision.world import CollisionWorld, InvalidMessage, Settings, collision_world

AHEAD = 0.02  # [s]
SETTINGS = Settings(threads=1, lookahead=AHEAD)
MOMENTS = 400
BALL, BLOCK, FLOOR = 3000, 3001, 3002
SIZES = {BALL: 0.3, BLOCK: 0.25, FLOOR: np.inf}  # [m] R; 1 m for all others


@pytest.fixture(scope="module", params=["ball", "shell, curved"])
def case(request) -> FracturedWorld:
    if request.param == "ball":
        return fractured_world(ball(1.0, 0.35), 5)
    return fractured_world(shell(1.0, 0.8, 0.35), 5, curved=True)


def with_others(case: FracturedWorld, settings: Settings) -> CollisionWorld:
    world = with_settings(case, settings)
    world.add_body(CollisionBody(BALL, BALL, primitive=SolidPrimitive(SPHERE, (0.3,)), density=1000.0))
    world.add_body(CollisionBody(BLOCK, BLOCK, primitive=SolidPrimitive(BOX, (0.5, 0.4, 0.3)), density=1000.0))
    world.add_body(CollisionBody(FLOOR, FLOOR, plane=np.array([0.0, 0.0, 1.0, 2.5]), is_static=True))
    return world


def thrown(case: FracturedWorld, seed: int, spin: float) -> FragmentStates:
    """All fragments, a ball and a block, packed closely and moving at random: 4 to 40 % of R in AHEAD."""
    random = np.random.default_rng(seed)
    pieces = case.states(0.0)
    ids = np.append(pieces.fragment_ids, [BALL, BLOCK]).astype(np.uint32)
    n = len(ids)
    centers = np.concatenate([case.world.fragments().centers_of_mass.reshape(-1, 3), np.zeros((2, 3))])
    known = case.world.fragments().fragment_ids.tolist()
    centers = np.array([centers[known.index(i)] if i in known else np.zeros(3) for i in ids.tolist()])
    places = np.concatenate([0.1 * centers[:-2], random.normal(0.0, 1.2, (2, 3))])
    turns = Rotation.from_rotvec(random.normal(0.0, 0.1, (n, 3)))
    linear = random.normal(size=(n, 3))
    linear *= random.uniform(2.0, 20.0, (n, 1)) / np.linalg.norm(linear, axis=1)[:, None]
    return FragmentStates(
        pieces.step + seed, pieces.fracture_sequence, ids, places.ravel(), turns.as_quat().ravel(), linear.ravel(),
        random.normal(0.0, spin, (n, 3)).ravel(),
    )  # fmt: skip


def later(world: CollisionWorld, states: FragmentStates, t: float) -> FragmentStates:
    """The states after `t` [s]: centres of mass move straight, and each body rotates about its own."""
    registry = world.fragments()
    centers = dict(zip(registry.fragment_ids.tolist(), registry.centers_of_mass.reshape(-1, 3), strict=True))
    arms = np.array([centers[i] for i in states.fragment_ids.tolist()])
    turns = Rotation.from_quat(states.orientations.reshape(-1, 4))
    spins = states.angular_velocities.reshape(-1, 3)
    offset = turns.apply(arms)
    linear = states.linear_velocities.reshape(-1, 3) + np.cross(spins, offset)
    after = Rotation.from_rotvec(spins * t) * turns
    places = states.positions.reshape(-1, 3) + offset + t * linear - after.apply(arms)
    return states._replace(positions=places.ravel(), orientations=after.as_quat().ravel())


def rows_of(answer: ContactConstraintArray) -> dict[tuple[int, int], slice]:
    pairs = zip(answer.fragment_a.tolist(), answer.fragment_b.tolist(), strict=True)
    begin = answer.pair_begin.tolist()
    return {pair: slice(begin[k], begin[k + 1]) for k, pair in enumerate(pairs) if begin[k + 1] > begin[k]}


@pytest.mark.parametrize(("spin", "surfaces"), [(0.0, "sampled"), (10.0, "sampled"), (10.0, "edges")])
def test_lists_what_the_slow_way_meets(case: FracturedWorld, spin: float, surfaces: str) -> None:
    """A separate pair is listed if it will be deeper than epsilon, with points that meet at the time of contact."""
    settings = SETTINGS._replace(surfaces=surfaces)
    world, now = with_others(case, settings), with_others(case, settings._replace(lookahead=0.0))
    met = unmet = unfollowed = 0
    for seed in range(10):
        states = thrown(case, seed, spin)
        listed, touching = world.contacts(states), rows_of(now.contacts(states))
        ahead = {pair: rows for pair, rows in rows_of(listed).items() if pair not in touching}
        first, deep = slow_way(now, states)
        unfollowed += unlisted(listed, deep - touching.keys() - ahead.keys())
        reach = 2.0 * 0.002 + 0.3 * (20.0 + spin) * AHEAD / MOMENTS
        for pair, rows in ahead.items():
            assert pair in first or listed.gaps[rows].min() > 0.0
            if pair not in first:
                unmet += 1
                continue
            there = _moved_points(now, states, listed, pair, rows, first[pair])
            assert np.linalg.norm(there[0] - there[1], axis=1).min() < reach
            assert listed.gaps[rows].max() > 0.0
            met += 1
    # a pair that only grazes the tolerance may touch between two time steps of one method and not of the other
    assert met > 10 and unmet <= 1 and unfollowed <= 1


def test_what_spins_fast_is_not_missed(case: FracturedWorld) -> None:
    """Rotation by three radians in AHEAD: the paths of its points are far from straight."""
    world, now = with_others(case, SETTINGS), with_others(case, SETTINGS._replace(lookahead=0.0))
    met = unfollowed = 0
    for seed in range(10):
        states = thrown(case, seed, 150.0)
        listed, touching = world.contacts(states), rows_of(now.contacts(states))
        _, deep = slow_way(now, states)
        unfollowed += unlisted(listed, deep - touching.keys() - rows_of(listed).keys())
        met += len(deep - touching.keys())
    assert met > 30 and unfollowed <= 1


@pytest.mark.parametrize("spin", [0.0, 10.0, 150.0])
def test_a_gap_is_never_less_than_what_is_known_of_it(
    case: FracturedWorld, spin: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The lower bound along random directions against the gap at 200 times; without spin it equals their minimum."""
    (pools, rows, rotations, positions, pairs), scratch, motion = _query(case, spin, monkeypatch)
    random, known = np.random.default_rng(1), []
    for i, j in pairs[:40]:
        a, b = rows[i], rows[j]
        if {pools.fragment.kind[a], pools.fragment.kind[b]} & {kinds.PLANE, kinds.SPHERE}:
            continue
        n = random.normal(size=3)
        n /= np.linalg.norm(n)
        ways = []
        for f, k, sign in ((a, i, 1.0), (b, j, -1.0)):
            points = _leaf_points(pools, f)
            ways.append([])
            for t in np.linspace(0.0, AHEAD, 200):
                turn, place = np.zeros((3, 3)), np.zeros(3)
                put_pose(motion, rotations, positions, k, t, turn, place)
                ways[-1].append(sign * (sign * (points @ turn.T + place) @ n).min())
        gaps = np.subtract(*ways)
        pair = Pair(a, b, scratch.rotation, scratch.translation)
        moving = Moving(i, j, step.rotations, step.positions, motion)
        least = least_gap_ahead(pools, pair, moving, 0.0, gaps[0], tuple(n), 0.0, scratch)
        assert least <= gaps.min() + 1e-12
        assert spin > 0.0 or least > gaps.min() - 1e-5
        known.append(gaps.min() - least)
    assert len(known) > 10 and (spin > 10.0 or np.median(known) < 0.05)


@pytest.mark.parametrize("spin", [0.0, 10.0, 150.0])
def test_no_point_comes_nearer_than_its_way_says(
    case: FracturedWorld, spin: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Relative motion along random directions against 200 times of a part of AHEAD; without spin the bound is exact."""
    (pools, rows, rotations, positions, pairs), _, motion = _query(case, spin, monkeypatch)
    random, way, unused = np.random.default_rng(2), np.zeros(WAY), []
    start, time = 0.3 * AHEAD, 0.4 * AHEAD
    for i, j in pairs[:40]:
        if pools.fragment.kind[rows[i]] in {kinds.PLANE, kinds.SPHERE}:
            continue
        points, seen = _leaf_points(pools, rows[i]), []
        for t in np.linspace(start, start + time, 200):
            own, other = (np.zeros((3, 3)), np.zeros(3)), (np.zeros((3, 3)), np.zeros(3))
            put_pose(motion, rotations, positions, i, t, *own)
            put_pose(motion, rotations, positions, j, t, *other)
            seen.append((points @ own[0].T + own[1] - other[1]) @ other[0])
        put_pose(motion, rotations, positions, j, start, *other)
        put_way(motion, i, j, start, AHEAD - start, time, other[0], way)
        for n in random.normal(size=(5, 3)):
            n /= np.linalg.norm(n)
            nearer, most = ((seen[0] - seen) @ n).max(), nearer_along(way, *n)
            assert nearer <= most + 1e-12
            assert spin > 0.0 or most < nearer + 1e-9
            unused.append(most - nearer)
    assert len(unused) > 50


def _query(
    case: FracturedWorld, spin: float, monkeypatch: pytest.MonkeyPatch
) -> tuple[tuple[Pools, np.ndarray, np.ndarray, np.ndarray, np.ndarray], Scratch, Motion]:
    """What query_pairs gets: (pools, rows, rotations, positions, pairs), scratch and motion."""
    asked = []
    monkeypatch.setattr(collision_world, "query_pairs", lambda *a: asked.append(a) or narrow_phase.query_pairs(*a))
    with_others(case, SETTINGS).contacts(thrown(case, 0, spin))
    return asked[0][:5], asked[0][10], asked[0][16]


def _leaf_points(pools: Pools, row: int) -> np.ndarray:
    """(n, 3) float64 [m]: points of the leaves of a fragment's tree."""
    begin, end = pools.fragment.tree_begin[row], pools.fragment.tree_end[row]
    return pools.tree.spheres[begin:end][pools.tree.entries[begin:end, SIZE] == 1, :3]


def slow_way(now: CollisionWorld, states: FragmentStates) -> tuple[dict[tuple[int, int], float], set[tuple[int, int]]]:
    """The pairs that touch and when first [s], and the pairs that are deeper than epsilon at some time."""
    first: dict[tuple[int, int], float] = {}
    deep = set()
    for k in range(1, MOMENTS + 1):
        t = AHEAD * k / MOMENTS
        there = now.contacts(later(now, states, t))
        for pair, rows in rows_of(there).items():
            first.setdefault(pair, t)
            if there.gaps[rows].min() < -SETTINGS.penetration_tolerance * min(SIZES.get(f, 1.0) for f in pair):
                deep.add(pair)
    return first, deep


def unlisted(listed: ContactConstraintArray, pairs: set[tuple[int, int]]) -> int:
    """The number of pairs; asserts that each was cut short by the budget and has a bound."""
    for pair in pairs:
        assert listed.status == BUDGET_EXHAUSTED and bound_of(listed, pair) > 0.01, pair
    return len(pairs)


def bound_of(answer: ContactConstraintArray, pair: tuple[int, int]) -> float:
    at = np.flatnonzero((answer.fragment_a == pair[0]) & (answer.fragment_b == pair[1]))
    return float(answer.missed_depth_bound[at].max(initial=0.0))


def _moved_points(world, states, answer, pair, rows, t) -> list[np.ndarray]:
    """Points of a pair's contacts on a and on b, each moved with its fragment until `t` [s]."""
    there, found = later(world, states, t), []
    for fragment, points in zip(pair, (answer.points_a, answer.points_b), strict=True):
        p = points.reshape(-1, 3)[rows]
        k = np.flatnonzero(states.fragment_ids == fragment)
        if len(k):
            (turn, place), (later_turn, later_place) = (_pose_of(each, k[0]) for each in (states, there))
            p = later_turn.apply(turn.inv().apply(p - place)) + later_place
        found.append(p)
    return found


def _pose_of(states: FragmentStates, k: int) -> tuple[Rotation, np.ndarray]:
    return Rotation.from_quat(states.orientations.reshape(-1, 4)[k]), states.positions.reshape(-1, 3)[k]


def test_gaps_are_along_the_normals(case: FracturedWorld) -> None:
    answer = with_others(case, SETTINGS).contacts(thrown(case, 1, 10.0))
    normals = answer.normals.reshape(-1, 3)
    apart = (answer.points_b - answer.points_a).reshape(-1, 3)
    assert np.abs((normals * apart).sum(axis=1) - answer.gaps).max() < 1e-12
    assert np.abs(np.linalg.norm(normals, axis=1) - 1.0).max() < 1e-12
    assert len(answer.contact_ids) == len(np.unique(answer.contact_ids))


def test_what_touches_now_is_told_as_without(case: FracturedWorld) -> None:
    world, now = with_others(case, SETTINGS), with_others(case, SETTINGS._replace(lookahead=0.0))
    for seed in range(3):
        states = thrown(case, seed, 10.0)._replace(positions=case_positions(case, seed))
        listed, touching = world.contacts(states), now.contacts(states)
        every = rows_of(listed)
        assert len(rows_of(touching)) > 3
        for pair, rows in rows_of(touching).items():
            count = rows.stop - rows.start
            mine = slice(every[pair].start, every[pair].start + count)
            assert np.array_equal(listed.contact_ids[mine], touching.contact_ids[rows])
            assert np.array_equal(listed.gaps[mine], touching.gaps[rows])


def case_positions(case: FracturedWorld, seed: int) -> np.ndarray:
    """All fragments near their places before the fracture, so that they touch; ball and block far away."""
    random, n = np.random.default_rng(seed), len(case.states(0.0).fragment_ids)
    return np.concatenate([random.normal(0.0, 0.01, 3 * n), [9.0, 0.0, 5.0, -9.0, 0.0, 5.0]])


def test_the_answer_does_not_depend_on_what_is_remembered(case: FracturedWorld) -> None:
    """With and without lists, with one and two threads, along a sequence of states."""
    worlds = [
        with_others(case, SETTINGS._replace(neighbour_lists=lists, threads=threads))
        for lists, threads in ((True, 1), (False, 1), (True, 2))
    ]
    states = thrown(case, 2, 10.0)
    still = states._replace(linear_velocities=np.zeros(0), angular_velocities=np.zeros(0))
    slow = states._replace(linear_velocities=0.02 * states.linear_velocities, angular_velocities=np.zeros(0))
    worlds[0].contacts(states)  # activates the registry
    flight = [later(worlds[0], states, t)._replace(step=k) for k, t in enumerate(np.linspace(0.0, 2.0 * AHEAD, 9))]
    flight += [states, still, states, slow, still, still, slow]
    # in place, where many touch: the previous answer may hold, or the next contacts must be searched
    places = case_positions(case, 0)
    creeping = still._replace(linear_velocities=1e-4 * states.linear_velocities)
    flight += [
        each._replace(positions=places)
        for each in (still, creeping, creeping, slow, creeping, states, creeping, states, still, slow, still)
    ]
    for k, each in enumerate(flight):
        answers = [world.contacts(each._replace(step=100 + k)) for world in worlds]
        for other in answers[1:]:
            for name, x, y in zip(other._fields, answers[0], other, strict=True):
                assert np.asarray(x).tobytes() == np.asarray(y).tobytes(), (k, name)


def test_what_turns_above_a_floor_meets_it() -> None:
    """Its centre stays in place; relative to it, distant parts of the floor move at any speed."""
    world = CollisionWorld(SETTINGS._replace(lookahead=0.0025))
    world.add_body(tetrahedral_body(brick((0.06, 0.06, 0.004), 0.02), 1))
    world.add_body(CollisionBody(2, 2, plane=np.array([0.0, 0.0, 1.0, 0.0]), is_static=True))
    states = FragmentStates(
        1, 0, np.array([1]), np.array([0.0, 0.0, 0.01]), np.array([0.0, 0.0, 0.0, 1.0]), np.zeros(3),
        np.array([150.0, 0.0, 0.0]),
    )  # fmt: skip
    answer = world.contacts(states)
    assert len(answer.gaps) and np.allclose(answer.gaps, 0.008, atol=1e-9)


def test_two_that_fly_as_one_do_not_meet() -> None:
    """Two bricks 4 cm apart tumble about their common centre at 50 rad/s: fast, but never closer."""
    world = CollisionWorld(SETTINGS._replace(lookahead=0.02))
    for i in (1, 2):
        world.add_body(tetrahedral_body(brick((1.0, 1.0, 0.5), 0.5), i))
    spin, apart = np.array([0.0, 50.0, 0.0]), np.array([0.0, 0.0, 0.27])
    linear = np.cross(spin, [-apart, apart])
    states = FragmentStates(
        1, 0, np.array([1, 2], np.uint32), np.concatenate([-apart, apart]), np.tile([0.0, 0.0, 0.0, 1.0], 2),
        linear.ravel(), np.tile(spin, 2),
    )  # fmt: skip
    # their centres move straight, so they separate as they rotate
    assert len(world.contacts(states).gaps) == 0
    towards = states._replace(linear_velocities=(linear + [[0.0, 0.0, 15.0], [0.0, 0.0, 0.0]]).ravel())
    assert len(world.contacts(towards).gaps) > 0


def test_a_fast_ball_is_seen_before_it_is_through() -> None:
    world = CollisionWorld(SETTINGS)
    world.add_body(tetrahedral_body(brick((1.0, 1.0, 0.01), 0.2), 1))
    world.add_body(CollisionBody(2, 2, primitive=SolidPrimitive(SPHERE, (0.05,)), density=1000.0))
    states = FragmentStates(
        1, 0, np.array([1, 2], np.uint32), np.array([0.0, 0.0, 0.0, 0.1, 0.1, 1.0]), np.tile([0.0, 0.0, 0.0, 1.0], 2),
        np.array([0.0, 0.0, 0.0, 0.0, 0.0, -200.0]), np.zeros(6),
    )  # fmt: skip
    answer = world.contacts(states)
    assert answer.fragment_a.tolist() == [1] and answer.fragment_b.tolist() == [2]
    assert np.allclose(answer.normals.reshape(-1, 3), [0.0, 0.0, 1.0])
    assert np.allclose(answer.gaps, 1.0 - 0.05 - 0.005, atol=1e-4)
    beside = states._replace(positions=np.array([0.0, 0.0, 0.0, 0.57, 0.0, 1.0]))
    assert len(world.contacts(beside).gaps) == 0
    slower = states._replace(linear_velocities=0.2 * states.linear_velocities)
    assert len(world.contacts(slower).gaps) == 0


def rod_on_one_end(world: CollisionWorld, degrees: float) -> FragmentStates:
    """A rod of 10 cm on one end on a plate, tilted by 20 degrees, rotates down by `degrees` about that end."""
    world.add_body(tetrahedral_body(brick((0.5, 0.5, 0.01), 0.1), 1))
    world.add_body(tetrahedral_body(brick((0.1, 0.008, 0.008), 0.02), 2))
    turn, end = Rotation.from_rotvec([0.0, -np.radians(20.0), 0.0]), np.array([-0.05, 0.0, -0.004])
    place = np.array([0.0, 0.0, 0.005 + 1e-5]) - turn.apply(end)  # 0.01 mm above the plate
    w = np.array([0.0, np.radians(degrees) / SETTINGS.lookahead, 0.0])
    return FragmentStates(
        1, 0, np.array([1, 2], np.uint32), np.concatenate([np.zeros(3), place]),
        np.concatenate([[0.0, 0.0, 0.0, 1.0], turn.as_quat()]),
        np.concatenate([np.zeros(3), np.cross(w, turn.apply(-end))]), np.concatenate([np.zeros(3), w]),
    )  # fmt: skip


@pytest.mark.parametrize(("degrees", "hits"), [(40.0, True), (10.0, False)])
def test_what_touches_with_one_end_is_seen_to_hit_with_the_other(degrees: float, hits: bool) -> None:
    world, now = CollisionWorld(SETTINGS), CollisionWorld(SETTINGS._replace(lookahead=0.0))
    listed = world.contacts(rod_on_one_end(world, degrees))
    touching = now.contacts(rod_on_one_end(now, degrees))
    assert 0 < len(touching.gaps) == (listed.gaps < 1e-3).sum()
    assert np.array_equal(listed.contact_ids[: len(touching.gaps)], touching.contact_ids)
    # the lower edge of the other end is 0.1 sin 20 above the point of impact
    far = listed.gaps[listed.gaps > 1e-3]
    assert (len(far) > 0) == hits and (not hits or abs(far.max() - 0.1 * np.sin(np.radians(20.0))) < 2e-3)


def test_the_answer_does_not_depend_on_the_room(monkeypatch: pytest.MonkeyPatch) -> None:
    """A pair that does not fit in the buffer is searched again, and again for its lookahead contacts."""
    worlds = [CollisionWorld(SETTINGS) for _ in range(2)]
    enough = worlds[0].contacts(rod_on_one_end(worlds[0], 40.0))
    monkeypatch.setattr(narrow_phase, "FIRST_ROOM", 1)
    monkeypatch.setattr(narrow_phase, "LEAST_ROOM", 1)
    for name, x, y in zip(enough._fields, enough, worlds[1].contacts(rod_on_one_end(worlds[1], 40.0)), strict=True):
        assert np.asarray(x).tobytes() == np.asarray(y).tobytes(), name


def test_nonsense_is_refused() -> None:
    for wrong in (-1e-3, 1.5, np.nan):
        with pytest.raises(ValueError, match="lookahead"):
            CollisionWorld(Settings(lookahead=wrong))
    world = CollisionWorld(SETTINGS)
    world.add_body(tetrahedral_body(brick((1.0, 1.0, 0.5), 0.5), 1))
    states = FragmentStates(
        1, 0, np.array([1], np.uint32), np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0]), np.array([1e300, 0.0, 0.0]),
        np.zeros(3),
    )  # fmt: skip
    with pytest.raises(InvalidMessage, match="linear_velocities"):
        world.contacts(states)
    with pytest.raises(InvalidMessage, match="angular_velocities"):
        world.contacts(states._replace(linear_velocities=np.zeros(3), angular_velocities=np.full(3, 1e300)))
    assert len(world.contacts(states._replace(linear_velocities=np.zeros(3))).gaps) == 0
