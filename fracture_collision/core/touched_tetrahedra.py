"""Which tetrahedra a fracture concerns, and how each of them is cut: what all later passes of an update go by."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fracture_collision.core.compiled import kernel, query_kernel
from fracture_collision.core.cut_tetrahedron import CUT, LONE, crossing_share
from fracture_collision.core.surface_rows import grow


class Touched(NamedTuple):
    """The tetrahedra that a fracture concerns: those with a node of the fragment that broke."""

    rows: np.ndarray  # int32
    first: int  # row of the mesh's first tetrahedron; `kinds` begins there
    kinds: np.ndarray  # (m,) uint8: LONE, CUT or DIVIDED of cut_tetrahedron.py


@kernel
def tetrahedra_of_nodes(mesh, body, node_shift, first_node_row, first_tet, last_tet, nodes, fragment):
    """Touched of the fragment whose nodes are `nodes` (rows), all that carry the label `fragment`; kinds are zero.

    first_tet .. last_tet - 1: the mesh's tetrahedra.
    """
    count = last_tet - first_tet
    seen = np.zeros(count, np.uint8)
    found = np.empty(count, dtype=np.int32)
    used = 0
    if 24 * len(nodes) > count:
        # most tetrahedra have one: reading all labels in order beats gathering
        for t in range(first_tet, last_tet):
            v = mesh.tetrahedra[t]
            own = False
            for i in range(4):
                own = own or body.node_fragment[v[i] + node_shift] == fragment
            if own:
                found[used] = t
                used += 1
    else:
        for n in nodes:
            r = n + first_node_row
            for e in range(mesh.node_tets_begin[r], mesh.node_tets_begin[r + 1]):
                t = mesh.node_tets[e]
                if seen[t - first_tet] == 0:
                    seen[t - first_tet] = 1
                    found[used] = t
                    used += 1
    return Touched(found[:used].copy(), first_tet, np.zeros(count, np.uint8))


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


@query_kernel
def classify(mesh, body, node_shift, touched):
    """Fill kinds of `touched`, for its rows: LONE or CUT."""
    for t in touched.rows:
        v = mesh.tetrahedra[t]
        label = body.node_fragment[v[0] + node_shift]
        alone = True
        for i in range(1, 4):
            alone = alone and body.node_fragment[v[i] + node_shift] == label
        touched.kinds[t - touched.first] = LONE if alone else CUT


@kernel
def boxes_of_nodes(mesh, body, node_shift, nodes, boxes):
    """Grow the boxes (F, 6) of the fragments that hold `nodes` (rows)."""
    for n in nodes:
        p = mesh.nodes[n]
        grow(boxes[body.node_fragment[n + node_shift]], p[0], p[1], p[2])
