"""A static hierarchy of boxes over a point cloud, halved at medians, for exact searches over many points.

All nodes of a level hold the same number of points, within one. Node k's children are 2k + 1 and 2k + 2, the leaves
come last. Bounds (here and closest_point.box_distance_squared) use exactly the operations of the point distances, and
rounding is monotone: the bounds of a box hold for its points to the last bit.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fracture_collision.core.memory.compiled import query_kernel

# Minimum points per leaf (a smaller cloud is one leaf); the maximum is twice as many.
LEAF_POINTS = 8


class PointHierarchy(NamedTuple):
    """The points of a cloud, and k boxes over them, level by level."""

    points: np.ndarray  # (n, 3) float64 [m], leaf by leaf, ascending by index within a leaf
    index: np.ndarray  # type: ignore[assignment] # (n,) int32: index of each in the cloud
    begin: np.ndarray  # (k,) int32: first of `points` below each node
    end: np.ndarray  # (k,) int32: one past the last
    box: np.ndarray  # (k, 6) float64 [m]: low x y z, high x y z
    lowest: np.ndarray  # (k,) int32: smallest index below each node


def build_point_hierarchy(points: np.ndarray) -> PointHierarchy:
    """Hierarchy over `points` (n, 3) [m], n >= 1; O(n log^2 n)."""
    n = len(points)
    depth = max((n // LEAF_POINTS).bit_length() - 1, 0)
    index = np.arange(n)
    begins, boxes = [], []
    for level in range(depth + 1):
        bounds = (np.arange((1 << level) + 1) * n) >> level
        node = np.repeat(np.arange(1 << level), np.diff(bounds))
        placed = points[index]
        low, high = np.minimum.reduceat(placed, bounds[:-1]), np.maximum.reduceat(placed, bounds[:-1])
        begins.append(bounds)
        boxes.append(np.column_stack([low, high]))
        widest = np.argmax(high - low, axis=1)
        # the next level halves each node along its widest side; leaves are sorted by index
        key = placed[np.arange(n), widest[node]] if level < depth else index
        index = index[np.lexsort((key, node))]
    return PointHierarchy(
        np.ascontiguousarray(points[index]),
        index.astype(np.int32),
        np.concatenate([bounds[:-1] for bounds in begins]).astype(np.int32),
        np.concatenate([bounds[1:] for bounds in begins]).astype(np.int32),
        np.concatenate(boxes),
        np.concatenate([np.minimum.reduceat(index, bounds[:-1]) for bounds in begins]).astype(np.int32),
    )


@query_kernel
def greatest_distance_squared(a, b):
    """Upper bound [m2] of the squared distance between a point of box `a` (6,) and one of box `b`."""
    dx = max(a[3] - b[0], b[3] - a[0])
    dy = max(a[4] - b[1], b[4] - a[1])
    dz = max(a[5] - b[2], b[5] - a[2])
    return dx * dx + dy * dy + dz * dz
