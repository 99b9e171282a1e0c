"""How far points of a fragment may come towards another within some time, direction by direction.

A way says how they move for one that moves with the other, in whose frame it is told: the displacement of the centre
(three numbers), the turning about it (three, times how far the fragment reaches) and by how much more than these points
may move, straight and by turning. motion.put_way fills it.
"""

from __future__ import annotations

import math

import numpy as np

from fracture_collision.core.memory.compiled import inlined_kernel

# Columns of a way [m], and one that lets everything come nearer by any length.
WAY = 8
ANY_WAY = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, math.inf, 0.0])


@inlined_kernel
def nearer_along(way, x, y, z):
    """By how much [m] some point may come nearer along the unit vector (x, y, z) that points to it; way: of it."""
    wx, wy, wz = way[3], way[4], way[5]
    cx, cy, cz = y * wz - z * wy, z * wx - x * wz, x * wy - y * wx
    # what turns about the vector comes no nearer along it
    turning = min(math.sqrt(wx * wx + wy * wy + wz * wz), math.sqrt(cx * cx + cy * cy + cz * cz) + way[7])
    return max(turning + way[6] - (x * way[0] + y * way[1] + z * way[2]), 0.0)
