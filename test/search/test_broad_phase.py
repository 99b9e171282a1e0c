"""The incremental broad phase, which tests only moved fragments, against its slow twin without history."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from fracture_collision.core.bodies.pool_tables import PoolTables
from fracture_collision.core.lookahead.motion import NO_MOTION, Motion
from fracture_collision.core.memory.kinds import PLANE, TETRAHEDRA
from fracture_collision.core.memory.pools import FragmentPool
from fracture_collision.core.pair.broad_phase import FEW, NOTHING_PAIRED, Paired, pairs_within_reach

TOLERANCE, MOST = 0.01, 1 << 20


def heap(count: int, random: np.random.Generator) -> tuple[FragmentPool, np.ndarray]:
    """`count` fragments, two of them planes, with the arrays a broad phase reads, and which are static."""
    half = random.uniform(0.02, 0.2, (count, 3))
    kind = np.full(count, TETRAHEDRA, np.int32)
    kind[[1, count - 2]] = PLANE
    half[kind == PLANE] = np.inf
    box = np.hstack((-half, half))
    radius = np.where(kind == PLANE, np.inf, half.max(axis=1))
    shape = np.zeros((count, 4))
    shape[1], shape[-2] = [0.0, 0.0, 1.0, 0.2], [0.6, 0.0, 0.8, -0.1]
    tables = PoolTables()
    for name, rows in (("box", box), ("radius", radius), ("kind", kind), ("shape", shape)):
        tables.fragment[name].append(rows)
    return tables.pools.fragment, (kind == PLANE) | (random.random(count) < 0.1)


def poses(count: int, random: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    return Rotation.random(count, random_state=random).as_matrix(), random.uniform(0.0, 1.0, (count, 3))


def columns_of(paired: Paired) -> list[np.ndarray]:
    return [column for part in paired for column in (part if isinstance(part, tuple) else (part,))]


@pytest.mark.parametrize("seed", range(4))
def test_pairs_after_partial_motion_equal_those_of_a_full_sweep(seed: int) -> None:
    random = np.random.default_rng(seed)
    count = 60
    shapes, is_static = heap(count + 5, random)
    rows = np.sort(random.choice(count + 5, count, replace=False))
    rotations, positions = poses(count, random)
    paired, quick = NOTHING_PAIRED, 0
    for step in range(40):
        rotations, positions = rotations.copy(), positions.copy()
        moving = random.choice(count, random.integers(0, 2 * count // FEW), replace=False)
        rotations[moving], positions[moving] = poses(len(moving), random)
        if step == 20:  # different fragments take part
            rows = np.sort(random.choice(count + 5, count, replace=False))
        if step % 10 >= 5:  # some steps with lookahead
            spins = np.where(np.isin(np.arange(count), moving)[:, None], random.normal(size=(count, 3)), 0.0)
            motion = Motion(0.01, positions, 5.0 * spins, spins, np.ones(count))
        else:
            motion = NO_MOTION
        told = shapes, (rows, rotations, positions), motion, is_static[rows], TOLERANCE, MOST
        radius, paired = pairs_within_reach(*told, paired)
        again, fresh = pairs_within_reach(*told, NOTHING_PAIRED)
        quick += 0 < FEW * len(moving) <= count and step not in (0, 20)
        np.testing.assert_array_equal(radius, again)
        for got, wanted in zip(columns_of(paired), columns_of(fresh), strict=True):
            np.testing.assert_array_equal(got, wanted)
        assert len(paired.pairs) > count
    assert quick > 5


def test_no_fragments_have_no_pairs_whatever_came_before() -> None:
    random = np.random.default_rng(1)
    shapes, is_static = heap(60, random)
    rows, paired = np.arange(60), NOTHING_PAIRED
    for count in (0, 60, 0):
        placed = (rows[:count], *(poses(count, random) if count else (np.zeros((0, 3, 3)), np.zeros((0, 3)))))
        _, paired = pairs_within_reach(shapes, placed, NO_MOTION, is_static[:count], TOLERANCE, MOST, paired)
        assert (len(paired.pairs) > 0) == (count > 0) and len(paired.boxes) == count
