"""Surface rows of a broken body as a fracture makes them: triangles, boxes, and distances to samples."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from fracture_collision.core.memory.compiled import query_kernel
from fracture_collision.core.memory.pools import BACK_SIDE, FRONT_SIDE, KIND, VOID

# A triangle thinner than this (area against its longest side squared) is rounding; other triangles contain its rim.
RESIDUE = 1e-13


class SurfaceRows(NamedTuple):
    """New rows of BodyPool's polygon arrays, with the same columns."""

    first: int  # where they begin
    triangles: np.ndarray
    faces: np.ndarray
    sides: np.ndarray


class Broken(NamedTuple):
    """A fragment that breaks, and the fragments that it breaks into, by their rows of FragmentPool."""

    parent: int
    first: int
    end: int
    mesh: int  # row of the body's mesh
    node_shift: int  # see FragmentPool
    tet_shift: int
    edge_shift: int


class Sums(NamedTuple):
    """What an update accumulates for each fragment, by rows of FragmentPool."""

    moments: np.ndarray  # (F, 10) float64, see moments.py
    gaps: np.ndarray  # (F,) float64 [m]: no point of the surface is farther from a sample
    boxes: np.ndarray  # (F, 6) float64 [m]


@query_kernel
def measure_triangle(a, b, c):
    """(nx, ny, nz, ab, ac, bc): the normal [m2] of a triangle, twice its area long, and its sides squared [m2]."""
    ux, uy, uz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    vx, vy, vz = c[0] - a[0], c[1] - a[1], c[2] - a[2]
    wx, wy, wz = c[0] - b[0], c[1] - b[1], c[2] - b[2]
    return (
        uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx,
        ux * ux + uy * uy + uz * uz, vx * vx + vy * vy + vz * vz, wx * wx + wy * wy + wz * wz,
    )  # fmt: skip


@query_kernel
def gap_of_triangle(ab, ac, bc, samples):
    """Upper bound [m] of the distance from a point of a triangle to the nearest of its last `samples` corners, 1 .. 3.

    ab, ac, bc: its sides squared [m2]. Balls of radius (longest side) / sqrt(3) around the corners cover a triangle;
    first corners that are not samples add their distance to one that is.
    """
    gap = math.sqrt(max(ab, ac, bc) / 3.0)
    if samples == 3:
        return gap
    return gap + math.sqrt(min(ab, ac) if samples == 2 else max(ac, bc))


@query_kernel
def is_residue(nx, ny, nz, ab, ac):
    """Whether a triangle with this normal and these sides is only rounding."""
    return nx * nx + ny * ny + nz * nz <= (RESIDUE * max(ab, ac)) ** 2


@query_kernel
def has_no_area(a, b, c):
    """Whether the triangle of three points is only rounding."""
    nx, ny, nz, ab, ac, _ = measure_triangle(a, b, c)
    return is_residue(nx, ny, nz, ab, ac)


@query_kernel
def grow(box, x, y, z):
    """Grow a box (6,) [m] so that it holds the point (x, y, z)."""
    box[0], box[1], box[2] = min(box[0], x), min(box[1], y), min(box[2], z)
    box[3], box[4], box[5] = max(box[3], x), max(box[4], y), max(box[5], z)


@query_kernel
def grow_by_box(box, low, high):
    """Grow a box by another box with corners `low` and `high`, tuples of three."""
    box[0], box[1], box[2] = min(box[0], low[0]), min(box[1], low[1]), min(box[2], low[2])
    box[3], box[4], box[5] = max(box[3], high[0]), max(box[4], high[1]), max(box[5], high[2])


@query_kernel
def write_row(corners, plane_of_it, owners, out, at):
    """Write a triangle to row `at` of SurfaceRows.

    corners: three points; plane_of_it: (nx, ny, nz, offset), out of the front; owners: the fragment in front, the
    fragment behind, and kind and void, see BodyPool.sides.
    """
    a, b, c = corners
    triangle, plane = out.triangles[at], out.faces[at]
    triangle[0], triangle[1], triangle[2] = a[0], a[1], a[2]
    triangle[3], triangle[4], triangle[5] = b[0], b[1], b[2]
    triangle[6], triangle[7], triangle[8] = c[0], c[1], c[2]
    plane[0], plane[1], plane[2], plane[3] = plane_of_it
    sides = out.sides[at]
    sides[FRONT_SIDE], sides[BACK_SIDE], sides[KIND], sides[VOID] = owners


@query_kernel
def write_fan_row(corners, measures, owners, out, at):
    """write_row for a triangle whose plane follows from its own `measures`.

    measures: of measure_triangle, with the normal out of front. Also writes a residue, with a plane of NaN: every
    comparison with it is false.
    """
    nx, ny, nz, ab, ac, _ = measures
    a = corners[0]
    length = math.sqrt(nx * nx + ny * ny + nz * nz)
    nx, ny, nz = nx / length, ny / length, nz / length
    offset = nx * a[0] + ny * a[1] + nz * a[2]
    if length <= RESIDUE * max(ab, ac):
        nx = ny = nz = offset = math.nan
    write_row(corners, (nx, ny, nz, offset), owners, out, at)
