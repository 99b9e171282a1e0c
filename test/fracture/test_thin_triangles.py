"""Removal of thin triangles: the surface stays closed, its volume and marks too, and none is left on rough surfaces."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from fracture_collision.core.mesh.thin_triangles import without_thin_triangles

TOLERANCE = 1e-6


def heights(surface: trimesh.Trimesh) -> np.ndarray:
    return 2.0 * surface.area_faces / surface.edges_unique_length[surface.faces_unique_edges].max(axis=1)


def with_thin_triangles(random: np.random.Generator) -> trimesh.Trimesh:
    """A rough ball; some triangles are divided at a point in a side of theirs, some edges at a point at their end."""
    ball = trimesh.creation.icosphere(subdivisions=2)
    vertices = list(ball.vertices * random.uniform(0.8, 1.2, (len(ball.vertices), 1)))
    triangles = []
    for i, (a, b, c) in enumerate(ball.faces.tolist()):
        if i % 3 == 0:
            share = 0.5 if i % 2 else 1e-9
            vertices.append(vertices[a] + share * (vertices[b] - vertices[a]))
            d = len(vertices) - 1
            triangles += [(a, b, d), (b, c, d), (c, a, d)]
        else:
            triangles.append((a, b, c))
    return trimesh.Trimesh(vertices, triangles, process=False)


@pytest.mark.parametrize("seed", range(5))
def test_a_rough_surface_has_no_thin_triangles_left(seed: int) -> None:
    rough = with_thin_triangles(np.random.default_rng(seed))
    assert rough.is_watertight and heights(rough).min() < TOLERANCE
    marked = np.asarray(rough.triangles_center[:, 2] > 0.0)
    vertices, triangles, kept = without_thin_triangles(rough.vertices, rough.faces, marked, TOLERANCE)
    smooth = trimesh.Trimesh(vertices, triangles, process=False)
    assert smooth.is_watertight and smooth.is_winding_consistent and smooth.euler_number == 2
    assert heights(smooth).min() > TOLERANCE and len(smooth.faces) < len(rough.faces)
    assert smooth.volume == pytest.approx(rough.volume, rel=1e-8)
    for mark in (False, True):
        assert smooth.area_faces[kept == mark].sum() == pytest.approx(rough.area_faces[marked == mark].sum(), rel=1e-8)


def test_a_surface_without_thin_triangles_is_unchanged() -> None:
    ball = trimesh.creation.icosphere(subdivisions=2)
    vertices, triangles, marked = without_thin_triangles(ball.vertices, ball.faces, np.arange(320) % 2 == 0, TOLERANCE)
    assert np.array_equal(vertices, ball.vertices) and np.array_equal(triangles, ball.faces)
    assert np.array_equal(marked, np.arange(320) % 2 == 0)


def test_two_sheets_with_a_short_bridge_are_not_joined() -> None:
    """An edge whose collapse would pinch the surface is kept: its ends have a third common neighbour."""
    random = np.random.default_rng(2)
    for _ in range(20):
        ring = trimesh.creation.torus(1.0, 0.4, 3, 3)
        flat = ring.vertices * [1.0, 1.0, 1e-9]
        flat[:, :2] += random.uniform(-1e-8, 1e-8, (len(flat), 2))
        unmarked = np.zeros(len(ring.faces), np.bool_)
        vertices, triangles, _ = without_thin_triangles(flat, ring.faces, unmarked, TOLERANCE)
        left = trimesh.Trimesh(vertices, triangles, process=False)
        assert left.is_watertight and left.is_winding_consistent and left.euler_number == ring.euler_number


def test_the_rim_of_an_open_surface_is_kept() -> None:
    strip = np.array([(0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (0.5, 1e-9, 0.0)])
    _, triangles, _ = without_thin_triangles(strip, np.array([[0, 1, 2]]), np.zeros(1, np.bool_), TOLERANCE)
    assert triangles.tolist() == [[0, 1, 2]]
