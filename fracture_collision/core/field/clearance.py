"""Whether a point is certainly farther than a limit from a fragment, or certainly inside: enough for most samples.

Visits the tetrahedron that holds the point and all whose walls are within reach: a path to a fragment crosses its
surface. Walls are single precision, one cache line per tetrahedron, so their heights are compared with a slack; where
the result is not certain, use the exact queries (elementary_queries.bounded_probe, flood.py).
"""

from __future__ import annotations

import math

import numpy as np

from fracture_collision.core.field.flood import EVERYTHING, NO_SOURCE, nearest_in_tetrahedron, nothing_within
from fracture_collision.core.field.tetrahedra_near import tetrahedra_near
from fracture_collision.core.memory.compiled import query_kernel
from fracture_collision.core.memory.kinds import TETRAHEDRA
from fracture_collision.core.memory.pools import (
    FRONT,
    NEVER_BROKEN,
    OWNER,
    PARTED,
    PLANE,
)
from fracture_collision.core.mesh.point_location import owner_in_cut, region_holds, tetrahedron_at

# Error bound of a point's single-precision height above a wall, as a share of R: no point of the mesh is farther than
# 6 R from the grid's corner, and each of its coordinates, the wall's numbers and the seven operations is rounded to
# 2^-24 of that.
WALL_ROUNDING = 2e-5
# Step limit of the walk from the last point; a longer walk falls back to the grid.
MOST_STEPS = 12
# Limit of the tetrahedra visited around a point.
MOST_AROUND = 16
CLEAR, NEAR, UNKNOWN = 0, 1, 2
BEYOND, DEEP = 3, 4


@query_kernel
def may_be_clear(pools, f):
    """Whether `clearance` applies to fragment `f`: it is part of a broken body."""
    return pools.fragment.kind[f] == TETRAHEDRA and pools.fragment.node_shift[f] != NEVER_BROKEN


@query_kernel
def _heights(walls, t, local):
    """Heights [m] of a point above the four walls of tetrahedron `t`, positive outside; local: see _held_by."""
    w = walls[t]
    x, y, z = local
    return (
        w[0] * x + w[4] * y + w[8] * z - w[12], w[1] * x + w[5] * y + w[9] * z - w[13],
        w[2] * x + w[6] * y + w[10] * z - w[14], w[3] * x + w[7] * y + w[11] * z - w[15],
    )  # fmt: skip


@query_kernel
def _held_by(mesh, k, last, point, local, slack):
    """The tetrahedron of mesh `k` that holds a point, and its distance behind the nearest wall.

    last: see `clearance`; local: the point relative to the grid's corner, single precision; slack [m]: rounding of
    heights. Returns (tetrahedron, -1: none; distance [m], a lower bound up to rounding).
    """
    t, steps = last, 0
    while t >= 0:
        h0, h1, h2, h3 = _heights(mesh.walls, t, local)
        highest, face = h0, 0
        if h1 > highest:
            highest, face = h1, 1
        if h2 > highest:
            highest, face = h2, 2
        if h3 > highest:
            highest, face = h3, 3
        if highest <= slack:
            return t, -highest
        steps += 1
        t = mesh.neighbours[t, face] if steps < MOST_STEPS else -1
    t = tetrahedron_at(mesh, k, point[0], point[1], point[2])
    if t < 0:
        return t, np.float32(0.0)
    h0, h1, h2, h3 = _heights(mesh.walls, t, local)
    return t, -max(h0, h1, h2, h3)


@query_kernel
def clearance(pools, f, last, point, within, rounding, scratch):
    """Lower bound of a point's distance from fragment `f`, which must satisfy may_be_clear.

    last: a tetrahedron near the point (x, y, z), -1: none is known; rounding [m]: error bound of the point. Returns
    (lower bound [m], 0: the point may be within `within` [m]; a tetrahedron near the point).
    """
    x, y, z = point
    mesh = pools.mesh
    k = pools.fragment.mesh[f]
    slack = np.float32(WALL_ROUNDING * pools.fragment.radius[f] + rounding)
    local = np.float32(x - mesh.grid[k, 0]), np.float32(y - mesh.grid[k, 1]), np.float32(z - mesh.grid[k, 2])
    t, behind = _held_by(mesh, k, last, point, local, slack)
    far = np.float32(within) + slack
    if t < 0:
        clear = _is_clear_of_cells(pools, f, point, local, far, scratch)
        return (within if clear else 0.0), last
    apart = _way_within(pools, f, t, point, local, far, slack)
    if behind < slack or apart < far:
        return 0.0, t
    if behind > far:
        return max(within, np.float64(min(apart, behind) - slack)), t
    around = _around(pools, f, t, point, local, far, scratch.stack)
    if around == UNKNOWN and _is_clear_of_cells(pools, f, point, local, far, scratch):
        around = CLEAR
    return (within if around == CLEAR else 0.0), t


@query_kernel
def side_of_surface(pools, f, last, point, deep, rounding):
    """Whether a point is certainly outside fragment `f`, or certainly deep inside.

    Arguments as in `clearance`. Returns (BEYOND: not in f; DEEP: in f, with nothing else within `deep` [m]; else
    UNKNOWN; a tetrahedron near the point).
    """
    x, y, z = point
    mesh = pools.mesh
    k = pools.fragment.mesh[f]
    slack = np.float32(WALL_ROUNDING * pools.fragment.radius[f] + rounding)
    local = np.float32(x - mesh.grid[k, 0]), np.float32(y - mesh.grid[k, 1]), np.float32(z - mesh.grid[k, 2])
    t, behind = _held_by(mesh, k, last, point, local, slack)
    if t < 0 or behind < slack:
        return UNKNOWN, last
    tet = t + pools.fragment.tet_shift[f]
    region = pools.body.regions[tet]
    if not region_holds(region, f):
        return BEYOND, t
    if region[OWNER] == PARTED:
        above = _above_plane(pools.body.region_planes[tet], local)
        if region[FRONT] == f:
            above = -above
        if above < -slack:
            return BEYOND, t
        behind = min(behind, above)
    elif region[OWNER] < 0:
        return (UNKNOWN if owner_in_cut(pools, f, t, x, y, z) == f else BEYOND), t
    return (DEEP if behind > np.float32(deep) + slack else UNKNOWN), t


@query_kernel
def _is_clear_of_cells(pools, f, point, local, far, scratch):
    """Whether no surface of `f` is within `far` [m] of a point outside f, by all tetrahedra in the cells around it."""
    mesh, near = pools.mesh, scratch.heap_tet
    for k in range(tetrahedra_near(pools, f, point[0], point[1], point[2], np.float64(far), scratch)):
        t = near[k]
        h0, h1, h2, h3 = _heights(mesh.walls, t, local)
        if max(h0, h1, h2, h3) > far:
            continue
        if _has_surface_near(pools, f, t, point, local, far):
            return False
    return True


@query_kernel
def _above_plane(region, local):
    """Height [m] of a point, relative to the grid's corner, above a tetrahedron's dividing plane, out of its front."""
    return region[PLANE] * local[0] + region[PLANE + 1] * local[1] + region[PLANE + 2] * local[2] - region[PLANE + 3]


@query_kernel
def _around(pools, f, start, point, local, far, reached):
    """Whether surface of `f` may be within `far` [m] of a point outside f, by the tetrahedra around the point.

    start: the tetrahedron that holds the point; reached (STACK,) int32: working space. Returns CLEAR: none of them has
    surface within reach; NEAR: one may have; UNKNOWN: the outside of the body, or too many tetrahedra, are within
    reach.
    """
    mesh = pools.mesh
    reached[0] = start
    count, done = 1, 0
    while done < count:
        t = reached[done]
        done += 1
        heights = _heights(mesh.walls, t, local)
        if t != start:
            # farther than `far` beyond one of its walls: neither it nor anything behind it is near
            if max(heights[0], heights[1], heights[2], heights[3]) > far:
                continue
            if _has_surface_near(pools, f, t, point, local, far):
                return NEAR
        for face in range(4):
            h = heights[0] if face == 0 else heights[1] if face == 1 else heights[2] if face == 2 else heights[3]
            if abs(h) > far:
                continue
            n = mesh.neighbours[t, face]
            if n < 0:
                return UNKNOWN
            k = 0
            while k < count and reached[k] != n:
                k += 1
            if k == count:
                if count == MOST_AROUND:
                    return UNKNOWN
                reached[count] = n
                count += 1
    return CLEAR


@query_kernel
def _has_surface_near(pools, f, t, point, local, far):
    """Whether surface of `f` in tetrahedron `t` may be within `far` [m] of a point outside f.

    local: the point relative to the grid's corner.
    """
    x, y, z = point
    tet = t + pools.fragment.tet_shift[f]
    region = pools.body.regions[tet]
    if not region_holds(region, f):
        return False
    if region[OWNER] == PARTED:
        above = _above_plane(pools.body.region_planes[tet], local)
        if (above if region[FRONT] == f else -above) > far:
            return False
    best = nearest_in_tetrahedron(pools, f, t, x, y, z, EVERYTHING, nothing_within(np.float64(far)))
    return best[5] != NO_SOURCE


@query_kernel
def _way_within(pools, f, t, point, local, far, slack):
    """Lower bound [m], up to rounding, of the distance from a point in tetrahedron `t` to f's part of `t`.

    0: the point may be in f; `far` [m] or more: no part is nearer than that.
    """
    x, y, z = point
    tet = t + pools.fragment.tet_shift[f]
    region = pools.body.regions[tet]
    if not region_holds(region, f):
        return np.float32(np.inf)
    if region[OWNER] >= 0:
        return np.float32(0.0)
    if region[OWNER] == PARTED:
        above = _above_plane(pools.body.region_planes[tet], local)
        if region[FRONT] != f:
            above = -above
        if above > far or not above > slack:
            return max(above, np.float32(0.0))
    elif owner_in_cut(pools, f, t, x, y, z) == f:
        return np.float32(0.0)
    best = nearest_in_tetrahedron(pools, f, t, x, y, z, EVERYTHING, nothing_within(np.float64(far)))
    return far if best[5] == NO_SOURCE else np.float32(math.sqrt(best[0]))
