"""Rows of a broken body's surface as a fracture makes them: triangles, boxes, and how far they are from samples."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from fracture_collision.core.compiled import inlined_kernel

# A triangle thinner than this (area against its longest side squared) is rounding; others hold its rim.
RESIDUE = 1e-13


class SurfaceRows(NamedTuple):
    """New rows of BodyPool's polygon arrays."""

    triangles: np.ndarray
    faces: np.ndarray
    front: np.ndarray
    back: np.ndarray
    kind: np.ndarray


@inlined_kernel
def longest_side_squared(a, b, c):
    """[m2] of the triangle (a, b, c)."""
    ux, uy, uz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    vx, vy, vz = c[0] - a[0], c[1] - a[1], c[2] - a[2]
    wx, wy, wz = c[0] - b[0], c[1] - b[1], c[2] - b[2]
    return max(ux * ux + uy * uy + uz * uz, vx * vx + vy * vy + vz * vz, wx * wx + wy * wy + wz * wz)


@inlined_kernel
def gap_of_triangle(a, b, c, samples):
    """Upper bound [m] of the distance from a point of the triangle to the nearest of its last `samples` corners, 1..3.

    Balls of radius (longest side) / sqrt(3) around the corners cover a triangle; the first corners, where they are no
    samples, add their distance to one that is.
    """
    gap = math.sqrt(longest_side_squared(a, b, c) / 3.0)
    if samples == 2:
        gap += math.sqrt(min(_squared(a, b), _squared(a, c)))
    elif samples == 1:
        gap += math.sqrt(max(_squared(a, c), _squared(b, c)))
    return gap


@inlined_kernel
def _squared(a, b):
    dx, dy, dz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    return dx * dx + dy * dy + dz * dz


@inlined_kernel
def grow(box, x, y, z):
    box[0], box[1], box[2] = min(box[0], x), min(box[1], y), min(box[2], z)
    box[3], box[4], box[5] = max(box[3], x), max(box[4], y), max(box[5], z)


@inlined_kernel
def _normal_and_span(a, b, c):
    ux, uy, uz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    vx, vy, vz = c[0] - a[0], c[1] - a[1], c[2] - a[2]
    span = max(ux * ux + uy * uy + uz * uz, vx * vx + vy * vy + vz * vz)
    return uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx, span


@inlined_kernel
def _write(a, b, c, front, back, kind, out, at):
    triangle = out.triangles[at]
    for d in range(3):
        triangle[d], triangle[3 + d], triangle[6 + d] = a[d], b[d], c[d]
    out.front[at], out.back[at], out.kind[at] = front, back, kind


@inlined_kernel
def write_row(a, b, c, nx, ny, nz, offset, front, back, kind, out, at):
    """Write a triangle of the plane n . x = offset to row `at`; returns the next row, `at` again for a residue."""
    mx, my, mz, span = _normal_and_span(a, b, c)
    if mx * mx + my * my + mz * mz <= (RESIDUE * span) ** 2:
        return at
    _write(a, b, c, front, back, kind, out, at)
    plane = out.faces[at]
    plane[0], plane[1], plane[2], plane[3] = nx, ny, nz, offset
    return at + 1


@inlined_kernel
def write_fan_row(a, b, c, front, back, kind, out, at):
    """Write a triangle, right-handed about the normal out of `front`, to row `at`; returns the next row.

    Also a residue, whose plane is no number: every comparison with it is false.
    """
    nx, ny, nz, span = _normal_and_span(a, b, c)
    length = math.sqrt(nx * nx + ny * ny + nz * nz)
    _write(a, b, c, front, back, kind, out, at)
    plane = out.faces[at]
    if length <= RESIDUE * span:
        plane[0] = plane[1] = plane[2] = plane[3] = math.nan
    else:
        plane[0], plane[1], plane[2] = nx / length, ny / length, nz / length
        plane[3] = plane[0] * a[0] + plane[1] * a[1] + plane[2] * a[2]
    return at + 1
