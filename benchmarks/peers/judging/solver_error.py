"""The error that matters to a solver: the penetration that remains, and the unnecessary displacement.

Both are measured after the smallest translation that satisfies the contacts reported for a pair
(`least_translation`).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from benchmarks.peers.judging.least_translation import least_translation
from benchmarks.peers.judging.moved_pairs import MovedPairs, Way
from benchmarks.peers.judging.truth import Solids
from benchmarks.peers.method import Contacts

RESOLVED = 0.0002  # [R] a pair no deeper than this counts as separated: a tenth of the depth that must be reported
HALVINGS = 7  # bisection steps in the search for a translation's necessary fraction


class SolverErrors(NamedTuple):
    """For k pairs."""

    remaining: np.ndarray  # (k,) [m] true depth after the whole translation
    unnecessary: np.ndarray  # (k,) [m] of the translation, beyond the fraction that separates the pair as well


def translations(answer: Contacts) -> dict[tuple[int, int], np.ndarray]:
    """(smaller, larger fragment) to the least translation (3,) [m] of the larger that satisfies the pair's contacts."""
    low, high = np.minimum(answer.first, answer.second), np.maximum(answer.first, answer.second)
    normals = np.where((answer.first > answer.second)[:, None], -answer.normals, answer.normals)
    order = np.lexsort((high, low))
    starts = np.flatnonzero((np.diff(low[order]) != 0) | (np.diff(high[order]) != 0)) + 1
    groups = np.split(order, starts) if len(order) else []
    return {
        (int(low[rows[0]]), int(high[rows[0]])): least_translation(normals[rows], answer.depths[rows])
        for rows in groups
    }  # fmt: skip


def solver_errors(
    solids: Solids, ways: Sequence[Way], resolved: float | np.ndarray = RESOLVED
) -> SolverErrors:  # fmt: skip
    """`resolved` [m], one or (k,).

    The necessary part is the smallest fraction of a translation, to 1 / 2^HALVINGS, after which the pair is no deeper
    than `resolved` or than after the whole. It is zero for a pair without overlap; a missed pair keeps its depth.
    """
    lengths = np.array([np.linalg.norm(way.shift) for way in ways])
    moved = np.flatnonzero(lengths > 0.0)
    pairs = MovedPairs(solids, [ways[k] for k in moved])
    remaining = np.array([way.depth for way in ways])
    before = remaining[moved]
    remaining[moved] = pairs.depths(np.ones(len(moved)))
    enough = np.maximum(remaining, resolved)[moved]
    least, most = np.zeros(len(moved)), np.where(before > enough, 1.0, 0.0)
    for _ in range(HALVINGS):
        middle = 0.5 * (least + most)
        is_open = most > least
        deep = pairs.depths(np.where(is_open, middle, np.nan)) > enough
        least, most = np.where(is_open & deep, middle, least), np.where(is_open & ~deep, middle, most)
    unnecessary = np.zeros(len(ways))
    unnecessary[moved] = (1.0 - most) * lengths[moved]
    return SolverErrors(remaining, unnecessary)
