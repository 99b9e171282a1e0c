"""Bodies that fly beside one that is held back within a step: the service has not searched how they pass it.

The service searches each pair with both bodies moving for the whole step. Where one stops earlier, the other moves on
alone only as long as balls or boxes about the two stay apart, or as the difference stays within `spare`. These are the
bodies' boxes of equal mass and inertia tensor enlarged by LARGER, an estimate of their extent without a mesh.

Within a step a body's centre moves straight, and the body turns about it at a constant spin. Velocities are rows (6,):
v [m/s], w [rad/s].
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from fracture_collision import portable_math
from fracture_collision.kernel_sources import cached_njit
from fracture_collision.simulation.compiled import uncounted

# Jacobi's method converges quadratically: six sweeps are enough for 3 x 3, more change nothing.
SWEEPS = 8


class Boxes(NamedTuple):
    """Of n bodies."""

    axes: np.ndarray  # (n, 3, 3) unit vectors along their sides, as rows, world
    halves: np.ndarray  # (n, 3) [m] half of these sides

    def reach(self) -> np.ndarray:
        """(n,) [m] from their centres to their corners."""
        return np.sqrt((self.halves * self.halves).sum(axis=1))

    def thickness(self) -> np.ndarray:
        """(n,) [m] their shortest sides."""
        return 2.0 * self.halves.min(axis=1, initial=np.inf)


def boxes_of(masses: np.ndarray, inertias: np.ndarray) -> Boxes:
    """Boxes of n bodies.

    masses (n,) [kg], inertias (n, 3, 3) [kg m2] about the centres of mass, world axes.
    """
    return Boxes(*_boxes(masses, inertias))


@cached_njit
def _boxes(masses, inertias):
    n = len(masses)
    axes, halves = np.zeros((n, 3, 3)), np.zeros((n, 3))
    work = np.empty((3, 3))
    for i in range(n):
        for j in range(3):
            axes[i, j, j] = 1.0
            for k in range(3):
                work[j, k] = inertias[i, j, k]
        for _ in range(SWEEPS):
            for p, q in ((0, 1), (0, 2), (1, 2)):
                _rotate(work, axes[i], p, q)
        total = work[0, 0] + work[1, 1] + work[2, 2]
        for k in range(3):
            # of a box with sides x, y, z the moment about x is m (y^2 + z^2) / 12
            halves[i, k] = 0.5 * math.sqrt(max(6.0 * (total - 2.0 * work[k, k]) / masses[i], 0.0))
    return axes, halves


@uncounted
def _rotate(matrix, axes, p, q):
    """One of Jacobi's rotations: matrix[p, q] becomes 0, and rows p, q of `axes` turn with it.

    Golub and Van Loan, "Matrix Computations", 8.5.2.
    """
    if matrix[p, q] == 0.0:
        return
    tau = (matrix[q, q] - matrix[p, p]) / (2.0 * matrix[p, q])
    t = 1.0 / (abs(tau) + math.sqrt(1.0 + tau * tau))
    if tau < 0.0:
        t = -t
    c = 1.0 / math.sqrt(1.0 + t * t)
    s = t * c
    for k in range(3):
        a, b = matrix[p, k], matrix[q, k]
        matrix[p, k], matrix[q, k] = c * a - s * b, s * a + c * b
    for k in range(3):
        a, b = matrix[k, p], matrix[k, q]
        matrix[k, p], matrix[k, q] = c * a - s * b, s * a + c * b
        a, b = axes[p, k], axes[q, k]
        axes[p, k], axes[q, k] = c * a - s * b, s * a + c * b
    matrix[p, q] = matrix[q, p] = 0.0


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


# Factor on inertia boxes, to contain the bodies: an estimate, no bound. Cylinders need 1.15, balls 1.29, an edge of a
# three-sided prism 1.63, and a corner of a tetrahedron 2.24 = sqrt(5), the most of any convex body (Kannan, Lovasz,
# Simonovits 1995). What sticks out may run into a body that has stopped; the next states then have it as a contact.
# With sqrt(5), bodies in a crowd would wait for each other more often.
LARGER = 1.5
# A body is held back further only where it exceeds the allowed share by this factor.
ENOUGH = 1.01


@cached_njit
def shares_side_by_side(shares, motion, searched, boxes, spare):
    """`shares` (n,) of the step for which bodies move, reduced where one may run into another that is held back more.

    motion: Motion; searched (n, 6): the velocities that the service looked ahead with; boxes: Boxes of the bodies;
    spare (n,) [m]: allowed deviation from the searched motion.
    """
    n, shares = len(shares), shares.copy()
    ways = np.zeros(n)
    for i in range(n):
        # One that stops is missed where it would have been, and so is one that a blow has stopped.
        for u in (motion.velocities[i], searched[i]):
            way = motion.time_step * (
                length(u[0], u[1], u[2]) + length(u[3], u[4], u[5]) * _reach(boxes.halves[i])
            )
            ways[i] = max(ways[i], way)
    changed = True
    while changed:
        changed = False
        for i in range(n):
            if shares[i] == 1.0:
                continue
            for j in range(n):
                free, later = min(spare[i], spare[j]), shares[j] - shares[i]
                # First: they are as near as if neither had stopped. Second: the other has hardly moved on alone.
                if later * ways[i] <= ENOUGH * free or later * ways[j] <= ENOUGH * free:
                    continue
                least = free / max(min(ways[i], ways[j]), free)
                alone = _alone(i, j, shares[i], later, motion, boxes, free)
                if later > ENOUGH * max(least, alone):
                    shares[j], changed = shares[i] + max(least, alone), True
    return shares


@uncounted
def _alone(i, j, share, later, motion, boxes, free):
    """Share of the step, at most `later`, for which body j may move on alone after i has stopped at `share`.

    All of it if balls about them stay apart, else as long as a side of a box separates them; 0 if none does.
    """
    centers, velocities, time_step = motion.centers, motion.velocities, motion.time_step
    axes, halves = boxes.axes, boxes.halves
    t, u = share * time_step, velocities[j]
    d = (
        centers[j, 0] - centers[i, 0] + t * (u[0] - velocities[i, 0]),
        centers[j, 1] - centers[i, 1] + t * (u[1] - velocities[i, 1]),
        centers[j, 2] - centers[i, 2] + t * (u[2] - velocities[i, 2]),
    )
    reach = LARGER * _reach(halves[j])
    if _least_distance(d, u, later * time_step) > LARGER * _reach(halves[i]) + reach:
        return later
    best = 0.0
    for which in range(2):
        k, other = (i, j) if which == 0 else (j, i)
        for side in range(3):
            axis = axes[k, side]
            x, y, z = turned(velocities[k], t, axis[0], axis[1], axis[2])
            along = x * d[0] + y * d[1] + z * d[2]
            if along < 0.0:
                x, y, z, along = -x, -y, -z, -along
            apart = along - LARGER * (halves[k, side] + _half_along(other, boxes, velocities, t, x, y, z))
            if apart >= 0.0:
                best = max(best, _until(x, y, z, apart + free, u, reach, later, time_step))
    return best


@uncounted
def _until(x, y, z, most, u, reach, later, time_step):
    """Share of the step, at most `later`, until a body has advanced by `most` [m] against the unit vector (x, y, z).

    The body has the velocities u and the extent `reach` [m].
    """
    turning = length(y * u[5] - z * u[4], z * u[3] - x * u[5], x * u[4] - y * u[3])
    nearer = turning * reach - (x * u[0] + y * u[1] + z * u[2])
    if nearer * later * time_step <= most:
        return later
    return most / (nearer * time_step)


@uncounted
def _half_along(k, boxes, velocities, t, x, y, z):
    """[m] half extent of box k, turned for `t` [s], along a unit vector."""
    half = 0.0
    for side in range(3):
        axis = boxes.axes[k, side]
        ax, ay, az = turned(velocities[k], t, axis[0], axis[1], axis[2])
        half += boxes.halves[k, side] * abs(ax * x + ay * y + az * z)
    return half


@uncounted
def _least_distance(d, u, time):
    """[m] least distance of d (3,) from the origin while it moves with u for `time` [s]."""
    square = u[0] * u[0] + u[1] * u[1] + u[2] * u[2]
    t = 0.0
    if square > 0.0:
        t = min(max(-(d[0] * u[0] + d[1] * u[1] + d[2] * u[2]) / square, 0.0), time)
    return length(d[0] + t * u[0], d[1] + t * u[1], d[2] + t * u[2])


@uncounted
def _reach(halves):
    return length(halves[0], halves[1], halves[2])
