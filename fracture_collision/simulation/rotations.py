"""Rotations of many bodies at once; quaternions are (x, y, z, w)."""

from __future__ import annotations

import math

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
def through_matrices(quaternions):
    """(n, 4) unit quaternions, made matrices and quaternions again, with the rounding of Bullet's btMatrix3x3."""
    result, m = np.empty_like(quaternions), np.empty((3, 3))
    for row in range(len(quaternions)):
        x, y, z, w = quaternions[row]
        s = 2.0 / (x * x + y * y + z * z + w * w)
        xs, ys, zs = x * s, y * s, z * s
        m[0, 0], m[0, 1], m[0, 2] = 1.0 - (y * ys + z * zs), x * ys - w * zs, x * zs + w * ys
        m[1, 0], m[1, 1], m[1, 2] = x * ys + w * zs, 1.0 - (x * xs + z * zs), y * zs - w * xs
        m[2, 0], m[2, 1], m[2, 2] = x * zs - w * ys, y * zs + w * xs, 1.0 - (x * xs + y * ys)
        trace, q = m[0, 0] + m[1, 1] + m[2, 2], result[row]
        if trace > 0.0:
            s = np.sqrt(trace + 1.0)
            q[3], s = 0.5 * s, 0.5 / s
            for i in range(3):
                j, k = (i + 1) % 3, (i + 2) % 3
                q[i] = (m[k, j] - m[j, k]) * s
        else:
            i = (2 if m[1, 1] < m[2, 2] else 1) if m[0, 0] < m[1, 1] else (2 if m[0, 0] < m[2, 2] else 0)
            j, k = (i + 1) % 3, (i + 2) % 3
            s = np.sqrt(m[i, i] - m[j, j] - m[k, k] + 1.0)
            q[i], s = 0.5 * s, 0.5 / s
            q[3], q[j], q[k] = (m[k, j] - m[j, k]) * s, (m[j, i] + m[i, j]) * s, (m[k, i] + m[i, k]) * s
    return result


@njit(cache=True)
def crossed(first, second):
    """Cross products of vectors (n, 3), row by row."""
    result = np.empty_like(first)
    for i in range(len(first)):
        a, b = first[i], second[i]
        result[i, 0] = a[1] * b[2] - a[2] * b[1]
        result[i, 1] = a[2] * b[0] - a[0] * b[2]
        result[i, 2] = a[0] * b[1] - a[1] * b[0]
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


@njit(cache=True)
def quaternions_of(matrices):
    """(n, 4) unit quaternions of rotation matrices (n, 3, 3), each by its largest coordinate (Shepperd 1978)."""
    result = np.empty((len(matrices), 4))
    squares, products = np.empty(4), np.empty(4)  # four times those of x, y, z, w; those with the largest
    for i in range(len(matrices)):
        m = matrices[i]
        trace = m[0, 0] + m[1, 1] + m[2, 2]
        for k in range(3):
            squares[k] = 1.0 + 2.0 * m[k, k] - trace
        squares[3] = 1.0 + trace
        k = squares.argmax()
        for j in range(3):
            # x, y and z with w; or with another of them
            products[j] = m[(j + 2) % 3, (j + 1) % 3] - m[(j + 1) % 3, (j + 2) % 3] if k == 3 else m[k, j] + m[j, k]
        if k < 3:
            products[3] = m[(k + 2) % 3, (k + 1) % 3] - m[(k + 1) % 3, (k + 2) % 3]
        products[k] = squares[k]
        result[i] = products / math.sqrt(np.dot(products, products))
    return result
