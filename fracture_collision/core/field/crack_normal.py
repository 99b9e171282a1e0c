"""Normals at cracks: a contact between fragments of one body is turned to the crack that separates them.

Near the rim of a crack the nearest surface of the other fragment is often its old outside or a third fragment's crack,
and the line to it is unrelated to the direction in which the two separated (Glondu 2014 uses it unchanged). So, if
their shared crack is near, the contact takes that crack's normal, and its depth is the path along it out of the other
fragment, never less than the distance to the nearest surface. Selection and the missed depth bound use distances and
are unaffected.
"""

from __future__ import annotations

import math

from fracture_collision.core.field.flood import (
    NO_SOURCE,
    nearest_from_inside,
    nearest_from_outside,
    source_normal,
)
from fracture_collision.core.memory.compiled import query_kernel
from fracture_collision.core.memory.pools import BACK_SIDE, FRONT_SIDE, KIND, NEVER_BROKEN, OLD_FACE, OWNER, PARTED, ROW
from fracture_collision.core.mesh.closest_point import DIRECTION_FLOOR
from fracture_collision.core.mesh.point_location import height, owner_in_cut

# The shared crack is used if it is at most this share of R farther than the nearest surface.
FARTHER = 0.03
# From outside, where contacts beyond the detection tolerance are not listed, it is searched up to this multiple of the
# nearest distance.
TIMES_NEAREST = 3.0
# The path must also be at most OBLIQUE times the crack's own distance plus LITTLE R: else the crack bends here.
# LITTLE = 1e-4 equals the overlap of resting contacts, and one of them turned back and forth forever.
OBLIQUE, LITTLE = 4.0, 1e-3
# A ray that meets more tetrahedra on so short a path is lost.
MOST_TETRAHEDRA = 256
# Roots closer than this share of a ray's path through a tetrahedron count as one: between them rounding decides.
SAME_ROOT = 1e-10
NOWHERE = -2  # no tetrahedron, nor -1, the outside
ANYBODY = -1


@query_kernel
def turn_to_crack(pools, f, g, near, row, witness, scratch):
    """Turn the contact of a sample of `g` with `f`, of the same body, to the crack that separates them, if it is near.

    Sets witness, normal and gap of `row` (10,), see Sink; `near` [m] is the detection tolerance; `witness`: its surface
    triangle, its tetrahedron and the sample's. Samples outside the unbroken body (-1) are left unchanged: they are not
    between the two.
    """
    source, where, t = witness
    x, y, z, d = row[0], row[1], row[2], row[9]
    radius = pools.fragment.radius[f]
    if t < 0:
        return
    inside = d <= 0.0
    only = (g, 0.0, 0.0, 0.0)
    # in any direction, contacts listed outside are no farther than the detection tolerance
    within = FARTHER * radius - d if inside else near
    away = abs(d)
    if not _parts(pools, f, g, source):
        if inside:
            best = nearest_from_inside(pools, f, t, (x, y, z), within, only, scratch)
        else:
            best = nearest_from_outside(pools, f, t, (x, y, z), max(TIMES_NEAREST * d, near), only, scratch)
        source, where, away = best[5], best[6], math.sqrt(best[0])
        if source == NO_SOURCE:
            return
    sign = 1.0 if inside else -1.0
    nx, ny, nz = crack_direction(pools, f, g, source, where)
    # where the two just touch, keep the witness
    if abs(d) > DIRECTION_FLOOR * radius:
        s = way_through(pools, f, t, (x, y, z), (sign * nx, sign * ny, sign * nz), within, inside, scratch)
        if s > min(within, OBLIQUE * away + LITTLE * radius):
            return
        s *= sign
        row[3], row[4], row[5] = x + s * nx, y + s * ny, z + s * nz
        row[9] = -s
    row[6], row[7], row[8] = nx, ny, nz


@query_kernel
def _parts(pools, f, g, source):
    """Whether the surface triangle `source` belongs to the crack between two fragments."""
    if source < 0 or source == NO_SOURCE:
        return False
    front, back = pools.body.sides[source, FRONT_SIDE], pools.body.sides[source, BACK_SIDE]
    return (front == f and back == g) or (front == g and back == f)


@query_kernel
def crack_direction(pools, f, g, source, t):
    """Unit normal out of fragment `f` of its crack with `g` in tetrahedron `t`: the mean over the edges it cuts there.

    It averages the edges' planes, which are the fracture's input; the triangles only join the crossings.
    """
    nx, ny, nz = sum_of_planes(pools, f, g, t)
    length = math.sqrt(nx * nx + ny * ny + nz * nz)
    if length == 0.0:
        return source_normal(pools, f, source)
    return nx / length, ny / length, nz / length


@query_kernel
def sum_of_planes(pools, f, g, t):
    """Sum of the normals, out of `f` towards `g` or ANYBODY, of the planes that cut edges of tetrahedron `t`."""
    mesh, body = pools.mesh, pools.body
    node_shift, edge_shift = pools.fragment.node_shift[f], pools.fragment.edge_shift[f]
    sx = sy = sz = 0.0
    for e in range(6):
        edge = mesh.tetrahedron_edges[t, e]
        plane = body.edge_plane[edge + edge_shift]
        if plane < 0:
            continue
        first = body.node_fragment[mesh.edges[edge, 0] + node_shift]
        second = body.node_fragment[mesh.edges[edge, 1] + node_shift]
        if (first == f and (second == g or g == ANYBODY)) or (second == f and (first == g or g == ANYBODY)):
            sign = 1.0 if first == f else -1.0
            p = body.planes[plane]
            sx, sy, sz = sx + sign * p[0], sy + sign * p[1], sz + sign * p[2]
    return sx, sy, sz


@query_kernel
def way_through(pools, f, t, point, way, limit, leaves, scratch):
    """Length [m] of the ray from a point in tetrahedron `t` along a unit vector to where it leaves `f`, or enters it.

    leaves: which of both. Infinity: not within `limit` [m]. Walks from tetrahedron to tetrahedron; in each it tests the
    owner of points, not polygons, so that no ray slips between two polygons.
    """
    x, y, z = point
    nx, ny, nz = way
    mesh, body = pools.mesh, pools.body
    tet_shift = pools.fragment.tet_shift[f]
    s, came_from = 0.0, NOWHERE
    for _ in range(MOST_TETRAHEDRA):
        if t < 0 or s > limit:
            break
        out, face = math.inf, -1
        b = mesh.barycentric[t]
        weight, rate = 1.0, 0.0
        for k in range(4):
            corner = (k + 1) % 4
            if corner:
                w = b[4 * k] * x + b[4 * k + 1] * y + b[4 * k + 2] * z + b[4 * k + 3]
                r = b[4 * k] * nx + b[4 * k + 1] * ny + b[4 * k + 2] * nz
                weight, rate = weight - w, rate - r
            else:
                w, r = weight, rate
            if r < 0.0 and mesh.neighbours[t, corner] != came_from:
                until = max(-w / r, s)
                if until < out:
                    out, face = until, corner
        if face < 0:
            return math.inf
        alone = f if tet_shift == NEVER_BROKEN else body.regions[t + tet_shift, OWNER]
        if alone < 0:
            begin = x + s * nx, y + s * ny, z + s * nz
            end = x + out * nx, y + out * ny, z + out * nz
            share = _share_of_segment(pools, f, t, leaves, begin, end, scratch.roots)
            if share < 1.0:
                s += share * (out - s)
                return s if s <= limit else math.inf
        elif (alone == f) != leaves:
            return s
        s, came_from, t = out, t, mesh.neighbours[t, face]
    return s if t < 0 and leaves and s <= limit else math.inf


@query_kernel
def _share_by_plane(body, row, f, leaves, begin, end):
    """_share_of_segment where a single plane, that of `row`, separates two fragments."""
    at_start, at_end = height(body, row, begin[0], begin[1], begin[2]), height(body, row, end[0], end[1], end[2])
    front, back = body.sides[row, FRONT_SIDE], body.sides[row, BACK_SIDE]
    before, after = back if at_start > 0.0 else front, back if at_end > 0.0 else front
    root = 1.0
    if (at_start > 0.0) != (at_end > 0.0):
        root = min(max(at_start / (at_start - at_end), 0.0), 1.0)
    if root > SAME_ROOT and (before == f) != leaves:
        return 0.0
    return root if root + SAME_ROOT < 1.0 and (after == f) != leaves else 1.0


@query_kernel
def _share_of_segment(pools, f, t, leaves, start, end, roots):
    """Share of a segment in cut tetrahedron `t`, from its start to where f's region ends (`leaves`) or begins: 0 .. 1.

    The owner is constant between neighbouring roots of the planes between fragments. `roots` (ROOTS,): working space.
    """
    x0, y0, z0 = start
    x1, y1, z1 = end
    body = pools.body
    begin, used = body.regions[t + pools.fragment.tet_shift[f], ROW], 0
    if body.regions[t + pools.fragment.tet_shift[f], OWNER] == PARTED:
        return _share_by_plane(body, begin, f, leaves, start, end)
    for i in range(begin, begin + body.cut_count[t + pools.fragment.tet_shift[f]]):
        if body.sides[i, KIND] >= OLD_FACE:
            break
        at_start, at_end = height(body, i, x0, y0, z0), height(body, i, x1, y1, z1)
        if (at_start > 0.0) != (at_end > 0.0):
            root, k = min(max(at_start / (at_start - at_end), 0.0), 1.0), used
            while k > 0 and roots[k - 1] > root:
                roots[k] = roots[k - 1]
                k -= 1
            roots[k] = root
            used += 1
    before = 0.0
    for i in range(used + 1):
        after = roots[i] if i < used else 1.0
        if after > before + SAME_ROOT:
            middle = 0.5 * (before + after)
            x, y, z = x0 + middle * (x1 - x0), y0 + middle * (y1 - y0), z0 + middle * (z1 - z0)
            if (owner_in_cut(pools, f, t, x, y, z) == f) != leaves:
                return before
        before = after
    return 1.0
