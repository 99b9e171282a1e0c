"""Which tetrahedron holds a point, and which fragment owns it there: insideTest of Glondu 2014, section 4.3.

A uniform grid takes the place of the paper's k-d tree: one cell, then the few tetrahedra whose boxes touch it.
"""

from __future__ import annotations

import math

import numpy as np

from fracture_collision.core.compiled import inlined_kernel
from fracture_collision.core.cut_tetrahedron import collect_margins, owner_slot
from fracture_collision.core.pools import CUT, NEVER_BROKEN

# A point of a shared face belongs to the first of its tetrahedra; rounding must not lose it between them.
WEIGHT_TOLERANCE = -1e-12
# Far from the origin of the body frame a weight is a small difference of large terms, and rounds as these do.
TERM_ROUNDING = 8.0 * np.finfo(np.float64).eps

# A walk that takes more is lost, or was not a short one.
MOST_STEPS = 16


@inlined_kernel
def tetrahedron_at(mesh, k, x, y, z):
    """Row of the tetrahedron of mesh `k` that holds the point (body frame [m]); -1 outside the body."""
    cell = mesh.grid[k, 3]
    i = math.floor((x - mesh.grid[k, 0]) / cell)
    j = math.floor((y - mesh.grid[k, 1]) / cell)
    l = math.floor((z - mesh.grid[k, 2]) / cell)  # noqa: E741
    nx, ny, nz, first = mesh.grid_dims[k]
    if i < 0 or j < 0 or l < 0 or i >= nx or j >= ny or l >= nz:
        return -1
    c = first + (int(i) * ny + int(j)) * nz + int(l)
    for e in range(mesh.cell_begin[c], mesh.cell_begin[c + 1]):
        t = mesh.cell_tets[e]
        b = mesh.barycentric[t]
        least = WEIGHT_TOLERANCE - TERM_ROUNDING * (abs(b[3]) + abs(b[7]) + abs(b[11]))
        w1 = b[0] * x + b[1] * y + b[2] * z + b[3]
        if w1 < least:
            continue
        w2 = b[4] * x + b[5] * y + b[6] * z + b[7]
        if w2 < least:
            continue
        w3 = b[8] * x + b[9] * y + b[10] * z + b[11]
        if w3 >= least and 1.0 - w1 - w2 - w3 >= least:
            return t
    return -1


@inlined_kernel
def tetrahedron_from(mesh, k, start, x, y, z):
    """As tetrahedron_at, by a walk from tetrahedron `start`: over the face that the point is farthest behind."""
    t = start
    for _ in range(MOST_STEPS):
        b = mesh.barycentric[t]
        least = WEIGHT_TOLERANCE - TERM_ROUNDING * (abs(b[3]) + abs(b[7]) + abs(b[11]))
        w1 = b[0] * x + b[1] * y + b[2] * z + b[3]
        w2 = b[4] * x + b[5] * y + b[6] * z + b[7]
        w3 = b[8] * x + b[9] * y + b[10] * z + b[11]
        lowest, face = 1.0 - w1 - w2 - w3, 0
        if w1 < lowest:
            lowest, face = w1, 1
        if w2 < lowest:
            lowest, face = w2, 2
        if w3 < lowest:
            lowest, face = w3, 3
        if lowest >= least:
            return t
        t = mesh.neighbours[t, face]
        if t < 0:
            break
    return tetrahedron_at(mesh, k, x, y, z)


@inlined_kernel
def load_margins(mesh, body, node_shift, edge_shift, t, slot_labels, functionals, counts):
    """Margins of cut tetrahedron `t` into the scratch arrays; returns the number of slots."""
    a, b, c, d = mesh.tetrahedra[t]
    na, nb, nc, nd = (
        body.node_fragment[a + node_shift],
        body.node_fragment[b + node_shift],
        body.node_fragment[c + node_shift],
        body.node_fragment[d + node_shift],
    )
    e = mesh.tetrahedron_edges[t]
    plane = body.edge_plane
    return collect_margins(
        (na, nb, nc, nd),
        (
            plane[e[0] + edge_shift],
            plane[e[1] + edge_shift],
            plane[e[2] + edge_shift],
            plane[e[3] + edge_shift],
            plane[e[4] + edge_shift],
            plane[e[5] + edge_shift],
        ),
        (a > b, a > c, a > d, b > c, b > d, c > d),
        body.planes,
        slot_labels,
        functionals,
        counts,
    )


@inlined_kernel
def owner_in_tetrahedron(pools, f, t, x, y, z, scratch, thread):
    """Fragment row that owns the point within tetrahedron `t` of fragment `f`'s body."""
    fragment = pools.fragment
    tet_shift = fragment.tet_shift[f]
    if tet_shift == NEVER_BROKEN:
        return f
    node_shift = fragment.node_shift[f]
    alone = pools.body.tet_fragment[t + tet_shift]
    if alone != CUT:
        return alone
    labels = scratch.slot_labels[thread]
    functionals = scratch.functionals[thread]
    counts = scratch.counts[thread]
    slots = load_margins(pools.mesh, pools.body, node_shift, fragment.edge_shift[f], t, labels, functionals, counts)
    return labels[owner_slot(slots, functionals, counts, labels, x, y, z)]


@inlined_kernel
def holds_fragment(pools, f, t):
    """Whether tetrahedron `t` has a node of fragment `f`."""
    tet_shift = pools.fragment.tet_shift[f]
    if tet_shift == NEVER_BROKEN:
        return True
    alone = pools.body.tet_fragment[t + tet_shift]
    if alone != CUT:
        return alone == f
    shift = pools.fragment.node_shift[f]
    v = pools.mesh.tetrahedra[t]
    label = pools.body.node_fragment
    return label[v[0] + shift] == f or label[v[1] + shift] == f or label[v[2] + shift] == f or label[v[3] + shift] == f
