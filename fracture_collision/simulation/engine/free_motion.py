"""Velocities of free rigid bodies after one time step: gravity, and the gyroscopic torque without energy gain.

Euler's equations I w' + w x I w = 0 by the implicit midpoint rule: with m = (w0 + w1) / 2,

    f(w1) = I (w1 - w0) + h m x I m = 0,   f' = I + h/2 ([m]x I - [I m]x)

It keeps the quadratic invariants w.Iw and |Iw|^2 (Hairer, Lubich, Wanner, "Geometric Numerical Integration", IV.2.1);
the explicit rule, Bullet's own, feeds energy to fast spins. I is the world-axes inertia of the pose at the start, w1
turns with the body. So the pose decides where the angular momentum points: mean_spins keeps it.
"""

from __future__ import annotations

import math

import numpy as np

from fracture_collision.kernel_sources import cached_njit
from fracture_collision.portable_math import dots, lengths, rotation_vectors
from fracture_collision.simulation.compiled import uncounted
from fracture_collision.simulation.rotations import crossed, quaternion_products, rotation_matrices, turned, turns_of

NEWTON_STEPS = 12
# A step in which a body turns by many radians is divided into parts, doubled in number while one does not converge.
MOST_PARTS = 1024
# Square of an angular momentum [(kg m2/s)2] whose own square is not a number any more: such a body does not turn.
STILL = 1.0e-140
# Residual relative to |I w|; quadratic convergence gets from a thousandth to here in two steps.
CONVERGED = 1.0e-15
# Accepted after the last step: rounding may keep the residual a little above.
NEARLY = 1.0e-12


@cached_njit
def free_velocities(velocities, inertias, gravity, spans):
    """(n, 6) v [m/s] and w [rad/s] `spans` (n,) [s] on, under `gravity` (3,) [m/s2]; inertias (n, 3, 3) [kg m2]."""
    result = velocities.copy()
    for i in range(len(velocities)):
        for k in range(3):
            result[i, k] += spans[i] * gravity[k]
        spin = _spin_after(
            (velocities[i, 3], velocities[i, 4], velocities[i, 5]), _columns(inertias[i]), spans[i]
        )
        result[i, 3], result[i, 4], result[i, 5] = spin
    return result


def mean_spins(before: np.ndarray, after: np.ndarray, inertias: np.ndarray, spans: np.ndarray) -> np.ndarray:
    """Constant spins (n, 3) [rad/s] that turn free bodies within `spans` (n,) [s] so that momentum keeps its direction.

    before, after (n, 3) [rad/s]: their spins, see free_velocities. It is the mean of both, corrected by the least turn
    that brings the momentum after the step to that before.
    """
    middle = 0.5 * (before + after)
    turns = turns_of(spans[:, None] * middle, 1.0)
    momentum, moved = turned(inertias, before), turned(rotation_matrices(turns), turned(inertias, after))
    size = lengths(momentum) * lengths(moved)
    align = np.column_stack((crossed(moved, momentum), dots(moved, momentum) + size))
    align[~((align[:, 3] > 0.5 * size) & (size > STILL))] = 0.0, 0.0, 0.0, 1.0
    align /= lengths(align)[:, None]
    vectors = rotation_vectors(quaternion_products(align, turns))
    angles, along = lengths(vectors), spans * dots(vectors, middle)
    safe = np.where(angles > 0.0, angles, 1.0)
    rounds = np.where(angles > 0.0, np.round((along / safe - angles) / (2.0 * np.pi)), 0.0)
    spins = vectors * ((1.0 + 2.0 * np.pi * rounds / safe) / spans)[:, None]
    return np.where((before == after).all(axis=1)[:, None], after, spins)


@uncounted
def _spin_after(before, inertia, time_step):
    parts = 1
    while parts <= MOST_PARTS:
        spin, has_converged = before, True
        for _ in range(parts):
            spin, has_converged = _spin_after_part(spin, inertia, time_step / parts)
            if not has_converged:
                break
        if has_converged:
            return spin
        parts *= 2
    return before


@uncounted
def _spin_after_part(before, inertia, time_step):
    """The spin after `time_step` [s], and whether Newton's method has converged."""
    spin = before
    momentum = _times(inertia, before)
    scale = math.sqrt(_dot(momentum, momentum))
    for _ in range(NEWTON_STEPS):
        middle = _sum(0.5, before, 0.5, spin)
        middle_momentum = _times(inertia, middle)
        residual = _sum(
            1.0, _times(inertia, _sum(1.0, spin, -1.0, before)), time_step, _cross(middle, middle_momentum)
        )
        size = math.sqrt(_dot(residual, residual))
        if size <= CONVERGED * scale:
            return spin, True
        # Columns of f', its products with the axes.
        x = _column(inertia[0], (1.0, 0.0, 0.0), middle, middle_momentum, time_step)
        y = _column(inertia[1], (0.0, 1.0, 0.0), middle, middle_momentum, time_step)
        z = _column(inertia[2], (0.0, 0.0, 1.0), middle, middle_momentum, time_step)
        # Cramer's rule.
        volume = _dot(x, _cross(y, z))
        spin = (
            spin[0] - _dot(residual, _cross(y, z)) / volume,
            spin[1] - _dot(residual, _cross(z, x)) / volume,
            spin[2] - _dot(residual, _cross(x, y)) / volume,
        )
    return spin, size <= NEARLY * scale


@uncounted
def _column(inertia, axis, middle, middle_momentum, time_step):
    change = _sum(1.0, _cross(middle, inertia), -1.0, _cross(middle_momentum, axis))
    return _sum(1.0, inertia, 0.5 * time_step, change)


@uncounted
def _columns(matrix):
    return (
        (matrix[0, 0], matrix[1, 0], matrix[2, 0]),
        (matrix[0, 1], matrix[1, 1], matrix[2, 1]),
        (matrix[0, 2], matrix[1, 2], matrix[2, 2]),
    )


@uncounted
def _times(columns, x):
    return _sum(1.0, _sum(x[0], columns[0], x[1], columns[1]), x[2], columns[2])


@uncounted
def _sum(a, x, b, y):
    return a * x[0] + b * y[0], a * x[1] + b * y[1], a * x[2] + b * y[2]


@uncounted
def _dot(x, y):
    return x[0] * y[0] + x[1] * y[1] + x[2] * y[2]


@uncounted
def _cross(x, y):
    return x[1] * y[2] - x[2] * y[1], x[2] * y[0] - x[0] * y[2], x[0] * y[1] - x[1] * y[0]
