"""The slow oracle's queries for millions of points: the owner of a point, the distance to a surface.

Compiled loops over arrays; nothing is shared with fracture_collision.core.

The method is plain: a point's tetrahedron is the best of all whose boxes contain it, a distance the minimum over all
triangles. Triangles whose boxes are farther than the best so far are skipped, which changes no result. In a
tetrahedron the owner is that of the best of its 24 parts.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numba import njit

if TYPE_CHECKING:
    from oracles.fragmented_body import FragmentedBody

# Parts below this share of their tetrahedron hold no point.
NO_VOLUME = 1e-15
# For a point this close to a face, in barycentric weight, the tetrahedron on either side may decide.
SHARED = 1e-9
# Thinner triangles (area against squared length) have no usable normal; their rims represent them.
THIN = 1e-11


class Partition(NamedTuple):
    """A fragmented body as arrays."""

    to_weights: np.ndarray  # (m, 4, 4): weights of a point x are to_weights[t] @ (x, 1)
    boxes: np.ndarray  # (m, 6) [m] lower and upper corner
    labels: np.ndarray  # (m, 4) fragment id of each corner
    row: np.ndarray  # (m,) in the next three, -1 where one fragment has all of the tetrahedron
    part_labels: np.ndarray  # (c, 24) fragment id of each part
    part_shares: np.ndarray  # (c, 24) its volume, as a share of the tetrahedron's
    to_part: np.ndarray  # (c, 24, 4, 4): weights in a part of a point with weights w in the tetrahedron are w @ to_part
    origin: np.ndarray  # (3,) [m] of a grid of cubes over the body
    cell: float  # [m]
    dims: np.ndarray  # (3,)
    cell_begin: np.ndarray  # (cells + 1,)
    cell_tets: np.ndarray  # tetrahedra whose boxes meet each cube, ascending


def partition_of(body: FragmentedBody) -> Partition:
    """The present state of the slow oracle as arrays: its vertices, tetrahedra, node labels and crack points."""
    corners = body.vertices[body.tetrahedra]
    to_weights = np.linalg.inv(np.concatenate((corners, np.ones((len(corners), 4, 1))), axis=2)).transpose(0, 2, 1)
    boxes = np.concatenate((corners.min(axis=1), corners.max(axis=1)), axis=1)
    origin, upper = boxes[:, :3].min(axis=0), boxes[:, 3:].max(axis=0)
    cell = float((np.prod(upper - origin) / len(boxes)) ** (1.0 / 3.0))
    dims = np.floor((upper - origin) / cell).astype(np.int64) + 1
    begin, tets = _tetrahedra_of_cells(boxes, origin, cell, dims)
    return Partition(np.ascontiguousarray(to_weights), boxes, body.labels[body.tetrahedra], body.parts.row,
                     body.parts.labels, body.parts.share, np.ascontiguousarray(body.parts.to_part),
                     origin, cell, dims, begin, tets)  # fmt: skip


@njit(cache=True)
def _cells_of(boxes, t, origin, cell, dims, k):
    low = int(np.floor((boxes[t, k] - origin[k]) / cell - 1e-6))
    high = int(np.floor((boxes[t, k + 3] - origin[k]) / cell + 1e-6))
    return max(low, 0), min(high, dims[k] - 1) + 1


@njit(cache=True)
def _tetrahedra_of_cells(boxes, origin, cell, dims):
    begin = np.zeros(dims[0] * dims[1] * dims[2] + 1, dtype=np.int64)
    tets = np.empty(0, dtype=np.int64)
    for fill in range(2):
        used = np.zeros(len(begin), dtype=np.int64)
        for t in range(len(boxes)):
            i0, i1 = _cells_of(boxes, t, origin, cell, dims, 0)
            j0, j1 = _cells_of(boxes, t, origin, cell, dims, 1)
            k0, k1 = _cells_of(boxes, t, origin, cell, dims, 2)
            for i in range(i0, i1):
                for j in range(j0, j1):
                    for k in range(k0, k1):
                        c = (i * dims[1] + j) * dims[2] + k
                        if fill:
                            tets[begin[c] + used[c]] = t
                        used[c] += 1
        if not fill:
            begin[1:] = np.cumsum(used[:-1])
            tets = np.empty(begin[-1], dtype=np.int64)
    return begin, tets


@njit(cache=True)
def _owner_in(labels, shares, to_part, w):
    """The label of the part that best contains the point of weights w; the smaller one at a tie."""
    owner, best = -1, -np.inf
    for p in range(len(labels)):
        if shares[p] <= NO_VOLUME:
            continue
        least = np.inf
        for v in range(4):
            column = to_part[p, :, v]
            least = min(least, w[0] * column[0] + w[1] * column[1] + w[2] * column[2] + w[3] * column[3])
        if least > best or (least == best and labels[p] < owner):
            owner, best = labels[p], least
    return owner


def owners(body: Partition, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The fragment id (n,) that each point [m] belongs to, 0 outside; and whether all containing tetrahedra agree.

    A point on a face shared by two tetrahedra gets the owner of the one that contains it best. As near to a crack as
    SHARED, the two may disagree by rounding, and the second array is False.
    """
    return _owners(body, np.ascontiguousarray(points, dtype=np.float64))


@njit(cache=True)
def _owners(body, points):
    found = np.zeros(len(points), dtype=np.int64)
    certain = np.ones(len(points), dtype=np.bool_)
    w = np.empty(4)
    for n in range(len(points)):
        x, y, z = points[n]
        i = int(np.floor((x - body.origin[0]) / body.cell))
        j = int(np.floor((y - body.origin[1]) / body.cell))
        k = int(np.floor((z - body.origin[2]) / body.cell))
        if min(i, j, k) < 0 or i >= body.dims[0] or j >= body.dims[1] or k >= body.dims[2]:
            continue
        c = (i * body.dims[1] + j) * body.dims[2] + k
        deepest = -1e-13
        first = -1
        for e in range(body.cell_begin[c], body.cell_begin[c + 1]):
            t = body.cell_tets[e]
            of_x = body.to_weights[t]
            for q in range(4):
                w[q] = of_x[q, 0] * x + of_x[q, 1] * y + of_x[q, 2] * z + of_x[q, 3]
            least = w.min()
            if least < -SHARED:
                continue
            owner, row = body.labels[t, 0], body.row[t]
            if row >= 0:
                owner = _owner_in(body.part_labels[row], body.part_shares[row], body.to_part[row], w)
            if first >= 0 and owner != first:
                certain[n] = False
            first = owner
            if least >= deepest:
                deepest = least
                found[n] = owner
    return found, certain


def distances(points: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Distance (n,) [m] of each point (n, 3) to the nearest of all triangles (t, 3, 3); infinity without any."""
    return nearest_on_triangles(points, triangles)[0]


def nearest_on_triangles(points: np.ndarray, triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Distance (n,) [m] and nearest point (n, 3) from each point to a set of triangles (t, 3, 3), over all of them."""
    return _nearest(*(np.ascontiguousarray(part, dtype=np.float64) for part in (points, triangles)))


def distances_to_triangles(x: np.ndarray, triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Of one point (3,): its distance (t,) from, and the nearest point (t, 3) of, each triangle (t, 3, 3)."""
    return _of_each(*(np.ascontiguousarray(part, dtype=np.float64) for part in (x, triangles)))


@njit(cache=True)
def _less(p, q):
    return p[0] - q[0], p[1] - q[1], p[2] - q[2]


@njit(cache=True)
def _plus(p, share, along):
    return p[0] + share * along[0], p[1] + share * along[1], p[2] + share * along[2]


@njit(cache=True)
def _dot(u, v):
    return u[0] * v[0] + u[1] * v[1] + u[2] * v[2]


@njit(cache=True)
def _cross(u, v):
    return u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]


@njit(cache=True, error_model="numpy")
def _on_triangle(x, a, b, c):
    """Squared distance [m2] and nearest point: on the rim, or the foot in the plane if that is inside all sides."""
    u, v = _less(b, a), _less(c, a)
    normal = _cross(u, v)
    best, nearest = np.inf, a
    if _dot(normal, normal) > (THIN * max(_dot(u, u), _dot(v, v))) ** 2:
        foot = _plus(x, -_dot(_less(x, a), normal) / _dot(normal, normal), normal)
        is_within = True
        for p, q in ((a, b), (b, c), (c, a)):
            is_within &= _dot(_cross(_less(q, p), _less(foot, p)), normal) >= 0.0
        if is_within:
            best, nearest = _dot(_less(foot, x), _less(foot, x)), foot
    for p, q in ((a, b), (b, c), (c, a)):
        along = _less(q, p)
        length = _dot(along, along)
        share = min(max(_dot(_less(x, p), along) / length, 0.0), 1.0) if length > 0.0 else 0.0
        foot = _plus(p, share, along)
        away = _dot(_less(foot, x), _less(foot, x))
        if away < best:
            best, nearest = away, foot
    return best, nearest


@njit(cache=True)
def _of_each(point, triangles):
    distance, nearest = np.empty(len(triangles)), np.empty((len(triangles), 3))
    for t in range(len(triangles)):
        (a0, a1, a2), (b0, b1, b2), (c0, c1, c2) = triangles[t]
        away, foot = _on_triangle((point[0], point[1], point[2]), (a0, a1, a2), (b0, b1, b2), (c0, c1, c2))
        distance[t] = np.sqrt(away)
        nearest[t, 0], nearest[t, 1], nearest[t, 2] = foot
    return distance, nearest


@njit(cache=True)
def _nearest(points, triangles):
    distance, nearest = np.empty(len(points)), np.zeros((len(points), 3))
    low, high = np.empty((len(triangles), 3)), np.empty((len(triangles), 3))
    for t in range(len(triangles)):
        for k in range(3):
            low[t, k] = min(triangles[t, 0, k], triangles[t, 1, k], triangles[t, 2, k])
            high[t, k] = max(triangles[t, 0, k], triangles[t, 1, k], triangles[t, 2, k])
    for n in range(len(points)):
        x, y, z = points[n]
        best = np.inf
        for t in range(len(triangles)):
            dx = max(low[t, 0] - x, 0.0, x - high[t, 0])
            dy = max(low[t, 1] - y, 0.0, y - high[t, 1])
            dz = max(low[t, 2] - z, 0.0, z - high[t, 2])
            if dx * dx + dy * dy + dz * dz < best:
                (a0, a1, a2), (b0, b1, b2), (c0, c1, c2) = triangles[t]
                away, foot = _on_triangle((x, y, z), (a0, a1, a2), (b0, b1, b2), (c0, c1, c2))
                if away < best:
                    best = away
                    nearest[n, 0], nearest[n, 1], nearest[n, 2] = foot
        distance[n] = np.sqrt(best)
    return distance, nearest
