"""The brute force for millions of points against the slow oracle it stands in for, on small bodies."""

from __future__ import annotations

import numpy as np
import pytest
from oracles.brute_force import distances, owners, partition_of
from oracles.fragmented_body import ALL_KINDS, CRACK
from truth.contact_truth import COARSE_SHAPES
from worlds.fractured_worlds import FracturedWorld, fractured_world


@pytest.fixture(scope="module", params=[("torus", False), ("torus", True), ("l_block", True)], ids=str)
def case(request) -> FracturedWorld:
    shape, curved = request.param
    return fractured_world(COARSE_SHAPES[shape](), seeds=4, generations=2, curved=curved)


def test_owners_equal_the_oracles_close_to_cracks(case: FracturedWorld) -> None:
    """The two oracles agree up to a few rounding errors from a crack.

    One works from the hub of a tetrahedron, the other finds the part that contains a point.
    """
    random, oracle = np.random.default_rng(4), case.oracle
    triangles = np.concatenate([oracle.surface_triangles(f, (CRACK,)) for f in oracle.fragment_ids])
    on_cracks = np.einsum("nij,ni->nj", triangles, random.dirichlet(np.ones(3), len(triangles)))
    away = random.normal(size=on_cracks.shape)
    away /= np.linalg.norm(away, axis=1)[:, None]
    points = on_cracks + away * 10.0 ** random.uniform(-12.0, -2.0, (len(away), 1))
    far = distances(points, triangles) > 1e-13
    found, _ = owners(partition_of(oracle), points)
    assert np.count_nonzero(far) > 0.9 * len(points) > 500
    assert np.array_equal(found[far], oracle.owner(points[far]))


def test_distances_equal_the_oracles(case: FracturedWorld) -> None:
    points = np.random.default_rng(2).uniform(-1.2, 1.2, (200, 3))
    for fragment in case.oracle.fragment_ids[:3]:
        triangles = case.oracle.surface_triangles(fragment, ALL_KINDS)
        expected, nearest = case.oracle.distance_to_surface(fragment, points)
        assert np.allclose(distances(points, triangles), expected, rtol=0, atol=1e-13)
        assert distances(nearest, triangles).max() <= 1e-13
    assert np.isinf(distances(points[:1], np.zeros((0, 3, 3)))[0])
