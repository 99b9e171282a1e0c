"""Exact distances by a local flood: penetration(p; D(f)) and the near outside (Glondu 2014, section 4.4, made exact).

The segment from a point inside fragment f to the nearest point of f's surface runs inside f. So the flood starts at the
tetrahedron that holds the point and spreads across faces to tetrahedra that hold part of f, nearest lower bound first,
while that is below the best distance so far; in each it measures against f's surface polygons. The segment is straight:
it leaves a tetrahedron only across faces that the point is behind. The result is exact, with no stored distance and
nothing to update at a fracture.
"""

from __future__ import annotations

import math

import numpy as np

from fracture_collision.core.field.tetrahedra_near import next_stamp, tetrahedra_near
from fracture_collision.core.memory.compiled import query_kernel
from fracture_collision.core.memory.heap import pop, push
from fracture_collision.core.memory.pools import BACK_SIDE, FRONT_SIDE, KIND, NEVER_BROKEN, OLD_FACE, OWNER, PARTED, ROW
from fracture_collision.core.mesh.closest_point import (
    DIRECTION_FLOOR,
    ON_FACE,
    ON_RIM,
    box_distance_squared,
    closest_on_triangle,
    triangle_normal,
)
from fracture_collision.core.mesh.cut_tetrahedron import FACE_VERTICES
from fracture_collision.core.mesh.point_location import height, holds_fragment

# `source`, the surface triangle of a closest point: a row of body.triangles, or -1 - (4 tetrahedron + face) on the old
# surface.
NO_SOURCE = np.iinfo(np.int64).max
# `only`, the surface that a search considers, (behind, x, y, z): the border with fragment `behind`; or EVERYTHING; or
# with TOWARD the surface that faces a sample with outward normal (x, y, z).
WHATEVER, TOWARD = -1, -2
EVERYTHING = (WHATEVER, 0.0, 0.0, 0.0)
PLANE_SLACK = 1.0 + 1e-9
# Rounding error bound of a height above a plane, as a share of R.
HEIGHT_ROUNDING = 1e-12
# Rounding error bound of a barycentric weight.
WEIGHT_ROUNDING = 1e-12


@query_kernel
def _weight_and_slope(mesh, t, corner, x, y, z):
    """Barycentric weight of a corner of tetrahedron `t` at the point, and the square of its gradient [1/m2]."""
    b = mesh.barycentric[t]
    if corner > 0:
        k = 4 * (corner - 1)
        gx, gy, gz = b[k], b[k + 1], b[k + 2]
        return gx * x + gy * y + gz * z + b[k + 3], gx * gx + gy * gy + gz * gz
    gx, gy, gz = b[0] + b[4] + b[8], b[1] + b[5] + b[9], b[2] + b[6] + b[10]
    return 1.0 - gx * x - gy * y - gz * z - b[3] - b[7] - b[11], gx * gx + gy * gy + gz * gz


@query_kernel
def _face_is_farther(mesh, t, face, x, y, z, d2):
    """Whether the plane of a face, and so the face, is farther than sqrt(d2) [m], with a margin for rounding."""
    weight, slope = _weight_and_slope(mesh, t, face, x, y, z)
    weight = abs(weight) - WEIGHT_ROUNDING
    return weight > 0.0 and weight * weight > d2 * slope * PLANE_SLACK


@query_kernel
def may_leave_over(mesh, t, face, x, y, z, d2):
    """Whether a segment from the point, at most sqrt(d2) [m] long, may leave tetrahedron `t` across a face.

    It may only if the point is on t's side of the face, and no farther than that from its plane.
    """
    weight, slope = _weight_and_slope(mesh, t, face, x, y, z)
    if weight < 0.0:
        return weight >= -WEIGHT_ROUNDING
    weight -= WEIGHT_ROUNDING
    return weight <= 0.0 or weight * weight <= d2 * slope * PLANE_SLACK


@query_kernel
def least_distance_squared(mesh, t, x, y, z):
    """Lower bound [m2] of a point's squared distance from tetrahedron `t`, from its box and its four face planes."""
    least = box_distance_squared(x, y, z, mesh.boxes[t])
    for face in range(4):
        weight, slope = _weight_and_slope(mesh, t, face, x, y, z)
        if weight < -WEIGHT_ROUNDING:
            least = max(least, (weight + WEIGHT_ROUNDING) ** 2 / (slope * PLANE_SLACK))
    return least


@query_kernel
def nothing_within(limit):
    """Initial `best` of a search for surface closer than `limit` [m].

    (squared distance [m2], x, y, z [m], feature, source, tetrahedron), with NO_SOURCE.
    """
    return limit * limit, 0.0, 0.0, 0.0, ON_RIM, NO_SOURCE, -1


@query_kernel
def nearest_in_tetrahedron(pools, f, t, x, y, z, only, best):
    """The nearer of `best`, see `nothing_within`, and f's surface within tetrahedron `t`.

    only: see EVERYTHING.
    """
    behind, ox, oy, oz = only
    d2, qx, qy, qz, feature, source, where = best
    mesh, body = pools.mesh, pools.body
    shift = pools.fragment.tet_shift[f]
    if behind < 0 and (shift == NEVER_BROKEN or body.regions[t + shift, OWNER] >= 0):
        for face in range(4):
            if mesh.neighbours[t, face] >= 0 or _face_is_farther(mesh, t, face, x, y, z, d2):
                continue
            a = mesh.nodes[mesh.tetrahedra[t, FACE_VERTICES[face, 0]]]
            b = mesh.nodes[mesh.tetrahedra[t, FACE_VERTICES[face, 1]]]
            c = mesh.nodes[mesh.tetrahedra[t, FACE_VERTICES[face, 2]]]
            if behind == TOWARD:
                nx, ny, nz = triangle_normal(a[0], a[1], a[2], b[0], b[1], b[2], c[0], c[1], c[2])
                if nx * ox + ny * oy + nz * oz >= 0.0:
                    continue
            e2, ex, ey, ez, rim = closest_on_triangle(x, y, z, a[0], a[1], a[2], b[0], b[1], b[2], c[0], c[1], c[2])
            if e2 < d2:
                d2, qx, qy, qz, feature, source, where = e2, ex, ey, ez, rim, -1 - (4 * t + face), t
    if shift == NEVER_BROKEN:
        return d2, qx, qy, qz, feature, source, where
    begin = body.regions[t + shift, ROW]
    face, farther = -1, False
    for i in range(begin, begin + body.cut_count[t + shift]):
        kind = body.sides[i, KIND]
        front, back = body.sides[i, FRONT_SIDE], body.sides[i, BACK_SIDE]
        sign = 1.0
        if front != f:
            if back != f:
                continue
            back = front
            sign = -1.0
        if kind >= OLD_FACE:
            # kinds are sorted: one test for all pieces of a face
            if kind != face:
                face, farther = kind, _face_is_farther(mesh, t, kind - OLD_FACE, x, y, z, d2)
            if farther:
                continue
        p = body.faces[i]
        if behind >= 0 and back != behind:
            continue
        if behind == TOWARD and sign * (p[0] * ox + p[1] * oy + p[2] * oz) >= 0.0:
            continue
        # no point of a triangle is nearer than its plane, with a margin for rounding; NaN for one without a plane
        above = height(body, i, x, y, z)
        if not above * above <= d2 * PLANE_SLACK:
            continue
        p = body.triangles[i]
        e2, ex, ey, ez, rim = closest_on_triangle(x, y, z, p[0], p[1], p[2], p[3], p[4], p[5], p[6], p[7], p[8])
        if e2 < d2:
            d2, qx, qy, qz, feature, source, where = e2, ex, ey, ez, rim, i, t
    return d2, qx, qy, qz, feature, source, where


@query_kernel
def nearest_from_inside(pools, f, start, point, limit, only, scratch):
    """Nearest point of f's surface closer than `limit` [m] (infinity: no limit) to a point of f in `start`.

    only: see EVERYTHING. Returns (squared distance [m2], x, y, z, feature, source, tetrahedron); NO_SOURCE if none is
    that close.
    """
    x, y, z = point
    mesh = pools.mesh
    keys = scratch.heap_key
    items = scratch.heap_tet
    visited = scratch.visited
    stamp = next_stamp(scratch)
    best = nothing_within(limit)
    keys[0], items[0] = 0.0, start
    visited[start] = stamp
    count = 1
    while count and keys[0] < best[0]:
        t = items[0]
        pop(keys, items, count)
        count -= 1
        best = nearest_in_tetrahedron(pools, f, t, x, y, z, only, best)
        for face in range(4):
            n = mesh.neighbours[t, face]
            if n < 0 or visited[n] == stamp or not may_leave_over(mesh, t, face, x, y, z, best[0]):
                continue
            visited[n] = stamp
            if holds_fragment(pools, f, n):
                key = least_distance_squared(mesh, n, x, y, z)
                if key < best[0]:
                    push(keys, items, count, key, n)
                    count += 1
    return best


@query_kernel
def nearest_from_outside(pools, f, at, point, limit, only, scratch):
    """Nearest point of f's surface closer than `limit` [m] to a point outside f; NO_SOURCE if none is.

    `at`: the tetrahedron that holds the point, -1 outside the body. `only` and the result as in nearest_from_inside.
    """
    x, y, z = point
    mesh = pools.mesh
    best = nothing_within(limit)
    if at >= 0:
        if _is_clear_within(pools, f, at, x, y, z, limit):
            return best
        best, complete = _nearest_around(pools, f, at, point, only, scratch, best)
        if complete:
            return best
    near = scratch.heap_tet
    for k in range(tetrahedra_near(pools, f, x, y, z, limit, scratch)):
        t = near[k]
        if box_distance_squared(x, y, z, mesh.boxes[t]) >= best[0]:
            continue
        if least_distance_squared(mesh, t, x, y, z) >= best[0]:
            continue
        if not _region_is_farther(pools, f, t, x, y, z, best[0]):
            best = nearest_in_tetrahedron(pools, f, t, x, y, z, only, best)
    return best


@query_kernel
def _is_clear_within(pools, f, t, x, y, z, limit):
    """Whether tetrahedron `t` alone shows that nothing of f is within `limit` [m] of a point in `t` outside f.

    True for most query points.
    """
    body, tet_shift, d2 = pools.body, pools.fragment.tet_shift[f], limit * limit
    if tet_shift == NEVER_BROKEN:
        return False
    alone = body.regions[t + tet_shift, OWNER]
    if alone == f:
        return False
    if alone < 0:
        limit += HEIGHT_ROUNDING * pools.fragment.radius[f]
        row = body.regions[t + tet_shift, ROW]
        end = row + (1 if alone == PARTED else body.cut_count[t + tet_shift])
        while row < end and body.sides[row, KIND] < OLD_FACE:
            of_f = body.sides[row, FRONT_SIDE] == f or body.sides[row, BACK_SIDE] == f
            if of_f and not abs(height(body, row, x, y, z)) > limit:
                return False
            row += 1
    return (
        _face_is_farther(pools.mesh, t, 0, x, y, z, d2) and _face_is_farther(pools.mesh, t, 1, x, y, z, d2)
        and _face_is_farther(pools.mesh, t, 2, x, y, z, d2) and _face_is_farther(pools.mesh, t, 3, x, y, z, d2)
    )  # fmt: skip


@query_kernel
def _region_is_farther(pools, f, t, x, y, z, d2):
    """Whether f's region of tetrahedron `t` is certainly farther than sqrt(d2) [m]: one plane divides `t`, and is."""
    body, tet_shift = pools.body, pools.fragment.tet_shift[f]
    if tet_shift == NEVER_BROKEN or body.regions[t + tet_shift, OWNER] != PARTED:
        return False
    row = body.regions[t + tet_shift, ROW]
    above = height(body, row, x, y, z)
    if body.sides[row, FRONT_SIDE] != f:
        above = -above
    above -= HEIGHT_ROUNDING * pools.fragment.radius[f]
    return above > 0.0 and above * above > d2


@query_kernel
def _nearest_around(pools, f, at, point, only, scratch, best):
    """nearest_from_outside for a point in tetrahedron `at`, across faces within reach.

    Returns (improved `best`, whether the search is complete). It is incomplete if the old surface is within reach: f
    may be near across the air.
    """
    x, y, z = point
    mesh = pools.mesh
    stack, visited, stamp = scratch.heap_tet, scratch.visited, next_stamp(scratch)
    stack[0] = at
    visited[at] = stamp
    count = 1
    while count:
        count -= 1
        t = stack[count]
        if holds_fragment(pools, f, t) and not _region_is_farther(pools, f, t, x, y, z, best[0]):
            best = nearest_in_tetrahedron(pools, f, t, x, y, z, only, best)
        for face in range(4):
            n = mesh.neighbours[t, face]
            if (n >= 0 and visited[n] == stamp) or _face_is_farther(mesh, t, face, x, y, z, best[0]):
                continue
            if n < 0:
                return best, False
            visited[n] = stamp
            if box_distance_squared(x, y, z, mesh.boxes[n]) < best[0]:
                stack[count] = n
                count += 1
    return best, True


@query_kernel
def source_normal(pools, f, source):
    """Outward unit normal of f on the surface triangle `source`."""
    if source < 0:
        t, face = (-1 - source) // 4, (-1 - source) % 4
        v = pools.mesh.tetrahedra[t]
        a = pools.mesh.nodes[v[FACE_VERTICES[face, 0]]]
        b = pools.mesh.nodes[v[FACE_VERTICES[face, 1]]]
        c = pools.mesh.nodes[v[FACE_VERTICES[face, 2]]]
        return triangle_normal(a[0], a[1], a[2], b[0], b[1], b[2], c[0], c[1], c[2])
    p = pools.body.faces[source]
    if pools.body.sides[source, FRONT_SIDE] == f:
        return p[0], p[1], p[2]
    return -p[0], -p[1], -p[2]


@query_kernel
def outward_direction(pools, f, x, y, z, best, inside):
    """Unit direction out of f at the closest point `best`: the face normal, or at a rim the line between the points."""
    d2, qx, qy, qz, feature, source, _ = best
    d = math.sqrt(d2)
    away = 1.0 if inside else -1.0
    touching = d <= DIRECTION_FLOOR * pools.fragment.radius[f]
    if feature == ON_FACE or touching:
        nx, ny, nz = source_normal(pools, f, source)
        # of a sheet of zero thickness between two fragments either side may have been found
        if not touching and away * (nx * (qx - x) + ny * (qy - y) + nz * (qz - z)) < 0.0:
            nx, ny, nz = -nx, -ny, -nz
        if nx * nx + ny * ny + nz * nz > 0.0:
            return nx, ny, nz
    if d == 0.0:
        return 0.0, 0.0, 1.0
    return away * (qx - x) / d, away * (qy - y) / d, away * (qz - z) / d
