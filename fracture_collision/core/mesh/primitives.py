"""Planes, spheres and boxes in closed form: the elementary queries without mesh, tree or field."""

from __future__ import annotations

import math

import numpy as np

from fracture_collision.core.memory.compiled import query_kernel
from fracture_collision.core.memory.kinds import BOX, PLANE

# A box is sampled along its edges, where it penetrates faces of others; its own faces are handled in closed form. The
# spacing, as a share of the longest edge, keeps the tree of a long shelf small and a cube's edge well covered.
BOX_EDGE_SPACING = 1.0 / 64.0


@query_kernel
def primitive_distance(kind, shape, x, y, z):
    """Signed distance [m], positive outside, with the outward unit normal: (distance, nx, ny, nz).

    `shape` (4,): plane (unit normal, offset), sphere (radius), box (half edges); the point in the body frame. The
    closest point is x - distance n.
    """
    if kind == PLANE:
        return shape[0] * x + shape[1] * y + shape[2] * z - shape[3], shape[0], shape[1], shape[2]
    if kind == BOX:
        return _box_distance(shape, x, y, z)
    r = math.sqrt(x * x + y * y + z * z)
    if r == 0.0:
        return -shape[0], 0.0, 0.0, 1.0
    return r - shape[0], x / r, y / r, z / r


@query_kernel
def _box_distance(half, x, y, z):
    ex, ey, ez = abs(x) - half[0], abs(y) - half[1], abs(z) - half[2]
    sx = 1.0 if x >= 0.0 else -1.0
    sy = 1.0 if y >= 0.0 else -1.0
    sz = 1.0 if z >= 0.0 else -1.0
    if ex <= 0.0 and ey <= 0.0 and ez <= 0.0:
        if ex >= ey and ex >= ez:
            return ex, sx, 0.0, 0.0
        if ey >= ez:
            return ey, 0.0, sy, 0.0
        return ez, 0.0, 0.0, sz
    ox, oy, oz = max(ex, 0.0), max(ey, 0.0), max(ez, 0.0)
    d = math.sqrt(ox * ox + oy * oy + oz * oz)
    return d, sx * ox / d, sy * oy / d, sz * oz / d


def _pieces_of_edges(half: np.ndarray) -> list[int]:
    """Number of equal pieces into which samples divide the edges along each axis of a box of half edges (3,) [m]."""
    step = 2.0 * float(half.max()) * BOX_EDGE_SPACING
    return [max(int(np.ceil(2.0 * h / step - 1e-9)), 1) for h in half.tolist()]


def box_edge_points(half: np.ndarray) -> np.ndarray:
    """Corners and evenly spaced points of the twelve edges, (n, 3) [m], no point twice."""
    points = [np.array([x, y, z]) * half for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]
    for axis, pieces in enumerate(_pieces_of_edges(half)):
        for t in np.linspace(-1.0, 1.0, pieces + 1)[1:-1]:
            for u in (-1, 1):
                for v in (-1, 1):
                    points.append(np.insert(np.array([u, v], float), axis, t) * half)
    return np.ascontiguousarray(points)


def box_sampling_gap(half: np.ndarray) -> float:
    """Tight upper bound [m] of the distance of a surface point from the nearest of box_edge_points(half).

    From a point of a face with half edges a and b it is at most a to an edge of length 2 b, and along that edge at most
    half the spacing of its samples to the nearest of them; likewise the other way round.
    """
    spacing = [h / pieces for h, pieces in zip(half.tolist(), _pieces_of_edges(half), strict=True)]  # half of it
    farthest = 0.0
    for i, j in ((0, 1), (1, 2), (2, 0)):
        a, b = float(half[i]), float(half[j])
        farthest = max(farthest, min(a * a + spacing[j] * spacing[j], b * b + spacing[i] * spacing[i]))
    return math.sqrt(farthest)
