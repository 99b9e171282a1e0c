"""The averaged field of a whole body, exact at its nodes and on a dense regular grid (Glondu 2014, 4.1, 4.2, 4.4).

It is made when a body of this geometry first breaks under the averaged field; equal geometries share it.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from fracture_collision.core.memory.compiled import query_kernel
from fracture_collision.core.mesh.tet_mesh import TetMesh
from fracture_collision.core.mesh.triangle_field import (
    STACK,
    build_triangle_mesh,
    triangle_distance,
    triangle_pool,
)
from fracture_collision.grouping import begins_of

# Grid cells along a cell of the location grid, which is about an edge long. Interpolation is wrong where the nearest
# surface changes within a cell; three cells per edge keep that error below the error of eq. 1 between nodes, with 5 to
# 12 values per tetrahedron (benchmarks/field_errors.py prints both).
CELLS_PER_EDGE = 3


class InteriorField(NamedTuple):
    """The averaged field of an unbroken body at its n nodes and on a grid."""

    node_field: np.ndarray  # (n, 7) float64 [m], as FieldPool.node_field
    origin: np.ndarray  # (3,) float64 [m] first grid point
    cell: float  # [m]
    dims: np.ndarray  # (3,) int32 grid points along x, y, z
    depth: np.ndarray  # (points,) float64 [m] signed distance of each grid point, positive inside
    neighbours_begin: np.ndarray  # (n + 1,) int32
    neighbours: np.ndarray  # (2 edges,) int32: the nodes at the other ends of a node's edges, ascending


def make_interior_field(mesh: TetMesh) -> InteriorField:
    """Measure the whole body.

    For points deep inside, a hierarchy over its surface is faster than a flood.
    """
    surface, stack = triangle_pool(build_triangle_mesh(mesh.nodes, mesh.surface)), np.empty(STACK, np.int32)
    radius = 0.5 * float((mesh.box[3:] - mesh.box[:3]).max())
    node_field = np.zeros((len(mesh.nodes), 7))
    _measure_nodes(surface, radius, mesh.nodes, mesh.on_surface, mesh.node_normals, node_field, stack)
    cell = mesh.grid_cell / CELLS_PER_EDGE
    # Half a cell of air, so that no point of the body lies on the grid's border.
    origin = mesh.box[:3] - 0.5 * cell
    dims = (np.floor((mesh.box[3:] - origin) / cell) + 2).astype(np.int32)
    depth = np.empty(int(np.prod(dims)))
    _measure_grid(surface, radius, origin, cell, dims, depth, stack)
    begin, neighbours = _edge_neighbours(mesh.edges, len(mesh.nodes))
    return InteriorField(node_field, origin, cell, dims, depth, begin, neighbours)


def _edge_neighbours(edges: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    both = np.concatenate([edges, edges[:, ::-1]])
    both = both[np.lexsort((both[:, 1], both[:, 0]))]
    begin = begins_of(np.bincount(both[:, 0], minlength=count)).astype(np.int32)
    return begin, np.ascontiguousarray(both[:, 1], dtype=np.int32)


@query_kernel
def _measure_nodes(surface, radius, nodes, on_surface, normals, node_field, stack):
    """Distance, direction and nearest surface point of each node; on the surface 0, the normal, the node itself."""
    for i in range(len(node_field)):
        x, y, z = nodes[i]
        d, nx, ny, nz, qx, qy, qz = 0.0, normals[i, 0], normals[i, 1], normals[i, 2], x, y, z
        if not on_surface[i]:
            d, nx, ny, nz, qx, qy, qz = triangle_distance(surface, 0, radius, x, y, z, stack)
        row = node_field[i]
        row[0], row[1], row[2], row[3] = -d, nx, ny, nz
        row[4], row[5], row[6] = qx, qy, qz


@query_kernel
def _measure_grid(surface, radius, origin, cell, dims, depth, stack):
    """Depth at the grid points; points too far outside to share a cell with the body get minus a diagonal."""
    diagonal = math.sqrt(3.0) * cell * (1.0 + 1e-9)
    for i in range(dims[0]):
        for j in range(dims[1]):
            for l in range(dims[2]):  # noqa: E741
                x, y, z = origin[0] + i * cell, origin[1] + j * cell, origin[2] + l * cell
                d = triangle_distance(surface, 0, radius, x, y, z, stack)[0]
                depth[(i * dims[1] + j) * dims[2] + l] = max(-d, -diagonal)
