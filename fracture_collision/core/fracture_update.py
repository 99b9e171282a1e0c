"""What a fracture changes in the field: crack polygons, masses, boxes, cells and sampling gaps of the fragments.

Only the tetrahedra of the fragment that broke and their neighbours are touched (Glondu 2014, section 4.2: "locally
update where needed"); the exact field keeps no distances, so nothing is propagated.

The border of a fragment's region is closed: its share of the old surface, the interfaces within tetrahedra, and the
steps, where two tetrahedra disagree about the owner of their common face.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from fracture_collision.core.cell_cut import add_region, cell_interfaces, cell_shares, cell_steps
from fracture_collision.core.compiled import inlined_kernel, query_kernel
from fracture_collision.core.cut_tetrahedron import (
    FACE_VERTICES,
    MAX_TRIANGLES,
    agree_on_face,
    face_shares,
    interfaces,
    owner_slot,
    steps,
)
from fracture_collision.core.plain_cut import (
    CELLS,
    LONE,
    MAX_PLAIN_TRIANGLES,
    MIXED,
    PLAIN,
    add_parts,
    cut_edges,
    kind_of_cut,
    write_face,
    write_section,
)
from fracture_collision.core.pools import CUT
from fracture_collision.core.surface_rows import (
    RESIDUE,
    gap_of_triangle,
    grow,
    longest_side_squared,
    samples_in_tetrahedron,
    write_row,
)
from fracture_collision.core.touched_tetrahedra import load_cut


@query_kernel
def _add_moments(slots, work, first, last, low, high, outside, sign, moments):
    """Add `sign` times the moments under triangles first .. last - 1 of `work`, see cell_cut.add_region.

    To fragments low .. high - 1, or, with `outside`, to all others.
    """
    for s in range(slots):
        if (low <= work.labels[s] < high) != outside:
            add_region(work, s, first, last, sign, moments[work.labels[s]])


@query_kernel
def external_moments(mesh, body, node_shift, edge_shift, tets, low, high, sign, moments, work):
    """Add `sign` times the moments that `tets` give to fragments outside low .. high - 1 where three or more meet.

    With planes that disagree, a third fragment's share of such a tetrahedron can change when its neighbour breaks.
    """
    for t in tets:
        slots = load_cut(mesh, body, node_shift, edge_shift, t, work)
        used = interfaces(slots, work, face_shares(0, slots, work, 0))
        _add_moments(slots, work, 0, used, low, high, True, sign, moments)


class SurfaceRows(NamedTuple):
    """New rows of BodyPool's polygon arrays."""

    triangles: np.ndarray
    faces: np.ndarray
    front: np.ndarray
    back: np.ndarray
    kind: np.ndarray


@query_kernel
def rebuild_lone(mesh, body, node_shift, tet_shift, touched, moments, gaps):
    """Tetrahedra that one fragment has alone and no step is possible at: owner, moments, gaps of the old surface.

    `touched`: as classified. Adds to `moments` (F, 10) of the new fragments, grows `gaps` (F,). Three passes rather
    than one (rebuild_plain, rebuild_others): the code of all kinds together does not fit the instruction cache.
    """
    for at in range(touched.near):
        t = touched.rows[at]
        if touched.kinds[t - touched.first] != LONE or touched.unclear[t - touched.first]:
            continue
        body.cut_count[t + tet_shift] = 0
        _take_alone(mesh, body, node_shift, tet_shift, t, at < touched.own, moments)
        for face in range(4):
            if mesh.neighbours[t, face] < 0:
                _grow_gap_of_face(mesh, body, node_shift, t, face, gaps)


@query_kernel
def rebuild_plain(
    mesh, body, node_shift, tet_shift, edge_shift, touched, low, high, start, first_polygon, out, moments, boxes,
    reaches, gaps, scratch,
):  # fmt: skip
    """Tetrahedra that one plane parts, where no step is possible; arguments and answer as of rebuild_others."""
    plain, samples, written = scratch.plain, scratch.samples, 0
    for at in range(start, touched.near):
        if len(out.front) - written < MAX_PLAIN_TRIANGLES:
            return at, written
        t = touched.rows[at]
        if touched.kinds[t - touched.first] != PLAIN or touched.unclear[t - touched.first]:
            continue
        body.tet_fragment[t + tet_shift], begin = CUT, written
        _grow_reaches(mesh, body, node_shift, t, low, high, reaches)
        kind_of_cut(mesh, body, node_shift, edge_shift, t, plain)
        below, count = cut_edges(mesh, body, edge_shift, t, plain)
        if at < touched.own:
            add_parts(mesh, t, plain, below, low, high, moments)
        for face in range(4):
            if mesh.neighbours[t, face] < 0:
                written = write_face(mesh, body, node_shift, edge_shift, t, face, plain, out, written, gaps, samples)
        written = write_section(mesh, body, node_shift, edge_shift, t, plain, count, out, written, boxes, gaps, samples)
        body.cut_begin[t + tet_shift], body.cut_count[t + tet_shift] = first_polygon + begin, written - begin
    return touched.near, written


@query_kernel
def rebuild_others(
    mesh, body, node_shift, tet_shift, edge_shift, touched, low, high, start, first_polygon, out, moments, boxes,
    reaches, gaps, scratch,
):  # fmt: skip
    """Polygons of touched.rows[start : near] as far as `out` has room; moments, boxes, sampling gaps of the fragments.

    `touched`: as classified, of the nodes of fragments low .. high - 1. Labels, planes and edge_share in `body` are
    those after the fracture. Writes body.tet_fragment, cut_begin and cut_count (rows of `out` count from
    `first_polygon` on); adds to the new fragments' `moments` (F, 10); grows `boxes` (F, 6), `gaps` (F,), and `reaches`
    (high - low, 6): the boxes of all cut tetrahedra that hold a new fragment. Returns (start of the next call, rows
    written).
    """
    work, behind, near, far, _, samples, _ = scratch
    own, first_tet, written = touched.own, touched.first, 0
    for at in range(start, touched.near):
        if len(out.front) - written < MAX_TRIANGLES:
            return at, written
        t = touched.rows[at]
        kind, unclear, begin = touched.kinds[t - first_tet], touched.unclear[t - first_tet], written
        if kind < CELLS and not unclear:
            continue
        slots = load_cut(mesh, body, node_shift, edge_shift, t, work)
        if kind == LONE:
            _take_alone(mesh, body, node_shift, tet_shift, t, at < own, moments)
        else:
            body.tet_fragment[t + tet_shift] = CUT
            _grow_reaches(mesh, body, node_shift, t, low, high, reaches)
            if kind == MIXED and at < own:
                _take_stock(slots, work, boxes)
        for face in range(4):
            n = mesh.neighbours[t, face]
            if n >= 0:
                if (unclear >> face) & 1 == 0:
                    continue
                behind_slots = load_cut(mesh, body, node_shift, edge_shift, n, behind)
                if kind != MIXED and touched.kinds[n - first_tet] != MIXED:
                    used = cell_steps(face, slots, work, behind_slots, behind, far, 0)
                elif agree_on_face(slots, work, behind_slots, behind, near, far, face):
                    continue
                else:
                    used = steps(face, slots, work, behind_slots, behind, near, far, 0)
                written = _write(
                    mesh, body, node_shift, edge_shift, t, n, work, behind, far, 0, used, boxes, gaps, out, written,
                    samples,
                )  # fmt: skip
            elif kind == LONE:
                _grow_gap_of_face(mesh, body, node_shift, t, face, gaps)
            else:
                used = face_shares(face, slots, work, 0) if kind == MIXED else cell_shares(face, slots, work, 0)
                written = _write(
                    mesh, body, node_shift, edge_shift, t, -1, work, work, work, 0, used, boxes, gaps, out, written,
                    samples,
                )  # fmt: skip
        if kind != LONE:
            used = interfaces(slots, work, 0) if kind == MIXED else cell_interfaces(slots, work, 0)
            if at < own:
                last = face_shares(0, slots, work, used) if kind == MIXED else cell_shares(0, slots, work, used)
                _add_moments(slots, work, 0, last, low, high, False, 1.0, moments)
            written = _write(
                mesh, body, node_shift, edge_shift, t, -1, work, work, work, 0, used, boxes, gaps, out, written, samples
            )
        body.cut_begin[t + tet_shift], body.cut_count[t + tet_shift] = first_polygon + begin, written - begin
    return touched.near, written


@inlined_kernel
def _take_alone(mesh, body, node_shift, tet_shift, t, is_new, moments):
    """Owner and moments of a tetrahedron that one fragment has; the mesh itself is its old surface."""
    if is_new:
        label = body.node_fragment[mesh.tetrahedra[t, 0] + node_shift]
        body.tet_fragment[t + tet_shift] = label
        for d in range(10):
            moments[label, d] += mesh.moments[t, d]


@inlined_kernel
def _grow_gap_of_face(mesh, body, node_shift, t, face, gaps):
    """The gap of an old face whose corners are samples."""
    v = mesh.tetrahedra[t]
    i, j, k = FACE_VERTICES[face, 0], FACE_VERTICES[face, 1], FACE_VERTICES[face, 2]
    longest = longest_side_squared(mesh.nodes[v[i]], mesh.nodes[v[j]], mesh.nodes[v[k]])
    label = body.node_fragment[v[0] + node_shift]
    gaps[label] = max(gaps[label], math.sqrt(longest / 3.0))


@inlined_kernel
def _grow_reaches(mesh, body, node_shift, t, low, high, reaches):
    b = mesh.boxes[t]
    for i in range(4):
        label = body.node_fragment[mesh.tetrahedra[t, i] + node_shift]
        if low <= label < high:
            grow(reaches[label - low], b[0], b[1], b[2])
            grow(reaches[label - low], b[3], b[4], b[5])


@query_kernel
def _take_stock(slots, work, boxes):
    """Boxes of the fragments that own the corners."""
    for i in range(4):
        x, y, z = work.corners[i, 0], work.corners[i, 1], work.corners[i, 2]
        grow(boxes[work.labels[owner_slot(slots, work.functionals, work.counts, work.labels, x, y, z)]], x, y, z)


@query_kernel
def _write(
    mesh, body, node_shift, edge_shift, t, n, front, back, made, first, last, boxes, gaps, out, written, samples
):
    """Append triangles first .. last - 1 of `made` as rows of tetrahedron `t`; grow boxes and gaps of their fragments.

    `front`, `back`: whose labels the slots in made.fronts and made.backs mean; `n`: the tetrahedron behind a step, -1.
    Returns the row behind the last.
    """
    for i in range(first, last):
        p = made.triangles[i]
        ux, uy, uz = p[3] - p[0], p[4] - p[1], p[5] - p[2]
        vx, vy, vz = p[6] - p[0], p[7] - p[1], p[8] - p[2]
        nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        span = max(ux * ux + uy * uy + uz * uz, vx * vx + vy * vy + vz * vz)
        length = math.sqrt(nx * nx + ny * ny + nz * nz)
        for side in range(2):
            s = made.fronts[i] if side == 0 else made.backs[i]
            if s < 0:
                continue
            label = front.labels[s] if side == 0 else back.labels[s]
            for c in range(3):
                grow(boxes[label], p[3 * c], p[3 * c + 1], p[3 * c + 2])
            # a step's far side is the near side of the far tetrahedron's own step
            if length > RESIDUE * span and (side == 0 or n < 0):
                count = samples_in_tetrahedron(mesh, body, node_shift, edge_shift, t, label, samples, 0)
                if n >= 0:
                    count = samples_in_tetrahedron(mesh, body, node_shift, edge_shift, n, label, samples, count)
                gaps[label] = max(gaps[label], gap_of_triangle(p[0:3], p[3:6], p[6:9], samples, count))
        if length <= RESIDUE * span:
            continue
        nx, ny, nz = nx / length, ny / length, nz / length
        offset = nx * p[0] + ny * p[1] + nz * p[2]
        other = -1 if made.backs[i] < 0 else back.labels[made.backs[i]]
        written = write_row(
            p[0:3], p[3:6], p[6:9], nx, ny, nz, offset, front.labels[made.fronts[i]], other, made.kinds[i], out, written
        )
    return written
