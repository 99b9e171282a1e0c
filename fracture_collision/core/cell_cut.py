"""A tetrahedron where flat cracks meet: three or four fragments, one plane between any two of them.

Where these planes are those of cells, so that what is on the right side of all its planes is the fragment's and nothing
is left over, the margin rule gives the same regions (docs/numerics.md), and each is a tetrahedron clipped by two or
three planes, without a choice of minima. `cells_fill` finds out: what two cells show each other has to be the same.
"""

from __future__ import annotations

import math

from fracture_collision.core.compiled import query_kernel
from fracture_collision.core.cut_tetrahedron import INTERFACE, emit, load_face, section
from fracture_collision.core.margin_clipping import clip, tie_limit
from fracture_collision.core.moments import add_tetrahedron

# Two interfaces are one if their areas differ by no more than this share of the squared span of a tetrahedron.
EQUAL_AREA = 1e-12


@query_kernel
def cells_fill(slots, work):
    """Whether the margins in `work` are those of cells that fill the tetrahedron.

    Each slot has one functional against each other, its negative there; no corner lies in one of their planes. Cells
    are convex and do not overlap, so they fill it if each side of a cell is the other's side there, all of it.
    """
    limit = tie_limit(work.corners)
    for s in range(slots):
        if work.counts[s] != slots - 1:
            return False
        for r in range(slots):
            if r != s and against(work, s, r) < 0:
                return False
        for q in range(work.counts[s]):
            g = work.functionals[s, q]
            for i in range(4):
                c = work.corners[i]
                if abs(g[0] * c[0] + g[1] * c[1] + g[2] * c[2] - g[3]) <= limit:
                    return False
    a, b = work.corners[0], work.corners[1]
    span = (a[0] - b[0]) ** 2 + (a[1] - b[1]) ** 2 + (a[2] - b[2]) ** 2
    for f in range(slots):
        for g in range(f + 1, slots):
            if abs(_area(work, _side(work, f, g)) - _area(work, _side(work, g, f))) > EQUAL_AREA * span:
                return False
    return True


@query_kernel
def _area(work, count):
    """[m2] of the first `count` vertices of work.polygon."""
    nx = ny = nz = 0.0
    p = work.polygon
    for k in range(1, count - 1):
        ux, uy, uz = p[k, 0] - p[0, 0], p[k, 1] - p[0, 1], p[k, 2] - p[0, 2]
        vx, vy, vz = p[k + 1, 0] - p[0, 0], p[k + 1, 1] - p[0, 1], p[k + 1, 2] - p[0, 2]
        nx, ny, nz = nx + uy * vz - uz * vy, ny + uz * vx - ux * vz, nz + ux * vy - uy * vx
    return 0.5 * math.sqrt(nx * nx + ny * ny + nz * nz)


@query_kernel
def _side(work, f, g):
    """The side of cell `f` towards cell `g`, into work.polygon, right-handed about the way out; its vertex count."""
    q = against(work, f, g)
    m = work.functionals[f, q]
    # outward of f is where its functional falls
    count = section(work.corners, -m[0], -m[1], -m[2], -m[3], 0.0, work.polygon, work.value, work.order)
    return _clip_to_cell(count, work, f, q)


@query_kernel
def against(work, s, r):
    """Which functional of slot `s` is the negative of one of slot `r`; -1: none."""
    for q in range(work.counts[s]):
        g = work.functionals[s, q]
        for p in range(work.counts[r]):
            h = work.functionals[r, p]
            if g[0] == -h[0] and g[1] == -h[1] and g[2] == -h[2] and g[3] == -h[3]:
                return q
    return -1


@query_kernel
def add_region(work, slot, first, last, sign, moments):
    """Add `sign` times the moments (10,) under a slot's triangles first .. last - 1 of `work`, seen from corner 0.

    Over a tetrahedron's interfaces and the slot's share of the face opposite corner 0 that sums to its region's; the
    other faces hold the corner.
    """
    o = work.corners[0]
    for i in range(first, last):
        p = work.triangles[i]
        for side in range(2):
            if (work.fronts[i] if side == 0 else work.backs[i]) != slot:
                continue
            # seen from behind a triangle runs the other way round
            b, c = (3, 6) if (side == 0) == (sign > 0.0) else (6, 3)
            add_tetrahedron(
                o[0], o[1], o[2], p[0], p[1], p[2], p[b], p[b + 1], p[b + 2], p[c], p[c + 1], p[c + 2], moments
            )


@query_kernel
def cell_shares(face, slots, work, used):
    """As cut_tetrahedron.face_shares, of cells."""
    for f in range(slots):
        count = load_face(work.corners, face, work.polygon)
        count = _clip_to_cell(count, work, f, -1)
        used = emit(work.polygon, count, f, -1, face, work.triangles, work.fronts, work.backs, work.kinds, used)
    return used


@query_kernel
def cell_interfaces(slots, work, used):
    """As cut_tetrahedron.interfaces, of cells."""
    for f in range(slots):
        for g in range(f + 1, slots):
            count = _side(work, f, g)
            used = emit(work.polygon, count, f, g, INTERFACE, work.triangles, work.fronts, work.backs, work.kinds, used)
    return used


@query_kernel
def _clip_to_cell(count, work, f, but):
    """Clip work.polygon to where all functionals of slot `f` but one are positive; returns its vertex count."""
    for q in range(work.counts[f]):
        if q != but and count:
            h = work.functionals[f, q]
            count = clip(work.polygon, count, work.spare, h[0], h[1], h[2], h[3])
    return count


@query_kernel
def clean_faces(slots, work):
    """Which faces of cells have nothing of a fragment that has no node on them: a bit each.

    Two tetrahedra that are clean at their common face agree about it: whoever is on the face has a node there, and
    what parts two of them is the plane at an edge of the face.
    """
    clean = 0
    for face in range(4):
        clear = True
        for h in range(slots):
            clear = clear and (_has_node(work, h, face) or _has_nothing(work, h, face))
        if clear:
            clean |= 1 << face
    return clean


@query_kernel
def _has_node(work, slot, face):
    """Whether a corner of a face is in the slot's cell."""
    for i in range(4):
        if i != face:
            c, inside = work.corners[i], True
            for q in range(work.counts[slot]):
                g = work.functionals[slot, q]
                inside = inside and g[0] * c[0] + g[1] * c[1] + g[2] * c[2] - g[3] > 0.0
            if inside:
                return True
    return False


@query_kernel
def _has_nothing(work, slot, face):
    """Whether all corners of a face are on the wrong side of one of the slot's planes."""
    for q in range(work.counts[slot]):
        g, beyond = work.functionals[slot, q], True
        for i in range(4):
            if i != face:
                c = work.corners[i]
                beyond = beyond and g[0] * c[0] + g[1] * c[1] + g[2] * c[2] - g[3] < 0.0
        if beyond:
            return True
    return False


@query_kernel
def cell_steps(face, slots, work, behind_slots, behind, far, used):
    """As cut_tetrahedron.steps, between two tetrahedra of cells, or of fewer fragments."""
    for f in range(slots):
        for g in range(behind_slots):
            if work.labels[f] == behind.labels[g]:
                continue
            count = load_face(work.corners, face, work.polygon)
            count = _clip_to_cell(count, work, f, -1)
            for q in range(behind.counts[g]):
                if count:
                    h = behind.functionals[g, q]
                    count = clip(work.polygon, count, work.spare, h[0], h[1], h[2], h[3])
            used = emit(work.polygon, count, f, g, face, far.triangles, far.fronts, far.backs, far.kinds, used)
    return used


@query_kernel
def reach_along(work, slot, start, end):
    """Share of the segment from `start` (3,), in the slot's cell, to `end` that lies in it."""
    share = 1.0
    for q in range(work.counts[slot]):
        g = work.functionals[slot, q]
        at_start = g[0] * start[0] + g[1] * start[1] + g[2] * start[2] - g[3]
        at_end = g[0] * end[0] + g[1] * end[1] + g[2] * end[2] - g[3]
        if at_end < 0.0:
            share = min(share, at_start / (at_start - at_end))
    return share
