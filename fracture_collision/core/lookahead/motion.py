"""Predicted motion over the time ahead: each centre of mass moves straight, and the fragment spins about it.

A fragment without contacts moves so, except for gravity and its gyroscopic torque, which act on the velocities of the
next step. `closing_speed` bounds how fast points of two such fragments approach each other: conservative advancement
depends on this bound (first_touch.py).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from fracture_collision import portable_math
from fracture_collision.core.memory.compiled import kernel, query_kernel
from fracture_collision.core.memory.kinds import is_bounded
from fracture_collision.core.memory.rotations import turned_back

_sine_after = query_kernel(portable_math.sine_after)
# A body that turns by no more than this [rad] moves as if straight: directions of the end hold for now, too.
MOST_TURN = 0.12
# [m] reach of a plane: in a rotating frame some of its points are arbitrarily fast.
ENDLESS = 1e30


class Motion(NamedTuple):
    """Motion of n fragments."""

    time: float  # [s] look-ahead; 0: none, and the columns are empty
    centers: np.ndarray  # (n, 3) float64 [m] centres of mass now, world
    linear: np.ndarray  # (n, 3) float64 [m/s] their velocities
    angular: np.ndarray  # (n, 3) float64 [rad/s] world axes
    reach: np.ndarray  # (n,) float64 [m] of a fragment about its centre; of a plane ENDLESS


class Moving(NamedTuple):
    """Two of the fragments of a Motion, the i-th and the j-th, with the world poses of all now."""

    i: int
    j: int
    rotations: np.ndarray  # (n, 3, 3) float64
    positions: np.ndarray  # (n, 3) float64 [m]
    motion: Motion


NO_MOTION = Motion(0.0, np.zeros((0, 3)), np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0))


@kernel
def motion_of(kinds, boxes, placed, centers, velocities, time):
    """The Motion of fragments for `time` [s]. Planes stand still.

    kinds, boxes (F,), (F, 6): of a FragmentPool; placed: rows (n,) of the fragments, and their poses (n, 3, 3),
    (n, 3); centers (n, 3) [m]: of mass, in body frames; velocities (n, 3) each: of the frames' origins [m/s], and spins
    [rad/s].
    """
    rows, rotations, positions = placed
    linear, angular = velocities
    n = len(rows)
    placed, velocities, spins, reach = positions.copy(), np.zeros((n, 3)), np.zeros((n, 3)), np.zeros(n)
    for i in range(n):
        if not is_bounded(kinds[rows[i]]):
            reach[i] = ENDLESS
            continue
        arm = np.zeros(3)
        box, square = boxes[rows[i]], 0.0
        for k in range(3):
            for j in range(3):
                arm[k] += rotations[i, k, j] * centers[i, j]
            square += max(box[k + 3] - centers[i, k], centers[i, k] - box[k]) ** 2
        w = angular[i]
        turn = w[1] * arm[2] - w[2] * arm[1], w[2] * arm[0] - w[0] * arm[2], w[0] * arm[1] - w[1] * arm[0]
        for k in range(3):
            placed[i, k], velocities[i, k], spins[i, k] = positions[i, k] + arm[k], linear[i, k] + turn[k], w[k]
        reach[i] = math.sqrt(square)
    return Motion(time, placed, velocities, spins, reach)


@kernel
def fastest(velocities):
    """The largest absolute value of velocities (n, 3)."""
    most = 0.0
    for i in range(len(velocities)):
        for d in range(3):
            most = max(most, abs(velocities[i, d]))
    return most


@query_kernel
def put_pose(motion, rotations, positions, i, t, rotation, position):
    """Write the pose of fragment i after `t` [s] to rotation (3, 3) and position (3,) [m].

    rotations (n, 3, 3), positions (n, 3) [m]: world poses now.
    """
    w, spin = motion.angular[i], _spin(motion.angular[i])
    for d in range(3):
        position[d] = positions[i, d] + t * motion.linear[i, d]
        for k in range(3):
            rotation[d, k] = rotations[i, d, k]
    if not spin * t > 0.0:
        return
    # Rodrigues' formula
    u = w[0] / spin, w[1] / spin, w[2] / spin
    sine, half = _sine_after(spin * t, 0.0), _sine_after(0.5 * spin * t, 0.0)
    versine = 2.0 * half * half
    for k in range(3):
        x, y, z = rotations[i, 0, k], rotations[i, 1, k], rotations[i, 2, k]
        rotation[0, k], rotation[1, k], rotation[2, k] = _turned(u, sine, versine, x, y, z)
    c = motion.centers[i]
    x, y, z = _turned(u, sine, versine, positions[i, 0] - c[0], positions[i, 1] - c[1], positions[i, 2] - c[2])
    position[0] = c[0] + t * motion.linear[i, 0] + x
    position[1] = c[1] + t * motion.linear[i, 1] + y
    position[2] = c[2] + t * motion.linear[i, 2] + z


@query_kernel
def _turned(u, sine, versine, x, y, z):
    cx, cy, cz = u[1] * z - u[2] * y, u[2] * x - u[0] * z, u[0] * y - u[1] * x
    return (
        x + sine * cx + versine * (u[1] * cz - u[2] * cy),
        y + sine * cy + versine * (u[2] * cx - u[0] * cz),
        z + sine * cz + versine * (u[0] * cy - u[1] * cx),
    )


@query_kernel
def _spin(w):
    return math.sqrt(w[0] * w[0] + w[1] * w[1] + w[2] * w[2])


@query_kernel
def turned_in(motion, i, left):
    """Angle by which fragment i turns in `left` [s]."""
    return _spin(motion.angular[i]) * left


@query_kernel
def _seen_from(motion, i, j, t, left):
    """Motion of fragment i in the frame of fragment j, from `t` [s] on for `left` [s].

    Returns (x, y, z, turning, farther, sway), all [m/s]: velocity of i's centre at t, world axes; excess speed of i's
    points due to rotation; excess due to the growing distance; how far the velocity turns in the time.
    """
    a, b = motion.linear[i], motion.linear[j]
    wa, wb = motion.angular[i], motion.angular[j]
    dx, dy, dz = a[0] - b[0], a[1] - b[1], a[2] - b[2]
    rx = motion.centers[i, 0] - motion.centers[j, 0] + t * dx
    ry = motion.centers[i, 1] - motion.centers[j, 1] + t * dy
    rz = motion.centers[i, 2] - motion.centers[j, 2] + t * dz
    x = dx - (wb[1] * rz - wb[2] * ry)
    y = dy - (wb[2] * rx - wb[0] * rz)
    z = dz - (wb[0] * ry - wb[1] * rx)
    turned = _spin(wb) * left
    turning = math.sqrt((wa[0] - wb[0]) ** 2 + (wa[1] - wb[1]) ** 2 + (wa[2] - wb[2]) ** 2)
    farther = turned * math.sqrt(dx * dx + dy * dy + dz * dz)
    return x, y, z, turning * motion.reach[i], farther, turned * math.sqrt(x * x + y * y + z * z)


@query_kernel
def closing_speed(motion, i, j, t, left):
    """Upper bound [m/s] on how fast a point of i and a point of j approach each other, from `t` [s] on for `left` [s].

    It holds in the frame of either; the smaller one is returned, which is 0 for two that turn together.
    """
    x, y, z, turning, farther, _ = _seen_from(motion, i, j, t, left)
    speed = math.sqrt(x * x + y * y + z * z) + turning + farther
    x, y, z, turning, farther, _ = _seen_from(motion, j, i, t, left)
    return min(speed, math.sqrt(x * x + y * y + z * z) + turning + farther)


@query_kernel
def closing_along(motion, i, j, t, left, x, y, z):
    """Upper bound [m/s] on how fast the hulls of i and j approach each other along a direction; negative: they part.

    (x, y, z): unit vector from j to i, world axes at `t` [s], that turns with one of the two; it holds for `left` [s].
    """
    u, w = motion.angular[i], motion.angular[j]
    wx, wy, wz = u[0] - w[0], u[1] - w[1], u[2] - w[2]
    cx, cy, cz = y * wz - z * wy, z * wx - x * wz, x * wy - y * wx
    across = math.sqrt(cx * cx + cy * cy + cz * cz)  # rotation about the vector closes nothing along it
    vx, vy, vz, turning, farther, sway = _seen_from(motion, i, j, t, left)
    turning = min(turning, across * motion.reach[i] + _spin(w) * left * turning)
    closing = turning + farther + sway - (x * vx + y * vy + z * vz)
    vx, vy, vz, turning, farther, sway = _seen_from(motion, j, i, t, left)
    turning = min(turning, across * motion.reach[j] + _spin(u) * left * turning)
    return min(closing, turning + farther + sway + (x * vx + y * vy + z * vz))


@query_kernel
def put_way(motion, i, j, t, left, time, turn, out):
    """Write how points of fragment i move in the frame of fragment j within `time` [s] of the `left` [s] from t on.

    turn (3, 3): j's world rotation at t; out (WAY,) [m]: a way, for `approach.nearer_along`.
    """
    x, y, z, turning, farther, sway = _seen_from(motion, i, j, t, left)
    out[0], out[1], out[2] = turned_back(turn, time * x, time * y, time * z)
    u, w = motion.angular[i], motion.angular[j]
    r = time * motion.reach[i]
    out[3], out[4], out[5] = turned_back(turn, r * (u[0] - w[0]), r * (u[1] - w[1]), r * (u[2] - w[2]))
    out[6], out[7] = time * (farther + sway), time * _spin(w) * left * turning


@query_kernel
def between_balls(motion, i, j):
    """Lower bound [m] of the current distance, by the balls about the centres of mass; negative: the balls overlap."""
    a, b = motion.centers[i], motion.centers[j]
    return math.sqrt((a[0] - b[0]) ** 2 + (a[1] - b[1]) ** 2 + (a[2] - b[2]) ** 2) - motion.reach[i] - motion.reach[j]


@query_kernel
def sweep_box(motion, i, box):
    """Grow a world box (6,) [m] of fragment i so that it holds the fragment at all times ahead."""
    turn = _spin(motion.angular[i]) * motion.reach[i] * motion.time
    for k in range(3):
        way = motion.time * motion.linear[i, k]
        box[k] += min(way, 0.0) - turn
        box[k + 3] += max(way, 0.0) + turn


@kernel
def is_moving(motion):
    """(n,) bool: which fragments of a Motion are moving."""
    moves = np.zeros(len(motion.reach), np.bool_)
    for i in range(len(moves)):
        for d in range(3):
            moves[i] |= motion.linear[i, d] != 0.0 or motion.angular[i, d] != 0.0
    return moves
