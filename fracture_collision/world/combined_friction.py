"""Friction and restitution of two bodies that touch, from their own coefficients.

The geometric mean and the larger of the two, as Box2D and Jolt combine them by default.
"""

from __future__ import annotations

import math

from fracture_collision.core.memory.compiled import query_kernel


@query_kernel
def combined_friction(one, other):
    """Coulomb's coefficient of a pair."""
    return math.sqrt(one * other)


@query_kernel
def combined_restitution(one, other):
    """Newton's coefficient of a pair, 0 to 1."""
    return max(one, other)
