"""The vase: a closed tetrahedral solid that stands, is hollow, and has the requested thickness."""

from __future__ import annotations

import numpy as np
import pytest

from fracture_collision.geometry.surface_meshing import require_closed_surface
from fracture_collision.geometry.tetrahedra import boundary_triangles, face_neighbours, tetrahedron_volumes
from fracture_collision.geometry.vase import PROFILE, vase

HEIGHT, WALL, EDGE = 0.3, 0.008, 0.015


@pytest.mark.parametrize("arguments", [(HEIGHT, WALL, EDGE), (1.0, 0.05, 0.1, 1), (0.1, 0.001, 0.004, 3)])
def test_a_vase_is_a_closed_solid_of_valid_tetrahedra(arguments):
    mesh = vase(*arguments)
    assert tetrahedron_volumes(mesh.vertices, mesh.tetrahedra).min() > 0.0
    face_neighbours(mesh.tetrahedra)  # raises where faces do not match
    surface = boundary_triangles(mesh.tetrahedra)
    require_closed_surface(mesh.vertices, surface)
    edges = np.unique(np.sort(surface[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1), axis=0)
    assert len(np.unique(surface)) - len(edges) + len(surface) == 2, "a cup has no handle"


def test_a_vase_stands_and_has_its_size():
    points = vase(HEIGHT, WALL, EDGE).vertices
    low, high = points.min(axis=0), points.max(axis=0)
    assert low[2] == pytest.approx(0.0, abs=1e-12) and high[2] == pytest.approx(HEIGHT, rel=0.01)
    standing = points[points[:, 2] < 1e-9]
    assert np.hypot(*standing[:, :2].T).max() > 0.08 * HEIGHT, "a foot, not a point"
    widest = 2.0 * PROFILE[:, 0].max() * (HEIGHT - WALL) + WALL
    assert high[0] - low[0] == pytest.approx(widest, rel=0.02)


def test_the_volume_of_a_vase_is_that_of_a_thin_wall():
    """Pappus: the wall's middle line turned about the axis, times the wall. The polygon of 36 corners lacks 0.5 %."""
    mesh = vase(HEIGHT, WALL, EDGE)
    r, z = (PROFILE * (HEIGHT - WALL)).T
    area = (2.0 * np.pi * 0.5 * (r[1:] + r[:-1]) * np.hypot(np.diff(r), np.diff(z))).sum()
    volume = tetrahedron_volumes(mesh.vertices, mesh.tetrahedra).sum()
    assert volume == pytest.approx(area * WALL, rel=0.02)


def test_equal_arguments_give_equal_bytes():
    one, other = vase(HEIGHT, WALL, EDGE), vase(HEIGHT, WALL, EDGE)
    assert one.vertices.tobytes() == other.vertices.tobytes()
    assert one.tetrahedra.tobytes() == other.tetrahedra.tobytes()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ((0.0, WALL, EDGE), "height: 0.0 is not a positive length"),
        ((HEIGHT, 0.02, EDGE), "wall: 0.02 m leaves no hollow"),
        ((HEIGHT, WALL, EDGE, 0), "layers: 0 is not at least 1"),
        ((HEIGHT, WALL, 1e-5), "edge_length: gives"),
    ],
)
def test_invalid_arguments_are_rejected_with_an_explanation(arguments, words):
    with pytest.raises(ValueError, match=words):
        vase(*arguments)
