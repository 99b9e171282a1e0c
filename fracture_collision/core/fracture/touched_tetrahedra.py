"""The tetrahedra that a fracture affects, and how each is cut: the input of all later passes of an update."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fracture_collision.core.fracture.cut_patterns import FAN_COUNT, GROUPS, PATTERN_OF_CUTS, PIECE_COUNT
from fracture_collision.core.fracture.surface_rows import Broken, Sums, gap_of_triangle, grow, measure_triangle
from fracture_collision.core.memory.compiled import query_kernel
from fracture_collision.core.memory.pools import OWNER, Pools
from fracture_collision.core.mesh.cut_tetrahedron import CUT, DIVIDED, FACE_VERTICES, LONE, crossing_share
from fracture_collision.core.mesh.moments import add_row


class Touched(NamedTuple):
    """The tetrahedra that a fracture affects: those with a node of the broken fragment."""

    rows: np.ndarray  # int32
    first: int  # row of the mesh's first tetrahedron; `kinds` begins there
    kinds: np.ndarray  # (m,) uint8: LONE, CUT or DIVIDED of cut_tetrahedron.py; 0: not affected
    cut: np.ndarray  # int32: those of `rows` that are not LONE
    room: int  # upper bound of the number of surface rows in them


class TouchedRoom(NamedTuple):
    """Working space for the tetrahedra of one mesh, kept between fractures.

    A fracture that affects few tetrahedra need not clear every mark.
    """

    kinds: np.ndarray  # (m,) uint8, as the last Touched.kinds
    rows: np.ndarray  # (m,) int32
    cut: np.ndarray  # (m,) int32
    used: np.ndarray  # (2,) int64: number of `rows` with marks, and the first tetrahedron of their mesh


def touched_room(tetrahedra: int) -> TouchedRoom:
    """TouchedRoom for a mesh of `tetrahedra` tetrahedra, without marks."""
    return TouchedRoom(
        np.zeros(tetrahedra, np.uint8), np.empty(tetrahedra, np.int32), np.empty(tetrahedra, np.int32),
        np.zeros(2, np.int64),
    )  # fmt: skip


class Cut(NamedTuple):
    """Where a fragment is cut."""

    nodes: np.ndarray  # (n,) int: all mesh nodes of the fragment
    parts: np.ndarray  # (n,) int: the new fragment of each, relative to the first
    edges: np.ndarray  # (k,) int: mesh edges cut, ascending
    first_plane: int  # row of the first one's plane


def find_touched(pools: Pools, broken: Broken, cut: Cut, tetrahedra: int, sums: Sums, room: TouchedRoom) -> Touched:
    """Cut a fragment into the new ones of a Broken, whose rows exist; returns the Touched tetrahedra.

    tetrahedra: number in its mesh; room: the mesh's TouchedRoom. Tetrahedra of one fragment are complete after this:
    their owner is written, their moments are added to the Sums, the gap is grown by their faces of the old surface, the
    box by their nodes.
    """
    used, cuts, rows, first = _find_touched(pools.mesh, pools.body, pools.fragment, broken, cut, tetrahedra, sums, room)
    return Touched(room.rows[:used], first, room.kinds, room.cut[:cuts], rows)


@query_kernel
def _find_touched(mesh, body, fragment, broken, cut, tetrahedra, sums, room):
    """find_touched on the parts of the pools that it needs.

    Returns (number of touched tetrahedra, number cut, upper bound of surface rows, row of the mesh's first
    tetrahedron).
    """
    first_node, first_edge, _, first_tet, _ = mesh.first[broken.mesh]
    _inherit(fragment, broken)
    for f in range(broken.first, broken.end):
        sums.gaps[f] = 0.0
        for i in range(sums.moments.shape[1]):
            sums.moments[f, i] = 0.0
    _label(mesh, body, fragment, broken, first_node, cut)
    _place_crossings(mesh, body, broken.edge_shift, first_edge, cut)
    for i in range(room.used[0]):
        room.kinds[room.rows[i] - room.used[1]] = 0
    room.used[0], room.used[1] = 0, first_tet
    own = first_node, first_tet, first_tet + tetrahedra
    used, cuts, rows = _sort_all(mesh, body, broken, own, cut.nodes, sums, room)
    room.used[0] = used
    return used, cuts, rows, first_tet


@query_kernel
def _inherit(fragment, broken):
    """Copy the body's values to each fragment; set its box empty."""
    parent = broken.parent
    for f in range(broken.first, broken.end):
        fragment.kind[f], fragment.mesh[f], fragment.radius[f] = (
            fragment.kind[parent], fragment.mesh[parent], fragment.radius[parent]
        )  # fmt: skip
        fragment.node_shift[f], fragment.tet_shift[f], fragment.edge_shift[f] = (
            fragment.node_shift[parent], fragment.tet_shift[parent], fragment.edge_shift[parent]
        )  # fmt: skip
        fragment.seeds[f, 0], fragment.seeds[f, 1] = fragment.seeds[parent, 0], fragment.seeds[parent, 1]
        for i in range(4):
            fragment.shape[f, i] = fragment.shape[parent, i]
        for i in range(3):
            fragment.box[f, i], fragment.box[f, 3 + i] = np.inf, -np.inf


@query_kernel
def _label(mesh, body, fragment, broken, first_node, cut):
    """Label the nodes with their new fragments, and grow these fragments' boxes."""
    nodes, parts, low, shift = cut.nodes, cut.parts, broken.first, broken.node_shift
    for i in range(len(nodes)):
        n = nodes[i] + first_node
        p = mesh.nodes[n]
        body.node_fragment[n + shift] = low + parts[i]
        grow(fragment.box[low + parts[i]], p[0], p[1], p[2])


@query_kernel
def _place_crossings(mesh, body, edge_shift, first_edge, cut):
    """Cut the edges of a mesh by their planes: edge_plane, edge_event, edge_share.

    Glondu 2014, section 6.3: the crossing is a sample of both fragments.
    """
    first_plane = cut.first_plane
    for i in range(len(cut.edges)):
        e = cut.edges[i] + first_edge
        a, b = mesh.edges[e, 0], mesh.edges[e, 1]
        body.edge_plane[e + edge_shift], body.edge_event[e + edge_shift] = first_plane + i, first_plane
        body.edge_share[e + edge_shift] = crossing_share(mesh.nodes, a, b, body.planes[first_plane + i])


@query_kernel
def _sort_all(mesh, body, broken, own, nodes, sums, room):
    """Fill `room` with the tetrahedra of `nodes`; returns (their number, number cut, upper bound of surface rows).

    own: the mesh's first node, its first tetrahedron, and the end of these.
    """
    first_node, first_tet, last_tet = own
    kinds, rows, cut = room.kinds, room.rows, room.cut
    used = cuts = most = 0
    if 24 * len(nodes) > last_tet - first_tet:
        # most tetrahedra have such a node: reading all labels in order is faster than gathering
        for t in range(first_tet, last_tet):
            kind, more = _sort_in(mesh, body, broken, t, sums)
            # branchless, as the outcome is unpredictable: always written, kept only if counted
            kinds[t - first_tet], rows[used], cut[cuts] = kind, t, t
            used, cuts, most = used + (kind > 0), cuts + (kind > LONE), most + more
    else:
        for node in nodes:
            # node_tets_begin has one row more than nodes in each mesh before this one
            n = node + first_node + broken.mesh
            for e in range(mesh.node_tets_begin[n], mesh.node_tets_begin[n + 1]):
                t = mesh.node_tets[e]
                if kinds[t - first_tet] == 0:
                    kind, more = _sort_in(mesh, body, broken, t, sums)
                    kinds[t - first_tet], rows[used], cut[cuts] = kind, t, t
                    used, cuts, most = used + 1, cuts + (kind > LONE), most + more
    return used, cuts, most


@query_kernel
def _sort_in(mesh, body, broken, t, sums):
    """(kind, 0 if the fracture does not affect it; upper bound of surface rows) of tetrahedron `t`."""
    v, node_shift, tet_shift = mesh.tetrahedra[t], broken.node_shift, broken.tet_shift
    a, b = body.node_fragment[v[0] + node_shift], body.node_fragment[v[1] + node_shift]
    c, d = body.node_fragment[v[2] + node_shift], body.node_fragment[v[3] + node_shift]
    low, high = min(a, b, c, d), max(a, b, c, d)
    if high < broken.first:
        return 0, 0
    n = mesh.neighbours[t]
    outer = n[0] < 0 or n[1] < 0 or n[2] < 0 or n[3] < 0
    if low == high:
        body.regions[t + tet_shift, OWNER], body.cut_count[t + tet_shift] = a, 0
        m = mesh.moments[t]
        add_row(sums.moments[a], m[0], m[1], m[2], m[3], m[4], m[5], m[6], m[7], m[8], m[9])
        if outer:
            sums.gaps[a] = max(sums.gaps[a], _gap_of_old_faces(mesh, t))
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


@query_kernel
def _gap_of_old_faces(mesh, t):
    v, gap = mesh.tetrahedra[t], 0.0
    for face in range(4):
        if mesh.neighbours[t, face] < 0:
            f = FACE_VERTICES[face]
            _, _, _, ab, ac, bc = measure_triangle(mesh.nodes[v[f[0]]], mesh.nodes[v[f[1]]], mesh.nodes[v[f[2]]])
            gap = max(gap, gap_of_triangle(ab, ac, bc, 3))
    return gap
