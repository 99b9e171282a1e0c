"""Transforms of vectors and points between frames, see vectors.py."""

from __future__ import annotations

from fracture_collision.core.memory.compiled import query_kernel
from fracture_collision.core.memory.vectors import dot, plus


@query_kernel
def rotated(rotation, v):
    """Apply rotation (3, 3) to v."""
    return dot(rotation[0], v), dot(rotation[1], v), dot(rotation[2], v)


@query_kernel
def turned_back(rotation, v):
    """Apply the inverse of rotation (3, 3) to v."""
    return (
        rotation[0, 0] * v[0] + rotation[1, 0] * v[1] + rotation[2, 0] * v[2],
        rotation[0, 1] * v[0] + rotation[1, 1] * v[1] + rotation[2, 1] * v[2],
        rotation[0, 2] * v[0] + rotation[1, 2] * v[1] + rotation[2, 2] * v[2],
    )


@query_kernel
def to_other(rotation, translation, p):
    """Apply rotation (3, 3), then translation (3,) [m] to the point p."""
    return plus(rotated(rotation, p), translation)
