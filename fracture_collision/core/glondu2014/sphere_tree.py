"""The adaptive sphere tree on points in maximum-distance order: Glondu 2014, sections 5.1 and 6.1.

Level l has the first 2^l points; a point's parent is the nearest point one level up, or itself if it is in that level.
A node's centre is its point, its radius the distance to its furthest descendant. Nodes with a single child are omitted,
so every inner node has at least two children, one of which carries the node's own point.

Storage is preorder: the subtree of entry i is i .. i + size[i] - 1, its first child i + 1, the next child behind the
first one's subtree. Siblings are in maximum-distance order, the one with the parent's own point first.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fracture_collision.core.glondu2014.max_distance_order import MaxDistanceOrder, max_distance_order
from fracture_collision.core.glondu2014.paper_pools import NONE_BELOW, OWN_SAMPLE
from fracture_collision.core.memory.compiled import kernel
from fracture_collision.portable_math import lengths


class SphereTree(NamedTuple):
    """A sphere tree of s entries in preorder."""

    center: np.ndarray  # (s, 3) float64 [m], body frame
    radius: np.ndarray  # (s,) float64 [m]
    size: np.ndarray  # (s,) int32
    sample: np.ndarray  # (s,) int32, index of the point within the body
    on_surface: np.ndarray  # (s,) uint8, 1: the point samples the fragment's surface


def build_sphere_tree(points: np.ndarray, on_surface: np.ndarray) -> SphereTree:
    """Tree over `points` (n, 3) [m], n >= 1; `on_surface` (n,) marks those that lie on the surface."""
    points = np.ascontiguousarray(points, dtype=np.float64)
    ranks = max_distance_order(points)
    size, rank = _emit(ranks)
    sample = ranks.order[rank]
    center = np.ascontiguousarray(points[sample])
    radius = np.zeros(len(size))
    update_radii(center, size, radius, np.ones(len(size), dtype=np.uint8))
    return SphereTree(center, radius, size, sample, np.ascontiguousarray(on_surface, dtype=np.uint8)[sample])


@kernel
def _emit_preorder(parent, level, size, rank_of):
    n = len(parent)
    # children of each rank, by level and then by rank: ranks ascend with the level, so ascending rank is enough
    first_child = np.full(n, -1, dtype=np.int32)
    next_sibling = np.full(n, -1, dtype=np.int32)
    for rank in range(n - 1, 0, -1):
        p = parent[rank]
        next_sibling[rank] = first_child[p]
        first_child[p] = rank
    # A stack item is a node (rank, remaining children); `closing` stores where its subtree began.
    stack_rank = np.empty(2 * n + 2, dtype=np.int32)
    stack_child = np.empty(2 * n + 2, dtype=np.int32)
    used = 0
    top = 0
    stack_rank[0], stack_child[0] = 0, first_child[0]
    closing = np.full(2 * n + 2, -1, dtype=np.int32)
    while top >= 0:
        rank, child, entry = stack_rank[top], stack_child[top], closing[top]
        top -= 1
        if entry >= 0:
            size[entry] = used - entry
            continue
        rank_of[used] = rank
        if child < 0:
            size[used] = 1
            used += 1
            continue
        # close this entry after its children; children of one level first, deeper ones through the node itself
        top += 1
        stack_rank[top], stack_child[top], closing[top] = rank, child, used
        used += 1
        deeper = child
        group = 0
        while deeper >= 0 and level[deeper] == level[child]:
            group += 1
            deeper = next_sibling[deeper]
        c = child
        for k in range(group):
            slot = top + group - k
            stack_rank[slot], stack_child[slot], closing[slot] = c, first_child[c], -1
            c = next_sibling[c]
        top += group + 1
        stack_rank[top], stack_child[top], closing[top] = rank, deeper, -1
    return used


def _emit(ranks: MaxDistanceOrder) -> tuple[np.ndarray, np.ndarray]:
    n = len(ranks.order)
    size = np.empty(2 * n, dtype=np.int32)
    rank = np.empty(2 * n, dtype=np.int32)
    used = _emit_preorder(ranks.parent, ranks.level, size, rank)
    return size[:used].copy(), rank[:used].copy()


@kernel
def update_radii(center, size, radius, stale):
    """Exact radii of all entries marked `stale`: the distance to the furthest leaf below."""
    for i in range(len(size)):
        if not stale[i]:
            continue
        furthest = 0.0
        for j in range(i + 1, i + size[i]):
            if size[j] == 1:
                dx, dy, dz = center[j, 0] - center[i, 0], center[j, 1] - center[i, 1], center[j, 2] - center[i, 2]
                furthest = max(furthest, dx * dx + dy * dy + dz * dz)
        radius[i] = np.sqrt(furthest)


@kernel
def surface_marks(size, on_surface):
    """TreePool's SURFACE column (s,) int32 of a tree."""
    marks = np.empty(len(size), dtype=np.int32)
    for i in range(len(size) - 1, -1, -1):
        marks[i] = OWN_SAMPLE if on_surface[i] else NONE_BELOW
        child = i + 1
        while marks[i] == NONE_BELOW and child < i + size[i]:
            if marks[child] != NONE_BELOW:
                marks[i] = 0
            child += size[child]
    return marks


def validate_sphere_tree(tree: SphereTree, expected_samples: np.ndarray) -> None:
    """Raise AssertionError unless `tree` is a sphere tree over exactly `expected_samples`.

    Every sample once as a leaf; every inner node with two children or more, one of them with its own point; every
    sphere holds all points below it.
    """
    center, radius, size, sample, on_surface = tree
    assert size[0] == len(size), "the root's subtree is not the whole tree"
    leaves = sample[size == 1]
    assert np.array_equal(np.sort(leaves), np.sort(expected_samples)), "the leaves are not the fragment's samples"
    for i in range(len(size)):
        end = i + size[i]
        if size[i] == 1:
            assert radius[i] == 0.0, f"leaf {i} has a radius"
            continue
        child, children, carries = i + 1, 0, False
        while child < end:
            assert size[child] >= 1, f"entry {child} has no size"
            children += 1
            carries = carries or sample[child] == sample[i]
            child += size[child]
        assert child == end, f"the children of entry {i} do not fill its subtree"
        assert children >= 2, f"entry {i} has a single child"
        assert carries, f"no child of entry {i} carries its point"
        reach = lengths(center[i + 1 : end] - center[i]).max()
        assert reach <= radius[i] * (1.0 + 1e-12), f"entry {i} does not hold a descendant: {reach} > {radius[i]}"
    assert len(on_surface) == len(size)
