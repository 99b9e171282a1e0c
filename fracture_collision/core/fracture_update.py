"""What a fracture changes in the field: crack polygons, masses, boxes, cells and sampling gaps of the new fragments.

Only the tetrahedra of the fragment that broke are touched (Glondu 2014, section 4.2: "locally update where needed");
the exact field keeps no distances, so nothing is propagated.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from fracture_collision.core.compiled import inlined_kernel, kernel, query_kernel
from fracture_collision.core.cut_tetrahedron import (
    EDGE_FIRST,
    EDGE_SECOND,
    FACE_VERTICES,
    INTERFACE,
    MAX_TRIANGLES,
    make_cut_scratch,
    margin,
    partition,
)
from fracture_collision.core.moments import add_tetrahedron
from fracture_collision.core.occupancy import mark_tetrahedron
from fracture_collision.core.point_location import load_margins
from fracture_collision.core.pools import CUT

# A triangle thinner than this (area against its longest side squared) is a clipping residue; others hold its rim.
RESIDUE = 1e-13


@kernel
def tetrahedra_of_nodes(mesh, first_node_row, nodes, visited):
    """Rows of all tetrahedra with one of `nodes` (rows), ascending by first encounter; `visited` uint8, left clear."""
    found = np.empty(16, dtype=np.int32)
    used = 0
    for n in nodes:
        r = n + first_node_row
        for e in range(mesh.node_tets_begin[r], mesh.node_tets_begin[r + 1]):
            t = mesh.node_tets[e]
            if not visited[t]:
                visited[t] = 1
                if used == len(found):
                    grown = np.empty(2 * used, dtype=np.int32)
                    grown[:used] = found
                    found = grown
                found[used] = t
                used += 1
    for i in range(used):
        visited[found[i]] = 0
    return found[:used].copy()


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
def _samples_of_slot(corners, labels, label, crack_points, is_cut, surface_node, samples):
    """Surface samples of one fragment in a tetrahedron: its ends of the cut edges, its nodes of the old surface."""
    count = 0
    for i in range(4):
        if labels[i] == label and surface_node[i]:
            for d in range(3):
                samples[count, d] = corners[i, d]
            count += 1
    for e in range(6):
        for end in range(2):
            if is_cut[e] and labels[EDGE_FIRST[e] if end == 0 else EDGE_SECOND[e]] == label:
                for d in range(3):
                    samples[count, d] = crack_points[e, end, d]
                count += 1
    return count


@query_kernel
def _own_share_of_edge(slots, functionals, counts, own, start, end, roots):
    """Share of the segment start - end (3,), from its start in slot `own`'s region, up to where another slot's begins.

    Margins are piecewise linear along the segment; between two neighbouring roots of their differences the owner stays.
    """
    used = 0
    for q in range(counts[own]):
        f = functionals[own, q]
        f0 = f[0] * start[0] + f[1] * start[1] + f[2] * start[2] - f[3]
        f1 = f[0] * end[0] + f[1] * end[1] + f[2] * end[2] - f[3]
        for s in range(slots):
            if s == own:
                continue
            for r in range(counts[s]):
                g = functionals[s, r]
                d0 = f0 - (g[0] * start[0] + g[1] * start[1] + g[2] * start[2] - g[3])
                d1 = f1 - (g[0] * end[0] + g[1] * end[1] + g[2] * end[2] - g[3])
                if (d0 > 0.0) != (d1 > 0.0):
                    roots[used] = min(max(d0 / (d0 - d1), 0.0), 1.0)
                    used += 1
    for i in range(1, used):
        root, k = roots[i], i
        while k > 0 and roots[k - 1] > root:
            roots[k] = roots[k - 1]
            k -= 1
        roots[k] = root
    for i in range(used):
        after = 0.5 * (roots[i] + (roots[i + 1] if i + 1 < used else 1.0))
        x = start[0] + after * (end[0] - start[0])
        y = start[1] + after * (end[1] - start[1])
        z = start[2] + after * (end[2] - start[2])
        mine = margin(functionals[own], counts[own], x, y, z)
        for s in range(slots):
            if s != own and margin(functionals[s], counts[s], x, y, z) > mine:
                return roots[i]
    return 1.0


@kernel
def crack_samples(mesh, body, node_shift, edge_shift, tets, low, high, first_edge, share):
    """Where the surfaces of fragments low .. high - 1 cross their cut edges: fills share (mesh edges, 2).

    share[e, side]: from the edge's node `side`, in parts of the edge, how far its fragment reaches in every tetrahedron
    of `tets` around the edge. With planes that agree both shares end in the crossing. Where a third fragment's cell
    reaches over the edge without holding an end, or planes disagree, they end before: a sample is never inside another
    fragment that is in place. Entries that no cut edge of these fragments needs keep their value.
    """
    _crack_samples(
        mesh, body, node_shift, edge_shift, tets, low, high, first_edge, share, make_cut_scratch(), np.empty(64)
    )


@query_kernel
def _crack_samples(mesh, body, node_shift, edge_shift, tets, low, high, first_edge, share, work, roots):
    labels, functionals, counts = work.labels, work.functionals, work.counts
    for t in tets:
        cut = False
        for e in range(6):
            cut = cut or body.edge_plane[mesh.tetrahedron_edges[t, e] + edge_shift] >= 0
        if not cut:
            continue
        slots = load_margins(mesh, body, node_shift, edge_shift, t, labels, functionals, counts)
        for e in range(6):
            edge = mesh.tetrahedron_edges[t, e]
            if body.edge_plane[edge + edge_shift] < 0:
                continue
            for side in range(2):
                label = body.node_fragment[mesh.edges[edge, side] + node_shift]
                if label < low or label >= high:
                    continue
                own = 0
                while labels[own] != label:
                    own += 1
                start, end = mesh.nodes[mesh.edges[edge, side]], mesh.nodes[mesh.edges[edge, 1 - side]]
                reach = _own_share_of_edge(slots, functionals, counts, own, start, end, roots)
                share[edge - first_edge, side] = min(share[edge - first_edge, side], reach)


@inlined_kernel
def _grow(box, x, y, z):
    box[0], box[1], box[2] = min(box[0], x), min(box[1], y), min(box[2], z)
    box[3], box[4], box[5] = max(box[3], x), max(box[4], y), max(box[5], z)


@inlined_kernel
def _behind_holds(mesh, body, node_shift, t, face, label):
    """Whether the tetrahedron behind a face has a node of fragment `label`; False at the old surface."""
    n = mesh.neighbours[t, face]
    if n < 0:
        return False
    holds = False
    for i in range(4):
        holds = holds or body.node_fragment[mesh.tetrahedra[n, i] + node_shift] == label
    return holds


@kernel
def external_moments(mesh, body, node_shift, edge_shift, tets, low, high, sign, moments):
    """Add `sign` times the moments that `tets` give to fragments outside low .. high - 1 where three or more meet.

    With planes that disagree, a third fragment's share of such a tetrahedron can change when its neighbour breaks.
    """
    work = make_cut_scratch()
    row = np.empty(10)
    for t in tets:
        slots = load_margins(mesh, body, node_shift, edge_shift, t, work.labels, work.functionals, work.counts)
        _load_corners(mesh, t, work.corners)
        used = partition(slots, work)
        o = work.corners[0]
        for i in range(used):
            p = work.triangles[i]
            for side in range(2):
                s = work.fronts[i] if side == 0 else work.backs[i]
                if s < 0 or low <= work.labels[s] < high:
                    continue
                row[:] = 0.0
                add_tetrahedron(o[0], o[1], o[2], p[0], p[1], p[2], p[3], p[4], p[5], p[6], p[7], p[8], row)
                weight = sign if side == 0 else -sign
                for d in range(10):
                    moments[work.labels[s], d] += weight * row[d]


@inlined_kernel
def _load_corners(mesh, t, corners):
    for i in range(4):
        v = mesh.tetrahedra[t, i]
        for d in range(3):
            corners[i, d] = mesh.nodes[v, d]


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


@kernel
def rebuild_surfaces(
    mesh, body, node_shift, tet_shift, edge_shift, tets, low, high, first_polygon, first_edge, share,
    moments, boxes, gaps,
):  # fmt: skip
    """Polygons of all cut tetrahedra among `tets`, and moments, boxes, sampling gaps of fragments low .. high - 1.

    Labels and planes in `body` are those after the fracture, `share` is what crack_samples filled. Writes
    body.tet_fragment, cut_begin and cut_count (rows from `first_polygon` on), adds to `moments` (F, 10), grows `boxes`
    (high - low, 6) and `gaps` (high - low,). Returns the new rows.
    """
    out = _make_rows(4 * MAX_TRIANGLES)
    work = make_cut_scratch()
    local = TetrahedronScratch(
        np.empty(4, np.int64), np.empty(4, np.uint8), np.empty(6, np.uint8), np.empty((6, 2, 3)), np.empty((16, 3)),
        np.empty(9),
    )  # fmt: skip
    written, start = 0, 0
    while start < len(tets):
        if len(out.front) - written < MAX_TRIANGLES:
            out = _grown_rows(out)
        start, written = _rebuild_some(
            mesh, body, node_shift, tet_shift, edge_shift, tets, low, high, first_polygon, first_edge, share,
            moments, boxes, gaps, start, written, out, work, local,
        )  # fmt: skip
    return SurfaceRows(
        out.triangles[:written], out.faces[:written], out.front[:written], out.back[:written], out.kind[:written]
    )


class SurfaceRows(NamedTuple):
    """New rows of BodyPool's polygon arrays."""

    triangles: np.ndarray
    faces: np.ndarray
    front: np.ndarray
    back: np.ndarray
    kind: np.ndarray


class TetrahedronScratch(NamedTuple):
    labels: np.ndarray  # (4,) int64 fragment of each corner
    surface_node: np.ndarray  # (4,) uint8
    is_cut: np.ndarray  # (6,) uint8
    crack_points: np.ndarray  # (6, 2, 3) float64 [m], sample of each end of each cut edge
    samples: np.ndarray  # (16, 3) float64 [m]
    triangle: np.ndarray  # (9,) float64 [m]


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
    mesh, body, node_shift, tet_shift, edge_shift, tets, low, high, first_polygon, first_edge, share,
    moments, boxes, gaps, start, written, out, work, local,
):  # fmt: skip
    """rebuild_surfaces for tets[start:], as far as `out` has room; returns (next start, rows written)."""
    labels, corners, triangles = work.labels, work.corners, work.triangles
    corner_labels, surface_node, is_cut = local.labels, local.surface_node, local.is_cut
    crack_points, samples, corner_triangle = local.crack_points, local.samples, local.triangle
    for at in range(start, len(tets)):
        if len(out.front) - written < MAX_TRIANGLES:
            return at, written
        t = tets[at]
        _load_corners(mesh, t, corners)
        for i in range(4):
            v = mesh.tetrahedra[t, i]
            corner_labels[i] = body.node_fragment[v + node_shift]
            surface_node[i] = mesh.on_surface[v]
        first = corner_labels[0]
        if corner_labels[1] == first and corner_labels[2] == first and corner_labels[3] == first:
            body.tet_fragment[t + tet_shift] = first
            for d in range(10):
                moments[first, d] += mesh.moments[t, d]
            for i in range(4):
                _grow(boxes[first - low], corners[i, 0], corners[i, 1], corners[i, 2])
            for face in range(4):
                if mesh.neighbours[t, face] < 0:
                    for i in range(3):
                        for d in range(3):
                            corner_triangle[3 * i + d] = corners[FACE_VERTICES[face, i], d]
                    gaps[first - low] = max(gaps[first - low], _gap_of_triangle(corner_triangle, corners, 4))
            continue
        for e in range(6):
            edge = mesh.tetrahedron_edges[t, e]
            is_cut[e] = 1 if body.edge_plane[edge + edge_shift] >= 0 else 0
            if is_cut[e]:
                flipped = 1 if mesh.tetrahedra[t, EDGE_FIRST[e]] > mesh.tetrahedra[t, EDGE_SECOND[e]] else 0
                for end in range(2):
                    own, far = (EDGE_FIRST[e], EDGE_SECOND[e]) if end == 0 else (EDGE_SECOND[e], EDGE_FIRST[e])
                    part = share[edge - first_edge, end if flipped == 0 else 1 - end]
                    for d in range(3):
                        crack_points[e, end, d] = corners[own, d] + part * (corners[far, d] - corners[own, d])
        slots = load_margins(mesh, body, node_shift, edge_shift, t, labels, work.functionals, work.counts)
        used = partition(slots, work)
        fronts, backs, kinds = work.fronts, work.backs, work.kinds
        body.tet_fragment[t + tet_shift] = CUT
        body.cut_begin[t + tet_shift] = first_polygon + written
        o = corners[0]
        for i in range(used):
            p = triangles[i]
            for side in range(2):
                s = fronts[i] if side == 0 else backs[i]
                if s < 0 or labels[s] < low or labels[s] >= high:
                    continue
                if side == 0:
                    add_tetrahedron(
                        o[0], o[1], o[2], p[0], p[1], p[2], p[3], p[4], p[5], p[6], p[7], p[8], moments[labels[s]]
                    )
                else:
                    add_tetrahedron(
                        o[0], o[1], o[2], p[0], p[1], p[2], p[6], p[7], p[8], p[3], p[4], p[5], moments[labels[s]]
                    )
                for c in range(3):
                    _grow(boxes[labels[s] - low], p[3 * c], p[3 * c + 1], p[3 * c + 2])
            # a face is surface of the fragment only where nothing of it lies behind
            if kinds[i] != INTERFACE and _behind_holds(mesh, body, node_shift, t, kinds[i], labels[fronts[i]]):
                continue
            ux, uy, uz = p[3] - p[0], p[4] - p[1], p[5] - p[2]
            vx, vy, vz = p[6] - p[0], p[7] - p[1], p[8] - p[2]
            nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
            span = max(ux * ux + uy * uy + uz * uz, vx * vx + vy * vy + vz * vz)
            length = math.sqrt(nx * nx + ny * ny + nz * nz)
            if length <= RESIDUE * span:
                continue
            for side in range(2):
                s = fronts[i] if side == 0 else backs[i]
                if s >= 0 and low <= labels[s] < high:
                    count = _samples_of_slot(
                        corners, corner_labels, labels[s], crack_points, is_cut, surface_node, samples
                    )
                    gaps[labels[s] - low] = max(gaps[labels[s] - low], _gap_of_triangle(p, samples, count))
            for d in range(9):
                out.triangles[written, d] = p[d]
            nx, ny, nz = nx / length, ny / length, nz / length
            out.faces[written, 0], out.faces[written, 1], out.faces[written, 2] = nx, ny, nz
            out.faces[written, 3] = nx * p[0] + ny * p[1] + nz * p[2]
            out.front[written] = labels[fronts[i]]
            out.back[written] = -1 if backs[i] < 0 else labels[backs[i]]
            out.kind[written] = kinds[i]
            written += 1
        body.cut_count[t + tet_shift] = first_polygon + written - body.cut_begin[t + tet_shift]
    return len(tets), written


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
