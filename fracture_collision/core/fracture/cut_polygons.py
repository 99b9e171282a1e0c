"""Polygons of a cut tetrahedron: the section between two fragments, the fan about a hub, shares of the old surface."""

from __future__ import annotations

import math

from fracture_collision.core.fracture.cut_patterns import (
    CUT_COUNT,
    CUT_EDGES,
    FACE_NODES,
    FAN,
    FAN_COUNT,
    PART_OF_SIDE,
    PATTERN_OF_SIDE,
    PIECE_COUNT,
    PIECES,
    SECTION,
    SECTION_COUNT,
    SOLIDS,
)
from fracture_collision.core.fracture.surface_rows import (
    gap_of_triangle,
    grow_by_box,
    has_no_area,
    is_residue,
    measure_triangle,
    write_fan_row,
    write_row,
)
from fracture_collision.core.memory.compiled import query_kernel
from fracture_collision.core.memory.pools import BACK_VOID, FRONT_VOID, OLD_FACE
from fracture_collision.core.mesh.closest_point import triangle_normal
from fracture_collision.core.mesh.cut_tetrahedron import FACE_VERTICES, SINGULAR


@query_kernel
def write_section(work, side, pair, plane, out, written, sums):
    """Append the section between the two fragments of a `pair`; grows their boxes and gaps. Returns the end row.

    plane: of load_plane.
    """
    first, second = pair
    same, of_both = plane
    points, pattern = work.points, PATTERN_OF_SIDE[side]
    longest = 0.0
    for k in range(SECTION_COUNT[side]):
        a, b, c = points[SECTION[side, k, 0]], points[SECTION[side, k, 1]], points[SECTION[side, k, 2]]
        mx, my, mz, ab, ac, bc = measure_triangle(a, b, c)
        longest = max(longest, ab, ac, bc)
        its_plane = of_both
        if not same:
            # a lone node: the plane through the three crossings
            its_plane = _plane_of_lone_node(work, side, mx, my, mz, max(ab, ac))
        if not is_residue(mx, my, mz, ab, ac):
            if PART_OF_SIDE[side] == 1:
                b, c = c, b
            write_row((a, b, c), its_plane, (first, second, 0, 0), out, written)
            written += 1
    p = work.crossings[CUT_EDGES[pattern, 0]]
    lx, ly, lz = p[0], p[1], p[2]
    hx, hy, hz = lx, ly, lz
    for c in range(1, CUT_COUNT[pattern]):
        p = work.crossings[CUT_EDGES[pattern, c]]
        lx, ly, lz = min(lx, p[0]), min(ly, p[1]), min(lz, p[2])
        hx, hy, hz = max(hx, p[0]), max(hy, p[1]), max(hz, p[2])
    grow_by_box(sums.boxes[first], (lx, ly, lz), (hx, hy, hz))
    grow_by_box(sums.boxes[second], (lx, ly, lz), (hx, hy, hz))
    gap = gap_of_triangle(longest, longest, longest, 3)
    gaps = sums.gaps
    gaps[first], gaps[second] = max(gaps[first], gap), max(gaps[second], gap)
    return written


@query_kernel
def _plane_of_lone_node(work, side, mx, my, mz, longest):
    """Plane (nx, ny, nz, offset) of the section of a tetrahedron with a lone node, out of the first fragment.

    (mx, my, mz): the section's normal [m2]; longest [m2]: the longer of two squared sides; both from measure_triangle.
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


@query_kernel
def write_fan(work, pattern, out, written, sums):
    """Append the triangles between hub and faces, each between two fragments; grows their boxes and gaps."""
    a, points, boxes, gaps = work.hub, work.points, sums.boxes, sums.gaps
    for k in range(FAN_COUNT[pattern]):
        row = FAN[pattern, k]
        b, c = points[row[0]], points[row[1]]
        front, back = work.labels[row[3]], work.labels[row[4]]
        measures = measure_triangle(a, b, c)
        gap = gap_of_triangle(measures[3], measures[4], measures[5], row[2])
        low = min(a[0], b[0], c[0]), min(a[1], b[1], c[1]), min(a[2], b[2], c[2])
        high = max(a[0], b[0], c[0]), max(a[1], b[1], c[1]), max(a[2], b[2], c[2])
        grow_by_box(boxes[front], low, high)
        grow_by_box(boxes[back], low, high)
        gaps[front], gaps[back] = max(gaps[front], gap), max(gaps[back], gap)
        void = FRONT_VOID * has_no_area(points[row[3]], b, c) + BACK_VOID * has_no_area(points[row[4]], b, c)
        write_fan_row((a, b, c), measures, (front, back, row[5], void), out, written + k)
    return written + FAN_COUNT[pattern]


@query_kernel
def write_old_faces(mesh, t, work, pattern, out, written, gaps):
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
                write_row((a, b, c), (nx, ny, nz, offset), (label, -1, OLD_FACE + face, 0), out, written)
                written += 1
    return written
