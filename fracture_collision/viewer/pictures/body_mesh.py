"""Triangles of a fragment or of an unbroken body, with normals for shading."""

from __future__ import annotations

import numpy as np

from fracture_collision.geometry.generators import brick, shell
from fracture_collision.geometry.round_solids import BY_PRIMITIVE
from fracture_collision.geometry.tetrahedra import boundary_triangles
from fracture_collision.geometry.unique_rows import unique_rows
from fracture_collision.records import BOX, SPHERE, CollisionBody, FragmentMesh
from fracture_collision.viewer.pictures.shading import smooth_normals

PLACE_DIGITS = 7  # of coordinates [m]: vertices that agree to this many digits are at the same place
CREASE = float(np.cos(np.radians(35.0)))  # triangles that meet at a sharper angle are not smoothed


class BodyMesh:
    """Triangles of one fragment or unbroken body, in its body frame, with the normals of their corners."""

    def __init__(self, vertices: np.ndarray, triangles: np.ndarray, is_crack: np.ndarray | None = None) -> None:
        """From vertices (n, 3), triangles (t, 3), is_crack (t,); vertices at the same place count as one."""
        self.triangles = vertices[triangles].astype(np.float64)  # (t, 3, 3)
        self.is_crack = np.zeros(len(triangles), dtype=np.bool_) if is_crack is None else is_crack
        normals = np.empty((3 * len(triangles), 3))
        _, places = unique_rows(np.round(vertices.astype(np.float64), PLACE_DIGITS))
        self.places = places[triangles]  # (t, 3) of the corners: those at the same place have the same number
        smooth_normals(self.triangles, self.is_crack, self.places.ravel(), CREASE, normals)
        self.normals = normals.reshape(-1, 3, 3)  # (t, 3, 3) unit
        self.centre = self.triangles.reshape(-1, 3).mean(axis=0) if len(triangles) else np.zeros(3)


def compile_mesh_kernels() -> None:
    """Load the kernels so that the first mesh does not wait: half a second from numba's cache."""
    BodyMesh(np.eye(3), np.array([[0, 1, 2]], np.uint32), np.zeros(1, np.bool_))


def mesh_of_body(body: CollisionBody) -> BodyMesh:
    """Mesh of a body before anything breaks; no triangles for a plane, which has no bounded surface."""
    if body.primitive.type == SPHERE:
        radius = body.primitive.dimensions[0]
        sphere = shell(radius, 0.9 * radius, 0.1 * radius, layers=1)
        return BodyMesh(sphere.vertices, boundary_triangles(sphere.tetrahedra))
    if body.primitive.type == BOX:
        x, y, z = body.primitive.dimensions
        box = brick((x, y, z), 2.0 * max(x, y, z))
        return BodyMesh(box.vertices, boundary_triangles(box.tetrahedra))
    if body.primitive.type in BY_PRIMITIVE:
        return BodyMesh(*BY_PRIMITIVE[body.primitive.type](*body.primitive.dimensions))
    triangles = body.triangles.reshape(-1, 3)
    if not len(triangles):
        triangles = boundary_triangles(body.tetrahedra.reshape(-1, 4).astype(np.int64))
    return BodyMesh(body.vertices.reshape(-1, 3), triangles)


def mesh_of_fragment(mesh: FragmentMesh) -> BodyMesh:
    """The mesh that the service published for a fragment, in the body frame."""
    return BodyMesh(mesh.vertices.reshape(-1, 3), mesh.triangles.reshape(-1, 3), mesh.is_crack)
