"""The averaged field after a fracture: exact at the new cracks, then front by front (Glondu 2014, 4.2, eq. 1 and 2).

Every node of a tetrahedron crossed by the new cracks measures the surface of its own fragment in it; these nodes are
the first front. Step i + 1 visits all neighbours, over edges within one fragment, of the nodes reached in step i; a
node is reached if the average of the distances its neighbours in the front propagate (eq. 1) is below its stored one.

Added here, for the certificate: each node also carries a point that is certainly not strictly inside its fragment, and
the fronts propagate it. It stays valid: a border point remains one when the fragment breaks again.
"""

from __future__ import annotations

import math

import numpy as np

from fracture_collision.core.field.flood import (
    EVERYTHING,
    NO_SOURCE,
    nearest_in_tetrahedron,
    nothing_within,
    outward_direction,
)
from fracture_collision.core.fracture.surface_rows import Broken
from fracture_collision.core.glondu2014.averaged_field import propagated_distance
from fracture_collision.core.memory.compiled import kernel, query_kernel
from fracture_collision.core.memory.pools import Pools
from fracture_collision.core.mesh.sample_numbers import FIRST_NODE, NODES

# A distance counts as shorter by more than this share of R only: two nodes must not exchange rounding errors forever.
SHORTER = 1e-12


@query_kernel
def measure_at_cracks(pools, node_field, broken, tets, first_plane, in_front, front):
    """Measure the nodes of the new fragments in those of `tets` that planes from row `first_plane` on cut.

    Lowers their stored distances to those of their fragment's surface in the tetrahedron. Marks them in `in_front` (n,)
    and lists them in `front` (n,), by mesh node; returns their number.
    """
    mesh, body = pools.mesh, pools.body
    node_shift, edge_shift, first_node = broken.node_shift, broken.edge_shift, mesh.first[broken.mesh, FIRST_NODE]
    used = 0
    for t in tets:
        crossed = False
        for e in range(6):
            crossed = crossed or body.edge_plane[mesh.tetrahedron_edges[t, e] + edge_shift] >= first_plane
        if not crossed:
            continue
        for i in range(4):
            v = mesh.tetrahedra[t, i]
            f = body.node_fragment[v + node_shift]
            if f < broken.first or f >= broken.end:
                continue
            if not in_front[v - first_node]:
                in_front[v - first_node] = 1
                front[used] = v - first_node
                used += 1
            x, y, z = mesh.nodes[v]
            best = nearest_in_tetrahedron(pools, f, t, x, y, z, EVERYTHING, nothing_within(math.inf))
            if best[5] == NO_SOURCE:
                continue
            row = node_field[v + node_shift]
            sx, sy, sz = row[4] - x, row[5] - y, row[6] - z
            if best[0] < sx * sx + sy * sy + sz * sz:
                row[4], row[5], row[6] = best[1], best[2], best[3]
            if math.sqrt(best[0]) < row[0]:
                row[0] = math.sqrt(best[0])
                row[1], row[2], row[3] = outward_direction(pools, f, x, y, z, best, True)
    return used


@kernel
def propagate_fronts(body, neighbours, in_front, front, used, shorter):
    """Propagate from the first `used` nodes of `front` until no distance is reduced; returns the number of steps.

    body: nodes (n, 3) [m], labels (n,) and node_field (n, 7), the rows of one body; neighbours: of InteriorField, where
    each node's begin and all of them; in_front (n,) marks the front, `front` (n,) lists it; shorter [m]: the least
    reduction that counts. Each step computes its values from the previous step's only, so the order of the nodes does
    not matter.
    """
    nodes, labels, node_field = body
    neighbours_begin, neighbour = neighbours
    n = len(nodes)
    seen = np.zeros(n, np.uint8)
    reached = np.empty(n, np.int32)
    value = np.empty((n, 7))
    steps = 0
    while used:
        steps += 1
        count = 0
        for k in range(used):
            j = front[k]
            for e in range(neighbours_begin[j], neighbours_begin[j + 1]):
                p = neighbour[e]
                if labels[p] == labels[j] and not seen[p]:
                    seen[p] = 1
                    reached[count] = p
                    count += 1
        for k in range(count):
            _average_of_front(body, neighbours, in_front, reached[k], value[k])
        for k in range(used):
            in_front[front[k]] = 0
        used = 0
        for k in range(count):
            p = reached[k]
            seen[p] = 0
            for d in range(4, 7):
                node_field[p, d] = value[k, d]
            # A node lies inside its fragment: a negative average, from beyond a bend of the surface, is not a distance.
            if 0.0 <= value[k, 0] < node_field[p, 0] - shorter:
                for d in range(4):
                    node_field[p, d] = value[k, d]
                in_front[p] = 1
                front[used] = p
                used += 1
    return steps


@query_kernel
def _average_of_front(body, neighbours, in_front, p, value):
    """Eq. 1 and 2 at node `p` over its neighbours in the front, and the nearest of their certain points and its own.

    Writes value (7,), a row of node_field.
    """
    nodes, labels, node_field = body
    neighbours_begin, neighbour = neighbours
    x, y, z = nodes[p]
    own = node_field[p]
    cx, cy, cz = own[4], own[5], own[6]
    sx, sy, sz = cx - x, cy - y, cz - z
    nearest = sx * sx + sy * sy + sz * sz
    d, nx, ny, nz, total = 0.0, 0.0, 0.0, 0.0, 0.0
    for e in range(neighbours_begin[p], neighbours_begin[p + 1]):
        j = neighbour[e]
        if not in_front[j] or labels[j] != labels[p]:
            continue
        row = node_field[j]
        px, py, pz = nodes[j, 0] - x, nodes[j, 1] - y, nodes[j, 2] - z
        weight = 1.0 / (px * px + py * py + pz * pz)
        d += weight * propagated_distance(row, px, py, pz)
        nx, ny, nz = nx + weight * row[1], ny + weight * row[2], nz + weight * row[3]
        total += weight
        sx, sy, sz = row[4] - x, row[5] - y, row[6] - z
        if sx * sx + sy * sy + sz * sz < nearest:
            nearest = sx * sx + sy * sy + sz * sz
            cx, cy, cz = row[4], row[5], row[6]
    value[0] = d / total
    length = math.sqrt(nx * nx + ny * ny + nz * nz)
    if length > 0.0:
        value[1], value[2], value[3] = nx / length, ny / length, nz / length
    else:
        # the directions cancel: keep the stored one
        value[1], value[2], value[3] = own[1], own[2], own[3]
    value[4], value[5], value[6] = cx, cy, cz


def update_averaged_field(
    pools: Pools, node_field: np.ndarray, neighbours: tuple[np.ndarray, np.ndarray], broken: Broken,
    touched: np.ndarray, first_plane: int,
) -> None:  # fmt: skip
    """Update the field of the fragments that planes from row `first_plane` on have made (Glondu 2014, 4.2).

    node_field: of FieldPool; neighbours: of the body's InteriorField, where each node's begin and all of them; touched
    (m,): rows of the tetrahedra that the fracture affects.
    """
    first_node, n = (int(pools.mesh.first[broken.mesh, column]) for column in (FIRST_NODE, NODES))
    in_front, front = np.zeros(n, np.uint8), np.empty(n, np.int32)
    used = measure_at_cracks(pools, node_field, broken, touched, first_plane, in_front, front)
    own = slice(first_node + broken.node_shift, first_node + broken.node_shift + n)
    nodes = pools.mesh.nodes[first_node : first_node + n]
    body = nodes, pools.body.node_fragment[own], node_field[own]
    propagate_fronts(body, neighbours, in_front, front, used, SHORTER * pools.fragment.radius[broken.first])
