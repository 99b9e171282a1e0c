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

from fracture_collision.core.compiled import inlined_kernel, kernel, query_kernel
from fracture_collision.core.cut_tetrahedron import (
    MAX_TRIANGLES,
    agree_on_face,
    face_shares,
    interfaces,
    make_cut_scratch,
    owner_slot,
    steps,
)
from fracture_collision.core.moments import add_tetrahedron
from fracture_collision.core.occupancy import mark_tetrahedron
from fracture_collision.core.point_location import load_margins
from fracture_collision.core.pools import CUT

# A triangle thinner than this (area against its longest side squared) is a clipping residue; others hold its rim.
RESIDUE = 1e-13
# Samples of one fragment in a tetrahedron and the one behind a face: four nodes and six edges each.
MAX_SAMPLES = 20


@kernel
def tetrahedra_of_nodes(mesh, first_node_row, nodes, visited):
    """Rows of all tetrahedra with one of `nodes` (rows), by first encounter, and behind them their other neighbours.

    `visited`: uint8, left clear. Returns (rows, how many of them have one of the nodes).
    """
    found = np.empty(16, dtype=np.int32)
    used = 0
    for n in nodes:
        r = n + first_node_row
        for e in range(mesh.node_tets_begin[r], mesh.node_tets_begin[r + 1]):
            found, used = _note(mesh.node_tets[e], visited, found, used)
    own = used
    for i in range(own):
        for face in range(4):
            n = mesh.neighbours[found[i], face]
            if n >= 0:
                found, used = _note(n, visited, found, used)
    for i in range(used):
        visited[found[i]] = 0
    return found[:used].copy(), own


@kernel
def _note(t, visited, found, used):
    if visited[t]:
        return found, used
    visited[t] = 1
    if used == len(found):
        grown = np.empty(2 * used, dtype=np.int32)
        grown[:used] = found
        found = grown
    found[used] = t
    return found, used + 1


@query_kernel
def _gap_of_triangle(corner, samples, count):
    """Upper bound [m] of the distance from a point of the triangle (9,) to the nearest of the samples (count, 3)."""
    longest = 0.0
    furthest = 0.0
    for i in range(3):
        j = 3 * ((i + 1) % 3)
        dx, dy, dz = corner[3 * i] - corner[j], corner[3 * i + 1] - corner[j + 1], corner[3 * i + 2] - corner[j + 2]
        longest = max(longest, dx * dx + dy * dy + dz * dz)
        nearest = np.inf
        for s in range(count):
            dx, dy, dz = (
                corner[3 * i] - samples[s, 0],
                corner[3 * i + 1] - samples[s, 1],
                corner[3 * i + 2] - samples[s, 2],
            )
            nearest = min(nearest, dx * dx + dy * dy + dz * dz)
        furthest = max(furthest, nearest)
    # balls of radius (longest side) / sqrt(3) around the corners cover a triangle
    return math.sqrt(longest / 3.0) + math.sqrt(furthest)


@query_kernel
def _samples_in_tetrahedron(mesh, body, node_shift, edge_shift, t, label, samples, count):
    """Append one fragment's surface samples in tetrahedron `t`: its nodes of the old surface, its ends of cut edges."""
    for i in range(4):
        v = mesh.tetrahedra[t, i]
        if mesh.on_surface[v] and body.node_fragment[v + node_shift] == label:
            for d in range(3):
                samples[count, d] = mesh.nodes[v, d]
            count += 1
    for e in range(6):
        edge = mesh.tetrahedron_edges[t, e]
        if body.edge_plane[edge + edge_shift] < 0:
            continue
        for side in range(2):
            own, far = mesh.edges[edge, side], mesh.edges[edge, 1 - side]
            if body.node_fragment[own + node_shift] == label:
                share = body.edge_share[edge + edge_shift, side]
                for d in range(3):
                    samples[count, d] = mesh.nodes[own, d] + share * (mesh.nodes[far, d] - mesh.nodes[own, d])
                count += 1
    return count


@inlined_kernel
def _grow(box, x, y, z):
    box[0], box[1], box[2] = min(box[0], x), min(box[1], y), min(box[2], z)
    box[3], box[4], box[5] = max(box[3], x), max(box[4], y), max(box[5], z)


@inlined_kernel
def _load_corners(mesh, t, corners):
    for i in range(4):
        v = mesh.tetrahedra[t, i]
        for d in range(3):
            corners[i, d] = mesh.nodes[v, d]


@inlined_kernel
def _lone_fragment(mesh, body, node_shift, t):
    """The fragment row that has all four nodes of tetrahedron `t`, -1 if several share it."""
    v = mesh.tetrahedra[t]
    label = body.node_fragment[v[0] + node_shift]
    for i in range(1, 4):
        if body.node_fragment[v[i] + node_shift] != label:
            return -1
    return label


@query_kernel
def _add_moments(work, first, last, low, high, outside, sign, moments):
    """Add `sign` times the moments under triangles first .. last - 1 of `work`, seen from corner 0.

    To fragments low .. high - 1, or, with `outside`, to all others. Over a tetrahedron's interfaces and the face
    opposite corner 0 that sums to the regions' own; the other faces hold the corner.
    """
    o = work.corners[0]
    for i in range(first, last):
        p = work.triangles[i]
        for side in range(2):
            s = work.fronts[i] if side == 0 else work.backs[i]
            if s < 0 or (low <= work.labels[s] < high) == outside:
                continue
            # seen from behind a triangle runs the other way round
            b, c = (3, 6) if (side == 0) == (sign > 0.0) else (6, 3)
            add_tetrahedron(
                o[0], o[1], o[2], p[0], p[1], p[2], p[b], p[b + 1], p[b + 2], p[c], p[c + 1], p[c + 2],
                moments[work.labels[s]],
            )  # fmt: skip


@kernel
def external_moments(mesh, body, node_shift, edge_shift, tets, low, high, sign, moments):
    """Add `sign` times the moments that `tets` give to fragments outside low .. high - 1 where three or more meet.

    With planes that disagree, a third fragment's share of such a tetrahedron can change when its neighbour breaks.
    """
    work = make_cut_scratch()
    for t in tets:
        slots = load_margins(mesh, body, node_shift, edge_shift, t, work.labels, work.functionals, work.counts)
        _load_corners(mesh, t, work.corners)
        used = interfaces(slots, work, face_shares(0, slots, work, 0))
        _add_moments(work, 0, used, low, high, True, sign, moments)


@kernel
def tetrahedra_shared_by_three(mesh, body, node_shift, tets, low, high):
    """Those of `tets` that hold three or more fragments, one of them outside low .. high - 1."""
    found = np.empty(len(tets), dtype=np.int32)
    used = 0
    for t in tets:
        distinct = 0
        external = False
        for i in range(4):
            label = body.node_fragment[mesh.tetrahedra[t, i] + node_shift]
            external = external or label < low or label >= high
            new = True
            for j in range(i):
                if body.node_fragment[mesh.tetrahedra[t, j] + node_shift] == label:
                    new = False
            distinct += 1 if new else 0
        if external and distinct >= 3:
            found[used] = t
            used += 1
    return found[:used].copy()


class SurfaceRows(NamedTuple):
    """New rows of BodyPool's polygon arrays."""

    triangles: np.ndarray
    faces: np.ndarray
    front: np.ndarray
    back: np.ndarray
    kind: np.ndarray


@kernel
def rebuild_surfaces(
    mesh, body, node_shift, tet_shift, edge_shift, tets, own, low, high, first_polygon, moments, boxes, reaches, gaps
):
    """Polygons of all `tets`, and moments, boxes, sampling gaps of the fragments there.

    `tets`: what tetrahedra_of_nodes gave for the nodes of fragments low .. high - 1; the first `own` hold these, the
    others are neighbours, whose common faces may have got steps. Labels, planes and edge_share in `body` are those
    after the fracture. Writes body.tet_fragment, cut_begin and cut_count (rows from `first_polygon` on); adds to the
    new fragments' `moments` (F, 10); grows `boxes` (F, 6), `gaps` (F,), and `reaches` (high - low, 6): the boxes of all
    tetrahedra that hold a new fragment. Returns the new rows.
    """
    out = _make_rows(4 * MAX_TRIANGLES)
    work, behind, near, far = make_cut_scratch(), make_cut_scratch(), make_cut_scratch(), make_cut_scratch()
    samples = np.empty((MAX_SAMPLES, 3))
    written, start = 0, 0
    while start < len(tets):
        if len(out.front) - written < MAX_TRIANGLES:
            out = _grown_rows(out)
        start, written = _rebuild_some(
            mesh, body, node_shift, tet_shift, edge_shift, tets, own, low, high, first_polygon,
            moments, boxes, reaches, gaps, start, written, out, work, behind, near, far, samples,
        )  # fmt: skip
    return SurfaceRows(
        out.triangles[:written], out.faces[:written], out.front[:written], out.back[:written], out.kind[:written]
    )


@kernel
def _make_rows(capacity):
    return SurfaceRows(
        np.empty((capacity, 9)), np.empty((capacity, 4)), np.empty(capacity, np.int32), np.empty(capacity, np.int32),
        np.empty(capacity, np.uint8),
    )  # fmt: skip


@kernel
def _grown_rows(rows):
    return SurfaceRows(
        np.concatenate((rows.triangles, np.empty_like(rows.triangles))),
        np.concatenate((rows.faces, np.empty_like(rows.faces))),
        np.concatenate((rows.front, np.empty_like(rows.front))),
        np.concatenate((rows.back, np.empty_like(rows.back))),
        np.concatenate((rows.kind, np.empty_like(rows.kind))),
    )


@query_kernel
def _rebuild_some(
    mesh, body, node_shift, tet_shift, edge_shift, tets, own, low, high, first_polygon,
    moments, boxes, reaches, gaps, start, written, out, work, behind, near, far, samples,
):  # fmt: skip
    """rebuild_surfaces for tets[start:], as far as `out` has room; returns (next start, rows written)."""
    for at in range(start, len(tets)):
        if len(out.front) - written < MAX_TRIANGLES:
            return at, written
        t = tets[at]
        _load_corners(mesh, t, work.corners)
        slots, begin = 1, written
        work.labels[0], work.counts[0] = _lone_fragment(mesh, body, node_shift, t), 0
        if work.labels[0] < 0:
            slots = load_margins(mesh, body, node_shift, edge_shift, t, work.labels, work.functionals, work.counts)
        if at < own:
            _take_stock(mesh, body, tet_shift, t, slots, low, high, work, moments, boxes, reaches)
        for face in range(4):
            n = mesh.neighbours[t, face]
            if n >= 0:
                if slots == 1 and _lone_fragment(mesh, body, node_shift, n) >= 0:
                    continue
                behind_slots = load_margins(
                    mesh, body, node_shift, edge_shift, n, behind.labels, behind.functionals, behind.counts
                )
                if agree_on_face(slots, work, behind_slots, behind, face):
                    continue
                used = steps(face, slots, work, behind_slots, behind, near, far, 0)
                written = _write(
                    mesh, body, node_shift, edge_shift, t, n, work, behind, far, 0, used, boxes, gaps, out, written,
                    samples,
                )  # fmt: skip
            else:
                # of a tetrahedron that one fragment has alone the mesh itself is the old surface
                used = face_shares(face, slots, work, 0)
                kept = _write(
                    mesh, body, node_shift, edge_shift, t, -1, work, work, work, 0, used, boxes, gaps, out, written,
                    samples,
                )  # fmt: skip
                if slots > 1:
                    written = kept
        if slots > 1:
            used = interfaces(slots, work, 0)
            if at < own:
                _add_moments(work, 0, used, low, high, False, 1.0, moments)
            written = _write(
                mesh, body, node_shift, edge_shift, t, -1, work, work, work, 0, used, boxes, gaps, out, written, samples
            )
        body.cut_begin[t + tet_shift] = first_polygon + begin
        body.cut_count[t + tet_shift] = written - begin
    return len(tets), written


@query_kernel
def _take_stock(mesh, body, tet_shift, t, slots, low, high, work, moments, boxes, reaches):
    """Owner, moments (but for the interfaces), and boxes of a tetrahedron with nodes of new fragments."""
    body.tet_fragment[t + tet_shift] = work.labels[0] if slots == 1 else CUT
    if slots == 1:
        for d in range(10):
            moments[work.labels[0], d] += mesh.moments[t, d]
    else:
        used = face_shares(0, slots, work, 0)
        _add_moments(work, 0, used, low, high, False, 1.0, moments)
    for i in range(4):
        x, y, z = work.corners[i, 0], work.corners[i, 1], work.corners[i, 2]
        s = owner_slot(slots, work.functionals, work.counts, work.labels, x, y, z)
        _grow(boxes[work.labels[s]], x, y, z)
        for s in range(slots):
            if low <= work.labels[s] < high:
                _grow(reaches[work.labels[s] - low], x, y, z)


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
                _grow(boxes[label], p[3 * c], p[3 * c + 1], p[3 * c + 2])
            # a step's far side is the near side of the far tetrahedron's own step
            if length > RESIDUE * span and (side == 0 or n < 0):
                count = _samples_in_tetrahedron(mesh, body, node_shift, edge_shift, t, label, samples, 0)
                if n >= 0:
                    count = _samples_in_tetrahedron(mesh, body, node_shift, edge_shift, n, label, samples, count)
                gaps[label] = max(gaps[label], _gap_of_triangle(p, samples, count))
        if length <= RESIDUE * span:
            continue
        for d in range(9):
            out.triangles[written, d] = p[d]
        nx, ny, nz = nx / length, ny / length, nz / length
        out.faces[written, 0], out.faces[written, 1], out.faces[written, 2] = nx, ny, nz
        out.faces[written, 3] = nx * p[0] + ny * p[1] + nz * p[2]
        out.front[written] = front.labels[made.fronts[i]]
        out.back[written] = -1 if made.backs[i] < 0 else back.labels[made.backs[i]]
        out.kind[written] = made.kinds[i]
        written += 1
    return written


@query_kernel
def mark_cells(mesh, k, body, node_shift, tets, low, high, cells, occupancy):
    """Set the level-0 cells of fragments low .. high - 1 (rows of `cells` (high - low, 7)) from their tetrahedra."""
    for t in tets:
        for i in range(4):
            label = body.node_fragment[mesh.tetrahedra[t, i] + node_shift]
            if low <= label < high:
                new = True
                for j in range(i):
                    if body.node_fragment[mesh.tetrahedra[t, j] + node_shift] == label:
                        new = False
                if new:
                    mark_tetrahedron(mesh, k, t, cells[label - low], occupancy)
