"""The field against brute force: owner of a point, exact depth and distance, masses, all to rounding."""

from __future__ import annotations

import numpy as np
import pytest
from oracles.fragmented_body import ALL_KINDS
from worlds.fractured_worlds import DENSITY, FracturedWorld, fractured_world

from fracture_collision.core.field.elementary_queries import INSIDE, probe
from fracture_collision.core.search.scratch import make_scratch
from fracture_collision.geometry.generators import ball, bowl, brick, plate, shell
from fracture_collision.geometry.tetrahedra import tetrahedron_volumes

SHAPES = {
    "ball": lambda: ball(1.0, 0.4),
    "brick": lambda: brick((2.0, 1.0, 0.8), 0.4),
    "shell": lambda: shell(1.0, 0.8, 0.6),
    "plate": lambda: plate(2.0, 0.2, 0.4, 0.2),
    "bowl": lambda: bowl(2.0, 0.2, 0.4, 0.6),
}
# Where planes disagree between neighbouring tetrahedra, regions have steps at the shared face, also surface.
SURFACE = ALL_KINDS
CASES = [(shape, cracks) for shape in SHAPES for cracks in ("flat", "curved")]


@pytest.fixture(scope="module", params=CASES, ids=["-".join(c) for c in CASES])
def case(request) -> FracturedWorld:
    shape, cracks = request.param
    return fractured_world(SHAPES[shape](), seeds=6, generations=2, curved=cracks == "curved")


def _points_within(case: FracturedWorld, count: int) -> np.ndarray:
    """Random points of the body and some just around its nodes and cracks."""
    random = np.random.default_rng(11)
    corners = case.oracle.vertices[case.oracle.tetrahedra[random.integers(0, len(case.oracle.tetrahedra), count)]]
    return np.einsum("nij,ni->nj", corners, random.dirichlet(np.ones(4), count))


def test_depth_equals_brute_force_over_all_polygons(case: FracturedWorld) -> None:
    points = _points_within(case, 150)
    owners = case.oracle.owner(points)
    scratch = make_scratch(len(case.oracle.tetrahedra), 8)
    for fragment in case.oracle.fragment_ids:
        own = points[owners == fragment]
        if not len(own):
            continue
        expected, _ = case.oracle.depth(fragment, own, SURFACE)
        for point, depth in zip(own, expected, strict=True):
            status, distance, *rest = probe(case.geometry.pools, case.row(fragment), tuple(point), 0.0, np.inf, scratch)
            assert status == INSIDE
            assert abs(-distance - depth) <= 1e-12
            normal, closest = np.array(rest[:3]), np.array(rest[3:])
            # the closest point is on the surface, and the normal points to it
            assert case.oracle.distance_to_surface(fragment, closest[None], SURFACE)[0][0] <= 1e-12
            assert np.allclose(point + depth * normal, closest, atol=1e-9)


def test_masses_equal_the_oracles_and_add_up(case: FracturedWorld) -> None:
    registry = case.world.fragments()
    volume = tetrahedron_volumes(case.oracle.vertices, case.oracle.tetrahedra).sum()
    assert registry.masses.sum() == pytest.approx(DENSITY * volume, rel=1e-12)
    radius = 0.5 * np.ptp(case.oracle.vertices, axis=0).max()
    for i, fragment in enumerate(registry.fragment_ids.tolist()):
        mass, center, inertia = case.oracle.mass_properties(fragment, DENSITY)
        assert registry.masses[i] == pytest.approx(mass, rel=1e-9)
        assert np.allclose(registry.centers_of_mass[3 * i : 3 * i + 3], center, atol=1e-9 * radius)
        xx, xy, xz, yy, yz, zz = registry.inertias[6 * i : 6 * i + 6]
        own = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        assert np.allclose(own, inertia, atol=1e-9 * mass * radius**2)
