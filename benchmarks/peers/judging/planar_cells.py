"""Closed meshes of flat fragments, built as in a solid modeller: the body's surface trimmed by planes (manifold3d).

The meshes are exact Voronoi cells, so their convex hulls are as good as hulls can be. The service's own regions differ
near rims: where a cell reaches into a tetrahedron without having a node there, its neighbours take that corner.
"""

from __future__ import annotations

import manifold3d
import numpy as np

from fracture_collision.geometry.tetrahedra import boundary_triangles

EDGE = 0.11  # [m] crack faces are divided to about the length of the tetrahedra's edges, like the paper's virtual nodes


def planar_cells(
    vertices: np.ndarray, tetrahedra: np.ndarray, seeds: np.ndarray
) -> list[tuple[np.ndarray, np.ndarray]]:
    """For each seed the mesh of its Voronoi cell in the body: vertices (n, 3) [m] and triangles (t, 3)."""
    triangles = boundary_triangles(tetrahedra)
    used, index = np.unique(triangles, return_inverse=True)
    body = manifold3d.Manifold(manifold3d.Mesh64(vertices[used], index.reshape(-1, 3).astype(np.uint64)))
    cells = []
    for i, seed in enumerate(seeds):
        cell = body
        for j in np.argsort(np.linalg.norm(seeds - seed, axis=1)).tolist():
            if j != i:
                normal = (seed - seeds[j]) / np.linalg.norm(seed - seeds[j])
                cell = cell.trim_by_plane(normal.tolist(), float(normal @ (seed + seeds[j])) / 2.0)
        mesh = cell.refine_to_length(EDGE).to_mesh64()
        corners = np.ascontiguousarray(np.asarray(mesh.vert_properties)[:, :3])
        cells.append((corners, np.asarray(mesh.tri_verts).astype(np.int64)))
    return cells
