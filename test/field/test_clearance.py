"""Single-precision clearance is conservative: against the exact field, everywhere around a fragment."""

from __future__ import annotations

import numpy as np
import pytest
from worlds.fractured_worlds import fractured_world

from fracture_collision.core.field.clearance import BEYOND, DEEP, clearance, may_be_clear, side_of_surface
from fracture_collision.core.field.elementary_queries import INSIDE, probe
from fracture_collision.core.memory.pools import Pools
from fracture_collision.core.search.scratch import Scratch, make_scratch
from fracture_collision.geometry.generators import ball, brick, shell

SHAPES = {
    "ball": (ball(1.0, 0.35), False),
    "curved ball": (ball(1.0, 0.3), True),
    "shell": (shell(1.0, 0.8, 0.5), True),
    "brick": (brick((1.0, 0.8, 0.5), 0.2), False),
}
WITHIN, ROUNDING, DEPTH = 0.03, 1e-9, 0.005  # [m]


def _fragments(shape: str, beside: float, seed: int) -> tuple[Pools, Scratch, list[tuple[int, np.ndarray]]]:
    """A broken body's pools, scratch, and each fragment's row with points (600, 3).

    The points are in its box, up to `beside` [m] outside it, and on mesh nodes (ties: on walls, on the old surface).
    """
    body, is_curved = SHAPES[shape]
    case = fractured_world(body, 4, generations=2, curved=is_curved)
    pools, random, fragments = case.geometry.pools, np.random.default_rng(seed), []
    for f in map(case.row, case.oracle.fragment_ids):
        box = pools.fragment.box[f]
        nodes = pools.mesh.nodes[random.integers(0, len(pools.mesh.nodes), 100)]
        anywhere = random.uniform(box[:3] - beside, box[3:] + beside, (500, 3))
        fragments.append((f, np.vstack([anywhere, nodes])))
    return pools, make_scratch(len(pools.mesh.tetrahedra), 1), fragments


@pytest.mark.parametrize("shape", SHAPES)
def test_samples_proven_far_are_far(shape: str) -> None:
    pools, scratch, fragments = _fragments(shape, 0.1, 5)
    far = said = 0
    for f, points in fragments:
        assert may_be_clear(pools, f)
        last = -1
        for point in points:
            least, last = clearance(pools, f, last, tuple(point), WITHIN, ROUNDING, scratch)
            status, distance = probe(pools, f, tuple(point), 10.0, np.inf, scratch)[:2]
            assert least == 0.0 or (status != INSIDE and WITHIN <= least <= distance)
            far += status != INSIDE and distance > 1.1 * WITHIN
            said += least > 0.0
    assert said > 0.7 * far > 0.0


@pytest.mark.parametrize("shape", SHAPES)
def test_samples_proven_inside_or_beyond_are(shape: str) -> None:
    pools, scratch, fragments = _fragments(shape, 0.05, 7)
    told, counts = 0, np.zeros(2, int)
    for f, points in fragments:
        last = -1
        for point in points:
            side, last = side_of_surface(pools, f, last, tuple(point), DEPTH, ROUNDING)
            status, distance = probe(pools, f, tuple(point), 1.0, np.inf, scratch)[:2]
            is_inside = status == INSIDE
            assert side != BEYOND or not is_inside
            assert side != DEEP or (is_inside and -distance > DEPTH)
            told += side in (BEYOND, DEEP)
            counts += side == BEYOND, side == DEEP
    assert told > 1000 and counts.min() > 20
