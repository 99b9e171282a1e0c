"""A fragment's surface for viewers and files: closed, of the old surface and the crack polygons."""

from __future__ import annotations

import numpy as np

from fracture_collision.core.bodies.collision_geometry import CollisionGeometry
from fracture_collision.core.fracture.closed_surface import closed_surface
from fracture_collision.core.memory.kinds import BOX, PLANE, SPHERE, TRIANGLES
from fracture_collision.core.mesh.thin_triangles import without_thin_triangles
from fracture_collision.geometry.generators import ball, brick
from fracture_collision.geometry.tetrahedra import boundary_triangles
from fracture_collision.geometry.unique_rows import unique_rows
from fracture_collision.portable_math import lengths
from fracture_collision.records import FragmentMesh

SPHERE_EDGE = 0.2  # of the radius: looks round enough
THIN = 1e-6  # of the longest side: shorter edges and lower triangles are removed
PLANE_HALF = 5.0  # [m] an unbounded plane is shown as a square of this half side


def fragment_mesh(fragment_id: int, geometry: CollisionGeometry, row: int) -> FragmentMesh:
    """The surface of the fragment in `row` of `geometry`, in its body frame, with shared vertices merged.

    Of tetrahedra it is closed and encloses the fragment's volume, but for changes by THIN of its size: single precision
    would make crossings of so short edges and so low triangles.
    """
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
        vertices, triangles, is_crack = closed_surface(geometry.pools, row, geometry.tet_range(row))
        vertices = vertices.astype(np.float32)
        tolerance = THIN * float(np.ptp(vertices, axis=0).max())
        vertices, triangles, is_crack = without_thin_triangles(vertices, triangles, is_crack, tolerance)
        _move_apart(vertices, triangles, 4.0 * tolerance)
        return FragmentMesh(fragment_id, vertices, triangles.astype(np.uint32), is_crack)
    return _record(fragment_id, corners, np.zeros(len(corners), np.bool_))


def _move_apart(vertices: np.ndarray, triangles: np.ndarray, distance: float) -> None:
    """Move vertices (n, 3) at the place of an earlier one by `distance` [m], towards the mean of their neighbours.

    Readers of files merge vertices at equal places, which would join sheets of the surface that touch.
    """
    first, _ = unique_rows(vertices)
    for i in np.setdiff1d(np.arange(len(vertices)), first):
        beside = vertices[triangles[(triangles == i).any(axis=1)]]
        way = beside.astype(np.float64).mean(axis=(0, 1)) - vertices[i]
        vertices[i] += way * (distance / max(float(lengths(way)), distance))


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
    return FragmentMesh(
        fragment_id, points[chosen], index.astype(np.uint32).reshape(-1, 3), is_crack.astype(np.bool_)
    )
