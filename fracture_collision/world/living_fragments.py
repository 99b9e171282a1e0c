"""The living fragments of a registry as columns by ascending id, updated by what was added and removed.

An update costs a few array operations, whatever the number of fragments; it rebuilds nothing per fragment.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fracture_collision.world.gates.body_gate import CheckedBody

MASS_VALUES = 10  # mass [kg], centre of mass (3) [m], inertia (6) [kg m2]; body frame


class Columns(NamedTuple):
    """n fragments, ascending by id."""

    ids: np.ndarray  # (n,) int64
    rows: np.ndarray  # (n,) int64, in the pools
    bodies: np.ndarray  # (n,) int64 body ids
    parents: np.ndarray  # (n,) int64 id of the fragment it broke from, its own id if none
    is_static: np.ndarray  # (n,) bool
    friction: np.ndarray  # (n,) float64
    restitution: np.ndarray  # (n,) float64
    density: np.ndarray  # (n,) float64 [kg/m3]
    sequences: np.ndarray  # (n,) uint64 of the message that added the body; 0: not numbered
    masses: np.ndarray  # (n, MASS_VALUES) float64; NaN: not computed yet


_TYPES = (np.int64, np.int64, np.int64, np.int64, np.bool_, np.float64, np.float64, np.float64, np.uint64)


class LivingFragments:
    """A set of fragments that can be read as Columns."""

    def __init__(self) -> None:
        self._columns = Columns._make([*(np.empty(0, kind) for kind in _TYPES), np.empty((0, MASS_VALUES))])
        self._row: dict[int, int] = {}
        self._came: dict[int, tuple] = {}  # added ids -> values of all columns but the first and the last
        self._went: set[int] = set()  # removed ids that are still in the columns

    def row_of(self, fragment_id: int) -> int | None:
        """Row of a fragment in the pools; None if it does not live."""
        return self._row.get(fragment_id)

    def add(self, fragment_id: int, row: int, body: CheckedBody, parent_id: int) -> None:
        """Add a fragment of `body`; other arguments as in Columns. Its id must be new."""
        self._row[fragment_id] = row
        self._came[fragment_id] = (
            row, body.body_id, parent_id, body.is_static, body.friction, body.restitution, body.density, body.sequence
        )  # fmt: skip

    def remove(self, fragment_id: int) -> int:
        """Returns its row."""
        if self._came.pop(fragment_id, None) is None:
            self._went.add(fragment_id)
        return self._row.pop(fragment_id)

    def columns(self) -> Columns:
        """The current columns; the caller may write to `masses`."""
        if self._went or self._came:
            parts = list(self._columns)
            if self._went:
                stays = np.isin(self._columns.ids, list(self._went), invert=True)
                parts = [column[stays] for column in parts]
            if self._came:
                values = [list(self._came), *zip(*self._came.values(), strict=True)]
                more: list[np.ndarray] = [np.array(each, kind) for each, kind in zip(values, _TYPES, strict=True)]
                more.append(np.full((len(self._came), MASS_VALUES), np.nan))
                order = np.argsort(np.concatenate([parts[0], more[0]]), kind="stable")
                parts = [np.concatenate(pair)[order] for pair in zip(parts, more, strict=True)]
            self._columns = Columns(*parts)
            self._went, self._came = set(), {}
        return self._columns

    def renumber(self, new_rows: np.ndarray) -> None:
        """Replace the rows of all fragments, in the order of `columns`, by `new_rows` (n,)."""
        self._columns = self.columns()._replace(rows=new_rows.astype(np.int64))
        self._row = dict(zip(self._columns.ids.tolist(), new_rows.tolist(), strict=True))
