"""The slow oracle's queries for millions of points: the owner of a point, the distance to a surface.

Compiled loops over arrays; nothing is shared with fracture_collision.core.

The method is plain: a point's tetrahedron is the best of all whose boxes contain it, a distance the minimum over all
triangles. Triangles whose boxes are farther than the best so far are skipped, which changes no result. In a
tetrahedron the owner is that of the best of its 24 parts.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from oracles.fragmented_body import NO_VOLUME, FragmentedBody

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


@njit(cache=True)
def _segment(x, y, z, p, q):
    dx, dy, dz = q[0] - p[0], q[1] - p[1], q[2] - p[2]
    length = dx * dx + dy * dy + dz * dz
    s = 0.0
    if length > 0.0:
        s = min(max(((x - p[0]) * dx + (y - p[1]) * dy + (z - p[2]) * dz) / length, 0.0), 1.0)
    return (x - p[0] - s * dx) ** 2 + (y - p[1] - s * dy) ** 2 + (z - p[2] - s * dz) ** 2


@njit(cache=True)
def _triangle(x, y, z, a, b, c):
    """Squared distance [m2]: to the rim, and to the plane if the foot of the perpendicular is inside all sides."""
    best = min(_segment(x, y, z, a, b), _segment(x, y, z, b, c), _segment(x, y, z, c, a))
    ux, uy, uz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    vx, vy, vz = c[0] - a[0], c[1] - a[1], c[2] - a[2]
    nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    area = nx * nx + ny * ny + nz * nz
    longest = max(ux * ux + uy * uy + uz * uz, vx * vx + vy * vy + vz * vz)
    if area <= (THIN * longest) ** 2:
        return best
    height = (x - a[0]) * nx + (y - a[1]) * ny + (z - a[2]) * nz
    for side in range(3):
        p, q = (a, b) if side == 0 else (b, c) if side == 1 else (c, a)
        dx, dy, dz = q[0] - p[0], q[1] - p[1], q[2] - p[2]
        fx, fy, fz = x - p[0], y - p[1], z - p[2]  # the foot differs along n only, which has no part in (d x f) . n
        if (dy * fz - dz * fy) * nx + (dz * fx - dx * fz) * ny + (dx * fy - dy * fx) * nz < 0.0:
            return best
    return min(best, height * height / area)


def distances(points: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Distance (n,) [m] of each point (n, 3) to the nearest of all triangles (t, 3, 3); infinity without any."""
    return _distances(np.ascontiguousarray(points, dtype=np.float64), np.ascontiguousarray(triangles))


@njit(cache=True)
def _distances(points, triangles):
    result = np.empty(len(points))
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
                best = min(best, _triangle(x, y, z, triangles[t, 0], triangles[t, 1], triangles[t, 2]))
        result[n] = np.sqrt(best)
    return result
