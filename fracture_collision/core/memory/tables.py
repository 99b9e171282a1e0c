"""Tables that grow at their end: the memory behind the structures that kernels read.

A field of a Struct, or of a NamedTuple, declares its column: what has a row each, the type, and what the values are
rows of. From that follow appending, byte counts and the removal of rows that nothing refers to (`Table.move`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Any, Generic, NamedTuple, TypeVar, get_type_hints

import numpy as np

from fracture_collision.grouping import begins_of

Made = TypeVar("Made")


class Moves(NamedTuple):
    """Of some rows those that stay, and where they are then."""

    stays: np.ndarray  # (n,) bool
    position: np.ndarray  # (n + 1,) int64; includes the end row

    def of(self, rows: np.ndarray | int) -> np.ndarray:
        """New positions of `rows`; negative values are not rows and stay unchanged."""
        return np.where(rows < 0, rows, self.position[np.maximum(rows, 0)])


def moves_of(stays: np.ndarray) -> Moves:
    """The rows where the mask `stays` (n,) is true stay."""
    return Moves(stays, begins_of(stays))


def moves_of_ranges(count: int, begins: np.ndarray, ends: np.ndarray) -> Moves:
    """Of `count` rows, those within any of the ranges stay."""
    depth = np.zeros(count + 1, np.int64)
    np.add.at(depth, begins, 1)
    np.add.at(depth, ends, -1)
    return moves_of(np.cumsum(depth[:-1]) > 0)


AllMoves = Mapping[str, Moves]  # by what has the rows


class Moved(NamedTuple):
    """How values change that are made of rows in another way."""

    concerned: tuple[str, ...]  # what they are rows of
    change: Callable[[np.ndarray, AllMoves], None]  # of values (n, width), in place


class Column(NamedTuple):
    """The column of a field."""

    rows: str  # what has a row each
    type: type
    width: int = 0  # values of a row; 0: one, in an array of one dimension
    # What the values are rows of, negative ones are none: one name, or one for each value of a row; or Moved
    of: str | tuple[str | None, ...] | Moved | None = None
    shape: tuple[int, ...] | None = None  # in which kernels see the values, if not (n, width)
    seen_in: str | None = None  # the name of the column whose memory it shares, seen as `type`

    def references(self, values: np.ndarray) -> list[tuple[str, np.ndarray]]:
        """What parts of `values` (n, width) are rows of, with views of these; empty for Moved."""
        if self.of is None or isinstance(self.of, Moved):
            return []
        if isinstance(self.of, str):
            return [(self.of, values)]
        return [(name, values[:, k]) for k, name in enumerate(self.of) if name is not None]

    def is_changed_by(self, moves: AllMoves, values: np.ndarray) -> bool:
        """Whether rows of it, or what its `values` refer to, do not all stay."""
        others = self.of.concerned if isinstance(self.of, Moved) else [name for name, _ in self.references(values)]
        return not all(moves[each].stays.all() for each in (self.rows, *others))

    def move(self, values: np.ndarray, moves: AllMoves) -> None:
        """Change the values of rows that stay, in place, to where what they refer to is then."""
        for name, part in self.references(values):
            part[:] = moves[name].of(part)
        if isinstance(self.of, Moved):
            self.of.change(values, moves)


class GrowableArray:
    """An array that grows at its end: amortized O(1) per row, `view` contiguous."""

    def __init__(self, columns: int, dtype: type, changed: Callable[[bool], None] = lambda moved: None) -> None:
        """changed: called whenever `view` becomes a new array; its argument is true if `whole` is a new array, too."""
        self._buffer: np.ndarray = np.zeros((16, columns) if columns else 16, dtype=dtype)
        self.used = 0
        self._view: np.ndarray | None = None  # cached: a fracture reads the views of all columns several times
        self._changed = changed

    def append(self, rows: np.ndarray) -> int:
        """Copy `rows` to the end; returns the index of the first new row."""
        self.reserve(len(rows))[:] = rows
        return self.advance(len(rows))

    def fill(self, count: int, row: Any) -> int:
        """Append `count` copies of `row`; returns the index of the first."""
        self.reserve(count)[:] = row
        return self.advance(count)

    def share(self, rows: np.ndarray) -> int:
        """As append, for rows that are never written again: the first call does not copy."""
        if self.used or rows.dtype != self._buffer.dtype or not rows.flags.c_contiguous:
            return self.append(rows)
        self._put(rows)
        return self.advance(len(rows))

    def reserve(self, count: int) -> np.ndarray:
        """The next `count` rows, for the caller to write; `advance` makes them part of the array."""
        end = self.used + count
        if end > len(self._buffer):
            grown = np.empty((max(end, 2 * len(self._buffer)), *self._buffer.shape[1:]), dtype=self._buffer.dtype)
            grown[: self.used] = self._buffer[: self.used]
            self._put(grown)
        return self._buffer[self.used : end]

    def advance(self, count: int) -> int:
        """Append the next `count` rows of the buffer, as written by the caller; returns the index of the first."""
        self.used, self._view = self.used + count, None
        self._changed(False)
        return self.used - count

    def replace(self, rows: np.ndarray) -> None:
        """Replace all rows; the old memory is released."""
        self.used = len(rows)
        self._put(np.ascontiguousarray(rows, dtype=self._buffer.dtype))

    def _put(self, buffer: np.ndarray) -> None:
        self._buffer, self._view = buffer, None
        self._changed(True)

    @property
    def row_bytes(self) -> int:
        """Size of a row [bytes]."""
        return self._buffer.strides[0]

    @property
    def view(self) -> np.ndarray:
        """The rows in use, contiguous; a new view after each change of their number."""
        if self._view is None:
            self._view = self._buffer[: self.used]
        return self._view

    @property
    def whole(self) -> np.ndarray:
        """`view` and the spare capacity behind it."""
        return self._buffer


class Table(Generic[Made]):
    """The columns of a class whose fields declare them; fields of such classes are tables within it."""

    def __init__(self, made: type[Made], changed: Callable[[bool], None] = lambda moved: None) -> None:
        """changed: called whenever `view` becomes a new one; its argument is true if `whole` is a new one, too."""
        self._made, self._told = made, changed
        self._columns: dict[str, Column] = {}
        self._arrays: dict[str, GrowableArray] = {}
        self.tables: dict[str, Table] = {}
        for name, hint in get_type_hints(made, include_extras=True).items():
            if not hasattr(hint, "__metadata__"):
                self.tables[name] = Table(hint, self._changed)
                continue
            self._columns[name] = column = hint.__metadata__[0]
            if column.seen_in is None:
                self._arrays[name] = GrowableArray(column.width, column.type, self._changed)
        self._all = [(name, self._columns[name], array) for name, array in self._arrays.items()]
        self._all += [each for table in self.tables.values() for each in table._all]
        self._view: Made | None = None
        self._whole: Made | None = None

    def _changed(self, moved: bool) -> None:
        self._view = None
        if moved:
            self._whole = None
        self._told(moved)

    def __getitem__(self, name: str) -> GrowableArray:
        return self._arrays[name]

    def __iter__(self) -> Iterator[GrowableArray]:
        return iter(self._arrays.values())

    @property
    def view(self) -> Made:
        """All rows, as kernels read them: the same until a column changes."""
        if self._view is None:
            self._view = self._seen("view")
        return self._view

    @property
    def whole(self) -> Made:
        """`view` with the spare capacity behind it, for kernels that write there: the same until one is reallocated."""
        if self._whole is None:
            self._whole = self._seen("whole")
        return self._whole

    def append_row(self, **values: np.ndarray) -> int:
        """Append a row to each column, of values (1, ...), zeros where none are given; returns its index."""
        row = 0
        for name, array in self._arrays.items():
            row = array.append(values[name]) if name in values else array.fill(1, 0)
        return row

    def rows(self, row: int) -> dict[str, np.ndarray]:
        """A row of each column, (1, ...)."""
        return {name: array.view[row : row + 1] for name, array in self._arrays.items()}

    def _seen(self, which: str) -> Made:
        values = {name: getattr(table, which) for name, table in self.tables.items()}
        for name, column in self._columns.items():
            values[name] = getattr(self._arrays[column.seen_in or name], which)
            if column.seen_in is not None:
                values[name] = values[name].view(column.type)
            if column.shape is not None:
                values[name] = values[name].reshape(column.shape)
        return self._made(**values)

    def all_columns(self) -> list[tuple[str, Column, GrowableArray]]:
        """Name, Column and rows of each column, those of the tables within too."""
        return self._all

    @property
    def bytes_used(self) -> int:
        """Size of all rows [bytes], without spare capacity."""
        return sum(array.used * array.row_bytes for _, _, array in self.all_columns())

    def move(self, moves: AllMoves) -> None:
        """Drop the rows that do not stay; what refers to rows that do is changed. Columns without rows stay empty."""
        for _, column, array in self.all_columns():
            if not array.used or not column.is_changed_by(moves, array.view):
                continue  # it may be shared with a preprocess, which this keeps so
            rows = array.view[moves[column.rows].stays]
            column.move(rows, moves)
            array.replace(rows)


def check_references(table: Table) -> None:
    """Raise AssertionError unless columns with rows of the same are as long, and refer to rows that there are."""
    used: dict[str, int] = {}
    for name, column, array in table.all_columns():
        if array.used:
            assert used.setdefault(column.rows, array.used) == array.used, f"{name}: not as long as others"
    for name, column, array in table.all_columns():
        for rows, values in column.references(array.view) if array.used else ():
            # the end of a range may be that of all rows
            assert values.max() <= used.get(rows, 0), f"{name}: a {rows} that there is not"
