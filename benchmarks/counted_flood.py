"""A plain copy of the flood of core/field/flood.py that counts what it dequeues, visits and measures.

Not cached: a cache would outlive changes to the service's functions called here.
"""

from __future__ import annotations

import heapq
import math

import numpy as np
from numba import njit

from fracture_collision.core.field.flood import least_distance_squared, may_leave_over
from fracture_collision.core.memory.pools import BACK_SIDE, FRONT_SIDE, KIND, OLD_FACE, OWNER, ROW, Pools
from fracture_collision.core.mesh.closest_point import closest_on_triangle
from fracture_collision.core.mesh.cut_tetrahedron import FACE_VERTICES
from fracture_collision.core.mesh.point_location import holds_fragment


def count_floods(
    pools: Pools, rows: np.ndarray, tets: np.ndarray, points: np.ndarray, limits: np.ndarray
) -> np.ndarray:
    """(n, 4): distance [m], tetrahedra taken from the queue, tetrahedra seen, triangles measured.

    Of points (n, 3) [m] in tetrahedra `tets` (n,) of broken fragments `rows` (n,), whose distance is below `limits`
    (n,) [m]. Measured are triangles whose own plane, and that of the tetrahedron's face they lie in, are near enough.
    """
    return _count_floods(pools, rows, tets, points, limits)


@njit(error_model="numpy")
def _count_floods(pools, rows, tets, points, limits):
    counts = np.empty((len(points), 4))
    for i in range(len(points)):
        x, y, z = points[i]
        distance, taken, seen, measured = _counted_flood(pools, rows[i], tets[i], x, y, z, limits[i])
        counts[i, 0], counts[i, 1], counts[i, 2], counts[i, 3] = distance, taken, seen, measured
    return counts


@njit(error_model="numpy")
def _counted_flood(pools, f, start, x, y, z, limit):
    mesh, body = pools.mesh, pools.body
    shift = pools.fragment.tet_shift[f]
    seen = np.zeros(len(mesh.tetrahedra), np.bool_)
    seen[start] = True
    queue = [(0.0, start)]
    best = limit * limit
    taken, looked_at, measured = 0, 1, 0
    while len(queue) and queue[0][0] < best:
        t = heapq.heappop(queue)[1]
        taken += 1
        if body.regions[t + shift, OWNER] >= 0:
            for face in range(4):
                if mesh.neighbours[t, face] < 0 and _height_squared(mesh, t, face, x, y, z) <= best:
                    c = mesh.nodes[mesh.tetrahedra[t][FACE_VERTICES[face]]].ravel()
                    best = min(best, _to_triangle(x, y, z, c))
                    measured += 1
        face, farther = -1, False
        for i in range(body.regions[t + shift, ROW], body.regions[t + shift, ROW] + body.cut_count[t + shift]):
            if body.sides[i, FRONT_SIDE] != f and body.sides[i, BACK_SIDE] != f:
                continue
            if body.sides[i, KIND] >= OLD_FACE:
                if body.sides[i, KIND] != face:
                    face = body.sides[i, KIND]
                    farther = _height_squared(mesh, t, face - OLD_FACE, x, y, z) > best
                if farther:
                    continue
            p = body.faces[i]
            if (p[0] * x + p[1] * y + p[2] * z - p[3]) ** 2 <= best:
                best = min(best, _to_triangle(x, y, z, body.triangles[i]))
                measured += 1
        for face in range(4):
            n = mesh.neighbours[t, face]
            if n >= 0 and not seen[n] and may_leave_over(mesh, t, face, x, y, z, best):
                seen[n] = True
                looked_at += 1
                if holds_fragment(pools, f, n):
                    key = least_distance_squared(mesh, n, x, y, z)
                    if key < best:
                        heapq.heappush(queue, (key, np.int64(n)))
    return math.sqrt(best), taken, looked_at, measured


@njit(error_model="numpy")
def _height_squared(mesh, t, face, x, y, z):
    """Squared height [m2] of a point over the plane of a tetrahedron's face."""
    a, b, c = mesh.nodes[mesh.tetrahedra[t][FACE_VERTICES[face]]]
    normal = np.cross(b - a, c - a)
    height = (x - a[0]) * normal[0] + (y - a[1]) * normal[1] + (z - a[2]) * normal[2]
    return height * height / (normal[0] ** 2 + normal[1] ** 2 + normal[2] ** 2)


@njit(error_model="numpy")
def _to_triangle(x, y, z, c):
    return closest_on_triangle((x, y, z), ((c[0], c[1], c[2]), (c[3], c[4], c[5]), (c[6], c[7], c[8])))[0]
