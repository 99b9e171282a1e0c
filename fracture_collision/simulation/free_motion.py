"""Velocities of free rigid bodies after one time step: gravity, and the gyroscopic torque without gain of energy.

Euler's equations I w' + w x I w = 0 by the implicit midpoint rule: with m = (w0 + w1) / 2,

    f(w1) = I (w1 - w0) + h m x I m = 0,   f' = I + h/2 ([m]x I - [I m]x)

It keeps the quadratic invariants w.Iw and |Iw|^2 (Hairer, Lubich, Wanner, "Geometric Numerical Integration", IV.2.1);
the explicit rule, Bullet's own, feeds energy to fast spins. I is the world-axes inertia of the pose at the start.
"""

from __future__ import annotations

import numpy as np
from numba import njit

NEWTON_STEPS = 12
# Relative to |I w|; quadratic convergence gets from a thousandth to here in two steps.
CONVERGED = 1.0e-15


@njit(cache=True)
def free_velocities(velocities, inertias, gravity, time_step):
    """(n, 6) v [m/s] and w [rad/s] one `time_step` [s] on, under `gravity` (3,) [m/s2]; inertias (n, 3, 3) [kg m2]."""
    result = velocities.copy()
    for i in range(len(velocities)):
        result[i, :3] += time_step * gravity
        result[i, 3:] = _spin_after(velocities[i, 3:], inertias[i], time_step)
    return result


@njit(cache=True)
def _spin_after(before, inertia, time_step):
    spin = before.copy()
    momentum = inertia @ before
    scale = np.sqrt(momentum @ momentum)
    for _ in range(NEWTON_STEPS):
        middle = 0.5 * (before + spin)
        middle_momentum = inertia @ middle
        residual = inertia @ (spin - before) + time_step * np.cross(middle, middle_momentum)
        if np.sqrt(residual @ residual) <= CONVERGED * scale:
            break
        jacobian = inertia + 0.5 * time_step * (_cross_matrix(middle) @ inertia - _cross_matrix(middle_momentum))
        spin = spin - np.linalg.solve(jacobian, residual)
    return spin


@njit(cache=True)
def _cross_matrix(x):
    return np.array([[0.0, -x[2], x[1]], [x[2], 0.0, -x[0]], [-x[1], x[0], 0.0]])
