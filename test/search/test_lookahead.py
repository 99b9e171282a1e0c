"""Pairs with lookahead contacts, and the bounds that find them: slow twins advance in small steps."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from worlds.fractured_worlds import FracturedWorld
from worlds.sampled_worlds import SampledWorld
from worlds.thrown_fragments import (
    AHEAD,
    BALL,
    BLOCK,
    CASES,
    FLOOR,
    SETTINGS,
    later,
    rows_of,
    thrown,
    thrown_case,
    with_others,
)

from fracture_collision.core.lookahead.first_touch import HELD
from fracture_collision.core.lookahead.motion import Motion, Moving, put_pose, put_way
from fracture_collision.core.lookahead.staying_apart import least_gap_ahead
from fracture_collision.core.memory import kinds
from fracture_collision.core.memory.pair import Pair, Step
from fracture_collision.core.memory.pools import Pools
from fracture_collision.core.pair import narrow_phase
from fracture_collision.core.search.scratch import Scratch
from fracture_collision.core.separation.approach import WAY, nearer_along
from fracture_collision.records import BUDGET_EXHAUSTED, ContactConstraintArray, FragmentStates
from fracture_collision.world import CollisionWorld, collision_world

MOMENTS = 400
# of throws; the slow twin takes its time
SEEDS = [range(1), pytest.param(range(10), marks=pytest.mark.slow)]
SIZES = {BALL: 0.3, BLOCK: 0.25, FLOOR: np.inf}  # [m] R; 1 m for all others


@pytest.fixture(scope="module", params=CASES)
def case(request) -> FracturedWorld:
    return thrown_case(request.param)


@pytest.mark.parametrize(
    ("spin", "kind", "seeds"),
    [
        (0.0, SampledWorld, range(2)), (10.0, CollisionWorld, range(1)),
        *(pytest.param(spin, kind, range(10), marks=pytest.mark.slow)
          for spin, kind in ((0.0, SampledWorld), (10.0, SampledWorld), (10.0, CollisionWorld))),
    ],
)  # fmt: skip
def test_listed_pairs_are_those_that_meet_in_small_steps(
    case: FracturedWorld, spin: float, kind: type[CollisionWorld], seeds: range
) -> None:
    """A separate pair is listed if it will be deeper than epsilon, with points that meet at the time of contact."""
    still = SETTINGS._replace(lookahead=0.0)
    world, now, of_samples = with_others(case, SETTINGS, kind), with_others(case, still, kind), None
    if kind is not SampledWorld:
        of_samples = with_others(case, still, SampledWorld)
    met = unmet = unfollowed = 0
    for seed in seeds:
        states = thrown(case, seed, spin)
        listed, touching = world.contacts(states), rows_of(now.contacts(states))
        ahead = {pair: rows for pair, rows in rows_of(listed).items() if pair not in touching}
        first, deep = meeting_in_small_steps(now, states)
        unfollowed += unlisted(listed, deep - touching.keys() - ahead.keys())
        reach = 2.0 * 0.002 + 0.3 * (20.0 + spin) * AHEAD / MOMENTS
        # ridges that cross no deeper than HELD before their ends are inside are left to the next query
        last = first if of_samples is None else meeting_in_small_steps(of_samples, states)[0]
        for pair, rows in ahead.items():
            assert pair in first or listed.gaps[rows].min() > 0.0
            if pair not in first:
                unmet += 1
                continue
            begin, end = (round(t / AHEAD * MOMENTS) for t in (first[pair], last.get(pair, AHEAD)))
            steps = AHEAD / MOMENTS * np.arange(begin, max(begin, end) + 1)
            apart = [_least_distance(now, states, listed, pair, rows, t) for t in steps]
            assert apart[0] < (reach if of_samples is None else reach + HELD)
            assert min(apart) < reach
            assert listed.gaps[rows].max() > 0.0
            met += 1
    # a pair that only grazes the tolerance may touch between two time steps of one method and not of the other
    assert met > len(seeds) and unmet <= 1 and unfollowed <= 1


@pytest.mark.parametrize("seeds", SEEDS, ids=str)
def test_no_pair_of_fast_spinning_bodies_is_missed(case: FracturedWorld, seeds: range) -> None:
    """Rotation by three radians in AHEAD: the paths of its points are far from straight."""
    world, now = with_others(case, SETTINGS), with_others(case, SETTINGS._replace(lookahead=0.0))
    met = unfollowed = 0
    for seed in seeds:
        states = thrown(case, seed, 150.0)
        listed, touching = world.contacts(states), rows_of(now.contacts(states))
        _, deep = meeting_in_small_steps(now, states)
        unfollowed += unlisted(listed, deep - touching.keys() - rows_of(listed).keys())
        met += len(deep - touching.keys())
    assert met > 3 * len(seeds) and unfollowed <= 1


def meeting_in_small_steps(
    now: CollisionWorld, states: FragmentStates
) -> tuple[dict[tuple[int, int], float], set[tuple[int, int]]]:
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


def _least_distance(world, states, answer, pair, rows, t) -> float:
    """Between the points of a pair's contacts on a and on b, each moved with its fragment until `t` [s]."""
    there, found = later(world, states, t), []
    for fragment, points in zip(pair, (answer.points_a, answer.points_b), strict=True):
        p = points.reshape(-1, 3)[rows]
        k = np.flatnonzero(states.fragment_ids == fragment)
        if len(k):
            (turn, place), (later_turn, later_place) = (_pose_of(each, k[0]) for each in (states, there))
            # a sphere rolls over its point
            offset = p - place if fragment == BALL else later_turn.apply(turn.inv().apply(p - place))
            p = later_place + offset
        found.append(p)
    return float(np.linalg.norm(found[0] - found[1], axis=1).min())


def _pose_of(states: FragmentStates, k: int) -> tuple[Rotation, np.ndarray]:
    return Rotation.from_quat(states.orientations.reshape(-1, 4)[k]), states.positions.reshape(-1, 3)[k]


@pytest.mark.parametrize("spin", [0.0, 10.0, 150.0])
def test_the_bound_on_a_gap_is_never_above_the_gap(
    case: FracturedWorld, spin: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The lower bound along random directions against the gap at 200 times; without spin it equals their minimum."""
    pools, (rows, rotations, positions, pairs), scratch, motion = _query(case, spin, monkeypatch)
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
        pair = Pair(int(a), int(b), scratch.rotation, scratch.translation)
        moving = Moving(int(i), int(j), rotations, positions, motion)
        least = least_gap_ahead(pools, pair, moving, 0.0, gaps[0], tuple(n), 0.0, scratch)
        assert least <= gaps.min() + 1e-12
        assert spin > 0.0 or least > gaps.min() - 1e-5
        known.append(gaps.min() - least)
    assert len(known) > 10 and (spin > 10.0 or np.median(known) < 0.05)


@pytest.mark.parametrize("spin", [0.0, 10.0, 150.0])
def test_the_bound_on_approach_is_never_exceeded(
    case: FracturedWorld, spin: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Relative motion along random directions against 200 times of a part of AHEAD; without spin the bound is exact."""
    pools, (rows, rotations, positions, pairs), _, motion = _query(case, spin, monkeypatch)
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
            nearer, most = ((seen[0] - seen) @ n).max(), nearer_along(way, tuple(n))
            assert nearer <= most + 1e-12
            assert spin > 0.0 or most < nearer + 1e-9
            unused.append(most - nearer)
    assert len(unused) > 50


def _query(
    case: FracturedWorld, spin: float, monkeypatch: pytest.MonkeyPatch
) -> tuple[Pools, Step, Scratch, Motion]:
    """What query_pairs gets: pools, step, one thread's scratch, motion."""
    asked = []
    monkeypatch.setattr(collision_world, "query_pairs", lambda *a: asked.append(a) or narrow_phase.query_pairs(*a))
    with_others(case, SETTINGS).contacts(thrown(case, 0, spin))
    scene, _, scratch = asked[0][:3]
    return scene.geometry.pools, scene.step, scratch[0], scene.motion


def _leaf_points(pools: Pools, row: int) -> np.ndarray:
    """(n, 3) float64 [m]: a fragment's samples."""
    return pools.samples.points[pools.fragment.sample_begin[row] : pools.fragment.sample_end[row]]
