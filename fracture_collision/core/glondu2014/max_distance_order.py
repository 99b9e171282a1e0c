"""Maximum-distance ordering of points: Glondu 2014, section 5.1.

L_2 is the two furthest points; L_{m+1} appends the point furthest from its closest point in L_m. Ties go to the lowest
index, so the order is a function of the points alone.

The paper compares every point with every other. Here each node of a hierarchy of boxes stores the greatest distance of
a point below it from its closest ordered point: a new point descends only to nodes that are nearer than that, and the
root holds the next point. Nothing is approximated; test/oracles has the definition.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fracture_collision.core.glondu2014.point_hierarchy import build_point_hierarchy, greatest_distance_squared
from fracture_collision.core.memory.compiled import kernel, query_kernel
from fracture_collision.core.mesh.closest_point import box_distance_squared


class MaxDistanceOrder(NamedTuple):
    """Points in maximum-distance order; a point's rank is its index in `order`."""

    order: np.ndarray  # (n,) int32 point indices
    parent: np.ndarray  # (n,) int32: rank of the nearest point one level up (section 5.1); rank 0: itself
    level: np.ndarray  # (n,) int32: level at which the rank enters, 0 for rank 0, l for ranks 2^(l-1) .. 2^l - 1


def max_distance_order(points: np.ndarray) -> MaxDistanceOrder:
    """Order `points` (n, 3) [m]; O(n log^2 n) time for points spread over a curve, surface or solid, O(n) memory."""
    n = len(points)
    result = MaxDistanceOrder(np.empty(n, np.int32), np.zeros(n, np.int32), np.zeros(n, np.int32))
    if n:
        hierarchy = build_point_hierarchy(np.ascontiguousarray(points, dtype=np.float64))
        _order_points(hierarchy, *_two_furthest(hierarchy), *result)
    return result


# Stack of pairs or nodes: 31 levels, at most four per level.
STACK = 128


@query_kernel
def _comes_before(a, b, c, d):
    """Whether the pair (a, b) is lexicographically lower than (c, d)."""
    return a < c or (a == c and b < d)


@query_kernel
def _lowest_pair(lowest, a, b):
    """Lexicographic lower bound of the pairs of points, one below node a and the other below b."""
    return min(lowest[a], lowest[b]), max(lowest[a], lowest[b]) + (1 if a == b else 0)


@kernel
def _two_furthest(hierarchy):
    """Positions of the diameter's end points, the lower index first; ties go to the lowest pair of indices."""
    points, index, begin, end, box, lowest = hierarchy
    first_leaf = len(begin) // 2
    stack = np.zeros((STACK, 2), dtype=np.int64)  # pairs of nodes of the same level
    ceiling = np.full(STACK, np.inf)  # [m2] upper bound of the squared distance of points below the pair
    best, first, second = -1.0, 0, 0
    top = 0
    while top >= 0:
        a, b = stack[top]
        farthest = ceiling[top]
        top -= 1
        low, high = _lowest_pair(lowest, a, b)
        if farthest < best or (farthest == best and not _comes_before(low, high, index[first], index[second])):
            continue
        if a >= first_leaf:
            for u in range(begin[a], end[a]):
                for v in range(u + 1 if a == b else begin[b], end[b]):
                    dx, dy, dz = points[u, 0] - points[v, 0], points[u, 1] - points[v, 1], points[u, 2] - points[v, 2]
                    d2 = dx * dx + dy * dy + dz * dz
                    p, q = (u, v) if index[u] < index[v] else (v, u)
                    if d2 > best or (d2 == best and _comes_before(index[p], index[q], index[first], index[second])):
                        best, first, second = d2, p, q
            continue
        bottom = top + 1
        for c in range(2 * a + 1, 2 * a + 3):
            for d in range(2 * b + 1, 2 * b + 3):
                if a == b and c > d:
                    continue
                # the most promising pair on top: its result prunes the others early
                farthest = greatest_distance_squared(box[c], box[d])
                low, high = _lowest_pair(lowest, c, d)
                top += 1
                slot = top
                while slot > bottom:
                    below = slot - 1
                    i, j = _lowest_pair(lowest, stack[below, 0], stack[below, 1])
                    if ceiling[below] < farthest or (ceiling[below] == farthest and _comes_before(low, high, i, j)):
                        break
                    stack[slot], ceiling[slot] = stack[below], ceiling[below]
                    slot = below
                stack[slot, 0], stack[slot, 1], ceiling[slot] = c, d, farthest
    return first, second


@kernel
def _order_points(hierarchy, first, second, order, parent, level):
    points, index, begin, end, box, _ = hierarchy
    n, nodes = len(points), len(begin)
    first_leaf = nodes // 2
    nearest = np.zeros(n, dtype=np.int32)  # rank of the closest point so far
    distance = np.full(n, np.inf)  # its squared distance [m2]; -1 once ordered
    level_nearest = np.zeros(n, dtype=np.int32)  # copy of `nearest` from the start of the current level
    greatest = np.full(nodes, np.inf)  # the largest `distance` below each node
    furthest = np.zeros(nodes, dtype=np.int32)  # its position; ties go to the lowest index
    entered = np.empty(nodes, dtype=np.int32)
    stack = np.empty(STACK, dtype=np.int32)
    current = first
    next_level_at, current_level = 1, 0
    for rank in range(n):
        if rank == next_level_at:
            next_level_at *= 2
            current_level += 1
            level_nearest[:] = nearest
        order[rank] = index[current]
        level[rank] = current_level
        parent[rank] = level_nearest[current]
        distance[current] = -1.0
        x, y, z = points[current]
        count, top = 0, 0
        stack[0] = 0
        while top >= 0:
            node = stack[top]
            top -= 1
            holds_current = begin[node] <= current < end[node]
            if not holds_current and box_distance_squared(x, y, z, box[node]) >= greatest[node]:
                continue
            if node < first_leaf:
                entered[count] = node
                count += 1
                stack[top + 1], stack[top + 2] = 2 * node + 1, 2 * node + 2
                top += 2
                continue
            most, at = -1.0, begin[node]
            for i in range(begin[node], end[node]):
                if distance[i] < 0.0:
                    continue
                dx, dy, dz = points[i, 0] - x, points[i, 1] - y, points[i, 2] - z
                d2 = dx * dx + dy * dy + dz * dz
                if d2 < distance[i]:
                    distance[i] = d2
                    nearest[i] = rank
                if distance[i] > most:
                    most, at = distance[i], i
            greatest[node], furthest[node] = most, at
        for k in range(count - 1, -1, -1):  # children were entered after their parents
            node = entered[k]
            a, b = 2 * node + 1, 2 * node + 2
            i, j = furthest[a], furthest[b]
            if greatest[a] > greatest[b] or (greatest[a] == greatest[b] and index[i] < index[j]):
                greatest[node], furthest[node] = greatest[a], i
            else:
                greatest[node], furthest[node] = greatest[b], j
        current = second if rank == 0 else furthest[0]
