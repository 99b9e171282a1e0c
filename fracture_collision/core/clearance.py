"""Whether a point is certainly farther from a fragment than so much: what most samples that are asked need to be told.

From the tetrahedron that holds the point over all whose walls are within reach. Walls are in single precision, a line
of the cache for each tetrahedron, so what they say is left room; where it is not certain, somebody else has to be asked
(elementary_queries.bounded_probe, flood.py).
"""

from __future__ import annotations

import numpy as np

from fracture_collision.core.compiled import inlined_kernel
from fracture_collision.core.flood import tetrahedra_near
from fracture_collision.core.kinds import TETRAHEDRA
from fracture_collision.core.point_location import height, owner_in_cut, region_holds, tetrahedron_at
from fracture_collision.core.pools import (
    BACK_SIDE,
    FRONT,
    FRONT_SIDE,
    KIND,
    NEVER_BROKEN,
    OLD_FACE,
    OWNER,
    PARTED,
    PLANE,
    ROW,
)

# What single precision may do to a point's height above a wall, as a share of R: no point of the mesh is farther than
# 6 R from the grid's corner, and each of its coordinates, the wall's numbers and the seven operations is rounded to
# 2^-24 of that.
WALL_ROUNDING = 2e-5
# A walk from the last point that takes more steps was no short one.
MOST_STEPS = 12
# Tetrahedra around a point that are looked at.
MOST_AROUND = 16
CLEAR, NEAR, UNKNOWN = 0, 1, 2


@inlined_kernel
def may_be_clear(pools, f):
    """Whether `clearance` can say anything of fragment `f`: it is part of something that broke."""
    return pools.fragment.kind[f] == TETRAHEDRA and pools.fragment.node_shift[f] != NEVER_BROKEN


@inlined_kernel
def _heights(walls, t, x, y, z):
    """Of a point, from the grid's corner, above the four walls of tetrahedron `t`, outwards [m]."""
    w = walls[t]
    return (
        w[0] * x + w[4] * y + w[8] * z - w[12], w[1] * x + w[5] * y + w[9] * z - w[13],
        w[2] * x + w[6] * y + w[10] * z - w[14], w[3] * x + w[7] * y + w[11] * z - w[15],
    )  # fmt: skip


@inlined_kernel
def clearance(pools, f, last, x, y, z, within, rounding, scratch, thread):
    """(how far [m] fragment `f` certainly is from a point at least, 0: perhaps no farther than `within` [m]; a
    tetrahedron near the point).

    last: a tetrahedron near the point, -1: none is known. f: may_be_clear. rounding [m]: how far the point may be from
    (x, y, z).
    """
    mesh = pools.mesh
    k = pools.fragment.mesh[f]
    slack = np.float32(WALL_ROUNDING * pools.fragment.radius[f] + rounding)
    px, py, pz = np.float32(x - mesh.grid[k, 0]), np.float32(y - mesh.grid[k, 1]), np.float32(z - mesh.grid[k, 2])
    t, steps = last, 0
    while t >= 0:
        h0, h1, h2, h3 = _heights(mesh.walls, t, px, py, pz)
        highest, face = h0, 0
        if h1 > highest:
            highest, face = h1, 1
        if h2 > highest:
            highest, face = h2, 2
        if h3 > highest:
            highest, face = h3, 3
        if highest <= slack:
            break
        steps += 1
        t = mesh.neighbours[t, face] if steps < MOST_STEPS else -1
    far = np.float32(within) + slack
    if t < 0:
        t = tetrahedron_at(mesh, k, x, y, z)
        if t < 0:
            clear = _is_clear_of_cells(pools, f, x, y, z, px, py, pz, far, scratch, thread)
            return (within if clear else 0.0), last
        h0, h1, h2, h3 = _heights(mesh.walls, t, px, py, pz)
        highest = max(h0, h1, h2, h3)
    apart = _least_way(pools, f, t, True, x, y, z, px, py, pz)
    if highest > -slack or not apart > far:
        return 0.0, t
    if highest < -far:
        return np.float64(min(apart, -highest) - slack), t
    around = _around(pools, f, t, x, y, z, px, py, pz, far, scratch.stack[thread])
    if around == UNKNOWN and _is_clear_of_cells(pools, f, x, y, z, px, py, pz, far, scratch, thread):
        around = CLEAR
    return (within if around == CLEAR else 0.0), t


@inlined_kernel
def _is_clear_of_cells(pools, f, x, y, z, px, py, pz, far, scratch, thread):
    """Whether all that `f` has in the cells about a point, wherever that is, is farther than `far` [m]."""
    mesh, near = pools.mesh, scratch.heap_tet[thread]
    for k in range(tetrahedra_near(pools, f, x, y, z, np.float64(far), scratch, thread)):
        h0, h1, h2, h3 = _heights(mesh.walls, near[k], px, py, pz)
        if max(h0, h1, h2, h3) > far:
            continue
        tet = near[k] + pools.fragment.tet_shift[f]
        if pools.body.regions[tet, OWNER] != PARTED:
            return False
        above = _above_plane(pools.body.region_planes[tet], px, py, pz)
        if not (above if pools.body.regions[tet, FRONT] == f else -above) > far:
            return False
    return True


@inlined_kernel
def _above_plane(region, px, py, pz):
    """Height [m] of a point, from the grid's corner, above what parts a tetrahedron, out of its front."""
    return region[PLANE] * px + region[PLANE + 1] * py + region[PLANE + 2] * pz - region[PLANE + 3]


@inlined_kernel
def _around(pools, f, start, x, y, z, px, py, pz, far, reached):
    """CLEAR if no tetrahedron around the point in `start` has surface of `f` within reach, NEAR if one may have it;
    UNKNOWN where air is within reach or too many are.
    """
    mesh = pools.mesh
    reached[0] = start
    count, done = 1, 0
    while done < count:
        t = reached[done]
        done += 1
        heights = _heights(mesh.walls, t, px, py, pz)
        if t != start:
            # beyond one of its walls, and far from that: nothing of it is near, nor of what lies behind
            if max(heights[0], heights[1], heights[2], heights[3]) > far:
                continue
            if not _least_way(pools, f, t, False, x, y, z, px, py, pz) > far:
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


@inlined_kernel
def _least_way(pools, f, t, holds_point, x, y, z, px, py, pz):
    """How far [m] what `f` has of tetrahedron `t` is at least, but for rounding, from a point that is not of f; if `t`
    is said to hold the point, 0 where it may be. (px, py, pz): from the grid's corner.
    """
    body, tet = pools.body, t + pools.fragment.tet_shift[f]
    region = body.regions[tet]
    if not region_holds(region, f):
        return np.float32(np.inf)
    if region[OWNER] >= 0:
        return np.float32(0.0)
    if region[OWNER] == PARTED:
        above = _above_plane(body.region_planes[tet], px, py, pz)
        return abs(above) if not holds_point else above if region[FRONT] == f else -above
    row, least = region[ROW], np.inf
    end = row + body.cut_count[tet]
    while row < end and body.sides[row, KIND] < OLD_FACE:
        if body.sides[row, FRONT_SIDE] == f or body.sides[row, BACK_SIDE] == f:
            away = abs(height(body, row, x, y, z))
            least = away if away < least else least if away >= least else 0.0  # 0: it has no plane
        row += 1
    return np.float32(least) if not holds_point or owner_in_cut(pools, f, t, x, y, z) != f else np.float32(0.0)
