"""Which tetrahedron holds a point, and which fragment owns it there: insideTest of Glondu 2014, section 4.3.

A uniform grid replaces the paper's k-d tree: a lookup of one cell, then the few tetrahedra that meet the point's part.
"""

from __future__ import annotations

import math

import numpy as np

from fracture_collision.core.memory.compiled import query_kernel
from fracture_collision.core.memory.pools import (
    BACK,
    BACK_SIDE,
    BACK_VOID,
    FRONT,
    FRONT_SIDE,
    FRONT_VOID,
    KIND,
    LABELS,
    NEVER_BROKEN,
    OWNER,
    PARTED,
    ROW,
    VOID,
)
from fracture_collision.core.mesh.cut_tetrahedron import ON_FACE
from fracture_collision.core.mesh.occupancy import part_at

# A point of a shared face belongs to the first of its tetrahedra; rounding must not lose it between them.
WEIGHT_TOLERANCE = -1e-12
# Far from the origin of the body frame a weight is a small difference of large terms, with their rounding error.
TERM_ROUNDING = 8.0 * np.finfo(np.float64).eps

# Step limit of a walk: a longer one is lost, or did not start near the point.
MOST_STEPS = 16


@query_kernel
def tetrahedron_at(mesh, k, x, y, z):
    """Row of the tetrahedron of mesh `k` that holds the point (body frame [m]); -1 outside the body."""
    per_cell = 1.0 / mesh.grid[k, 3]
    px, py, pz = (x - mesh.grid[k, 0]) * per_cell, (y - mesh.grid[k, 1]) * per_cell, (z - mesh.grid[k, 2]) * per_cell
    i, j, l = math.floor(px), math.floor(py), math.floor(pz)  # noqa: E741
    nx, ny, nz, first = mesh.grid_dims[k]
    if i < 0 or j < 0 or l < 0 or i >= nx or j >= ny or l >= nz:
        return -1
    c = first + (int(i) * ny + int(j)) * nz + int(l)
    part = part_at(px - i, py - j, pz - l)
    for e in range(mesh.cell_begin[c], mesh.cell_begin[c + 1]):
        if not mesh.cell_parts[e] & part:
            continue
        t = mesh.cell_tets[e]
        b = mesh.barycentric[t]
        least = WEIGHT_TOLERANCE - TERM_ROUNDING * (abs(b[3]) + abs(b[7]) + abs(b[11]))
        w1 = b[0] * x + b[1] * y + b[2] * z + b[3]
        if w1 < least:
            continue
        w2 = b[4] * x + b[5] * y + b[6] * z + b[7]
        if w2 < least:
            continue
        w3 = b[8] * x + b[9] * y + b[10] * z + b[11]
        if w3 >= least and 1.0 - w1 - w2 - w3 >= least:
            return t
    return -1


@query_kernel
def tetrahedron_from(mesh, k, start, x, y, z):
    """As tetrahedron_at, by a walk from tetrahedron `start` across the face with the lowest barycentric weight."""
    t = start
    for _ in range(MOST_STEPS):
        b = mesh.barycentric[t]
        least = WEIGHT_TOLERANCE - TERM_ROUNDING * (abs(b[3]) + abs(b[7]) + abs(b[11]))
        w1 = b[0] * x + b[1] * y + b[2] * z + b[3]
        w2 = b[4] * x + b[5] * y + b[6] * z + b[7]
        w3 = b[8] * x + b[9] * y + b[10] * z + b[11]
        lowest, face = 1.0 - w1 - w2 - w3, 0
        if w1 < lowest:
            lowest, face = w1, 1
        if w2 < lowest:
            lowest, face = w2, 2
        if w3 < lowest:
            lowest, face = w3, 3
        if lowest >= least:
            return t
        t = mesh.neighbours[t, face]
        if t < 0:
            break
    return tetrahedron_at(mesh, k, x, y, z)


@query_kernel
def owner_in_tetrahedron(pools, f, t, x, y, z):
    """Fragment row that owns the point within tetrahedron `t` of fragment `f`'s body."""
    tet_shift = pools.fragment.tet_shift[f]
    if tet_shift == NEVER_BROKEN:
        return f
    alone = pools.body.regions[t + tet_shift, OWNER]
    if alone >= 0:
        return alone
    return owner_in_cut(pools, f, t, x, y, z)


@query_kernel
def owner_in_cut(pools, f, t, x, y, z):
    """The same for a tetrahedron that several fragments share (cut_tetrahedron.py)."""
    body = pools.body
    first = body.regions[t + pools.fragment.tet_shift[f], ROW]
    if body.regions[t + pools.fragment.tet_shift[f], OWNER] == PARTED:
        region = body.regions[t + pools.fragment.tet_shift[f]]
        return region[FRONT] if height(body, first, x, y, z) <= 0.0 else region[BACK]
    return _owner_about_hub(pools, f, t, first, x, y, z)


@query_kernel
def height(body, row, x, y, z):
    """Height [m] of the point above the plane of a triangle, out of its front; NaN for a triangle without a plane."""
    p = body.faces[row]
    return p[0] * x + p[1] * y + p[2] * z - p[3]


@query_kernel
def _side(body, row, x, y, z):
    """The owner in a sector of two fragments; its triangle cuts off a corner of the face, in front."""
    in_front = height(body, row, x, y, z) <= 0.0 and not body.sides[row, VOID] & FRONT_VOID
    return body.sides[row, FRONT_SIDE] if in_front else body.sides[row, BACK_SIDE]


@query_kernel
def _owner_about_hub(pools, f, t, first, x, y, z):
    """The hub and a face span a sector; in it, planes through the hub divide the fragments as they divide the face."""
    mesh, body = pools.mesh, pools.body
    hub = body.triangles[first]
    face, least = 0, math.inf
    rest, hub_rest = 1.0, 1.0
    b = mesh.barycentric[t]
    for k in range(4):
        if k < 3:
            weight = b[4 * k] * x + b[4 * k + 1] * y + b[4 * k + 2] * z + b[4 * k + 3]
            of_hub = b[4 * k] * hub[0] + b[4 * k + 1] * hub[1] + b[4 * k + 2] * hub[2] + b[4 * k + 3]
            rest, hub_rest = rest - weight, hub_rest - of_hub
        else:
            weight, of_hub = rest, hub_rest
        # a hub on a face has no sector with it
        if of_hub > ON_FACE and weight / of_hub < least:
            face, least = k + 1 if k < 3 else 0, weight / of_hub
    last = first + body.cut_count[t + pools.fragment.tet_shift[f]]
    row = first
    while row < last and body.sides[row, KIND] < face:
        row += 1
    if row == last or body.sides[row, KIND] != face:
        return body.node_fragment[mesh.tetrahedra[t, (face + 1) % 4] + pools.fragment.node_shift[f]]
    if row + 1 == last or body.sides[row + 1, KIND] != face:
        return _side(body, row, x, y, z)
    # three fragments about the face point, none over more than half a turn: each owns the wedge behind the half-plane
    # at its end and beyond the one at its start; on a border, where rounding decides, the least violated wedge wins.
    # A wedge without volume owns nothing: all of the plane of its half-planes would be its border.
    first, second, third = height(body, row, x, y, z), height(body, row + 1, x, y, z), height(body, row + 2, x, y, z)
    lacks = math.inf if _is_void(body, row, row + 2) else _larger(first, -third)
    of_second = math.inf if _is_void(body, row + 1, row) else _larger(second, -first)
    of_third = math.inf if _is_void(body, row + 2, row + 1) else _larger(third, -second)
    if of_third < lacks and of_third < of_second:
        return body.sides[row + 2, FRONT_SIDE]
    return body.sides[row, FRONT_SIDE] if lacks <= of_second else body.sides[row + 1, FRONT_SIDE]


@query_kernel
def _is_void(body, row, other):
    """Whether the part between two triangles, in front of `row` and behind `other`, has no volume."""
    return body.sides[row, VOID] & FRONT_VOID != 0 and body.sides[other, VOID] & BACK_VOID != 0


@query_kernel
def _larger(a, b):
    """The larger of two heights; if one is NaN, the other; if both are, infinity."""
    if math.isnan(a):
        return math.inf if math.isnan(b) else b
    return a if math.isnan(b) else max(a, b)


@query_kernel
def holds_fragment(pools, f, t):
    """Whether tetrahedron `t` has a node of fragment `f`."""
    tet_shift = pools.fragment.tet_shift[f]
    if tet_shift == NEVER_BROKEN:
        return True
    return region_holds(pools.body.regions[t + tet_shift], f)


@query_kernel
def region_holds(region, f):
    """holds_fragment for a row of BodyPool.regions."""
    if region[OWNER] >= 0:
        return region[OWNER] == f
    if region[OWNER] == PARTED:
        return region[FRONT] == f or region[BACK] == f
    return region[LABELS] == f or region[LABELS + 1] == f or region[LABELS + 2] == f or region[LABELS + 3] == f
