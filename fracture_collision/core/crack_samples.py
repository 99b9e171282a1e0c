"""Where a crack is sampled: two points a cut edge, one for each fragment, where its region ends (Glondu 2014, 6.3)."""

from __future__ import annotations

import numpy as np

from fracture_collision.core.cell_cut import reach_along
from fracture_collision.core.compiled import inlined_kernel, kernel, query_kernel
from fracture_collision.core.cut_tetrahedron import EDGE_FIRST, EDGE_SECOND, margin, owner_slot
from fracture_collision.core.plain_cut import (
    CELLS,
    LONE,
    MIXED,
    PLAIN,
    ROUNDING,
    crossing,
    kind_of_cut,
)
from fracture_collision.core.point_location import load_margins


@query_kernel
def share_of_segment(slots, functionals, counts, labels, own, of_own, x0, y0, z0, x1, y1, z1, roots):
    """Share of a segment within one tetrahedron, from its start to where slot `own`'s region ends: 0 .. 1.

    of_own False: to where it begins. At a tie the smaller of `labels` (slots,) has it, as in owner_slot.
    Margins are piecewise linear along the segment; between two neighbouring roots of their differences the owner stays.
    `roots` (64,): room for them.
    """
    used = 0
    for q in range(counts[own]):
        f = functionals[own, q]
        f0 = f[0] * x0 + f[1] * y0 + f[2] * z0 - f[3]
        f1 = f[0] * x1 + f[1] * y1 + f[2] * z1 - f[3]
        for s in range(slots):
            if s == own:
                continue
            for r in range(counts[s]):
                g = functionals[s, r]
                d0 = f0 - (g[0] * x0 + g[1] * y0 + g[2] * z0 - g[3])
                d1 = f1 - (g[0] * x1 + g[1] * y1 + g[2] * z1 - g[3])
                if (d0 > 0.0) != (d1 > 0.0):
                    roots[used] = min(max(d0 / (d0 - d1), 0.0), 1.0)
                    used += 1
    for i in range(1, used):
        root, k = roots[i], i
        while k > 0 and roots[k - 1] > root:
            roots[k] = roots[k - 1]
            k -= 1
        roots[k] = root
    before = 0.0
    for i in range(used + 1):
        after = roots[i] if i < used else 1.0
        if after > before:
            middle = 0.5 * (before + after)
            x, y, z = x0 + middle * (x1 - x0), y0 + middle * (y1 - y0), z0 + middle * (z1 - z0)
            mine = margin(functionals[own], counts[own], x, y, z)
            owned = True
            for s in range(slots):
                if s != own:
                    other = margin(functionals[s], counts[s], x, y, z)
                    owned = owned and (other < mine or (other == mine and labels[own] < labels[s]))
            if owned != of_own:
                return before
        before = after
    return 1.0


@kernel
def crack_samples(mesh, body, node_shift, edge_shift, touched, low, high, certain, overlap, scratch):
    """Where the surfaces of fragments low .. high - 1 cross their cut edges: fills body.edge_share.

    edge_share[e, side]: from the edge's node `side`, in parts of the edge, how far its fragment reaches in every
    tetrahedron around the edge (`touched` holds all with a node of these fragments). With planes that agree both shares
    end in the crossing. Where a third fragment's cell reaches over the edge without holding an end, or planes disagree,
    they end before: a sample is never inside another fragment that is in place. Other fragments' shares keep their
    value.

    overlap (F,) [m] grows where that fails: a fragment's own node has nothing of it around, or a plane now reaches over
    an older neighbour's sample. A sample at the end of a stretch that its fragment owns is on that one's border.
    certain: that cannot be, there is no older neighbour and no tetrahedron is MIXED.
    """
    room = 0 if certain else 1
    at_home = np.zeros(room * len(mesh.nodes), np.uint8)
    farthest = np.zeros((room * len(mesh.edges), 2))
    _crack_samples(mesh, body, node_shift, edge_shift, touched, low, high, certain, at_home, farthest, scratch)
    if not certain:
        _note_overlaps(mesh, body, node_shift, edge_shift, touched, low, high, at_home, farthest, overlap)


@query_kernel
def _note_overlaps(mesh, body, node_shift, edge_shift, touched, low, high, at_home, farthest, overlap):
    """`overlap` of the fragments whose samples are not at the end of a stretch of their own.

    at_home (nodes,): 1 where some tetrahedron's margins give the node to its own fragment; farthest (edges, 2): how far
    a fragment reaches along its cut edge in the tetrahedron where that is most.
    """
    for t in touched.rows[: touched.own]:
        if touched.kinds[t - touched.first] == LONE:
            continue
        for e in range(6):
            edge = mesh.tetrahedron_edges[t, e]
            if body.edge_plane[edge + edge_shift] < 0:
                continue
            for side in range(2):
                node = mesh.edges[edge, side]
                # on the old surface nothing is deep in place
                if mesh.on_surface[node] and body.edge_share[edge + edge_shift, side] == 0.0:
                    continue
                label = body.node_fragment[node + node_shift]
                share = body.edge_share[edge + edge_shift, side]
                if share > 0.0:
                    home = farthest[edge, side] >= share * (1.0 - ROUNDING)
                else:
                    home = at_home[node] == 1 and low <= label < high
                if not home:
                    overlap[label] = np.inf


@query_kernel
def _crack_samples(
    mesh, body, node_shift, edge_shift, touched, low, high, certain, at_home, farthest, scratch
):
    work, plain, roots = scratch.work, scratch.plain, scratch.roots
    labels, functionals, counts, share = work.labels, work.functionals, work.counts, body.edge_share
    for t in touched.rows[: touched.own]:
        if touched.kinds[t - touched.first] == LONE:
            continue
        for e in range(6):
            edge = mesh.tetrahedron_edges[t, e]
            for side in range(2):
                label = body.node_fragment[mesh.edges[edge, side] + node_shift]
                if low <= label < high:
                    share[edge + edge_shift, side] = 1.0
    for t in touched.rows[: touched.own]:
        kind = touched.kinds[t - touched.first]
        if kind != MIXED and not certain:
            for i in range(4):
                at_home[mesh.tetrahedra[t, i]] = 1
        if kind == LONE:
            continue
        if kind == PLAIN:
            _sample_plain(mesh, body, node_shift, edge_shift, t, plain, low, high, certain, farthest)
            continue
        slots = load_margins(mesh, body, node_shift, edge_shift, t, labels, functionals, counts)
        for i in range(4 if kind == MIXED else 0):
            v = mesh.tetrahedra[t, i]
            p = mesh.nodes[v]
            s = owner_slot(slots, functionals, counts, labels, p[0], p[1], p[2])
            if labels[s] == body.node_fragment[v + node_shift]:
                at_home[v] = 1
        for e in range(6):
            edge = mesh.tetrahedron_edges[t, e]
            if body.edge_plane[edge + edge_shift] < 0:
                continue
            for side in range(2):
                label = body.node_fragment[mesh.edges[edge, side] + node_shift]
                own = 0
                while labels[own] != label:
                    own += 1
                start, end = mesh.nodes[mesh.edges[edge, side]], mesh.nodes[mesh.edges[edge, 1 - side]]
                if kind == CELLS:
                    reach = reach_along(work, own, start, end)
                else:
                    reach = share_of_segment(
                        slots, functionals, counts, labels, own, True,
                        start[0], start[1], start[2], end[0], end[1], end[2], roots,
                    )  # fmt: skip
                if not certain:
                    farthest[edge, side] = max(farthest[edge, side], reach)
                if low <= label < high:
                    share[edge + edge_shift, side] = min(share[edge + edge_shift, side], reach)


@inlined_kernel
def _sample_plain(mesh, body, node_shift, edge_shift, t, plain, low, high, certain, farthest):
    """Both shares of each cut edge of a tetrahedron that one plane parts."""
    kind_of_cut(mesh, body, node_shift, edge_shift, t, plain)
    for e in range(6):
        i, j = EDGE_FIRST[e], EDGE_SECOND[e]
        if (plain.heights[i] > 0.0) == (plain.heights[j] > 0.0):
            continue
        below, above = (i, j) if plain.heights[i] < 0.0 else (j, i)
        share = crossing(plain, below, above)
        edge = mesh.tetrahedron_edges[t, e]
        side = 0 if mesh.tetrahedra[t, below] == mesh.edges[edge, 0] else 1
        for k in range(2):
            label, reach = plain.labels[k], share if k == 0 else 1.0 - share
            at = side if k == 0 else 1 - side
            if not certain:
                farthest[edge, at] = max(farthest[edge, at], reach)
            if low <= label < high:
                body.edge_share[edge + edge_shift, at] = min(body.edge_share[edge + edge_shift, at], reach)
