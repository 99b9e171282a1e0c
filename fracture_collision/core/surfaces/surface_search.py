"""The deepest point of a triangle of one fragment's surface in another, by bisection.

Depth is 1-Lipschitz: within r of a point of depth d nothing is deeper than d + r. And no point of a triangle is deeper
than s if the triangle, displaced by s in some direction, avoids the other's interior (surface_avoidance.py). A triangle
that neither test settles is halved.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from fracture_collision.core.field.elementary_queries import INSIDE, OUTSIDE, bounded_probe
from fracture_collision.core.memory.compiled import inlined_kernel, query_kernel
from fracture_collision.core.mesh.closest_point import triangle_normal
from fracture_collision.core.surfaces.surface_avoidance import gather_near, triangle_avoids


@inlined_kernel
def middle_of(p):
    """Middle (x, y, z) [m] of a triangle (9,), and an upper bound r of its corners' distance from there [m]."""
    x, y, z, r2 = (p[0] + p[3] + p[6]) / 3.0, (p[1] + p[4] + p[7]) / 3.0, (p[2] + p[5] + p[8]) / 3.0, 0.0
    for k in range(3):
        r2 = max(r2, (p[3 * k] - x) ** 2 + (p[3 * k + 1] - y) ** 2 + (p[3 * k + 2] - z) ** 2)
    return x, y, z, math.sqrt(r2)


@inlined_kernel
def moved_triangle_avoids(pools, other, near, p, shift, ball, slack, scratch):
    """Whether the triangle p (9,) in a ball about its middle, displaced by `shift` (x, y, z) [m], avoids `other`."""
    mx, my, mz = shift
    x, y, z, r = ball
    moved = scratch.surface_work.moved
    for k in range(3):
        moved[3 * k], moved[3 * k + 1], moved[3 * k + 2] = p[3 * k] + mx, p[3 * k + 1] + my, p[3 * k + 2] + mz
    return triangle_avoids(pools, other, near, moved, (x + mx, y + my, z + mz, r), slack, scratch)


class Margins(NamedTuple):
    """Targets of a search for a deeper point, in addition to the deepest depth known [m]."""

    prove: float  # [m] margin to prove as a depth bound
    limit: float  # [m] a point that is deeper by more is found
    finest: float  # [m] a triangle within that of its middle is not halved
    most_asked: int  # points queried at most; if they do not suffice, the bound is infinite


@inlined_kernel
def along(way, s):
    """The displacement (x, y, z) by `s` [m] along a unit vector."""
    return s * way[0], s * way[1], s * way[2]


@query_kernel
def search_triangle(pools, other, deepest, margins, way, slack, found, scratch):
    """Search a triangle for a point deeper than `deepest` [m] in fragment `other`, or bound the depth of its points.

    The triangle is row 0 of surface_work.stack, in the frame of `other`. margins: Margins; way: a unit vector along
    which the triangle may be displaced; slack [m]: rounding of heights. A point beyond margins.limit is written to
    `found` (3,) [m], and `deepest` is its depth from then on.

    Returns (bound [m] on the depth of the triangle's points, unless a deeper one was found; infinity:
    margins.most_asked did not suffice; depth [m] of the deepest point found, or else `deepest`; points queried).
    """
    prove, limit, finest, most_asked = margins
    stack = scratch.surface_work.stack
    top, bound, asked, at = 1, 0.0, 0, -1
    while top:
        if asked == most_asked:
            return math.inf, deepest, asked
        p = stack[top - 1]
        x, y, z, r = middle_of(p)
        answer = bounded_probe(pools, other, (x, y, z), r, math.inf, at, False, scratch)
        at, asked, depth = answer.tetrahedron if answer.tetrahedron >= 0 else at, asked + 1, -answer.distance
        if answer.status == INSIDE and depth > deepest + limit:
            deepest = depth
            found[0], found[1], found[2] = x, y, z
        most, is_settled = depth + r, answer.status == OUTSIDE
        if is_settled:
            most = 0.0
        elif most <= deepest + limit or r <= finest or top == len(stack):
            is_settled = True
        elif depth <= deepest + prove:
            s = deepest + prove
            near = scratch.heap_tet[: gather_near(pools, other, (x, y, z, r + s), slack, scratch)]
            outward = (answer.nx, answer.ny, answer.nz)
            ball = x, y, z, r
            if moved_triangle_avoids(
                pools, other, near, p, along(outward, s), ball, slack, scratch
            ) or moved_triangle_avoids(pools, other, near, p, along(way, s), ball, slack, scratch):
                most, is_settled = s, True
        if is_settled:
            bound, top = max(bound, most), top - 1
        else:
            top = _halve(stack, top)
    return bound, deepest, asked


@inlined_kernel
def inward(p):
    """Inward unit normal of a triangle (9,)."""
    x, y, z = triangle_normal(p[0], p[1], p[2], p[3], p[4], p[5], p[6], p[7], p[8])
    return -x, -y, -z


@inlined_kernel
def _halve(stack, top):
    """Replace the triangle on top by the halves of its longest side; returns the new height."""
    p, q = stack[top - 1], stack[top]
    longest, side = -1.0, 0
    for k in range(3):
        i, j = 3 * k, 3 * ((k + 1) % 3)
        square = (p[i] - p[j]) ** 2 + (p[i + 1] - p[j + 1]) ** 2 + (p[i + 2] - p[j + 2]) ** 2
        if square > longest:
            longest, side = square, k
    i, j = 3 * side, 3 * ((side + 1) % 3)
    for k in range(9):
        q[k] = p[k]
    for d in range(3):
        middle = 0.5 * (p[i + d] + p[j + d])
        p[j + d], q[i + d] = middle, middle
    return top + 1
