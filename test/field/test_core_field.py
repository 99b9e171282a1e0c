"""The field against brute force: owner of a point, exact depth and distance, masses, all to rounding."""

from __future__ import annotations

import numpy as np
import pytest
from oracles.fragmented_body import ALL_KINDS
from worlds.fractured_worlds import DENSITY, FracturedWorld, fractured_world, samples_of

from fracture_collision.core.field.elementary_queries import INSIDE, NEAR, inside_tetrahedron, probe
from fracture_collision.core.mesh.occupancy import sphere_may_touch
from fracture_collision.core.mesh.surface_triangles import surface_triangles
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


def test_owners_of_points_equal_the_oracles(case: FracturedWorld) -> None:
    points = _points_within(case, 400)
    owners = case.oracle.owner(points)
    for fragment in case.oracle.fragment_ids:
        row = case.row(fragment)
        inside = [inside_tetrahedron(case.geometry.pools, row, *p) >= 0 for p in points]
        assert np.array_equal(inside, owners == fragment)


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


def test_distance_outside_equals_brute_force(case: FracturedWorld) -> None:
    points = np.vstack([_points_within(case, 60), 1.15 * case.oracle.vertices[::7]])
    owners = case.oracle.owner(points)
    scratch = make_scratch(len(case.oracle.tetrahedra), 8)
    near = 0.3
    for fragment in case.oracle.fragment_ids[:4]:
        outside = points[owners != fragment]
        expected, _ = case.oracle.distance_outside(fragment, outside, SURFACE)
        for point, true in zip(outside, expected, strict=True):
            status, distance, *_ = probe(case.geometry.pools, case.row(fragment), tuple(point), near, np.inf, scratch)
            assert (status == NEAR) == (true < near)
            if status == NEAR:
                assert abs(distance - true) <= 1e-12
            else:
                assert distance <= true + 1e-12


def test_sphere_test_is_conservative(case: FracturedWorld) -> None:
    points = np.vstack([_points_within(case, 60), 1.3 * case.oracle.vertices[::5]])
    owners = case.oracle.owner(points)
    for fragment in case.oracle.fragment_ids[:4]:
        outside = points[owners != fragment]
        true, _ = case.oracle.distance_outside(fragment, outside, SURFACE)
        for r in (0.01, 0.1, 0.3, 1.0):
            may = [sphere_may_touch(case.geometry.pools, case.row(fragment), *p, r) for p in outside]
            assert np.all(np.array(may) | (true >= r))


def test_masses_equal_the_oracles_and_add_up(case: FracturedWorld) -> None:
    registry = case.world.fragments()
    volume = tetrahedron_volumes(case.oracle.vertices, case.oracle.tetrahedra).sum()
    assert registry.masses.sum() == pytest.approx(DENSITY * volume, rel=1e-12)
    radius = 0.5 * np.ptp(case.oracle.vertices, axis=0).max()
    for i, fragment in enumerate(registry.fragment_ids.tolist()):
        mass, center, inertia = case.oracle.mass_properties(fragment, DENSITY)
        assert registry.masses[i] == pytest.approx(mass, rel=1e-9)
        assert np.allclose(registry.centers_of_mass[i], center, atol=1e-9 * radius)
        xx, xy, xz, yy, yz, zz = registry.inertias[i]
        own = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        assert np.allclose(own, inertia, atol=1e-9 * mass * radius**2)


def test_surfaces_equal_the_oracles(case: FracturedWorld) -> None:
    """Area by kind, and every corner on the other's surface."""
    for fragment in case.oracle.fragment_ids[:4]:
        row = case.row(fragment)
        triangles, _ = surface_triangles(case.geometry.pools, row, case.geometry.tet_range(row))
        expected = case.oracle.surface_triangles(fragment, SURFACE)
        areas = [
            np.linalg.norm(np.cross(t[:, 1] - t[:, 0], t[:, 2] - t[:, 0]), axis=1).sum() for t in (triangles, expected)
        ]
        assert areas[0] == pytest.approx(areas[1], rel=1e-9)
        assert case.oracle.distance_to_surface(fragment, triangles.reshape(-1, 3), SURFACE)[0].max() <= 1e-12


def test_no_surface_point_is_farther_from_a_sample_than_the_gap(case: FracturedWorld, request) -> None:
    consistent_planes = "flat" in request.node.callspec.id
    registry = case.world.fragments()
    random = np.random.default_rng(5)
    for fragment, gap in zip(registry.fragment_ids.tolist(), registry.sampling_gaps, strict=True):
        row = case.row(fragment)
        samples, _ = samples_of(case.geometry, row)
        if consistent_planes:
            assert case.oracle.distance_to_surface(fragment, samples, SURFACE)[0].max() <= 1e-12
        triangles = case.oracle.surface_triangles(fragment, SURFACE)
        points = np.einsum("ti,tij->tj", random.dirichlet(np.ones(3), len(triangles)), triangles)
        points = np.vstack([points, triangles.reshape(-1, 3)])
        nearest = np.linalg.norm(points[:, None] - samples[None], axis=2).min(axis=1)
        assert nearest.max() <= gap * (1.0 + 1e-12)
