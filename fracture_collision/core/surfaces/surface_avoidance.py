"""Tests whether a small piece of surface, once displaced, avoids the interior of another fragment.

A negative result is inconclusive: the tests here do not show it. For a body of tetrahedra, those near the piece are
gathered once. A fragment's part of a tetrahedron lies within its walls; a part of a shared tetrahedron lies behind the
plane of its own triangle (cut_tetrahedron.py). So a hull that is beyond a wall, or beyond the planes of all triangles,
avoids it. A triangle also avoids a fragment if no triangle of that fragment meets it and its middle is outside.
"""

from __future__ import annotations

import math

import numpy as np

from fracture_collision.core.field.clearance import WALL_ROUNDING
from fracture_collision.core.field.tetrahedra_near import tetrahedra_near
from fracture_collision.core.memory.compiled import inlined_kernel
from fracture_collision.core.memory.kinds import BOX, TETRAHEDRA, TRIANGLES
from fracture_collision.core.memory.pools import (
    BACK_SIDE,
    FRONT,
    FRONT_SIDE,
    KIND,
    LABELS,
    NEVER_BROKEN,
    OLD_FACE,
    OWNER,
    PARTED,
    PLANE,
    ROW,
)
from fracture_collision.core.mesh.closest_point import box_distance_squared, triangle_normal
from fracture_collision.core.mesh.point_location import owner_in_tetrahedron, tetrahedron_at
from fracture_collision.core.mesh.triangle_field import triangle_distance

# Single-precision rounding of a corner of an element, as a share of the fragment's R (surface_elements.py).
OWN_ROUNDING = 1e-6


@inlined_kernel
def room_for_rounding(pools, f, own):
    """Single-precision error bound [m] of the height of a point of fragment `own` in f's frame."""
    return WALL_ROUNDING * pools.fragment.radius[f] + OWN_ROUNDING * pools.fragment.radius[own]


@inlined_kernel
def gather_near(pools, f, ball, slack, scratch):
    """Write the tetrahedra that hold part of `f` and may reach a ball to scratch.heap_tet; returns their number.

    ball (x, y, z, r) [m]: in f's frame; slack [m]: rounding of heights. For fragments of other kinds: 1, nothing
    written.
    """
    if pools.fragment.kind[f] != TETRAHEDRA:
        return 1
    mesh, near, count = pools.mesh, scratch.heap_tet, 0
    x, y, z, r = ball
    k = pools.fragment.mesh[f]
    px, py, pz = np.float32(x - mesh.grid[k, 0]), np.float32(y - mesh.grid[k, 1]), np.float32(z - mesh.grid[k, 2])
    far = np.float32(r + slack)
    for i in range(tetrahedra_near(pools, f, x, y, z, r, scratch)):
        w = mesh.walls[near[i]]
        if (
            w[0] * px + w[4] * py + w[8] * pz - w[12] > far or w[1] * px + w[5] * py + w[9] * pz - w[13] > far
            or w[2] * px + w[6] * py + w[10] * pz - w[14] > far or w[3] * px + w[7] * py + w[11] * pz - w[15] > far
        ):  # fmt: skip
            continue
        near[count] = near[i]
        count += 1
    return count


@inlined_kernel
def hull_avoids(pools, f, near, points, way, ball, slack):
    """Whether the hull of points avoids the interior of fragment `f`, a box or of tetrahedra.

    points (n, 3) [m]: in f's frame; ball (x, y, z, r) [m]: contains them; near: the tetrahedra that gather_near has
    found about it; way: a unit vector out of f; slack [m]: rounding of heights.
    """
    if pools.fragment.kind[f] == BOX:
        return _avoids_box(pools.fragment.shape[f], points, slack)
    if pools.fragment.kind[f] != TETRAHEDRA:
        return False
    mesh, body = pools.mesh, pools.body
    shift, k = pools.fragment.tet_shift[f], pools.fragment.mesh[f]
    # separating planes are relative to the grid's corner
    ox, oy, oz = mesh.grid[k, 0], mesh.grid[k, 1], mesh.grid[k, 2]
    lowest = math.inf
    for q in range(len(points)):
        lowest = min(lowest, way[0] * points[q, 0] + way[1] * points[q, 1] + way[2] * points[q, 2])
    for t in near:
        if _is_below(mesh, t, way, lowest - slack):
            continue
        if _is_beyond_a_wall(mesh, t, k, points, ball, slack):
            continue
        if shift == NEVER_BROKEN:
            return False
        region = body.regions[t + shift]
        if region[OWNER] >= 0:
            return False
        if region[OWNER] == PARTED:
            p = body.region_planes[t + shift]
            sign = 1.0 if region[FRONT] == f else -1.0
            nx, ny, nz = sign * np.float64(p[PLANE]), sign * np.float64(p[PLANE + 1]), sign * np.float64(p[PLANE + 2])
            offset = sign * np.float64(p[PLANE + 3]) + nx * ox + ny * oy + nz * oz
            if not _is_beyond(points, ball, (nx, ny, nz), offset, slack):
                return False
            continue
        if _has_whole_face(region, f):
            return False
        begin = region[ROW]
        for row in range(begin, begin + body.cut_count[t + shift]):
            if body.sides[row, KIND] >= OLD_FACE:
                break
            sign = _side_of(body.sides[row], f)
            p = body.faces[row]
            if sign == 0.0 or math.isnan(p[3]):  # a part behind such a face has no volume
                continue
            if not _is_beyond(points, ball, (sign * p[0], sign * p[1], sign * p[2]), sign * p[3], slack):
                return False
    return True


@inlined_kernel
def triangle_avoids(pools, f, near, p, ball, slack, scratch):
    """Whether the triangle p (9,) [m] in f's frame avoids the interior of fragment `f`, of any kind.

    near, slack: see hull_avoids; ball (x, y, z, r) [m]: about the triangle's middle.
    """
    x, y, z, _ = ball
    kind, points = pools.fragment.kind[f], p[:9].reshape(3, 3)
    if kind == BOX:
        return _avoids_box(pools.fragment.shape[f], points, slack)
    hx, hy, hz = triangle_normal(p[0], p[1], p[2], p[3], p[4], p[5], p[6], p[7], p[8])
    up, down = (hx, hy, hz), (-hx, -hy, -hz)
    if kind == TRIANGLES:
        return _avoids_triangles(pools, f, p, ball, slack, up, scratch)
    mesh, body = pools.mesh, pools.body
    shift, k = pools.fragment.tet_shift[f], pools.fragment.mesh[f]
    is_outside, height = True, hx * x + hy * y + hz * z
    for t in near:
        if _is_below(mesh, t, up, height - slack) or _is_below(mesh, t, down, -height - slack):
            continue
        if _is_beyond_a_wall(mesh, t, k, points, ball, slack):
            continue
        if shift == NEVER_BROKEN:
            return False
        region = body.regions[t + shift]
        if region[OWNER] >= 0:
            return False
        begin, is_over = region[ROW], region[OWNER] == PARTED or not _has_whole_face(region, f)
        end = begin + body.cut_count[t + shift]
        for row in range(begin, end):
            if not is_over or body.sides[row, KIND] >= OLD_FACE:
                break
            sign, g = _side_of(body.sides[row], f), body.faces[row]
            if sign != 0.0 and not math.isnan(g[3]):
                nx, ny, nz, offset = sign * g[0], sign * g[1], sign * g[2], sign * g[3]
                is_over = _is_beyond(points, ball, (nx, ny, nz), offset, slack)
        if is_over:
            continue
        is_outside = False
        for row in range(begin, end):
            sign, g = _side_of(body.sides[row], f), body.faces[row]
            if sign == 0.0 or math.isnan(g[3]):
                continue
            if _is_beyond(points, ball, (sign * g[0], sign * g[1], sign * g[2]), sign * g[3], slack):
                continue
            if not _is_off(body.triangles[row], p, ball, up, slack):
                return False
    if is_outside:
        return True
    t = tetrahedron_at(mesh, k, x, y, z)
    return t < 0 or owner_in_tetrahedron(pools, f, t, x, y, z) != f


@inlined_kernel
def _is_beyond_a_wall(mesh, t, k, points, ball, slack):
    """Whether all points are beyond a wall of tetrahedron `t` of mesh `k`; walls are relative to the grid's corner."""
    w = mesh.walls[t]
    for q in range(4):
        nx, ny, nz = np.float64(w[q]), np.float64(w[4 + q]), np.float64(w[8 + q])
        offset = np.float64(w[12 + q]) + nx * mesh.grid[k, 0] + ny * mesh.grid[k, 1] + nz * mesh.grid[k, 2]
        if _is_beyond(points, ball, (nx, ny, nz), offset, slack):
            return True
    return False


@inlined_kernel
def _is_below(mesh, t, n, height):
    """Whether tetrahedron `t` is below a plane."""
    nx, ny, nz = n
    for k in range(4):
        p = mesh.nodes[mesh.tetrahedra[t, k]]
        if not nx * p[0] + ny * p[1] + nz * p[2] < height:
            return False
    return True


@inlined_kernel
def _has_whole_face(region, f):
    """Whether three nodes of a tetrahedron belong to f: its part behind their face is behind no triangle."""
    labels = 0
    for q in range(4):
        labels += region[LABELS + q] == f
    return labels > 2


@inlined_kernel
def _side_of(sides, f):
    """1: `f` is on the front of a triangle, -1: on its back, 0: on neither side."""
    if sides[FRONT_SIDE] == f:
        return 1.0
    return -1.0 if sides[BACK_SIDE] == f else 0.0


@inlined_kernel
def _is_beyond(points, ball, n, offset, slack):
    """Whether all points are more than `slack` above a plane; the ball around them is tested first."""
    x, y, z, r = ball
    nx, ny, nz = n
    above = nx * x + ny * y + nz * z - offset
    if above > r + slack:
        return True
    least = above if above <= 0.0 else math.inf
    k = 0
    while k < len(points) and least > slack:
        least = min(least, nx * points[k, 0] + ny * points[k, 1] + nz * points[k, 2] - offset)
        k += 1
    return least > slack


@inlined_kernel
def _least_of_three(p, nx, ny, nz, offset):
    return min(
        nx * p[0] + ny * p[1] + nz * p[2], nx * p[3] + ny * p[4] + nz * p[5], nx * p[6] + ny * p[7] + nz * p[8]
    ) - offset


@inlined_kernel
def _is_off(c, p, ball, normal, slack):
    """Whether triangle `c` is on one side of the plane of `p`, with a normal, or beyond a side of `p`."""
    x, y, z, _ = ball
    hx, hy, hz = normal
    height = hx * x + hy * y + hz * z
    if _least_of_three(c, hx, hy, hz, height) > slack or _least_of_three(c, -hx, -hy, -hz, -height) > slack:
        return True
    for k in range(3):
        i, j = 3 * k, 3 * ((k + 1) % 3)
        ex, ey, ez = p[j] - p[i], p[j + 1] - p[i + 1], p[j + 2] - p[i + 2]
        nx, ny, nz = ey * hz - ez * hy, ez * hx - ex * hz, ex * hy - ey * hx
        length = math.sqrt(nx * nx + ny * ny + nz * nz)
        offset = nx * p[i] + ny * p[i + 1] + nz * p[i + 2]
        if _least_of_three(c, nx, ny, nz, offset) > slack * length:
            return True
    return False


@inlined_kernel
def _avoids_box(half, points, slack):
    for d in range(3):
        low, high = math.inf, -math.inf
        for k in range(len(points)):
            low, high = min(low, points[k, d]), max(high, points[k, d])
        if low > half[d] + slack or high < -half[d] - slack:
            return True
    return False


@inlined_kernel
def _avoids_triangles(pools, f, p, ball, slack, normal, scratch):
    x, y, z, r = ball
    meshes, k = pools.triangles, pools.fragment.mesh[f]
    node, end = meshes.node_range[k]
    r2 = (r + slack) * (r + slack)
    while node < end:
        if box_distance_squared(x, y, z, meshes.node_box[node]) > r2:
            node = meshes.node_skip[node]
            continue
        begin = meshes.node_first[node]
        for t in range(begin, begin + meshes.node_count[node]):
            c = meshes.corners[t]
            nx, ny, nz = triangle_normal(c[0], c[1], c[2], c[3], c[4], c[5], c[6], c[7], c[8])
            offset = nx * c[0] + ny * c[1] + nz * c[2]
            if not (
                _least_of_three(p, nx, ny, nz, offset) > slack
                or _least_of_three(p, -nx, -ny, -nz, -offset) > slack
                or _is_off(c, p, ball, normal, slack)
            ):
                return False
        node += 1
    return triangle_distance(meshes, k, pools.fragment.radius[f], x, y, z, scratch.stack)[0] > 0.0
