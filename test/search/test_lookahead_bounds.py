"""Bounds on gaps and on approach within the lookahead, against motion in small steps."""

from __future__ import annotations

import numpy as np
import pytest
from worlds.fractured_worlds import FracturedWorld
from worlds.thrown_fragments import AHEAD, CASES, SETTINGS, thrown, thrown_case, with_others

from fracture_collision.core.lookahead.motion import Motion, Moving, put_pose, put_way
from fracture_collision.core.lookahead.staying_apart import least_gap_ahead
from fracture_collision.core.memory import kinds
from fracture_collision.core.memory.pair import Pair, Step
from fracture_collision.core.memory.pools import Pools
from fracture_collision.core.pair import narrow_phase
from fracture_collision.core.search.scratch import Scratch
from fracture_collision.core.separation.approach import WAY, nearer_along
from fracture_collision.world import collision_world


@pytest.fixture(scope="module", params=CASES)
def case(request) -> FracturedWorld:
    return thrown_case(request.param)


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
