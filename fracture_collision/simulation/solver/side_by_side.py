"""Bodies that fly beside one that is held back within a step: nobody has looked for how they pass it.

The service looks for two that both move for the whole step. Where one of them stops on the way, the other goes on alone
from there: so far as its box says that it comes no nearer, or as it would have to go to come through.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from fracture_collision.simulation.compiled import uncounted
from fracture_collision.simulation.solver.straight_motion import length, turned

# So much larger than the box of its inertia a body may be; a three-sided prism is by 1.8 to one side.
LARGER = 1.5
# What is held back by less than this share more is not told again.
ENOUGH = 1.01


@njit(cache=True)
def shares_side_by_side(shares, centers, axes, halves, spare, velocities, time_step):
    """`shares` (n,) of the step for which bodies move, less where one may run into another that is held back more.

    centers (n, 3) [m]; axes (n, 3, 3), halves (n, 3): of Boxes; spare (n,) [m]: by how much they may be astray of what
    was looked for; velocities (n, 6) by which they move.
    """
    n, shares = len(shares), shares.copy()
    ways = np.empty(n)
    for i in range(n):
        u = velocities[i]
        ways[i] = time_step * (length(u[0], u[1], u[2]) + length(u[3], u[4], u[5]) * _reach(halves[i]))
    changed = True
    while changed:
        changed = False
        for i in range(n):
            if shares[i] == 1.0:
                continue
            for j in range(n):
                free, later = min(spare[i], spare[j]), shares[j] - shares[i]
                # by the first two are as near as if neither stopped, by the second the other has gone nowhere
                if later * ways[i] <= ENOUGH * free or later * ways[j] <= ENOUGH * free:
                    continue
                least = free / max(min(ways[i], ways[j]), free)
                alone = _alone(i, j, shares[i], later, centers, axes, halves, free, velocities, time_step)
                if later > ENOUGH * max(least, alone):
                    shares[j], changed = shares[i] + max(least, alone), True
    return shares


@uncounted
def _alone(i, j, share, later, centers, axes, halves, free, velocities, time_step):
    """For which share of the step, up to `later`, body j may go on alone where i has stopped after `share` of it: as
    far as balls about them do not meet, or as a side of a box that lies between them says; 0: there is none.
    """
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
            apart = along - LARGER * (halves[k, side] + _half_along(other, axes, halves, velocities, t, x, y, z))
            if apart >= 0.0:
                best = max(best, _until(x, y, z, apart + free, u, reach, later, time_step))
    return best


@uncounted
def _until(x, y, z, most, u, reach, later, time_step):
    """For which share of the step, up to `later`, what moves with velocities u and reaches so far [m] may go until it
    has come nearer by more than `most` [m] against a unit vector.
    """
    turning = length(y * u[5] - z * u[4], z * u[3] - x * u[5], x * u[4] - y * u[3])
    nearer = turning * reach - (x * u[0] + y * u[1] + z * u[2])
    if nearer * later * time_step <= most:
        return later
    return most / (nearer * time_step)


@uncounted
def _half_along(k, axes, halves, velocities, t, x, y, z):
    """[m] how far box k, turned for `t` [s], reaches along a unit vector."""
    half = 0.0
    for side in range(3):
        axis = axes[k, side]
        ax, ay, az = turned(velocities[k], t, axis[0], axis[1], axis[2])
        half += halves[k, side] * abs(ax * x + ay * y + az * z)
    return half


@uncounted
def _least_distance(d, u, time):
    """[m] from the origin to d (3,) as it moves with u for `time` [s]."""
    square = u[0] * u[0] + u[1] * u[1] + u[2] * u[2]
    t = 0.0
    if square > 0.0:
        t = min(max(-(d[0] * u[0] + d[1] * u[1] + d[2] * u[2]) / square, 0.0), time)
    return length(d[0] + t * u[0], d[1] + t * u[1], d[2] + t * u[2])


@uncounted
def _reach(halves):
    return length(halves[0], halves[1], halves[2])
