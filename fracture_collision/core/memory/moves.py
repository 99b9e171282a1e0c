"""Where the rows of a column are after some were dropped."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fracture_collision.core.memory.pools import GrowableArray
from fracture_collision.grouping import begins_of


class Moves(NamedTuple):
    """The rows of a column that stay, and their new positions."""

    stays: np.ndarray  # (n,) bool
    position: np.ndarray  # (n + 1,) int64; includes the end row

    def of(self, rows: np.ndarray | int) -> np.ndarray:
        """New positions of `rows`; negative values are not rows and stay unchanged."""
        return np.where(rows < 0, rows, self.position[np.maximum(rows, 0)])

    def keep(self, columns: dict[str, GrowableArray], *names: str) -> None:
        """Drop the rows that do not stay from the named columns."""
        for name in names:
            columns[name].keep(self.stays)


def moves_of_ranges(count: int, begins: np.ndarray, ends: np.ndarray) -> Moves:
    """Of `count` rows, those within any of the ranges stay."""
    depth = np.zeros(count + 1, np.int64)
    np.add.at(depth, begins, 1)
    np.add.at(depth, ends, -1)
    return moves_of(np.cumsum(depth[:-1]) > 0)


def moves_of(stays: np.ndarray) -> Moves:
    """The rows where the mask `stays` (n,) is true stay."""
    return Moves(stays, begins_of(stays))
