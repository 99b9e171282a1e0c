"""Which triangles of two surfaces pierce each other, over all pairs of them."""

from __future__ import annotations

import numpy as np
from numba import njit


def all_pierced(a: np.ndarray, b: np.ndarray) -> set[tuple[int, int]]:
    """Rows of the triangles (n, 3, 3) and (m, 3, 3) of which an edge of either passes through the other."""
    found = _pierced(np.ascontiguousarray(a), np.ascontiguousarray(b))
    return set(zip(*(rows.tolist() for rows in np.nonzero(found)), strict=True))


@njit(cache=True)
def _pierced(a, b):
    found = np.zeros((len(a), len(b)), np.bool_)
    for i in range(len(a)):
        for j in range(len(b)):
            found[i, j] = _has_edge_through(a[i], b[j]) or _has_edge_through(b[j], a[i])
    return found


@njit(cache=True)
def _has_edge_through(own, other):
    u, v, w = other[0], other[1], other[2]
    for k in range(3):
        p, q = own[k], own[(k + 1) % 3]
        if _volume(u, v, w, p) * _volume(u, v, w, q) < 0.0:
            x, y, z = _volume(p, q, u, v), _volume(p, q, v, w), _volume(p, q, w, u)
            if (x > 0.0 and y > 0.0 and z > 0.0) or (x < 0.0 and y < 0.0 and z < 0.0):
                return True
    return False


@njit(cache=True)
def _volume(a, b, c, d):
    ux, uy, uz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    vx, vy, vz = c[0] - a[0], c[1] - a[1], c[2] - a[2]
    wx, wy, wz = d[0] - a[0], d[1] - a[1], d[2] - a[2]
    return (uy * vz - uz * vy) * wx + (uz * vx - ux * vz) * wy + (ux * vy - uy * vx) * wz
