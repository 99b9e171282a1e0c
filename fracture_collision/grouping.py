"""Groups of indices: the counting sort, where each group begins, and disjoint sets."""

from __future__ import annotations

import numpy as np


def grouped(groups, count):
    """Indices into `groups` (n,) int, by group 0 .. count - 1, and where each group begins (count + 1,), both int64.

    Ascending within each group; indices of negative groups are left out. Plain Python that numba compiles: each room
    compiles it with its own decorator.
    """
    begin = np.zeros(count + 1, np.int64)
    for group in groups:
        if group >= 0:
            begin[group + 1] += 1
    begin = np.cumsum(begin)
    order, free = np.empty(begin[-1], np.int64), begin.copy()
    for i in range(len(groups)):
        if groups[i] >= 0:
            order[free[groups[i]]] = i
            free[groups[i]] += 1
    return order, begin


def root_of(root, i):
    """Root of i in a forest of parents `root` (n,) int64; halves the path to it (union-find).

    Plain Python, as `grouped`.
    """
    while root[i] != i:
        root[i] = root[root[i]]
        i = root[i]
    return i


def begins_of(counts: np.ndarray) -> np.ndarray:
    """Where each of n consecutive groups of `counts` (n,) rows begins, and the end: (n + 1,) int64."""
    begins = np.zeros(len(counts) + 1, np.int64)
    counts.cumsum(out=begins[1:])
    return begins
