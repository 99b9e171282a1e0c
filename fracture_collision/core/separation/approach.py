"""Bounds, per direction, on how far points of a fragment may approach another within a given time.

A way describes their motion in the frame of the other: the displacement of the centre (three numbers), the rotation
about it (three, times the fragment's reach), and by how much more its points may move, by translation and by rotation.
motion.put_way fills it.
"""

from __future__ import annotations

import math

import numpy as np

from fracture_collision.core.memory.compiled import query_kernel
from fracture_collision.core.memory.vectors import cross, dot, length, vector_at

# Columns of a way [m], and a way that allows any approach.
WAY = 8
ANY_WAY = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, math.inf, 0.0])


@query_kernel
def nearer_along(way, n):
    """Upper bound [m] on the approach of a point along the unit vector n that points to it; way: its motion."""
    turn = vector_at(way, 3)
    # rotation about the vector closes nothing along it
    turning = min(length(turn), length(cross(n, turn)) + way[7])
    return max(turning + way[6] - dot(n, way), 0.0)
