"""What a fracture changes in the field: crack polygons, masses, boxes, cells and sampling gaps of the fragments.

Only the tetrahedra of the fragment that broke are touched (Glondu 2014, section 4.2: "locally update where needed"):
regions fit over faces, and what a neighbour has it keeps. The exact field keeps no distances, so nothing is propagated.

The border of a fragment's region is closed: its share of the old surface, and the interfaces within tetrahedra.
"""

from __future__ import annotations

import math

from fracture_collision.core.closest_point import triangle_normal
from fracture_collision.core.compiled import inlined_kernel, query_kernel
from fracture_collision.core.cut_tetrahedron import (
    CUT,
    DIVIDED,
    EDGE_BETWEEN,
    EDGE_FIRST,
    EDGE_SECOND,
    FACE_VERTICES,
    LONE,
    load_cut,
    place_hub,
)
from fracture_collision.core.moments import add_tetrahedron
from fracture_collision.core.pools import FANNED, OLD_FACE, PARTED
from fracture_collision.core.surface_rows import (
    gap_of_triangle,
    grow,
    longest_side_squared,
    write_fan_row,
    write_row,
)

# Rows of one tetrahedron: three a face between fragments, and as many or twice as many pieces of old faces.
MOST_ROWS = 12 + 24


@query_kernel
def rebuild_lone(mesh, body, node_shift, tet_shift, touched, moments, gaps):
    """Tetrahedra that one fragment has alone: owner, moments, gaps of the old surface.

    `touched`: with kinds (touched_tetrahedra.py). Adds to `moments` (F, 10) of the new fragments, grows `gaps` (F,).
    Three passes rather than one (rebuild_parted, rebuild_fanned): the code of all kinds together does not fit the
    instruction cache.
    """
    for t in touched.rows:
        if touched.kinds[t - touched.first] != LONE:
            continue
        label = body.node_fragment[mesh.tetrahedra[t, 0] + node_shift]
        body.tet_fragment[t + tet_shift], body.cut_count[t + tet_shift] = label, 0
        for d in range(10):
            moments[label, d] += mesh.moments[t, d]
        for face in range(4):
            if mesh.neighbours[t, face] < 0:
                v = mesh.tetrahedra[t]
                i, j, k = FACE_VERTICES[face, 0], FACE_VERTICES[face, 1], FACE_VERTICES[face, 2]
                longest = longest_side_squared(mesh.nodes[v[i]], mesh.nodes[v[j]], mesh.nodes[v[k]])
                gaps[label] = max(gaps[label], math.sqrt(longest / 3.0))


@query_kernel
def rebuild_parted(
    mesh, body, node_shift, tet_shift, edge_shift, touched, low, high, start, first_polygon, out, moments, boxes,
    reaches, gaps, work,
):  # fmt: skip
    """Polygons of the tetrahedra in touched.rows[start :] that one plane parts, as far as `out` has room; of the others
    that are CUT it says that they are DIVIDED.

    touched: of the nodes of fragments low .. high - 1. Labels, planes and crossings in `body` are those after the
    fracture. Writes body.tet_fragment, cut_begin and cut_count (rows of `out` count from `first_polygon` on); adds to
    the new fragments' `moments` (F, 10); grows `boxes` (F, 6), `gaps` (F,), and `reaches` (high - low, 6): the boxes of
    all cut tetrahedra that hold a new fragment. Returns (start of the next call, rows written).
    """
    written = 0
    for at in range(start, len(touched.rows)):
        if len(out.front) - written < MOST_ROWS:
            return at, written
        t = touched.rows[at]
        if touched.kinds[t - touched.first] != CUT:
            continue
        begin = written
        if not load_cut(mesh, body, node_shift, edge_shift, t, work):
            touched.kinds[t - touched.first] = DIVIDED
            continue
        _grow_reaches(mesh, work, t, low, high, reaches)
        written = _write_section(work, out, written, boxes, gaps)
        smaller = _add_parts(mesh, t, work, low, high, moments)
        # a section that is rounding alone leaves the smaller part nothing
        body.tet_fragment[t + tet_shift] = PARTED if written > begin else work.sides[1 - smaller]
        for face in range(4):
            if mesh.neighbours[t, face] < 0 and written > begin:
                written = _write_old_face(work, face, out, written, gaps)
        body.cut_begin[t + tet_shift], body.cut_count[t + tet_shift] = first_polygon + begin, written - begin
    return len(touched.rows), written


@query_kernel
def rebuild_fanned(
    mesh, body, node_shift, tet_shift, edge_shift, touched, low, high, start, first_polygon, out, moments, boxes,
    reaches, gaps, work,
):  # fmt: skip
    """The same for tetrahedra that are divided about their hub."""
    written = 0
    for at in range(start, len(touched.rows)):
        if len(out.front) - written < MOST_ROWS:
            return at, written
        t = touched.rows[at]
        if touched.kinds[t - touched.first] != DIVIDED:
            continue
        begin = written
        load_cut(mesh, body, node_shift, edge_shift, t, work)
        place_hub(mesh, t, work)
        _grow_reaches(mesh, work, t, low, high, reaches)
        for face in range(4):
            _add_sector(work, face, low, high, moments)
            written = _write_sector(work, face, out, written, boxes, gaps)
        for face in range(4):
            if mesh.neighbours[t, face] < 0:
                written = _write_old_face(work, face, out, written, gaps)
        body.tet_fragment[t + tet_shift] = FANNED
        body.cut_begin[t + tet_shift], body.cut_count[t + tet_shift] = first_polygon + begin, written - begin
    return len(touched.rows), written


@inlined_kernel
def _grow_reaches(mesh, work, t, low, high, reaches):
    b = mesh.boxes[t]
    for i in range(4):
        label = work.labels[i]
        if low <= label < high:
            grow(reaches[label - low], b[0], b[1], b[2])
            grow(reaches[label - low], b[3], b[4], b[5])


@inlined_kernel
def _order_of_parts(work):
    """(nodes of the first side, local nodes): those of sides[0] ascending, then those of sides[1]."""
    a = b = c = d = -1
    first = 0
    for i in range(4):
        if work.labels[i] == work.sides[0]:
            a, b, c, d = (i, b, c, d) if first == 0 else (a, i, c, d) if first == 1 else (a, b, i, d)
            first += 1
    at = first
    for i in range(4):
        if work.labels[i] != work.sides[0]:
            a, b, c, d = (a, i, c, d) if at == 1 else (a, b, i, d) if at == 2 else (a, b, c, i)
            at += 1
    return first, a, b, c, d


@inlined_kernel
def _add_parts(mesh, t, work, low, high, moments):
    """Add the moments of both parts of a parted tetrahedron to those of fragments low .. high - 1 among its sides.

    Returns the index in `sides` of the smaller part.
    """
    x = work.crossings
    first, a, b, c, d = _order_of_parts(work)
    solid = work.moments[0]
    solid[:] = 0.0
    p = work.corners
    part = 0
    if first == 2:
        ac, ad, bc, bd = x[EDGE_BETWEEN[a, c]], x[EDGE_BETWEEN[a, d]], x[EDGE_BETWEEN[b, c]], x[EDGE_BETWEEN[b, d]]
        _add_solid(p[a], ac, ad, p[b], solid)
        _add_solid(ac, ad, p[b], bc, solid)
        _add_solid(ad, p[b], bc, bd, solid)
    else:
        lone = a if first == 1 else d
        part = 0 if first == 1 else 1
        f = FACE_VERTICES[lone]
        _add_solid(
            p[lone], x[EDGE_BETWEEN[lone, f[0]]], x[EDGE_BETWEEN[lone, f[1]]], x[EDGE_BETWEEN[lone, f[2]]], solid
        )
    own, rest = work.sides[part], work.sides[1 - part]
    if low <= own < high:
        for k in range(10):
            moments[own, k] += solid[k]
    if low <= rest < high:
        for k in range(10):
            moments[rest, k] += mesh.moments[t, k] - solid[k]
    return part if solid[0] < 0.5 * mesh.moments[t, 0] else 1 - part


@inlined_kernel
def _add_solid(a, b, c, d, solid):
    """Add the moments of a tetrahedron of either orientation."""
    ux, uy, uz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    vx, vy, vz = c[0] - a[0], c[1] - a[1], c[2] - a[2]
    nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    p, q = (b, c) if nx * (d[0] - a[0]) + ny * (d[1] - a[1]) + nz * (d[2] - a[2]) > 0.0 else (c, b)
    add_tetrahedron(a[0], a[1], a[2], p[0], p[1], p[2], q[0], q[1], q[2], d[0], d[1], d[2], solid)


@inlined_kernel
def _write_section(work, out, written, boxes, gaps):
    """Append what parts the two fragments; grows their boxes and gaps. Returns the row behind the last."""
    x = work.crossings
    first, a, b, c, d = _order_of_parts(work)
    low, high, n = work.sides[0], work.sides[1], work.plane
    if first == 2:
        # which way round follows from the order of the nodes: a tetrahedron is of positive volume
        p, q, r, s = x[EDGE_BETWEEN[a, c]], x[EDGE_BETWEEN[a, d]], x[EDGE_BETWEEN[b, d]], x[EDGE_BETWEEN[b, c]]
        if (a + b) % 2 == 0:
            q, s = s, q
        gap = max(gap_of_triangle(p, q, r, 3), gap_of_triangle(p, r, s, 3))
        written = write_row(p, q, r, n[0], n[1], n[2], n[3], low, high, 0, out, written)
        written = write_row(p, r, s, n[0], n[1], n[2], n[3], low, high, 0, out, written)
    else:
        lone = a if first == 1 else d
        f = FACE_VERTICES[lone]
        p, q, r = x[EDGE_BETWEEN[lone, f[0]]], x[EDGE_BETWEEN[lone, f[1]]], x[EDGE_BETWEEN[lone, f[2]]]
        if first == 3:
            q, r = r, q
        gap = gap_of_triangle(p, q, r, 3)
        written = write_row(p, q, r, n[0], n[1], n[2], n[3], low, high, 0, out, written)
    for e in range(6):
        if work.labels[EDGE_FIRST[e]] != work.labels[EDGE_SECOND[e]]:
            p = work.crossings[e]
            grow(boxes[low], p[0], p[1], p[2])
            grow(boxes[high], p[0], p[1], p[2])
    gaps[low], gaps[high] = max(gaps[low], gap), max(gaps[high], gap)
    return written


@inlined_kernel
def _lone_first(work, face):
    """(fragments in the face, its nodes): counter-clockwise from outside, of two fragments the lone node first."""
    i, j, k = FACE_VERTICES[face, 0], FACE_VERTICES[face, 1], FACE_VERTICES[face, 2]
    a, b, c = work.labels[i], work.labels[j], work.labels[k]
    if a == b and b == c:
        return 1, i, j, k
    if a == c:
        return 2, j, k, i
    if a == b:
        return 2, k, i, j
    return (2 if b == c else 3), i, j, k


@inlined_kernel
def _add_sector(work, face, low, high, moments):
    """Add the moments of the part between hub and face to those of its fragments among low .. high - 1."""
    x = work.crossings
    fragments, i, j, k = _lone_first(work, face)
    p = work.corners
    if fragments == 1:
        _add_part(work, p[i], p[j], p[k], work.labels[i], low, high, moments)
        return
    ij, ik = x[EDGE_BETWEEN[i, j]], x[EDGE_BETWEEN[i, k]]
    if fragments == 2:
        _add_part(work, p[i], ij, ik, work.labels[i], low, high, moments)
        _add_part(work, ij, p[j], p[k], work.labels[j], low, high, moments)
        _add_part(work, ij, p[k], ik, work.labels[j], low, high, moments)
        return
    m, jk = work.face_points[face], x[EDGE_BETWEEN[j, k]]
    _add_part(work, p[i], ij, m, work.labels[i], low, high, moments)
    _add_part(work, p[i], m, ik, work.labels[i], low, high, moments)
    _add_part(work, p[j], jk, m, work.labels[j], low, high, moments)
    _add_part(work, p[j], m, ij, work.labels[j], low, high, moments)
    _add_part(work, p[k], ik, m, work.labels[k], low, high, moments)
    _add_part(work, p[k], m, jk, work.labels[k], low, high, moments)


@inlined_kernel
def _add_part(work, a, b, c, label, low, high, moments):
    if low <= label < high:
        q = work.hub
        add_tetrahedron(q[0], q[1], q[2], a[0], a[1], a[2], b[0], b[1], b[2], c[0], c[1], c[2], moments[label])


@inlined_kernel
def _write_sector(work, face, out, written, boxes, gaps):
    """Append what parts the fragments between hub and face."""
    x = work.crossings
    fragments, i, j, k = _lone_first(work, face)
    if fragments == 2:
        return _write_fan_row(work, work.hub, x[EDGE_BETWEEN[i, k]], x[EDGE_BETWEEN[i, j]], 2, i, j, face, out, written,
                              boxes, gaps)  # fmt: skip
    if fragments == 3:
        m = work.face_points[face]
        written = _write_fan_row(work, work.hub, m, x[EDGE_BETWEEN[i, j]], 1, i, j, face, out, written, boxes, gaps)
        written = _write_fan_row(work, work.hub, m, x[EDGE_BETWEEN[j, k]], 1, j, k, face, out, written, boxes, gaps)
        written = _write_fan_row(work, work.hub, m, x[EDGE_BETWEEN[k, i]], 1, k, i, face, out, written, boxes, gaps)
    return written


@inlined_kernel
def _write_fan_row(work, a, b, c, samples, i, j, face, out, written, boxes, gaps):
    """Append the triangle (a, b, c) between the fragments of nodes i and j; its last `samples` corners are samples."""
    gap = gap_of_triangle(a, b, c, samples)
    for side in range(2):
        label = work.labels[i] if side == 0 else work.labels[j]
        gaps[label] = max(gaps[label], gap)
        grow(boxes[label], a[0], a[1], a[2])
        grow(boxes[label], b[0], b[1], b[2])
        grow(boxes[label], c[0], c[1], c[2])
    return write_fan_row(a, b, c, work.labels[i], work.labels[j], face, out, written)


@inlined_kernel
def _write_old_face(work, face, out, written, gaps):
    """Append the fragments' shares of a face of the old surface."""
    x = work.crossings
    fragments, i, j, k = _lone_first(work, face)
    p = work.corners
    a, b, c = p[i], p[j], p[k]
    nx, ny, nz = triangle_normal(a[0], a[1], a[2], b[0], b[1], b[2], c[0], c[1], c[2])
    plane = nx, ny, nz, nx * a[0] + ny * a[1] + nz * a[2]
    own, second, third, kind = work.labels[i], work.labels[j], work.labels[k], OLD_FACE + face
    if fragments == 1:
        return _write_piece(a, b, c, 3, plane, own, kind, out, written, gaps)
    ij, ik = x[EDGE_BETWEEN[i, j]], x[EDGE_BETWEEN[i, k]]
    if fragments == 2:
        written = _write_piece(a, ij, ik, 3, plane, own, kind, out, written, gaps)
        written = _write_piece(ij, b, c, 3, plane, second, kind, out, written, gaps)
        return _write_piece(ij, c, ik, 3, plane, second, kind, out, written, gaps)
    m, jk = work.face_points[face], x[EDGE_BETWEEN[j, k]]
    written = _write_piece(m, a, ij, 2, plane, own, kind, out, written, gaps)
    written = _write_piece(m, ik, a, 2, plane, own, kind, out, written, gaps)
    written = _write_piece(m, b, jk, 2, plane, second, kind, out, written, gaps)
    written = _write_piece(m, ij, b, 2, plane, second, kind, out, written, gaps)
    written = _write_piece(m, c, ik, 2, plane, third, kind, out, written, gaps)
    return _write_piece(m, jk, c, 2, plane, third, kind, out, written, gaps)


@inlined_kernel
def _write_piece(a, b, c, samples, plane, label, kind, out, written, gaps):
    gaps[label] = max(gaps[label], gap_of_triangle(a, b, c, samples))
    return write_row(a, b, c, plane[0], plane[1], plane[2], plane[3], label, -1, kind, out, written)
