"""The field update of a fracture: crack polygons, masses, boxes, cells and sampling gaps of the fragments.

Only the tetrahedra of the broken fragment are touched (Glondu 2014, section 4.2: "locally update where needed"):
regions fit across faces, and neighbours keep theirs. The exact field stores no distances, so nothing is propagated.

The border of a fragment's region is closed: its share of the old surface, and the interfaces within tetrahedra. The
division of a tetrahedron is looked up (cut_patterns.py): a branch would be unpredictable, and each misprediction wastes
half a tetrahedron's work.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fracture_collision.core.fracture.corner_samples import add_corners, room_for_corners
from fracture_collision.core.fracture.cut_hub import load_crossings, place_hub
from fracture_collision.core.fracture.cut_loading import load_pattern, load_plane, load_sides
from fracture_collision.core.fracture.cut_moments import add_parts, add_sides
from fracture_collision.core.fracture.cut_patterns import GROUP, PATTERN_OF_SIDE, SECTION_COUNT
from fracture_collision.core.fracture.cut_polygons import write_fan, write_old_faces, write_section
from fracture_collision.core.fracture.surface_rows import SurfaceRows, grow_by_box
from fracture_collision.core.memory.compiled import kernel, query_kernel
from fracture_collision.core.memory.pools import (
    BACK,
    BACK_SIDE,
    FANNED,
    FRONT,
    FRONT_SIDE,
    LABELS,
    OWNER,
    PARTED,
    PLANE,
    ROW,
)
from fracture_collision.core.mesh.cut_tetrahedron import CUT, DIVIDED
from fracture_collision.core.mesh.occupancy import cells_of_boxes
from fracture_collision.core.mesh.sample_numbers import NewSamples


class _Update(NamedTuple):
    """What the passes over cut tetrahedra write, besides their rows."""

    moments: np.ndarray  # (F, 10) float64: of Sums
    gaps: np.ndarray  # (F,) float64 [m], likewise
    boxes: np.ndarray  # (F, 6) float64 [m], likewise
    reaches: np.ndarray  # (n, 6) float64 [m]: boxes of all cut tetrahedra that hold each of the n new fragments


@kernel
def rebuild_surfaces(pools, broken, touched, room, words, sums, work):
    """Surfaces of the new fragments of a Broken: polygons, moments, boxes, gaps, corners, cells.

    touched: of touched_tetrahedra; room: the free SurfaceRows, at least touched.room; words: number of words of the
    occupancy; sums: Sums; work: CutScratch.

    Returns (rows written, NewSamples at corners, words to append).
    """
    mesh, body, fragment = pools.mesh, pools.body, pools.fragment
    low, high, k = broken.first, broken.end, broken.mesh
    reaches = sums.boxes[low:high].copy()
    update = _Update(sums.moments, sums.gaps, sums.boxes, reaches)
    parted = _rebuild_parted(mesh, body, broken, touched, room, update, work)
    most = 0
    for t in touched.cut:
        most += touched.kinds[t - touched.first] == DIVIDED
    new = room_for_corners(most)
    rest = SurfaceRows(room.first + parted, room.triangles[parted:], room.faces[parted:], room.sides[parted:])
    fanned, found = _rebuild_fanned(mesh, body, broken, touched, rest, update, new, work)
    corners = NewSamples(new.points[:found], new.samples[:found], new.parents[:found], new.parts[:found])
    more = cells_of_boxes(reaches, mesh.grid[k], mesh.grid_dims[k], words, fragment.cells[low:high])
    return parted + fanned, corners, more


@query_kernel
def _rebuild_parted(mesh, body, broken, touched, out, update, work):
    """Polygons of the tetrahedra in touched.cut that one plane divides; marks the other CUT tetrahedra as DIVIDED.

    Labels, planes and crossings in `body` are those after the fracture. Writes body.regions and cut_count, adds to
    `update`. Returns the number of rows of `out` written.
    """
    written, tet_shift = 0, broken.tet_shift
    for t in touched.cut:
        if touched.kinds[t - touched.first] != CUT:
            continue
        side, first, second = load_sides(mesh, body, broken, t, work)
        plane = load_plane(mesh, body, broken, t, side, work)
        if not plane[0] and SECTION_COUNT[side] == 2:
            # two nodes against two, and their planes differ
            touched.kinds[t - touched.first] = DIVIDED
            continue
        _grow_reach(mesh, t, first, broken, update.reaches)
        _grow_reach(mesh, t, second, broken, update.reaches)
        begin = written
        written = write_section(work, side, (first, second), plane, out, written, update)
        smaller = add_sides(mesh, t, work, side, (first, second), broken, update.moments, written > begin)
        if smaller < 0:
            # its plane is that of a face, and does not divide the face
            touched.kinds[t - touched.first], written = DIVIDED, begin
            continue
        # a section that is only rounding leaves nothing to the smaller part
        body.regions[t + tet_shift, OWNER] = PARTED if written > begin else second if smaller == 0 else first
        if written > begin:
            grid = mesh.grid[broken.mesh]
            _put_plane(grid, out, begin, body.regions[t + tet_shift], body.region_planes[t + tet_shift])
            written = write_old_faces(mesh, t, work, PATTERN_OF_SIDE[side], out, written, update.gaps)
        body.regions[t + tet_shift, ROW], body.cut_count[t + tet_shift] = out.first + begin, written - begin
    return written


@query_kernel
def _rebuild_fanned(mesh, body, broken, touched, out, update, corners, work):
    """_rebuild_parted for tetrahedra divided about their hub.

    Writes their corners to `corners`, NewSamples. Returns the numbers of rows of `out` and of corners written.
    """
    written, found, tet_shift = 0, 0, broken.tet_shift
    for t in touched.cut:
        if touched.kinds[t - touched.first] != DIVIDED:
            continue
        begin = written
        pattern = load_pattern(mesh, body, broken, t, work)
        oldest, newest = load_crossings(mesh, body, broken.edge_shift, t, pattern, work)
        place_hub(mesh, body, broken.edge_shift, t, pattern, oldest, newest, work)
        for i in range(4):
            if GROUP[pattern, i] == i:
                _grow_reach(mesh, t, work.labels[i], broken, update.reaches)
        add_parts(mesh, work, pattern, broken, update.moments)
        written = write_fan(work, pattern, out, written, update)
        written = write_old_faces(mesh, t, work, pattern, out, written, update.gaps)
        found = add_corners(mesh, broken, t, work, pattern, oldest == newest, corners, found)
        body.regions[t + tet_shift, OWNER] = FANNED
        body.regions[t + tet_shift, ROW], body.cut_count[t + tet_shift] = out.first + begin, written - begin
        for i in range(4):
            body.regions[t + tet_shift, LABELS + i] = work.labels[i]
    return written, found


@query_kernel
def _put_plane(grid, out, row, region, plane):
    """Copy a tetrahedron's dividing plane, a row of `out`, to its own row."""
    region[FRONT], region[BACK] = out.sides[row, FRONT_SIDE], out.sides[row, BACK_SIDE]
    p = out.faces[row]
    plane[PLANE], plane[PLANE + 1], plane[PLANE + 2] = p[0], p[1], p[2]
    plane[PLANE + 3] = p[3] - (p[0] * grid[0] + p[1] * grid[1] + p[2] * grid[2])


@query_kernel
def _grow_reach(mesh, t, label, broken, reaches):
    """Grow the reach of a new fragment by tetrahedron `t`; no effect for others."""
    if broken.first <= label < broken.end:
        b = mesh.boxes[t]
        grow_by_box(reaches[label - broken.first], (b[0], b[1], b[2]), (b[3], b[4], b[5]))
