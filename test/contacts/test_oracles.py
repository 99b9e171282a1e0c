"""Tests of the oracles: partition, closed surfaces, volumes, and independent cross-checks of all three."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from oracles.brute_force import distances_to_triangles, nearest_on_triangles, owners
from oracles.convex_cells import area_vector
from oracles.fracture_patterns import curved_event, disagreeing_event, event_of_labels, voronoi_event
from oracles.fragmented_body import CRACK, ORIGINAL, FragmentedBody, uniform_points
from oracles.voronoi_cells import against_voronoi_cells
from truth.field_truth import igl_closest
from worlds.rigid_shapes import winding_number

from fracture_collision.geometry.generators import ball, brick, plate, shell
from fracture_collision.geometry.tetrahedra import tetrahedron_volumes
from fracture_collision.records import FractureEvent

BODIES = {
    "ball": ball(0.05, 0.017),
    "brick": brick((0.2, 0.12, 0.08), 0.04),
    "plate": plate(0.2, 0.02, 0.045, 0.03),
    "shell": shell(0.05, 0.04, 0.03),
}


def disagreeing(
    body: FragmentedBody, fragment_id: int, seeds: np.ndarray, first_new_id: int, sequence: int = 1
) -> FractureEvent:
    random = np.random.default_rng(sequence)
    return disagreeing_event(body, fragment_id, seeds, first_new_id, sequence, 0.5, random)


EVENTS = {"flat": voronoi_event, "curved": curved_event, "disagreeing": disagreeing}
every_case = pytest.mark.parametrize(("shape", "crack"), [(s, c) for s in BODIES for c in EVENTS])


@cache
def broken(shape: str, crack: str) -> FragmentedBody:
    """Four cells, then the largest fragment into three, and again: many fragments share tetrahedra."""
    mesh = BODIES[shape]
    body = FragmentedBody(*mesh)
    rng = np.random.default_rng(11)
    for generation in range(3):
        labels, counts = np.unique(body.labels, return_counts=True)
        largest = int(labels[np.argmax(counts)])
        nodes = mesh.vertices[body.labels == largest]
        seeds = rng.uniform(nodes.min(axis=0), nodes.max(axis=0), size=(4 if generation == 0 else 3, 3))
        body.apply(EVENTS[crack](body, largest, seeds, max(body.fragment_ids) + 1, generation + 1))
    assert len(body.fragment_ids) >= 5
    return body


@every_case
def test_every_point_has_one_owner_and_is_within_its_surface_alone(shape: str, crack: str) -> None:
    body = broken(shape, crack)
    points = uniform_points(*BODIES[shape], 200, np.random.default_rng(5))
    owners = body.owner(points)
    assert set(owners.tolist()) <= set(body.fragment_ids)
    for f in body.fragment_ids:
        triangles = body.surface_triangles(f)
        times = winding_number(triangles, points)
        assert np.abs(times - (owners == f)).max() < 1e-9
    far = np.array([[1.0, 0, 0], [0, 0, 0.3]])
    assert body.owner(far).tolist() == [0, 0]


@every_case
def test_distances_are_those_of_libigl(shape: str, crack: str) -> None:
    body = broken(shape, crack)
    points = np.random.default_rng(2).uniform(-0.15, 0.15, (100, 3))
    triangles = body.surface_triangles(body.fragment_ids[-1])
    distance, nearest = nearest_on_triangles(points, triangles)
    assert distance == pytest.approx(igl_closest(points, triangles)[0], abs=1e-13)
    assert np.linalg.norm(points - nearest, axis=1) == pytest.approx(distance, abs=1e-13)
    assert igl_closest(nearest, triangles)[0].max() <= 1e-13
    assert distances_to_triangles(points[0], triangles)[0].min() == distance[0]
    assert np.isinf(nearest_on_triangles(points[:1], triangles[:0])[0])


@every_case
def test_surface_is_closed_and_encloses_the_volume(shape: str, crack: str) -> None:
    body = broken(shape, crack)
    for fragment in body.fragment_ids:
        triangles = body.surface_triangles(fragment)
        a, b, c = (triangles[:, i] for i in range(3))
        area = 0.5 * np.cross(b - a, c - a)
        assert np.abs(area.sum(axis=0)).max() < 1e-12 * np.abs(area).sum()
        assert np.einsum("ij,ij->", np.cross(a, b), c) / 6.0 == pytest.approx(body.volume(fragment), rel=1e-11, abs=0.0)


@every_case
def test_every_crack_belongs_to_both_of_its_fragments(shape: str, crack: str) -> None:
    """Moreover, no part of the old surface is lost or doubled."""
    body = broken(shape, crack)
    sides = {}
    for f in body.fragment_ids:
        for p in body.surface_polygons(f, (CRACK,)):
            key = (p.tetrahedron, f, p.other)
            sides[key] = sides.get(key, np.zeros(3)) + area_vector(p.points)
    assert sides
    for (t, f, other), area in sides.items():
        assert np.abs(area + sides[t, other, f]).max() <= 1e-13 * np.ptp(body.vertices) ** 2
    old = np.concatenate([body.surface_triangles(f, (ORIGINAL,)) for f in body.fragment_ids])
    whole = FragmentedBody(*BODIES[shape]).surface_triangles(1)
    area, expected = (sum(np.linalg.norm(area_vector(t)) for t in side) for side in (old, whole))
    assert area == pytest.approx(expected, rel=1e-12, abs=0.0)


@pytest.mark.parametrize("shares", [(0.0, 1.0), (0.0, 0.5, 1.0), (1e-8, 1.0 - 1e-8)], ids=str)
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_crossings_at_nodes_and_any_labels_leave_a_partition(shares: tuple[float, ...], seed: int) -> None:
    """Most regions have no volume in some tetrahedron; those that did not break keep their points."""
    mesh = ball(1.0, 0.5)
    body = FragmentedBody(*mesh)
    random = np.random.default_rng(seed)

    def plane(a: int, b: int, _i: int, _j: int) -> tuple[np.ndarray, float]:
        along = mesh.vertices[b] - mesh.vertices[a]
        normal = along / np.linalg.norm(along)
        return normal, float(normal @ (mesh.vertices[a] + random.choice(shares) * along))

    points, whole = random.uniform(-1.0, 1.0, (2000, 3)), tetrahedron_volumes(*mesh).sum()
    for sequence in (1, 2, 3):
        largest = max(body.fragment_ids, key=lambda f: np.count_nonzero(body.labels == f))
        volumes = {f: body.volume(f) for f in body.fragment_ids if f != largest}
        was = body.owner(points)
        labels = random.integers(0, 4, len(body.labels))
        body.apply(event_of_labels(body, largest, labels, plane, max(body.fragment_ids) + 1, sequence, 1))
        assert sum(body.volume(f) for f in body.fragment_ids) == pytest.approx(whole, rel=1e-12, abs=0.0)
        assert max((abs(body.volume(f) - volumes[f]) for f in volumes), default=0.0) <= 1e-14
        now = body.owner(points)
        assert np.array_equal(was[np.isin(was, list(volumes))], now[np.isin(now, list(volumes))])
        assert owners(body.partition, points)[1].all()
        for f in body.fragment_ids:
            area = np.array([area_vector(t) for t in body.surface_triangles(f)]).reshape(-1, 3)
            assert np.abs(area.sum(axis=0)).max() <= 1e-13


@pytest.mark.parametrize("shape", BODIES)
def test_flat_cracks_give_voronoi_cells(shape: str) -> None:
    """Exactly in tetrahedra whose edges and faces meet the cells of their own nodes alone; nearly elsewhere."""
    mesh = BODIES[shape]
    random = np.random.default_rng(2)
    for _ in range(3):
        seeds = random.uniform(mesh.vertices.min(axis=0), mesh.vertices.max(axis=0), size=(5, 3))
        check = against_voronoi_cells(mesh, seeds)
        assert check.cells.sum() == pytest.approx(1.0, rel=1e-12, abs=0.0)
        assert check.fitting > 2 * check.other
        assert check.worst_fitting < 1e-12


def test_deviation_from_voronoi_cells_shrinks_in_a_finer_mesh() -> None:
    seeds = np.random.default_rng(2).uniform(-0.05, 0.05, size=(5, 3))
    coarse, fine = (against_voronoi_cells(ball(0.05, length), seeds) for length in (0.017, 0.0085))
    assert 0.0 < fine.misplaced < 0.5 * coarse.misplaced < 0.0025
    assert np.abs(fine.off / fine.cells).max() < 0.005


def test_mass_properties_of_a_cut_brick() -> None:
    """A slab cut off by a plane x = const through mesh nodes: closed form."""
    mesh = BODIES["brick"]
    body = FragmentedBody(*mesh)
    body.apply(voronoi_event(body, 1, np.array([[-0.07, 0.0, 0.0], [0.03, 0.0, 0.0]]), 2))
    assert body.fragment_ids == [2, 3]
    mass, centre, inertia = body.mass_properties(2, density=2500.0)
    a, b, c = 0.08, 0.12, 0.08  # the slab from x = -0.1 to -0.02
    assert mass == pytest.approx(2500.0 * a * b * c, rel=1e-12, abs=0.0)
    assert centre == pytest.approx([-0.06, 0.0, 0.0], abs=1e-15)
    expected = mass / 12.0 * np.diag([b * b + c * c, a * a + c * c, a * a + b * b])
    assert inertia == pytest.approx(expected, rel=1e-12, abs=1e-15)


@every_case
def test_mass_properties_add_up(shape: str, crack: str) -> None:
    body, whole = broken(shape, crack), FragmentedBody(*BODIES[shape])
    mass, centre, inertia = whole.mass_properties(1)
    parts = [body.mass_properties(f) for f in body.fragment_ids]
    assert min(m for m, _, _ in parts) > 0.0 and body.parts.share.min() > -1e-15
    assert body.parts.share.sum(axis=1) == pytest.approx(1.0, abs=1e-14)
    assert sum(m for m, _, _ in parts) == pytest.approx(mass, rel=1e-12, abs=0.0)
    assert mass == pytest.approx(tetrahedron_volumes(*BODIES[shape]).sum(), rel=1e-12, abs=0.0)
    assert sum(m * x for m, x, _ in parts) / mass == pytest.approx(centre, abs=1e-14)
    arms = [x - centre for _, x, _ in parts]
    moved = sum(i + m * (r @ r * np.eye(3) - np.outer(r, r)) for (m, _, i), r in zip(parts, arms, strict=True))
    assert moved == pytest.approx(inertia, rel=1e-11, abs=1e-12 * inertia.max())
