"""Winding numbers of closed surfaces around a point, counted from the crossings of a ray from the point.

A ray that leaves a surface counts +1, one that enters it -1. Each crossing depends on the signs of four determinants,
and a sign counts only where rounding cannot have flipped it; a ray that passes too near an edge to decide is replaced
by one of another direction. So a returned count is exact. A hierarchy of boxes finds the triangles that a ray may
cross.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fracture_collision.core.memory.compiled import kernel, query_kernel
from fracture_collision.core.memory.vectors import corners_of, minus, vector_at
from fracture_collision.core.mesh.triangle_field import build_hierarchy

UNDECIDED = np.iinfo(np.int64).min
# Directions of rays, tried in turn. Edges of real meshes run along axes and diagonals; none of these does.
DIRECTIONS = np.array([
    [0.531, 0.287, 0.797], [-0.673, 0.601, 0.431], [0.239, -0.859, 0.453], [0.811, 0.367, -0.457],
    [-0.307, -0.421, 0.853], [0.617, -0.523, -0.587], [-0.769, 0.223, -0.599], [-0.389, 0.907, -0.163],
])  # fmt: skip
# Rounding error bound of a determinant, as a share of the sum of the magnitudes of its six products. Corners enter as
# differences from the point, each rounded once.
SIGN_ROUNDING = 32.0 * np.finfo(np.float64).eps
# Rounding error bound of where a ray meets the planes of a box, as a share of all lengths involved.
BOX_ROUNDING = 1e-12
# A ray whose direction has less of an axis goes across it.
ACROSS = 1e-200


class _Surface(NamedTuple):
    """Triangles under a hierarchy of boxes (triangle_field.build_hierarchy)."""

    corners: np.ndarray  # (t, 9) float64 [m]
    piece: np.ndarray  # (t,) int64
    node_box: np.ndarray  # (b, 6) float64 [m]
    skip: np.ndarray  # (b,) int: the node after all below this one
    first: np.ndarray  # (b,) int: first triangle of a node
    triangles: np.ndarray  # (b,) int: how many it has


def windings_of_others(corners: np.ndarray, piece: np.ndarray, points: np.ndarray, own: np.ndarray) -> np.ndarray:
    """Winding numbers of all pieces but own[i] around points[i]: (n,) int64, UNDECIDED where the point is on a piece.

    corners: (t, 3, 3) [m] of triangles that form closed pieces, counter-clockwise from outside; piece: (t,) the piece
    of each triangle; points: (n, 3) [m].
    """
    lower, upper = corners.min(axis=1), corners.max(axis=1)
    boxes = np.ascontiguousarray(np.concatenate([lower, upper], axis=1))
    order, node_box, skip, first, count = build_hierarchy(boxes, 0.5 * (lower + upper))
    windings = np.empty(len(points), np.int64)
    surface = _Surface(
        np.ascontiguousarray(corners[order].reshape(-1, 9)), piece[order].astype(np.int64), node_box, skip, first, count
    )
    _count_windings(surface, np.ascontiguousarray(points), own.astype(np.int64), windings)
    return windings


@kernel
def _count_windings(surface, points, own, windings):
    for i in range(len(points)):
        windings[i] = UNDECIDED
        for k in range(len(DIRECTIONS)):
            windings[i] = _winding_along(surface, points[i], own[i], DIRECTIONS[k])
            if windings[i] != UNDECIDED:
                break


@kernel
def _winding_along(surface, point, own, d):
    corners, piece, node_box, skip, first, count = surface
    winding, node = 0, 0
    while node < len(node_box):
        if not may_meet_box(node_box[node], point, d, np.inf):
            node = skip[node]
            continue
        for t in range(first[node], first[node] + count[node]):
            if piece[t] == own:
                continue
            crossing = _crossing(corners[t], point, d)
            if crossing == UNDECIDED:
                return UNDECIDED
            winding += crossing
        node += 1
    return winding


@query_kernel
def may_meet_box(box, point, d, farthest):
    """Whether a ray may meet a box (6,) nearer than `farthest` [m], for a unit d; where rounding decides, it may."""
    enter, leave = 0.0, farthest
    for k in range(3):
        if abs(d[k]) < ACROSS:
            if point[k] < box[k] or point[k] > box[k + 3]:
                return False
            continue
        low, high = (box[k] - point[k]) / d[k], (box[k + 3] - point[k]) / d[k]
        if low > high:
            low, high = high, low
        slack = BOX_ROUNDING * (abs(low) + abs(high))
        enter, leave = max(enter, low - slack), min(leave, high + slack)
    return enter <= leave


@query_kernel
def _sign(a, b, c):
    """Sign of the determinant of three vectors; 0 if rounding decides."""
    ax, ay, az = a
    bx, by, bz = b
    cx, cy, cz = c
    x1, x2, y1, y2, z1, z2 = by * cz, bz * cy, bz * cx, bx * cz, bx * cy, by * cx
    value = ax * (x1 - x2) + ay * (y1 - y2) + az * (z1 - z2)
    size = abs(ax) * (abs(x1) + abs(x2)) + abs(ay) * (abs(y1) + abs(y2)) + abs(az) * (abs(z1) + abs(z2))
    if abs(value) <= SIGN_ROUNDING * size:
        return 0
    return 1 if value > 0.0 else -1


@query_kernel
def _crossing(c, p, d):
    """+1: the ray leaves through the triangle; -1: it enters; 0: it misses; UNDECIDED."""
    corner_a, corner_b, corner_c = corners_of(c)
    corner_a, corner_b, corner_c = minus(corner_a, p), minus(corner_b, p), minus(corner_c, p)
    way = vector_at(d, 0)
    ab, bc, ca = _sign(way, corner_a, corner_b), _sign(way, corner_b, corner_c), _sign(way, corner_c, corner_a)
    most, least = max(ab, bc, ca), min(ab, bc, ca)
    if most > 0 and least < 0:
        return 0
    side = _sign(corner_a, corner_b, corner_c)
    if least > 0 and side != 0:
        return 1 if side > 0 else 0
    if most < 0 and side != 0:
        return -1 if side < 0 else 0
    if (most > 0 and side < 0) or (least < 0 and side > 0):
        return 0  # the line touches the rim, behind the point
    return UNDECIDED
