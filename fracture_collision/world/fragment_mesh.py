"""A fragment's surface for viewers: the original surface and the crack polygons that the field measures against."""

from __future__ import annotations

import numpy as np

from fracture_collision.core.bodies.collision_geometry import CollisionGeometry
from fracture_collision.core.memory.kinds import BOX, PLANE, SPHERE, TRIANGLES
from fracture_collision.core.mesh.surface_triangles import surface_triangles
from fracture_collision.geometry.generators import ball, brick
from fracture_collision.geometry.tetrahedra import boundary_triangles
from fracture_collision.geometry.unique_rows import unique_rows
from fracture_collision.portable_math import lengths
from fracture_collision.records import FragmentMesh

SPHERE_EDGE = 0.2  # of the radius: looks round enough
PLANE_HALF = 5.0  # [m] an unbounded plane is shown as a square of this half side


def fragment_mesh(fragment_id: int, geometry: CollisionGeometry, row: int) -> FragmentMesh:
    """The surface of the fragment in `row` of `geometry`, in its body frame, with shared vertices merged."""
    fragment = geometry.pools.fragment
    kind, shape = fragment.kind[row], fragment.shape[row]
    if kind == PLANE:
        corners = _plane_square(shape)
    elif kind == SPHERE:
        corners = _boundary(ball(float(shape[0]), SPHERE_EDGE * float(shape[0])))
    elif kind == BOX:
        corners = _boundary(brick(2.0 * shape[:3], 2.0 * float(shape[:3].max())))
    elif kind == TRIANGLES:
        corners = geometry.rigid_triangles(row)
    else:
        corners, is_crack = surface_triangles(geometry.pools, row, geometry.tet_range(row))
        return _record(fragment_id, corners, is_crack)
    return _record(fragment_id, corners, np.zeros(len(corners), np.bool_))


def _boundary(body) -> np.ndarray:
    return body.vertices[boundary_triangles(body.tetrahedra)]


def _plane_square(shape: np.ndarray) -> np.ndarray:
    normal, center = shape[:3], shape[:3] * shape[3]
    side = np.cross(normal, np.eye(3)[np.argmin(np.abs(normal))])
    u = PLANE_HALF * side / lengths(side)
    v = np.cross(normal, u)
    corners = np.array([center - u - v, center + u - v, center + u + v, center - u + v])
    return corners[[[0, 1, 2], [0, 2, 3]]]


def _record(fragment_id: int, corners: np.ndarray, is_crack: np.ndarray) -> FragmentMesh:
    points = corners.reshape(-1, 3).astype(np.float32)
    chosen, index = unique_rows(points)
    return FragmentMesh(fragment_id, points[chosen].ravel(), index.astype(np.uint32), is_crack.astype(np.bool_))
