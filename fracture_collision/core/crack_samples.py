"""Where a crack is sampled: two points a cut edge, one for each fragment, where its region ends (Glondu 2014, 6.3)."""

from __future__ import annotations

import numpy as np

from fracture_collision.core.compiled import kernel, query_kernel
from fracture_collision.core.cut_tetrahedron import make_cut_scratch, margin
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
def crack_samples(mesh, body, node_shift, edge_shift, tets, low, high):
    """Where the surfaces of fragments low .. high - 1 cross their cut edges: fills body.edge_share.

    edge_share[e, side]: from the edge's node `side`, in parts of the edge, how far its fragment reaches in every
    tetrahedron around the edge (`tets` holds all with a node of these fragments). With planes that agree both shares
    end in the crossing. Where a third fragment's cell reaches over the edge without holding an end, or planes disagree,
    they end before: a sample is never inside another fragment that is in place. Other fragments' shares keep their
    value.
    """
    _crack_samples(mesh, body, node_shift, edge_shift, tets, low, high, make_cut_scratch(), np.empty(64))


@query_kernel
def _crack_samples(mesh, body, node_shift, edge_shift, tets, low, high, work, roots):
    labels, functionals, counts, share = work.labels, work.functionals, work.counts, body.edge_share
    for t in tets:
        for e in range(6):
            edge = mesh.tetrahedron_edges[t, e]
            for side in range(2):
                label = body.node_fragment[mesh.edges[edge, side] + node_shift]
                if low <= label < high:
                    share[edge + edge_shift, side] = 1.0
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
                reach = share_of_segment(
                    slots, functionals, counts, labels, own, True,
                    start[0], start[1], start[2], end[0], end[1], end[2], roots,
                )  # fmt: skip
                share[edge + edge_shift, side] = min(share[edge + edge_shift, side], reach)
