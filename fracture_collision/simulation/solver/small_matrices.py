"""Symmetric 3 x 3 matrices, such as inertia tensors."""

from __future__ import annotations

from fracture_collision.simulation.compiled import uncounted


@uncounted
def invert_symmetric(matrix, out):
    """The inverse of a symmetric (3, 3) matrix, by its cofactors, into `out` (3, 3)."""
    a, b, c = matrix[0, 0], matrix[0, 1], matrix[0, 2]
    d, e, f = matrix[1, 1], matrix[1, 2], matrix[2, 2]
    aa, bb, cc = d * f - e * e, c * e - b * f, b * e - c * d
    scale = 1.0 / (a * aa + b * bb + c * cc)
    out[0, 0] = scale * aa
    out[0, 1] = out[1, 0] = scale * bb
    out[0, 2] = out[2, 0] = scale * cc
    out[1, 1] = scale * (a * f - c * c)
    out[1, 2] = out[2, 1] = scale * (b * c - a * e)
    out[2, 2] = scale * (a * d - b * b)
