"""Rotations of many bodies at once; quaternions are (x, y, z, w)."""

from __future__ import annotations

import math

import numpy as np

from fracture_collision import portable_math
from fracture_collision.kernel_sources import cached_njit
from fracture_collision.portable_math import cosine, images, normal_numbers, sine

DEGREE = np.pi / 180.0  # [rad]
# [rad] sin(x) / x is 1 to the last bit below this angle.
SMALL_ANGLE = 1e-8
INVERSE = np.array([-1.0, -1.0, -1.0, 1.0])  # of a unit quaternion, coordinate by coordinate

_sine_after = cached_njit(portable_math.sine_after)


@cached_njit
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


@cached_njit
def turns_of(spins, time_step):
    """exp(h w / 2): the quaternions (n, 4) by which spins (n, 3) [rad/s] turn in a time step [s]."""
    result = np.empty((len(spins), 4))
    for i in range(len(spins)):
        x, y, z = time_step * spins[i, 0], time_step * spins[i, 1], time_step * spins[i, 2]
        half = 0.5 * math.sqrt(x * x + y * y + z * z)
        scale = 0.5 if half < SMALL_ANGLE else 0.5 * _sine_after(half, 0.0) / half
        result[i, 0], result[i, 1], result[i, 2] = scale * x, scale * y, scale * z
        result[i, 3] = _sine_after(half, 1.0)
    return result


@cached_njit
def quaternion_products(p, q):
    """Products p q (n, 4), row by row, to unit length: first q's rotation, then p's."""
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


@cached_njit
def crossed(first, second):
    """Cross products of vectors (n, 3), row by row."""
    result = np.empty_like(first)
    for i in range(len(first)):
        a, b = first[i], second[i]
        result[i, 0] = a[1] * b[2] - a[2] * b[1]
        result[i, 1] = a[2] * b[0] - a[0] * b[2]
        result[i, 2] = a[0] * b[1] - a[1] * b[0]
    return result


@cached_njit
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


@cached_njit
def turned(rotations, vectors):
    """Vectors (n, 3) turned by matrices (n, 3, 3)."""
    result = np.zeros_like(vectors)
    for i in range(len(vectors)):
        for j in range(3):
            for k in range(3):
                result[i, j] += rotations[i, j, k] * vectors[i, k]
    return result


@cached_njit
def turned_matrices(rotations, matrices):
    """R M R^T, (n, 3, 3), of matrices M (n, 3, 3) in frames turned by R (n, 3, 3)."""
    result, half = np.zeros_like(matrices), np.empty((3, 3))
    for i in range(len(matrices)):
        r, m = rotations[i], matrices[i]
        for j in range(3):
            for k in range(3):
                half[j, k] = r[j, 0] * m[0, k] + r[j, 1] * m[1, k] + r[j, 2] * m[2, k]
        for j in range(3):
            for k in range(3):
                result[i, j, k] = half[j, 0] * r[k, 0] + half[j, 1] * r[k, 1] + half[j, 2] * r[k, 2]
    return result


def turned_by(quaternion: np.ndarray, vector: np.ndarray) -> np.ndarray:
    """A vector (3,) turned by a unit quaternion (4,)."""
    return images(rotation_matrices(quaternion[None])[0], vector)


def turned_back(quaternion: np.ndarray, vector: np.ndarray) -> np.ndarray:
    """The vector (3,) that a unit quaternion (4,) turns to `vector`."""
    return images(rotation_matrices(quaternion[None])[0].T, vector)


def from_euler_angles(angles: np.ndarray) -> np.ndarray:
    """The quaternion (4,) of rotations about the fixed x, y and z axes, in this order, by angles (3,) [rad].

    Not compiled: scenes are read with it, before kernels are loaded.
    """
    sx, sy, sz = sine(0.5 * np.asarray(angles)).tolist()
    cx, cy, cz = cosine(0.5 * np.asarray(angles)).tolist()
    return np.array(
        [
            sx * cy * cz - cx * sy * sz, cx * sy * cz + sx * cy * sz, cx * cy * sz - sx * sy * cz,
            cx * cy * cz + sx * sy * sz,
        ]
    )  # fmt: skip


def random_quaternion(generator: np.random.Generator) -> np.ndarray:
    """Unit (4,), evenly distributed over all rotations (Marsaglia 1972)."""
    numbers = normal_numbers(generator, (1, 4))
    return quaternion_products(numbers, np.array([[0.0, 0.0, 0.0, 1.0]]))[0]
