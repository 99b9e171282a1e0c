"""Motion of a body within a step: its centre moves straight, and it turns about that at a constant spin.

Velocities are rows (6,): v [m/s], w [rad/s].
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from fracture_collision import portable_math
from fracture_collision.kernel_sources import cached_njit
from fracture_collision.simulation.compiled import uncounted


class Motion(NamedTuple):
    """Motion of n bodies in a step."""

    centers: np.ndarray  # (n, 3) [m], at its beginning
    velocities: np.ndarray  # (n, 6)
    time_step: float  # [s]


_sine_after = cached_njit(portable_math.sine_after)


@uncounted
def length(x, y, z):
    """Length of a vector."""
    return math.sqrt(x * x + y * y + z * z)


@uncounted
def turned(u, t, x, y, z):
    """(x, y, z) after `t` [s] with the spin of velocities u: Rodrigues' formula."""
    spin = length(u[3], u[4], u[5])
    if not spin * t > 0.0:
        return x, y, z
    kx, ky, kz = u[3] / spin, u[4] / spin, u[5] / spin
    sine, half = _sine_after(spin * t, 0.0), _sine_after(0.5 * spin * t, 0.0)
    versine = 2.0 * half * half
    cx, cy, cz = ky * z - kz * y, kz * x - kx * z, kx * y - ky * x
    return (
        x + sine * cx + versine * (ky * cz - kz * cy),
        y + sine * cy + versine * (kz * cx - kx * cz),
        z + sine * cz + versine * (kx * cy - ky * cx),
    )
