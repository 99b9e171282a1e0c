"""The piggy bank: hollow, closed, without inverted tetrahedra, and with the radii of a pig's shape."""

from __future__ import annotations

import numpy as np
import pytest

from fracture_collision.core.mesh.connected_pieces import connected_pieces
from fracture_collision.geometry.generators import piggy_bank
from fracture_collision.geometry.tetrahedra import (
    boundary_triangles,
    tetrahedron_volumes,
    unique_edges,
)

LENGTH, WALL, EDGE = 0.25, 0.01, 0.0085


@pytest.fixture(scope="module")
def pig():
    return piggy_bank(LENGTH, WALL, EDGE)


def surfaces(mesh) -> list[np.ndarray]:
    """Triangles of each closed surface, (t, 3, 3), the largest first."""
    triangles = boundary_triangles(mesh.tetrahedra)
    nodes, local = np.unique(triangles, return_inverse=True)
    local = local.reshape(-1, 3)
    edges = np.concatenate([local[:, [0, 1]], local[:, [1, 2]]])
    piece = connected_pieces(edges, np.zeros(len(nodes), dtype=int))[local[:, 0]]
    parts = [mesh.vertices[triangles[piece == k]] for k in range(piece.max() + 1)]
    return sorted(parts, key=lambda part: -np.ptp(part.reshape(-1, 3), axis=0).prod())


def enclosed(triangles: np.ndarray) -> float:
    a, b, c = triangles.transpose(1, 0, 2)
    return float(np.einsum("ij,ij->", np.cross(a, b), c)) / 6.0


def test_a_piggy_bank_has_its_length_and_a_moderate_mesh(pig):
    assert 2000 <= len(pig.vertices) <= 5000
    assert np.ptp(pig.vertices[:, 0]) == pytest.approx(LENGTH, rel=0.03)
    used = np.unique(pig.tetrahedra)
    assert len(used) == len(pig.vertices)


def test_a_piggy_bank_is_hollow_and_closed(pig):
    outside, inside = surfaces(pig)
    assert enclosed(outside) > 0.0 > enclosed(inside)
    volume = tetrahedron_volumes(*pig)
    assert volume.min() > 0.0
    # the volume between the two surfaces equals that of the tetrahedra: no overlap, no gap
    assert volume.sum() == pytest.approx(enclosed(outside) + enclosed(inside), rel=1e-9)
    edges = np.concatenate([boundary_triangles(pig.tetrahedra)[:, [i, (i + 1) % 3]] for i in range(3)])
    assert len(np.unique(edges, axis=0)) == len(edges)
    assert set(map(tuple, edges.tolist())) == set(map(tuple, edges[:, ::-1].tolist()))
    assert len(unique_edges(pig.tetrahedra)) > 0


def test_a_piggy_bank_stands_on_four_legs_and_is_symmetric(pig):
    (outside, _) = surfaces(pig)
    points = outside.reshape(-1, 3)
    low = points[points[:, 2] < points[:, 2].min() + 0.004]
    quadrants = {(x > 0.0, y > 0.0) for x, y, _ in low}
    assert len(quadrants) == 4
    # legs, ears, snout and tail extend beyond the belly
    belly = points[np.abs(points[:, 0]) < 0.01]
    assert points[:, 2].min() < belly[:, 2].min() - 0.01
    assert np.ptp(points[:, 1]) == pytest.approx(2.0 * points[:, 1].max(), rel=0.02)


def test_the_wall_has_its_thickness_away_from_bumps(pig):
    layers = pig.vertices.reshape(3, -1, 3)
    thickness = np.linalg.norm(layers[2] - layers[0], axis=1)
    assert thickness.min() == pytest.approx(WALL, rel=0.1)
    assert np.mean(thickness < 1.3 * WALL) > 0.3


def test_equal_arguments_give_equal_bytes(pig):
    again = piggy_bank(LENGTH, WALL, EDGE)
    assert again.vertices.tobytes() == pig.vertices.tobytes()
    assert again.tetrahedra.tobytes() == pig.tetrahedra.tobytes()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ((0.0, 0.01, 0.01), "length: 0.0 is not a positive length"),
        ((0.25, 0.1, 0.01), "wall: 0.1 m leaves no hollow"),
        ((0.25, 0.01, float("nan")), "edge_length"),
        ((0.25, 0.01, 1e-6), "more than"),
        ((0.25, 0.01, 0.01, 0), "layers: 0 is not at least 1"),
    ],
)
def test_errors_name_the_argument(arguments, words):
    with pytest.raises(ValueError, match=words):
        piggy_bank(*arguments)
