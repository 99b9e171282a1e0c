"""Mass moments of the parts of a cut tetrahedron."""

from __future__ import annotations

from fracture_collision.core.fracture.cut_patterns import PART_COUNT, PART_OF_SIDE, PARTS, SOLID_COUNT, SOLIDS
from fracture_collision.core.fracture.surface_rows import measure_triangle
from fracture_collision.core.memory.compiled import query_kernel
from fracture_collision.core.mesh.cut_tetrahedron import NO_VOLUME
from fracture_collision.core.mesh.moments import add_row, tetrahedron_terms


@query_kernel
def add_sides(mesh, t, work, side, pair, broken, moments, has_section):
    """Add the moments of both parts of a tetrahedron to those of its two fragments, a `pair`, that are new.

    Returns which fragment has the smaller part, 0 or 1. -1, and nothing added: there is a section, but the part that it
    cuts off has no volume.
    """
    points = work.points
    s0 = s1 = s2 = s3 = s4 = s5 = s6 = s7 = s8 = s9 = 0.0
    for k in range(SOLID_COUNT[side]):
        row = SOLIDS[side, k]
        a, b, c, d = points[row[0]], points[row[1]], points[row[2]], points[row[3]]
        nx, ny, nz, _, _, _ = measure_triangle(a, b, c)
        if not nx * (d[0] - a[0]) + ny * (d[1] - a[1]) + nz * (d[2] - a[2]) > 0.0:
            b, c = c, b
        m = tetrahedron_terms(a, b, c, d, mesh.grid[broken.mesh])
        s0, s1, s2, s3, s4 = s0 + m[0], s1 + m[1], s2 + m[2], s3 + m[3], s4 + m[4]
        s5, s6, s7, s8, s9 = s5 + m[5], s6 + m[6], s7 + m[7], s8 + m[8], s9 + m[9]
    w = mesh.moments[t]
    # a lone node's part is the one cut off; the rest without volume means that the section is a whole face
    smaller = s0 if SOLID_COUNT[side] == 1 else min(s0, w[0] - s0)
    if has_section and smaller <= NO_VOLUME * w[0]:
        return -1
    part = PART_OF_SIDE[side]
    own, rest = (pair[0], pair[1]) if part == 0 else (pair[1], pair[0])
    if broken.first <= own < broken.end:
        add_row(moments[own], s0, s1, s2, s3, s4, s5, s6, s7, s8, s9)
    if broken.first <= rest < broken.end:
        add_row(
            moments[rest], w[0] - s0, w[1] - s1, w[2] - s2, w[3] - s3, w[4] - s4, w[5] - s5, w[6] - s6, w[7] - s7,
            w[8] - s8, w[9] - s9,
        )  # fmt: skip
    return part if s0 < 0.5 * w[0] else 1 - part


@query_kernel
def add_parts(mesh, work, pattern, broken, moments):
    """Add the moments of all parts between hub and faces to those of the new fragments."""
    o, points = work.hub, work.points
    for k in range(PART_COUNT[pattern]):
        row = PARTS[pattern, k]
        label = work.labels[row[3]]
        if broken.first <= label < broken.end:
            a, b, c = points[row[0]], points[row[1]], points[row[2]]
            m = tetrahedron_terms(o, a, b, c, mesh.grid[broken.mesh])
            add_row(moments[label], m[0], m[1], m[2], m[3], m[4], m[5], m[6], m[7], m[8], m[9])
