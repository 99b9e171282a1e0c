"""Maximum-distance order by definition (Glondu 2014, section 5.1): every distance, in O(n^2) time and O(n) memory."""

from __future__ import annotations

import numpy as np


def squared_distances(points: np.ndarray, point: np.ndarray) -> np.ndarray:
    """(n,) [m2], summed x, y, z as in the fast code, so that ties are the same."""
    x, y, z = (points - point).T
    return x * x + y * y + z * z


def two_furthest(points: np.ndarray) -> tuple[int, int]:
    """The lowest pair of indices among those at the greatest distance."""
    best, pair = -1.0, (0, 0)
    for i in range(len(points) - 1):
        d2 = squared_distances(points[i + 1 :], points[i])
        if d2.max() > best:
            best, pair = d2.max(), (i, i + 1 + int(np.argmax(d2)))
    return pair


def order_by_definition(points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """order, parent, level as in core.max_distance_order, for n >= 1 points."""
    n = len(points)
    first, second = two_furthest(points)
    order, parent, level = [first], [0], [0]
    distance, nearest = squared_distances(points, points[first]), np.zeros(n, dtype=int)
    distance[first] = -1.0
    for rank in range(1, n):
        if rank & (rank - 1) == 0:  # 2^l points make level l
            nearest_above = nearest.copy()
        following = second if rank == 1 else int(np.argmax(distance))
        order.append(following)
        parent.append(int(nearest_above[following]))
        level.append(level[-1] + (rank & (rank - 1) == 0))
        d2 = squared_distances(points, points[following])
        nearer = d2 < distance
        distance[nearer], nearest[nearer] = d2[nearer], rank
        distance[following] = -1.0
    return np.array(order), np.array(parent), np.array(level)
