"""Meshes whose boundary touches itself: pinched edges lose the smaller fan, pinched vertices are doubled."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from fracture_collision.geometry.generators import brick
from fracture_collision.geometry.stored_meshes import bunny
from fracture_collision.geometry.tetrahedra import boundary_triangles, tetrahedron_volumes
from fracture_collision.meshing import tetrahedralize_by_lattice
from fracture_collision.meshing.lattice_mesher import without_pinches

BRICK = brick((3.0, 3.0, 1.0), 1.0)


def is_manifold(vertices: np.ndarray, tetrahedra: np.ndarray) -> bool:
    """Each edge of the boundary in two triangles, each vertex in one fan of them."""
    boundary = trimesh.Trimesh(vertices, boundary_triangles(tetrahedra), process=False)
    fans = boundary.vertex_faces
    for vertex in np.unique(boundary.faces):
        around = fans[vertex][fans[vertex] >= 0]
        pairs = boundary.face_adjacency[np.isin(boundary.face_adjacency, around).all(axis=1)]
        at_vertex = [p for p in pairs if (boundary.faces[p] == vertex).any(axis=1).all()]
        if len(trimesh.graph.connected_components(at_vertex, nodes=around)) != 1:
            return False
    return bool(boundary.is_watertight)


def without_cubes(*middles: tuple[float, float]) -> np.ndarray:
    """The brick's tetrahedra but those of the unit cubes around these places."""
    centre = BRICK.vertices[BRICK.tetrahedra].mean(axis=1)[:, :2]
    gone = [np.abs(centre - middle).max(axis=1) < 0.5 for middle in middles]
    return BRICK.tetrahedra[~np.any(gone, axis=0)]


def test_a_mesh_without_pinches_stays_as_it_is() -> None:
    vertices, tetrahedra = without_pinches(*BRICK)
    assert np.array_equal(np.sort(vertices[tetrahedra].ravel()), np.sort(BRICK.vertices[BRICK.tetrahedra].ravel()))
    assert len(vertices) == len(BRICK.vertices) and len(tetrahedra) == len(BRICK.tetrahedra)


def test_a_pinched_edge_loses_its_smaller_fans() -> None:
    holed = without_cubes((0.0, 0.0), (1.0, 1.0))  # two holes that meet in an edge
    assert not is_manifold(BRICK.vertices, holed)
    vertices, tetrahedra = without_pinches(BRICK.vertices, holed)
    assert is_manifold(vertices, tetrahedra)
    assert 0 < len(holed) - len(tetrahedra) <= 8


def test_a_pinched_vertex_is_doubled() -> None:
    two = np.concatenate((np.eye(3), np.zeros((1, 3)), -np.eye(3)))
    tetrahedra = np.array([[0, 1, 2, 3], [4, 5, 6, 3]])
    tetrahedra[tetrahedron_volumes(two, tetrahedra) < 0.0, :2] = tetrahedra[
        tetrahedron_volumes(two, tetrahedra) < 0.0, 1::-1
    ]
    assert not is_manifold(two, tetrahedra)
    vertices, apart = without_pinches(two, tetrahedra)
    assert len(vertices) == 8 and is_manifold(vertices, apart)
    assert np.array_equal(vertices[apart], two[tetrahedra])


@pytest.mark.parametrize("edges_along", [8.3, 10.1, 12.7, 15.0, 18.9])
def test_the_mesher_gives_none(edges_along: float) -> None:
    mesh = bunny(0.2)
    surface = boundary_triangles(mesh.tetrahedra)
    used, surface = np.unique(surface, return_inverse=True)
    filled = tetrahedralize_by_lattice(mesh.vertices[used], surface.reshape(-1, 3), 0.2 / edges_along)
    assert is_manifold(*filled)
