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
from fracture_collision.core.memory.transforms import turned_back
from fracture_collision.core.memory.vectors import (
    cross,
    distance,
    divided,
    dot,
    length,
    minus,
    plus,
    plus_scaled,
    put,
    scaled,
    vector,
)

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
        w = vector(angular, i)
        put(placed, i, plus(vector(positions, i), arm))
        put(velocities, i, plus(vector(linear, i), cross(w, arm)))
        put(spins, i, w)
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
    w, spin = motion.angular[i], length(motion.angular[i])
    for d in range(3):
        position[d] = positions[i, d] + t * motion.linear[i, d]
        for k in range(3):
            rotation[d, k] = rotations[i, d, k]
    if not spin * t > 0.0:
        return
    # Rodrigues' formula
    u = divided(w, spin)
    sine, half = _sine_after(spin * t, 0.0), _sine_after(0.5 * spin * t, 0.0)
    versine = 2.0 * half * half
    for k in range(3):
        axis = rotations[i, 0, k], rotations[i, 1, k], rotations[i, 2, k]
        rotation[0, k], rotation[1, k], rotation[2, k] = _turned(u, sine, versine, axis)
    c = motion.centers[i]
    arm = _turned(u, sine, versine, minus(positions[i], c))
    position[0], position[1], position[2] = plus(plus_scaled(c, t, motion.linear[i]), arm)


@query_kernel
def _turned(u, sine, versine, v):
    across = cross(u, v)
    return plus_scaled(plus_scaled(v, sine, across), versine, cross(u, across))


@query_kernel
def turned_in(motion, i, left):
    """Angle by which fragment i turns in `left` [s]."""
    return length(motion.angular[i]) * left


@query_kernel
def _seen_from(motion, i, j, t, left):
    """Motion of fragment i in the frame of fragment j, from `t` [s] on for `left` [s].

    Returns (velocity, turning, farther, sway), all [m/s]: velocity of i's centre at t, world axes; excess speed of i's
    points due to rotation; excess due to the growing distance; how far the velocity turns in the time.
    """
    wa, wb = motion.angular[i], motion.angular[j]
    along = minus(motion.linear[i], motion.linear[j])
    velocity = minus(along, cross(wb, plus_scaled(minus(motion.centers[i], motion.centers[j]), t, along)))
    turned = length(wb) * left
    return velocity, distance(wa, wb) * motion.reach[i], turned * length(along), turned * length(velocity)


@query_kernel
def closing_speed(motion, i, j, t, left):
    """Upper bound [m/s] on how fast a point of i and a point of j approach each other, from `t` [s] on for `left` [s].

    It holds in the frame of either; the smaller one is returned, which is 0 for two that turn together.
    """
    v, turning, farther, _ = _seen_from(motion, i, j, t, left)
    speed = length(v) + turning + farther
    v, turning, farther, _ = _seen_from(motion, j, i, t, left)
    return min(speed, length(v) + turning + farther)


@query_kernel
def closing_along(motion, i, j, t, left, n):
    """Upper bound [m/s] on how fast the hulls of i and j approach each other along a direction; negative: they part.

    n: unit vector from j to i, world axes at `t` [s], that turns with one of the two; it holds for `left` [s].
    """
    u, w = motion.angular[i], motion.angular[j]
    across = length(cross(n, minus(u, w)))  # rotation about the vector closes nothing along it
    v, turning, farther, sway = _seen_from(motion, i, j, t, left)
    turning = min(turning, across * motion.reach[i] + length(w) * left * turning)
    closing = turning + farther + sway - dot(n, v)
    v, turning, farther, sway = _seen_from(motion, j, i, t, left)
    turning = min(turning, across * motion.reach[j] + length(u) * left * turning)
    return min(closing, turning + farther + sway + dot(n, v))


@query_kernel
def put_way(motion, i, j, t, left, time, turn, out):
    """Write how points of fragment i move in the frame of fragment j within `time` [s] of the `left` [s] from t on.

    turn (3, 3): j's world rotation at t; out (WAY,) [m]: a way, for `approach.nearer_along`.
    """
    v, turning, farther, sway = _seen_from(motion, i, j, t, left)
    u, w = motion.angular[i], motion.angular[j]
    out[0], out[1], out[2] = turned_back(turn, scaled(time, v))
    out[3], out[4], out[5] = turned_back(turn, scaled(time * motion.reach[i], minus(u, w)))
    out[6], out[7] = time * (farther + sway), time * length(w) * left * turning


@query_kernel
def between_balls(motion, i, j):
    """Lower bound [m] of the current distance, by the balls about the centres of mass; negative: the balls overlap."""
    return distance(motion.centers[i], motion.centers[j]) - motion.reach[i] - motion.reach[j]


@query_kernel
def sweep_box(motion, i, box):
    """Grow a world box (6,) [m] of fragment i so that it holds the fragment at all times ahead."""
    turn = length(motion.angular[i]) * motion.reach[i] * motion.time
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
