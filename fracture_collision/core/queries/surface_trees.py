"""The exact surfaces of fragments under hierarchies of boxes: what rays and closest points are searched in.

Triangles are those of triangles_of (patches/shapes.py): old surface and cracks, in the body frame.
"""

from __future__ import annotations

import numpy as np

from fracture_collision.core.memory.pools import Pools
from fracture_collision.core.memory.struct import Struct
from fracture_collision.core.mesh.triangle_field import build_hierarchy
from fracture_collision.core.patches.shapes import triangles_of


class SurfaceTrees(Struct):
    """Surfaces of fragments, a row of node_range each; fields as in TriangleMesh, rows absolute."""

    corners: np.ndarray  # (t, 9) float64 [m]
    node_box: np.ndarray  # (b, 6) float64 [m]
    node_skip: np.ndarray  # (b,) int32
    node_first: np.ndarray  # (b,) int32
    node_count: np.ndarray  # (b,) int32
    node_range: np.ndarray  # (F, 2) int32; empty for planes, spheres, and fragments that were not asked for


def surface_trees(pools: Pools, rows: np.ndarray) -> SurfaceTrees:
    """Trees of the fragments in `rows` (n,) of FragmentPool; those of planes and spheres are empty."""
    corners, boxes, skips, firsts, counts = [np.empty((0, 9))], [np.empty((0, 6))], [_INTS], [_INTS], [_INTS]
    ranges, triangle, node = np.zeros((len(pools.fragment.kind), 2), np.int32), 0, 0
    for row in rows.tolist():
        given, _ = triangles_of(pools, row, row + 1)
        if not len(given):
            continue
        three = given.reshape(-1, 3, 3)
        lower, upper = three.min(axis=1), three.max(axis=1)
        order, box, skip, first, count = build_hierarchy(
            np.ascontiguousarray(np.hstack((lower, upper))), 0.5 * (lower + upper)
        )
        corners.append(given[order])
        boxes.append(box)
        skips.append(skip + np.int32(node))
        firsts.append(first + np.int32(triangle))
        counts.append(count)
        ranges[row] = node, node + len(box)
        triangle, node = triangle + len(given), node + len(box)
    return SurfaceTrees(
        np.concatenate(corners), np.concatenate(boxes), np.concatenate(skips), np.concatenate(firsts),
        np.concatenate(counts), ranges,
    )  # fmt: skip


_INTS = np.empty(0, np.int32)
