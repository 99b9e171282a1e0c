"""Loads a tetrahedron with its labels and crossings into the working memory of an update, and looks up its pattern."""

from __future__ import annotations

from fracture_collision.core.fracture.cut_patterns import CUT_COUNT, CUT_EDGES, PATTERN_OF_CUTS, PATTERN_OF_SIDE
from fracture_collision.core.memory.compiled import query_kernel
from fracture_collision.core.mesh.cut_tetrahedron import EDGE_FIRST, EDGE_SECOND, point_on_edge


@query_kernel
def _load_nodes(mesh, body, node_shift, t, work):
    v = mesh.tetrahedra[t]
    for i in range(4):
        work.labels[i] = body.node_fragment[v[i] + node_shift]
        p = mesh.nodes[v[i]]
        work.points[i, 0], work.points[i, 1], work.points[i, 2] = p[0], p[1], p[2]


@query_kernel
def load_sides(mesh, body, broken, t, work):
    """(bit mask of the first fragment's nodes, first fragment, second) of a tetrahedron of two, smaller row first."""
    _load_nodes(mesh, body, broken.node_shift, t, work)
    a, b, c, d = work.labels[0], work.labels[1], work.labels[2], work.labels[3]
    low, high = min(a, b, c, d), max(a, b, c, d)
    return (a == low) + 2 * (b == low) + 4 * (c == low) + 8 * (d == low), low, high


@query_kernel
def load_pattern(mesh, body, broken, t, work):
    """Load a tetrahedron's nodes and labels; returns its pattern."""
    _load_nodes(mesh, body, broken.node_shift, t, work)
    a, b, c, d = work.labels[0], work.labels[1], work.labels[2], work.labels[3]
    return PATTERN_OF_CUTS[
        (a != b) + 2 * (a != c) + 4 * (a != d) + 8 * (b != c) + 16 * (b != d) + 32 * (c != d)
    ]  # fmt: skip


@query_kernel
def load_plane(mesh, body, broken, t, side, work):
    """Load the crossings of a tetrahedron of two fragments, with the nodes of the first as bit mask `side`.

    Returns (whether its planes are bitwise equal, the plane (nx, ny, nz, offset) out of the first fragment).
    """
    v = mesh.tetrahedra[t]
    pattern = PATTERN_OF_SIDE[side]
    same, nx, ny, nz, offset = True, 0.0, 0.0, 0.0, 0.0
    for c in range(CUT_COUNT[pattern]):
        e = CUT_EDGES[pattern, c]
        edge = mesh.tetrahedron_edges[t, e] + broken.edge_shift
        i = EDGE_FIRST[e]
        a, b = v[i], v[EDGE_SECOND[e]]
        point_on_edge(mesh.nodes, min(a, b), max(a, b), body.edge_share[edge], work.crossings[e])
        # planes point away from the smaller node
        sign = 1.0 if (a < b) == ((side >> i & 1) == 1) else -1.0
        p = body.planes[body.edge_plane[edge]]
        px, py, pz, h = sign * p[0], sign * p[1], sign * p[2], sign * p[3]
        if c == 0:
            nx, ny, nz, offset = px, py, pz, h
        same = same and nx == px and ny == py and nz == pz and offset == h
    return same, (nx, ny, nz, offset)
