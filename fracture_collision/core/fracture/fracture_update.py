"""The field update of a fracture: crack polygons, masses, boxes, cells and sampling gaps of the fragments.

Only the tetrahedra of the broken fragment are touched (Glondu 2014, section 4.2: "locally update where needed"):
regions fit across faces, and neighbours keep theirs. The exact field stores no distances, so nothing is propagated.

The border of a fragment's region is closed: its share of the old surface, and the interfaces within tetrahedra. The
division of a tetrahedron is looked up (cut_patterns.py): a branch would be unpredictable, and each misprediction wastes
half a tetrahedron's work.
"""

from __future__ import annotations

import math

from fracture_collision.core.fracture.corner_samples import add_corners, room_for_corners
from fracture_collision.core.fracture.cut_hub import load_crossings, place_hub
from fracture_collision.core.fracture.cut_patterns import (
    CUT_COUNT,
    CUT_EDGES,
    FACE_NODES,
    FAN,
    FAN_COUNT,
    GROUP,
    PART_COUNT,
    PART_OF_SIDE,
    PARTS,
    PATTERN_OF_CUTS,
    PATTERN_OF_SIDE,
    PIECE_COUNT,
    PIECES,
    SECTION,
    SECTION_COUNT,
    SOLID_COUNT,
    SOLIDS,
)
from fracture_collision.core.fracture.surface_rows import (
    SurfaceRows,
    gap_of_triangle,
    grow_by_box,
    is_residue,
    measure_triangle,
    write_fan_row,
    write_row,
)
from fracture_collision.core.memory.compiled import inlined_kernel, kernel, query_kernel
from fracture_collision.core.memory.pools import (
    BACK,
    BACK_SIDE,
    FANNED,
    FRONT,
    FRONT_SIDE,
    LABELS,
    OLD_FACE,
    OWNER,
    PARTED,
    PLANE,
    ROW,
)
from fracture_collision.core.mesh.closest_point import triangle_normal
from fracture_collision.core.mesh.cut_tetrahedron import (
    CUT,
    DIVIDED,
    EDGE_FIRST,
    EDGE_SECOND,
    FACE_VERTICES,
    SINGULAR,
    point_on_edge,
)
from fracture_collision.core.mesh.moments import add_row, tetrahedron_terms
from fracture_collision.core.mesh.occupancy import cells_of_boxes
from fracture_collision.core.mesh.sample_numbers import NewSamples


@kernel
def rebuild_surfaces(
    mesh, body, fragment, parent, touched, low, high, begin, room, words, moments, gaps, work
):  # fmt: skip
    """Surfaces of fragments low .. high - 1, into which `parent` broke: polygons, moments, boxes, gaps, corners, cells.

    touched: of touched_tetrahedra; `begin`: number of polygon rows in BodyPool; `room`: the free SurfaceRows behind
    them, at least touched.room; `words`: number of words of the occupancy.

    Returns (rows written, NewSamples at corners, words to append).
    """
    k = fragment.mesh[parent]
    shifts = fragment.node_shift[parent], fragment.tet_shift[parent], fragment.edge_shift[parent]
    boxes = fragment.box
    reaches = boxes[low:high].copy()
    parted = _rebuild_parted(
        mesh, body, shifts[0], shifts[1], shifts[2], k, touched, low, high, begin, room, moments, boxes, reaches, gaps,
        work,
    )  # fmt: skip
    most = 0
    for t in touched.cut:
        most += touched.kinds[t - touched.first] == DIVIDED
    new = room_for_corners(most)
    rest = SurfaceRows(room.triangles[parted:], room.faces[parted:], room.sides[parted:])
    fanned, found = _rebuild_fanned(
        mesh, body, shifts[0], shifts[1], shifts[2], touched, low, high, begin + parted, rest, moments, boxes, reaches,
        gaps, mesh.first[k], new, work,
    )  # fmt: skip
    corners = NewSamples(new.points[:found], new.samples[:found], new.parents[:found], new.parts[:found])
    more = cells_of_boxes(reaches, mesh.grid[k], mesh.grid_dims[k], words, fragment.cells[low:high])
    return parted + fanned, corners, more


@query_kernel
def _rebuild_parted(
    mesh, body, node_shift, tet_shift, edge_shift, k, touched, low, high, first_polygon, out, moments, boxes, reaches,
    gaps, work,
):  # fmt: skip
    """Polygons of the tetrahedra in touched.cut that one plane divides; marks the other CUT tetrahedra as DIVIDED.

    touched: of the nodes of fragments low .. high - 1. Labels, planes and crossings in `body` are those after the
    fracture. Writes body.regions and cut_count (rows of `out` count from `first_polygon` on; mesh `k`); adds to
    the new fragments' `moments` (F, 10); grows `boxes` (F, 6), `gaps` (F,), and `reaches` (high - low, 6): the boxes of
    all cut tetrahedra that hold a new fragment. Returns the number of rows of `out` written.
    """
    written = 0
    for t in touched.cut:
        if touched.kinds[t - touched.first] != CUT:
            continue
        side, first, second = _load_sides(mesh, body, node_shift, t, work)
        same, nx, ny, nz, offset = _load_plane(mesh, body, edge_shift, t, side, work)
        if not same and SECTION_COUNT[side] == 2:
            # two nodes against two, and their planes differ
            touched.kinds[t - touched.first] = DIVIDED
            continue
        _grow_reach(mesh, t, first, low, high, reaches)
        _grow_reach(mesh, t, second, low, high, reaches)
        begin = written
        written = _write_section(
            work, side, first, second, same, nx, ny, nz, offset, out, written, boxes[first], boxes[second], gaps
        )
        smaller = _add_sides(mesh, t, work, side, first, second, low, high, moments)
        # a section that is only rounding leaves nothing to the smaller part
        body.regions[t + tet_shift, OWNER] = PARTED if written > begin else second if smaller == 0 else first
        if written > begin:
            _put_plane(mesh.grid[k], out, begin, body.regions[t + tet_shift], body.region_planes[t + tet_shift])
            written = _write_old_faces(mesh, t, work, PATTERN_OF_SIDE[side], out, written, gaps)
        body.regions[t + tet_shift, ROW], body.cut_count[t + tet_shift] = first_polygon + begin, written - begin
    return written


@query_kernel
def _rebuild_fanned(
    mesh, body, node_shift, tet_shift, edge_shift, touched, low, high, first_polygon, out, moments, boxes, reaches,
    gaps, first, corners, work,
):  # fmt: skip
    """_rebuild_parted for tetrahedra divided about their hub.

    Writes their corners to `corners`, NewSamples; first (5,): MeshPool.first of the mesh. Returns the numbers of rows
    of `out` and of corners written.
    """
    written = found = 0
    for t in touched.cut:
        if touched.kinds[t - touched.first] != DIVIDED:
            continue
        begin = written
        pattern = _load_pattern(mesh, body, node_shift, t, work)
        oldest, newest = load_crossings(mesh, body, edge_shift, t, pattern, work)
        place_hub(mesh, body, edge_shift, t, pattern, oldest, newest, work)
        for i in range(4):
            if GROUP[pattern, i] == i:
                _grow_reach(mesh, t, work.labels[i], low, high, reaches)
        _add_parts(work, pattern, low, high, moments)
        written = _write_fan(work, pattern, out, written, boxes, gaps)
        written = _write_old_faces(mesh, t, work, pattern, out, written, gaps)
        found = add_corners(mesh, first, t, work, pattern, oldest == newest, low, high, corners, found)
        body.regions[t + tet_shift, OWNER] = FANNED
        body.regions[t + tet_shift, ROW], body.cut_count[t + tet_shift] = first_polygon + begin, written - begin
        for i in range(4):
            body.regions[t + tet_shift, LABELS + i] = work.labels[i]
    return written, found


@inlined_kernel
def _put_plane(grid, out, row, region, plane):
    """Copy a tetrahedron's dividing plane, a row of `out`, to its own row."""
    region[FRONT], region[BACK] = out.sides[row, FRONT_SIDE], out.sides[row, BACK_SIDE]
    p = out.faces[row]
    plane[PLANE], plane[PLANE + 1], plane[PLANE + 2] = p[0], p[1], p[2]
    plane[PLANE + 3] = p[3] - (p[0] * grid[0] + p[1] * grid[1] + p[2] * grid[2])


@inlined_kernel
def _load_nodes(mesh, body, node_shift, t, work):
    v = mesh.tetrahedra[t]
    for i in range(4):
        work.labels[i] = body.node_fragment[v[i] + node_shift]
        p = mesh.nodes[v[i]]
        work.points[i, 0], work.points[i, 1], work.points[i, 2] = p[0], p[1], p[2]


@inlined_kernel
def _load_sides(mesh, body, node_shift, t, work):
    """(bit mask of the first fragment's nodes; first fragment; second) of a tetrahedron of two, the smaller row first.
    """
    _load_nodes(mesh, body, node_shift, t, work)
    a, b, c, d = work.labels[0], work.labels[1], work.labels[2], work.labels[3]
    low, high = min(a, b, c, d), max(a, b, c, d)
    return (a == low) + 2 * (b == low) + 4 * (c == low) + 8 * (d == low), low, high


@inlined_kernel
def _load_pattern(mesh, body, node_shift, t, work):
    _load_nodes(mesh, body, node_shift, t, work)
    a, b, c, d = work.labels[0], work.labels[1], work.labels[2], work.labels[3]
    return PATTERN_OF_CUTS[
        (a != b) + 2 * (a != c) + 4 * (a != d) + 8 * (b != c) + 16 * (b != d) + 32 * (c != d)
    ]  # fmt: skip


@inlined_kernel
def _load_plane(mesh, body, edge_shift, t, side, work):
    """Load the crossings of a tetrahedron of two fragments; returns whether its planes are bitwise equal, and the plane
    out of the first.
    """
    v = mesh.tetrahedra[t]
    pattern = PATTERN_OF_SIDE[side]
    same, nx, ny, nz, offset = True, 0.0, 0.0, 0.0, 0.0
    for c in range(CUT_COUNT[pattern]):
        e = CUT_EDGES[pattern, c]
        edge = mesh.tetrahedron_edges[t, e] + edge_shift
        i = EDGE_FIRST[e]
        a, b = v[i], v[EDGE_SECOND[e]]
        point_on_edge(mesh.nodes, min(a, b), max(a, b), body.edge_share[edge], work.crossings[e])
        # planes point away from the smaller node
        sign = 1.0 if (a < b) == ((side >> i & 1) == 1) else -1.0
        p = body.planes[body.edge_plane[edge]]
        px, py, pz, h = sign * p[0], sign * p[1], sign * p[2], sign * p[3]
        if c == 0:
            nx, ny, nz, offset = px, py, pz, h
        same = same and nx == px and ny == py and nz == pz and offset == h
    return same, nx, ny, nz, offset


@inlined_kernel
def _grow_reach(mesh, t, label, low, high, reaches):
    if low <= label < high:
        b = mesh.boxes[t]
        grow_by_box(reaches[label - low], (b[0], b[1], b[2]), (b[3], b[4], b[5]))


@inlined_kernel
def _write_section(work, side, first, second, same, nx, ny, nz, offset, out, written, box, other_box, gaps):
    """Append the section between the two fragments; grows their boxes and gaps. Returns the end row."""
    points, pattern = work.points, PATTERN_OF_SIDE[side]
    longest = 0.0
    for k in range(SECTION_COUNT[side]):
        a, b, c = points[SECTION[side, k, 0]], points[SECTION[side, k, 1]], points[SECTION[side, k, 2]]
        mx, my, mz, ab, ac, bc = measure_triangle(a, b, c)
        longest = max(longest, ab, ac, bc)
        if not same:
            # a lone node: the plane through the three crossings
            nx, ny, nz, offset = _plane_of_lone_node(work, side, mx, my, mz, max(ab, ac))
        if not is_residue(mx, my, mz, ab, ac):
            if PART_OF_SIDE[side] == 1:
                b, c = c, b
            write_row(a, b, c, nx, ny, nz, offset, first, second, 0, out, written)
            written += 1
    p = work.crossings[CUT_EDGES[pattern, 0]]
    lx, ly, lz = p[0], p[1], p[2]
    hx, hy, hz = lx, ly, lz
    for c in range(1, CUT_COUNT[pattern]):
        p = work.crossings[CUT_EDGES[pattern, c]]
        lx, ly, lz = min(lx, p[0]), min(ly, p[1]), min(lz, p[2])
        hx, hy, hz = max(hx, p[0]), max(hy, p[1]), max(hz, p[2])
    grow_by_box(box, (lx, ly, lz), (hx, hy, hz))
    grow_by_box(other_box, (lx, ly, lz), (hx, hy, hz))
    gap = gap_of_triangle(longest, longest, longest, 3)
    gaps[first], gaps[second] = max(gaps[first], gap), max(gaps[second], gap)
    return written


@inlined_kernel
def _plane_of_lone_node(work, side, mx, my, mz, longest):
    """The plane of the section out of the first fragment; m, `longest`: the section's normal and the longer of two
    squared sides, from measure_triangle.
    """
    points = work.points
    a = points[SECTION[side, 0, 0]]
    length = math.sqrt(mx * mx + my * my + mz * mz)
    if length <= SINGULAR * longest:
        # the crossings nearly coincide: a node with almost no volume, cut off parallel to the face
        f = FACE_VERTICES[SOLIDS[side, 0, 0]]
        mx, my, mz, _, _, _ = measure_triangle(points[f[0]], points[f[1]], points[f[2]])
        length = math.sqrt(mx * mx + my * my + mz * mz)
    sign = (1.0 if PART_OF_SIDE[side] == 0 else -1.0) / length
    return sign * mx, sign * my, sign * mz, sign * (mx * a[0] + my * a[1] + mz * a[2])


@inlined_kernel
def _add_sides(mesh, t, work, side, first, second, low, high, moments):
    """Add the moments of both parts of a tetrahedron to those of its two fragments that are in low .. high - 1.

    Returns which fragment has the smaller part, 0 or 1.
    """
    points = work.points
    s0 = s1 = s2 = s3 = s4 = s5 = s6 = s7 = s8 = s9 = 0.0
    for k in range(SOLID_COUNT[side]):
        row = SOLIDS[side, k]
        a, b, c, d = points[row[0]], points[row[1]], points[row[2]], points[row[3]]
        nx, ny, nz, _, _, _ = measure_triangle(a, b, c)
        if not nx * (d[0] - a[0]) + ny * (d[1] - a[1]) + nz * (d[2] - a[2]) > 0.0:
            b, c = c, b
        m = tetrahedron_terms(a[0], a[1], a[2], b[0], b[1], b[2], c[0], c[1], c[2], d[0], d[1], d[2])
        s0, s1, s2, s3, s4 = s0 + m[0], s1 + m[1], s2 + m[2], s3 + m[3], s4 + m[4]
        s5, s6, s7, s8, s9 = s5 + m[5], s6 + m[6], s7 + m[7], s8 + m[8], s9 + m[9]
    part = PART_OF_SIDE[side]
    own, rest = (first, second) if part == 0 else (second, first)
    w = mesh.moments[t]
    if low <= own < high:
        add_row(moments[own], s0, s1, s2, s3, s4, s5, s6, s7, s8, s9)
    if low <= rest < high:
        add_row(
            moments[rest], w[0] - s0, w[1] - s1, w[2] - s2, w[3] - s3, w[4] - s4, w[5] - s5, w[6] - s6, w[7] - s7,
            w[8] - s8, w[9] - s9,
        )  # fmt: skip
    return part if s0 < 0.5 * w[0] else 1 - part


@inlined_kernel
def _add_parts(work, pattern, low, high, moments):
    """Add the moments of all parts between hub and faces to those of fragments low .. high - 1."""
    o, points = work.hub, work.points
    for k in range(PART_COUNT[pattern]):
        row = PARTS[pattern, k]
        label = work.labels[row[3]]
        if low <= label < high:
            a, b, c = points[row[0]], points[row[1]], points[row[2]]
            m = tetrahedron_terms(o[0], o[1], o[2], a[0], a[1], a[2], b[0], b[1], b[2], c[0], c[1], c[2])
            add_row(moments[label], m[0], m[1], m[2], m[3], m[4], m[5], m[6], m[7], m[8], m[9])


@inlined_kernel
def _write_fan(work, pattern, out, written, boxes, gaps):
    """Append the triangles between hub and faces, each between two fragments; grows their boxes and gaps."""
    a, points = work.hub, work.points
    for k in range(FAN_COUNT[pattern]):
        row = FAN[pattern, k]
        b, c = points[row[0]], points[row[1]]
        front, back = work.labels[row[3]], work.labels[row[4]]
        nx, ny, nz, ab, ac, bc = measure_triangle(a, b, c)
        gap = gap_of_triangle(ab, ac, bc, row[2])
        low = min(a[0], b[0], c[0]), min(a[1], b[1], c[1]), min(a[2], b[2], c[2])
        high = max(a[0], b[0], c[0]), max(a[1], b[1], c[1]), max(a[2], b[2], c[2])
        grow_by_box(boxes[front], low, high)
        grow_by_box(boxes[back], low, high)
        gaps[front], gaps[back] = max(gaps[front], gap), max(gaps[back], gap)
        write_fan_row(a, b, c, nx, ny, nz, ab, ac, front, back, row[5], out, written + k)
    return written + FAN_COUNT[pattern]


@inlined_kernel
def _write_old_faces(mesh, t, work, pattern, out, written, gaps):
    """Append the fragments' shares of the tetrahedron's faces of the old surface."""
    points = work.points
    for face in range(4):
        if mesh.neighbours[t, face] >= 0:
            continue
        f = FACE_NODES[pattern, face]
        a, b, c = points[f[0]], points[f[1]], points[f[2]]
        nx, ny, nz = triangle_normal(a[0], a[1], a[2], b[0], b[1], b[2], c[0], c[1], c[2])
        offset = nx * a[0] + ny * a[1] + nz * a[2]
        for k in range(PIECE_COUNT[pattern, face]):
            row = PIECES[pattern, face, k]
            a, b, c, label = points[row[0]], points[row[1]], points[row[2]], work.labels[row[4]]
            mx, my, mz, ab, ac, bc = measure_triangle(a, b, c)
            gaps[label] = max(gaps[label], gap_of_triangle(ab, ac, bc, row[3]))
            if not is_residue(mx, my, mz, ab, ac):
                write_row(a, b, c, nx, ny, nz, offset, label, -1, OLD_FACE + face, out, written)
                written += 1
    return written
