"""Pairs with lookahead contacts: the slow twin advances in small steps and queries the contacts at each."""

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
from fracture_collision.records import BUDGET_EXHAUSTED, ContactConstraintArray, FragmentStates
from fracture_collision.world import CollisionWorld

MOMENTS = 400
# of throws; the slow twin takes its time
SEEDS = [range(2), pytest.param(range(10), marks=pytest.mark.slow)]
SIZES = {BALL: 0.3, BLOCK: 0.25, FLOOR: np.inf}  # [m] R; 1 m for all others


@pytest.fixture(scope="module", params=CASES)
def case(request) -> FracturedWorld:
    return thrown_case(request.param)


@pytest.mark.parametrize("seeds", SEEDS, ids=str)
@pytest.mark.parametrize(("spin", "kind"), [(0.0, SampledWorld), (10.0, SampledWorld), (10.0, CollisionWorld)])
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
