"""Which tetrahedra a fracture concerns, and how each of them is cut: what all later passes of an update go by."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fracture_collision.core.compiled import inlined_kernel, query_kernel
from fracture_collision.core.cut_patterns import FAN_COUNT, GROUPS, PATTERN_OF_CUTS, PIECE_COUNT
from fracture_collision.core.cut_tetrahedron import CUT, DIVIDED, FACE_VERTICES, LONE, crossing_share
from fracture_collision.core.moments import add_row
from fracture_collision.core.pools import OWNER
from fracture_collision.core.surface_rows import gap_of_triangle, grow, measure_triangle


class Touched(NamedTuple):
    """The tetrahedra that a fracture concerns: those with a node of the fragment that broke."""

    rows: np.ndarray  # int32
    first: int  # row of the mesh's first tetrahedron; `kinds` begins there
    kinds: np.ndarray  # (m,) uint8: LONE, CUT or DIVIDED of cut_tetrahedron.py
    cut: np.ndarray  # int32: those of `rows` that are not LONE
    room: int  # no more rows of the surface are in them


@query_kernel
def place_crossings(mesh, body, edge_shift, edges, first_plane):
    """Cut `edges` (rows of the mesh pool) by the planes from row `first_plane` on: edge_plane, edge_event, edge_share.

    Glondu 2014, section 6.3: the crossing is a sample of both fragments.
    """
    for i in range(len(edges)):
        e = edges[i] + edge_shift
        a, b = mesh.edges[edges[i], 0], mesh.edges[edges[i], 1]
        body.edge_plane[e], body.edge_event[e] = first_plane + i, first_plane
        body.edge_share[e] = crossing_share(mesh.nodes, a, b, body.planes[first_plane + i])


def find_touched(
    mesh, body, node_shift, tet_shift, first_node_row, first_tet, last_tet, nodes, first_fragment, moments, gaps
) -> Touched:
    """Touched of the fragment that broke, whose `nodes` (rows) carry the labels of its parts, first_fragment on.

    first_tet .. last_tet - 1: the mesh's tetrahedra. What one fragment has alone is done with: its owner is written,
    its moments added to `moments` (F, 10), `gaps` (F,) grown by its faces of the old surface.
    """
    count = last_tet - first_tet
    kinds, rows, cut = np.zeros(count, np.uint8), np.empty(count, np.int32), np.empty(count, np.int32)
    used, cuts, room = _find_touched(
        mesh, body, node_shift, tet_shift, first_node_row, first_tet, last_tet, nodes, first_fragment, moments, gaps,
        kinds, rows, cut,
    )  # fmt: skip
    return Touched(rows[:used], first_tet, kinds, cut[:cuts], room)


@query_kernel
def _find_touched(
    mesh, body, node_shift, tet_shift, first_node_row, first_tet, last_tet, nodes, first_fragment, moments, gaps, kinds,
    rows, cut,
):  # fmt: skip
    used = cuts = room = 0
    if 24 * len(nodes) > last_tet - first_tet:
        # most tetrahedra have one: reading all labels in order beats gathering
        for t in range(first_tet, last_tet):
            kind, more = _sort_in(mesh, body, node_shift, tet_shift, t, first_fragment, moments, gaps)
            # written in any case, kept if it counts: which it does is anybody's guess
            kinds[t - first_tet], rows[used], cut[cuts] = kind, t, t
            used, cuts, room = used + (kind > 0), cuts + (kind > LONE), room + more
    else:
        for n in nodes:
            for e in range(mesh.node_tets_begin[n + first_node_row], mesh.node_tets_begin[n + first_node_row + 1]):
                t = mesh.node_tets[e]
                if kinds[t - first_tet] == 0:
                    kind, more = _sort_in(mesh, body, node_shift, tet_shift, t, first_fragment, moments, gaps)
                    kinds[t - first_tet], rows[used], cut[cuts] = kind, t, t
                    used, cuts, room = used + 1, cuts + (kind > LONE), room + more
    return used, cuts, room


@inlined_kernel
def _sort_in(mesh, body, node_shift, tet_shift, t, first_fragment, moments, gaps):
    """(kind, or 0 of one that the fracture does not concern; most rows of the surface) of tetrahedron `t`."""
    v = mesh.tetrahedra[t]
    a, b = body.node_fragment[v[0] + node_shift], body.node_fragment[v[1] + node_shift]
    c, d = body.node_fragment[v[2] + node_shift], body.node_fragment[v[3] + node_shift]
    low, high = min(a, b, c, d), max(a, b, c, d)
    if high < first_fragment:
        return 0, 0
    n = mesh.neighbours[t]
    outer = n[0] < 0 or n[1] < 0 or n[2] < 0 or n[3] < 0
    if low == high:
        body.regions[t + tet_shift, OWNER], body.cut_count[t + tet_shift] = a, 0
        m = mesh.moments[t]
        add_row(moments[a], m[0], m[1], m[2], m[3], m[4], m[5], m[6], m[7], m[8], m[9])
        if outer:
            gaps[a] = max(gaps[a], _gap_of_old_faces(mesh, t))
        return LONE, 0
    pattern = PATTERN_OF_CUTS[
        (a != b) + 2 * (a != c) + 4 * (a != d) + 8 * (b != c) + 16 * (b != d) + 32 * (c != d)
    ]  # fmt: skip
    most = FAN_COUNT[pattern]
    if outer:
        for face in range(4):
            if n[face] < 0:
                most += PIECE_COUNT[pattern, face]
    return CUT if GROUPS[pattern] == 2 else DIVIDED, most


@inlined_kernel
def _gap_of_old_faces(mesh, t):
    v, gap = mesh.tetrahedra[t], 0.0
    for face in range(4):
        if mesh.neighbours[t, face] < 0:
            f = FACE_VERTICES[face]
            _, _, _, ab, ac, bc = measure_triangle(mesh.nodes[v[f[0]]], mesh.nodes[v[f[1]]], mesh.nodes[v[f[2]]])
            gap = max(gap, gap_of_triangle(ab, ac, bc, 3))
    return gap


@query_kernel
def boxes_of_nodes(mesh, body, node_shift, nodes, boxes):
    """Grow the boxes (F, 6) of the fragments that hold `nodes` (rows)."""
    for n in nodes:
        p = mesh.nodes[n]
        grow(boxes[body.node_fragment[n + node_shift]], p[0], p[1], p[2])
