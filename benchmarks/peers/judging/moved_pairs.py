"""True depth of pairs after one of the two is translated: as in `truth`, for many pairs and fractions."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from benchmarks.peers.boxes import SLACK
from benchmarks.peers.judging.truth import Solids
from benchmarks.peers.worlds import Frame


class Way(NamedTuple):
    """A pair, and the translation of the second against the first."""

    frame: Frame
    first: int
    second: int
    shift: np.ndarray  # (3,) [m] world, of the second
    depth: float  # [m] true depth before, 0 if they do not overlap


class MovedPairs:
    """Points of k pairs, gathered once. Few large calls: each call rebuilds a winding-number tree."""

    def __init__(self, solids: Solids, ways: Sequence[Way]) -> None:
        self._solids = solids
        self._low = np.array([s.vertices.min(axis=0) - SLACK for s in solids.surfaces])
        self._high = np.array([s.vertices.max(axis=0) + SLACK for s in solids.surfaces])
        parts = [self._points_of(k, way, turned) for k, way in enumerate(ways) for turned in (False, True)]
        empty = np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0, int), np.zeros(0, int)
        columns = [np.concatenate(column) for column in zip(empty, *parts, strict=True)]
        order = np.argsort(columns[3], kind="stable")
        self._start, self._along, self._way, self._other = (column[order] for column in columns)
        self._keep_points_in_reach(np.array([max(way.depth, np.linalg.norm(way.shift)) for way in ways]))

    def _points_of(self, row: int, way: Way, turned: bool) -> tuple[np.ndarray, ...]:
        """Points (n, 3) [m] of one of the two in the other's frame, translation (n, 3) [m], row (n,), other (n,)."""
        own, other = (way.second, way.first) if turned else (way.first, way.second)
        frame, into = way.frame, way.frame.rotations[other]
        along = (way.shift if turned else -way.shift) @ into  # as the second moves, the first's points recede
        moved = self._solids.points(own) @ frame.rotations[own].T + frame.positions[own] - frame.positions[other]
        local = moved @ into
        low, high = self._low[other] - np.maximum(along, 0.0), self._high[other] - np.minimum(along, 0.0)
        local = local[np.all((local >= low) & (local <= high), axis=1)]
        shape = len(local), 3
        return local, np.broadcast_to(along, shape), np.full(shape[0], row), np.full(shape[0], other)

    def _keep_points_in_reach(self, reach: np.ndarray) -> None:
        """Drops points farther than `reach` (k,) [m] from the surface: none of them is inside, or gets inside."""
        keep = np.zeros(len(self._start), bool)
        for v, rows in self._by_other(np.arange(len(self._start))):
            distance, _ = self._solids.nearest(v, self._start[rows])
            keep[rows] = distance <= reach[self._way[rows]] + SLACK
        columns = self._start, self._along, self._way, self._other
        self._start, self._along, self._way, self._other = (column[keep] for column in columns)

    def depths(self, shares: np.ndarray) -> np.ndarray:
        """(k,) [m] after `shares` (k,) of each translation; nan: not computed, returns nan."""
        found = np.where(np.isnan(shares), np.nan, 0.0)
        points = self._start + shares[self._way, None] * self._along
        low, high = self._low[self._other], self._high[self._other]
        in_box = np.all((points >= low) & (points <= high), axis=1)  # nan is in no box
        for v, rows in self._by_other(np.flatnonzero(in_box)):
            inside = rows[self._solids.inside(v, points[rows])]
            if len(inside):
                np.maximum.at(found, self._way[inside], self._solids.nearest(v, points[inside])[0])
        return found

    def _by_other(self, rows: np.ndarray) -> Iterator[tuple[int, np.ndarray]]:
        """Each fragment whose surface is queried, and its part of `rows`, which ascend."""
        others, begin = np.unique(self._other[rows], return_index=True)
        return zip(others.tolist(), np.split(rows, begin)[1:], strict=True)
