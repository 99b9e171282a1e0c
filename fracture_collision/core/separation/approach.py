"""Bounds, per direction, on how far points of a fragment may approach another within a given time.

A way describes their motion in the frame of the other: the displacement of the centre (three numbers), the rotation
about it (three, times the fragment's reach), and by how much more its points may move, by translation and by rotation.
motion.put_way fills it.
"""

from __future__ import annotations

import math

import numpy as np

from fracture_collision.core.memory.compiled import query_kernel

# Columns of a way [m], and a way that allows any approach.
WAY = 8
ANY_WAY = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, math.inf, 0.0])


@query_kernel
def nearer_along(way, x, y, z):
    """Upper bound [m] on the approach of a point along the unit vector (x, y, z) that points to it; way: its motion."""
    wx, wy, wz = way[3], way[4], way[5]
    cx, cy, cz = y * wz - z * wy, z * wx - x * wz, x * wy - y * wx
    # rotation about the vector closes nothing along it
    turning = min(math.sqrt(wx * wx + wy * wy + wz * wz), math.sqrt(cx * cx + cy * cy + cz * cz) + way[7])
    return max(turning + way[6] - (x * way[0] + y * way[1] + z * way[2]), 0.0)
