"""Isosurface stuffing: volumes, angles, boundary without pinches, repeatability, and what cannot be filled."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from fracture_collision.geometry.generators import TetGeometry, brick
from fracture_collision.geometry.stored_meshes import bunny
from fracture_collision.geometry.tetrahedra import (
    FACE_VERTICES,
    boundary_triangles,
    tetrahedron_volumes,
    unique_edges,
)
from fracture_collision.meshing import tetrahedralize_by_lattice
from fracture_collision.meshing.lattice_mesher import without_pinches
from fracture_collision.records import CollisionBody
from fracture_collision.world import CollisionWorld


def hollow() -> trimesh.Trimesh:
    inside = trimesh.creation.icosphere(3, 0.05)
    inside.invert()
    return trimesh.util.concatenate(trimesh.creation.icosphere(3, 0.1), inside)


SURFACES = {
    "ball": trimesh.creation.icosphere(3, 0.1),
    "box": trimesh.creation.box((0.2, 0.1, 0.06)),
    "torus": trimesh.creation.torus(0.1, 0.04),
    "cylinder": trimesh.creation.cylinder(0.05, 0.2),
    "hollow": hollow(),
    "turned box": trimesh.creation.box((0.2, 0.1, 0.06)).apply_transform(
        trimesh.transformations.rotation_matrix(0.7, (1, 2, 3), (5, 0, 0))
    ),
}


def filled(name: str, edges_along: float) -> TetGeometry:
    surface = SURFACES[name]
    return tetrahedralize_by_lattice(surface.vertices, surface.faces, surface.extents.max() / edges_along)


def dihedral_angles(mesh: TetGeometry) -> np.ndarray:
    corners = mesh.vertices[mesh.tetrahedra[:, FACE_VERTICES]]  # (m, 4, 3, 3)
    normals = np.cross(corners[:, :, 1] - corners[:, :, 0], corners[:, :, 2] - corners[:, :, 0])
    normals /= np.linalg.norm(normals, axis=2, keepdims=True)
    pairs = [(normals[:, i] * normals[:, j]).sum(axis=1) for i in range(4) for j in range(i)]
    return 180.0 - np.degrees(np.arccos(np.clip(pairs, -1.0, 1.0)))


@pytest.mark.parametrize("name", SURFACES)
def test_a_mesh_fills_its_surface(name: str) -> None:
    surface, mesh = SURFACES[name], filled(name, 16)
    volumes = tetrahedron_volumes(*mesh)
    assert volumes.min() > 0.0
    assert 0.94 < volumes.sum() / surface.volume < 1.01
    angles = dihedral_angles(mesh)
    assert angles.min() > 9.0 and angles.max() < 160.0
    ends = mesh.vertices[unique_edges(mesh.tetrahedra)]
    assert np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1).mean() == pytest.approx(surface.extents.max() / 16, rel=0.1)
    boundary = trimesh.Trimesh(mesh.vertices, boundary_triangles(mesh.tetrahedra), process=False)
    assert boundary.is_watertight and boundary.is_winding_consistent
    assert len(np.unique(mesh.tetrahedra)) == len(mesh.vertices)
    world = CollisionWorld()
    world.add_body(CollisionBody(1, 1, vertices=mesh.vertices, tetrahedra=mesh.tetrahedra))
    assert world.fragments().masses[0] == pytest.approx(1000.0 * volumes.sum(), rel=1e-12)


@pytest.mark.parametrize("name", SURFACES)
def test_the_boundary_lies_on_the_surface_and_rounds_corners_by_less_than_an_edge(name: str) -> None:
    surface, mesh = SURFACES[name], filled(name, 16)
    triangles, longest = boundary_triangles(mesh.tetrahedra), surface.extents.max()
    _, distance, _ = trimesh.proximity.closest_point_naive(surface, mesh.vertices[np.unique(triangles)])
    assert np.mean(distance < 1e-9 * longest) > 0.9
    assert distance.max() < 0.5 * longest / 16
    if "box" in name:
        boundary = trimesh.Trimesh(mesh.vertices, triangles, process=False)
        _, distance, _ = trimesh.proximity.closest_point_naive(boundary, surface.vertices)
        assert distance.max() < longest / 16


def test_the_error_of_the_volume_falls_with_the_edge_length() -> None:
    errors = [1.0 - tetrahedron_volumes(*filled("ball", n)).sum() / SURFACES["ball"].volume for n in (10, 20)]
    assert errors[0] / errors[1] > 3.0


def test_equal_arguments_give_equal_bytes() -> None:
    for one, again in zip(filled("torus", 12), filled("torus", 12), strict=True):
        assert one.tobytes() == again.tobytes()


def test_what_cannot_be_filled_is_named() -> None:
    box = SURFACES["box"]
    dumbbell = trimesh.util.concatenate(
        [trimesh.creation.icosphere(3, 0.1).apply_translation((x, 0.0, 0.0)) for x in (-0.2, 0.2)]
    )
    rods = [trimesh.creation.box((0.4, 0.002, 0.002)) for _ in range(2)]
    rods[1].apply_transform(trimesh.transformations.rotation_matrix(0.5, (1, 1, 1)))
    for vertices, triangles, length, words in (
        (box.vertices, box.faces[1:], 0.02, "triangles: the surface has holes"),
        (box.vertices, box.faces[:, ::-1], 0.02, "triangles: clockwise"),
        (box.vertices, box.faces, 0.0, "edge_length: 0.0 is not a positive length"),
        (box.vertices, box.faces, 1e-5, "edge_length: gives .* tetrahedra, more than"),
        *[(rod.vertices, rod.faces, 0.1, "edge_length: 0.1 m is too long, no lattice point") for rod in rods],
        (dumbbell.vertices, dumbbell.faces, 0.02, "edge_length: at 0.02 m thin parts are lost and 2 pieces are left"),
    ):
        with pytest.raises(ValueError, match=words):
            tetrahedralize_by_lattice(vertices, triangles, length)


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
