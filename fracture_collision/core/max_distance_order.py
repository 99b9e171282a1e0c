"""Maximum-distance ordering of points: Glondu 2014, section 5.1.

L_2 is the two furthest points; L_{m+1} appends the point furthest from its closest point in L_m. Ties go to the lowest
index, so the order is a function of the points alone.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fracture_collision.core.compiled import kernel


class MaxDistanceOrder(NamedTuple):
    order: np.ndarray  # (n,) int32 point indices
    parent: np.ndarray  # (n,) int32: rank of the nearest point one level up (section 5.1); rank 0: itself
    level: np.ndarray  # (n,) int32: level at which the rank enters, 0 for rank 0, l for ranks 2^(l-1) .. 2^l - 1


@kernel
def _two_furthest(points):
    """The diameter's end points, lowest indices first."""
    n = len(points)
    center = np.zeros(3)
    for i in range(n):
        for k in range(3):
            center[k] += points[i, k] / n
    # |a - b| <= |a - c| + |c - b|: in order of falling distance from the centre, few pairs need a look.
    reach = np.empty(n)
    for i in range(n):
        reach[i] = np.sqrt(
            (points[i, 0] - center[0]) ** 2 + (points[i, 1] - center[1]) ** 2 + (points[i, 2] - center[2]) ** 2
        )
    by_reach = np.argsort(-reach, kind="mergesort")
    best, first, second = -1.0, 0, 0
    for u in range(n):
        i = by_reach[u]
        bound = np.sqrt(max(best, 0.0)) * (1.0 - 1e-12)
        if 2.0 * reach[i] < bound:
            break
        for v in range(u + 1, n):
            j = by_reach[v]
            if reach[i] + reach[j] < bound:
                break
            dx, dy, dz = points[i, 0] - points[j, 0], points[i, 1] - points[j, 1], points[i, 2] - points[j, 2]
            d2 = dx * dx + dy * dy + dz * dz
            a, b = min(i, j), max(i, j)
            if d2 > best or (d2 == best and (a < first or (a == first and b < second))):
                best, first, second = d2, a, b
                bound = np.sqrt(max(best, 0.0)) * (1.0 - 1e-12)
    return first, second


@kernel
def _order_points(points, order, parent, level):
    n = len(points)
    nearest = np.zeros(n, dtype=np.int32)  # rank of the closest point so far
    distance = np.empty(n)  # squared, [m2]; -1 once ordered
    level_nearest = np.zeros(n, dtype=np.int32)  # `nearest` as it was when the current level began
    first, second = _two_furthest(points) if n > 1 else (0, 0)
    current = first
    for i in range(n):
        distance[i] = np.inf
    next_level_at, current_level = 1, 0
    for rank in range(n):
        if rank == next_level_at:
            next_level_at *= 2
            current_level += 1
            level_nearest[:] = nearest
        order[rank] = current
        level[rank] = current_level
        parent[rank] = level_nearest[current]
        distance[current] = -1.0
        following, furthest = -1, -1.0
        px, py, pz = points[current, 0], points[current, 1], points[current, 2]
        for i in range(n):
            if distance[i] < 0.0:
                continue
            dx, dy, dz = points[i, 0] - px, points[i, 1] - py, points[i, 2] - pz
            d2 = dx * dx + dy * dy + dz * dz
            if d2 < distance[i]:
                distance[i] = d2
                nearest[i] = rank
            if distance[i] > furthest:
                following, furthest = i, distance[i]
        current = second if rank == 0 else following


def max_distance_order(points: np.ndarray) -> MaxDistanceOrder:
    """Order `points` (n, 3) [m]; O(n^2) time, O(n) memory."""
    n = len(points)
    result = MaxDistanceOrder(np.empty(n, np.int32), np.zeros(n, np.int32), np.zeros(n, np.int32))
    if n:
        _order_points(np.ascontiguousarray(points, dtype=np.float64), *result)
    return result
