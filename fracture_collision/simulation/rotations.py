"""Rotations of many bodies at once; quaternions are (x, y, z, w)."""

from __future__ import annotations

import numpy as np
from numba import njit


@njit(cache=True)
def rotation_matrices(quaternions):
    """(n, 4) unit quaternions as (n, 3, 3) matrices."""
    result = np.empty((len(quaternions), 3, 3))
    for i in range(len(quaternions)):
        x, y, z, w = quaternions[i]
        result[i, 0, 0] = 1.0 - 2.0 * (y * y + z * z)
        result[i, 0, 1] = 2.0 * (x * y - z * w)
        result[i, 0, 2] = 2.0 * (x * z + y * w)
        result[i, 1, 0] = 2.0 * (x * y + z * w)
        result[i, 1, 1] = 1.0 - 2.0 * (x * x + z * z)
        result[i, 1, 2] = 2.0 * (y * z - x * w)
        result[i, 2, 0] = 2.0 * (x * z - y * w)
        result[i, 2, 1] = 2.0 * (y * z + x * w)
        result[i, 2, 2] = 1.0 - 2.0 * (x * x + y * y)
    return result


@njit(cache=True)
def quaternion_products(p, q):
    """p q, row by row, to unit length: first q's rotation, then p's."""
    result = np.empty_like(p)
    for i in range(len(p)):
        px, py, pz, pw = p[i]
        qx, qy, qz, qw = q[i]
        result[i, 0] = pw * qx + px * qw + py * qz - pz * qy
        result[i, 1] = pw * qy - px * qz + py * qw + pz * qx
        result[i, 2] = pw * qz + px * qy - py * qx + pz * qw
        result[i, 3] = pw * qw - px * qx - py * qy - pz * qz
        result[i] /= np.sqrt(np.sum(result[i] * result[i]))
    return result


@njit(cache=True)
def turned_along(before, after, vectors):
    """Vectors (n, 3) carried along by frames that turn from quaternions `before` (n, 4) to `after`."""
    was, now = rotation_matrices(before), rotation_matrices(after)
    result = np.zeros_like(vectors)
    for i in range(len(vectors)):
        for j in range(3):
            inside = was[i, 0, j] * vectors[i, 0] + was[i, 1, j] * vectors[i, 1] + was[i, 2, j] * vectors[i, 2]
            for k in range(3):
                result[i, k] += now[i, k, j] * inside
    return result


@njit(cache=True)
def from_principal(axes, moments):
    """(n, 3, 3) symmetric matrices with `moments` (n, 3) along the columns of `axes` (n, 3, 3)."""
    result = np.zeros_like(axes)
    for i in range(len(axes)):
        for j in range(3):
            for k in range(3):
                for m in range(3):
                    result[i, j, k] += axes[i, j, m] * moments[i, m] * axes[i, k, m]
    return result


@njit(cache=True)
def turned(rotations, vectors):
    """Vectors (n, 3) turned by matrices (n, 3, 3)."""
    result = np.zeros_like(vectors)
    for i in range(len(vectors)):
        for j in range(3):
            for k in range(3):
                result[i, j] += rotations[i, j, k] * vectors[i, k]
    return result


def quaternion_of(matrix: np.ndarray) -> np.ndarray:
    """(4,) unit quaternion of a rotation matrix (3, 3), by its largest coordinate (Shepperd 1978)."""
    trace = matrix.trace()
    squares = np.array([*(1.0 + 2.0 * matrix.diagonal() - trace), 1.0 + trace])  # four times those of x, y, z, w
    k = int(squares.argmax())
    antisymmetric = matrix - matrix.T
    products = np.empty(4)  # four times those with the largest
    if k == 3:
        products[:3] = antisymmetric[2, 1], antisymmetric[0, 2], antisymmetric[1, 0]
    else:
        products[:3] = (matrix + matrix.T)[k]
        products[3] = antisymmetric[(k + 2) % 3, (k + 1) % 3]
    products[k] = squares[k]
    return products / np.sqrt(products @ products)
