"""The averaged field of a whole body, exact: at its nodes and on a dense regular grid (Glondu 2014, 4.1, 4.2, 4.4).

Made by the exact flood when a body of this geometry first breaks under the averaged field; equal geometries share it.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from fracture_collision.core.compiled import query_kernel
from fracture_collision.core.flood import (
    EVERYTHING,
    NO_SOURCE,
    nearest_from_inside,
    nearest_from_outside,
    outward_direction,
)
from fracture_collision.core.point_location import tetrahedron_at
from fracture_collision.core.pools import Pools
from fracture_collision.core.scratch import make_scratch
from fracture_collision.core.tet_mesh import TetMesh

# Grid cells along a cell of the location grid, which is about an edge long. Interpolation errs where the nearest
# surface changes within a cell; three cells an edge keep that below the error that eq. 1 makes between nodes, with
# fewer than ten values a tetrahedron (benchmarks/field_errors.py prints both).
CELLS_PER_EDGE = 3


class InteriorField(NamedTuple):
    node_field: np.ndarray  # (n, 7) float64 [m], as BodyPool.node_field
    origin: np.ndarray  # (3,) float64 [m] first grid point
    cell: float  # [m]
    dims: np.ndarray  # (3,) int32 grid points along x, y, z
    depth: np.ndarray  # (points,) float64 [m] signed distance of each grid point, positive inside
    neighbours_begin: np.ndarray  # (n + 1,) int32
    neighbours: np.ndarray  # (2 edges,) int32: the nodes at the other ends of a node's edges, ascending


def make_interior_field(pools: Pools, row: int, first_node: int, mesh: TetMesh) -> InteriorField:
    """Measure the whole body `row`, whose mesh has its nodes from row `first_node` of `pools` on."""
    scratch = make_scratch(1, len(pools.mesh.tetrahedra), 1)
    node_field = np.zeros((len(mesh.nodes), 7))
    _measure_nodes(pools, row, first_node, mesh.node_normals, node_field, scratch)
    cell = mesh.grid_cell / CELLS_PER_EDGE
    # Half a cell of air, so that no point of the body lies on the grid's border.
    origin = mesh.box[:3] - 0.5 * cell
    dims = (np.floor((mesh.box[3:] - origin) / cell) + 2).astype(np.int32)
    depth = np.empty(int(np.prod(dims)))
    _measure_grid(pools, row, origin, cell, dims, depth, scratch)
    begin, neighbours = _edge_neighbours(mesh.edges, len(mesh.nodes))
    return InteriorField(node_field, origin, cell, dims, depth, begin, neighbours)


def _edge_neighbours(edges: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    both = np.concatenate([edges, edges[:, ::-1]])
    both = both[np.lexsort((both[:, 1], both[:, 0]))]
    begin = np.zeros(count + 1, np.int32)
    begin[1:] = np.cumsum(np.bincount(both[:, 0], minlength=count))
    return begin, np.ascontiguousarray(both[:, 1], dtype=np.int32)


@query_kernel
def _measure_nodes(pools, f, first_node, normals, node_field, scratch):
    """Distance, direction and nearest surface point of each node; on the surface 0, the normal, the node itself."""
    mesh = pools.mesh
    k = pools.fragment.mesh[f]
    for i in range(len(node_field)):
        x, y, z = mesh.nodes[first_node + i]
        row = node_field[i]
        if mesh.on_surface[first_node + i]:
            row[0], row[1], row[2], row[3] = 0.0, normals[i, 0], normals[i, 1], normals[i, 2]
            row[4], row[5], row[6] = x, y, z
            continue
        t = mesh.node_tets[mesh.node_tets_begin[first_node + i + k]]
        best = nearest_from_inside(pools, f, t, x, y, z, math.inf, EVERYTHING, scratch, 0)
        row[0] = math.sqrt(best[0])
        row[1], row[2], row[3] = outward_direction(pools, f, x, y, z, best, True)
        row[4], row[5], row[6] = best[1], best[2], best[3]


@query_kernel
def _measure_grid(pools, f, origin, cell, dims, depth, scratch):
    """Signed distance at the grid points; those too far outside to share a cell with the body get minus a diagonal."""
    diagonal = math.sqrt(3.0) * cell * (1.0 + 1e-9)
    k = pools.fragment.mesh[f]
    for i in range(dims[0]):
        for j in range(dims[1]):
            for l in range(dims[2]):  # noqa: E741
                x, y, z = origin[0] + i * cell, origin[1] + j * cell, origin[2] + l * cell
                t = tetrahedron_at(pools.mesh, k, x, y, z)
                at = (i * dims[1] + j) * dims[2] + l
                if t >= 0:
                    best = nearest_from_inside(pools, f, t, x, y, z, math.inf, EVERYTHING, scratch, 0)
                    depth[at] = math.sqrt(best[0])
                else:
                    best = nearest_from_outside(pools, f, t, x, y, z, diagonal, EVERYTHING, scratch, 0)
                    depth[at] = -diagonal if best[5] == NO_SOURCE else -math.sqrt(best[0])
