"""Which triangles of two surfaces pierce each other, over all pairs of them."""

from __future__ import annotations

import numpy as np


def all_pierced(a: np.ndarray, b: np.ndarray) -> set[tuple[int, int]]:
    """Rows of the triangles (n, 3, 3) and (m, 3, 3) of which an edge of either passes through the other."""
    first, second = a[:, None], b[None]
    found = np.zeros((len(a), len(b)), bool)
    for own, other in ((first, second), (second, first)):
        u, v, w = (other[:, :, k] for k in range(3))
        for k in range(3):
            p, q = own[:, :, k], own[:, :, (k + 1) % 3]
            x, y, z = _volume(p, q, u, v), _volume(p, q, v, w), _volume(p, q, w, u)
            through = ((x > 0) & (y > 0) & (z > 0)) | ((x < 0) & (y < 0) & (z < 0))
            found |= through & (_volume(u, v, w, p) * _volume(u, v, w, q) < 0.0)
    return set(zip(*(rows.tolist() for rows in np.nonzero(found)), strict=True))


def _volume(a: np.ndarray, b: np.ndarray, c: np.ndarray, d: np.ndarray) -> np.ndarray:
    return np.einsum("...i,...i", np.cross(b - a, c - a), d - a)
