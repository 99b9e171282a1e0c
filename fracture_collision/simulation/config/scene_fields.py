"""Scene files as plain data of bounded size, and their fields, consumed one by one.

Every error is a SceneError that names the file or the field.
"""

from __future__ import annotations

import csv
import math
import reprlib
import sys
from collections.abc import Container, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple, get_type_hints

import numpy as np

from fracture_collision.near_names import did_you_mean
from fracture_collision.plain_yaml import YamlError, load_yaml, shortened


class SceneError(ValueError):
    """An invalid scene file; the text begins with the field's path."""


MAX_SCENE_BYTES = 1_000_000
MAX_TRACK_BYTES = 20_000_000  # hours of a hand, at one row per step
ROTATION = "about the fixed axes x, y and z, one after the other"


def quoted(value: Any) -> str:
    """The value, shortened for an error."""
    return shortened(reprlib.repr(value))


class Entry(NamedTuple):
    """A field that a scene file may have, as the parser reads it."""

    path: str  # full name, of one scene
    kind: str  # "number", "3 numbers", "text" ...
    default: Any  # ...: it must be given
    limits: str  # of numbers; "": any
    words: str  # "[unit] meaning"


_recorded: list[Entry] | None = None


@contextmanager
def recorded() -> Iterator[list[Entry]]:
    """All fields that are read meanwhile, in the order of reading, whether given or not."""
    global _recorded
    before, _recorded = _recorded, []
    try:
        yield _recorded
    finally:
        _recorded = before


class Fields:
    """A mapping consumed field by field; a field left at the end is an error, probably a typo.

    Each field is read with `words`, its unit and meaning: errors quote them, and docs/scenes.md lists them.
    """

    def __init__(self, content: Any, path: str) -> None:
        if not isinstance(content, Mapping):
            raise SceneError(f"{path or 'scene'}: needs fields, got {quoted(content)}")
        self._left = dict(content)
        self._path = path
        self._known: list[str] = []

    def name(self, key: str) -> str:
        """Full name of a field, as errors print it."""
        return f"{self._path}.{key}" if self._path else key

    def take(self, key: str, words: str, default: Any = ..., kind: str = "", limits: str = "") -> Any:
        """The value of a field, consumed; SceneError if it is missing and has no default."""
        self._known.append(key)
        if _recorded is not None:
            _recorded.append(Entry(self.name(key), kind, default, limits, words))
        if key in self._left:
            return self._left.pop(key)
        if default is ...:
            raise SceneError(f"{self.name(key)}: missing; it is: {words}")
        return default

    def number(
        self,
        key: str,
        words: str,
        default: Any = ...,
        minimum: float = -math.inf,
        above: float = -math.inf,
        maximum: float = math.inf,
    ) -> float:
        """A finite number from `minimum`, or more than `above`, to `maximum`; raises SceneError."""
        limits = [f"at least {minimum:g}"] * (minimum > -math.inf) + [f"more than {above:g}"] * (above > -math.inf)
        limits += [f"at most {maximum:g}"] * (maximum < math.inf)
        value = self.take(key, words, default, "number", ", ".join(limits))
        if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) <= sys.float_info.max:
            raise SceneError(f"{self.name(key)}: needs a finite number, got {quoted(value)}")
        if value < minimum or value <= above or value > maximum:
            broken = f"more than {above}" if value <= above else f"at most {maximum:g}"
            broken = f"at least {minimum}" if value < minimum else broken
            raise SceneError(f"{self.name(key)}: needs {broken}, got {value}")
        return float(value)

    def text(self, key: str, words: str, default: Any = ...) -> str:
        """A text, or a number as text."""
        value = self.take(key, words, default, kind="text")
        if isinstance(value, bool) or not isinstance(value, str | int | float):
            raise SceneError(f"{self.name(key)}: needs a text, got {quoted(value)}")
        return str(value)

    def integer(self, key: str, words: str, default: Any = ..., minimum: int = 0) -> int:
        """A whole number of at least `minimum`; raises SceneError."""
        value = self.take(key, words, default, "whole number", f"at least {minimum}")
        if isinstance(value, bool) or not isinstance(value, int) or value < minimum:
            raise SceneError(f"{self.name(key)}: needs a whole number of at least {minimum}, got {quoted(value)}")
        return value

    def vector(self, key: str, words: str, size: int, default: Any = ..., above: float = -math.inf) -> np.ndarray:
        """`size` finite numbers, more than `above`, (size,) float64; raises SceneError."""
        value = self.take(key, words, default, f"{size} numbers", f"more than {above:g}" if above > -math.inf else "")
        if not isinstance(value, list | tuple) or len(value) != size:
            raise SceneError(f"{self.name(key)}: needs {size} numbers, got {quoted(value)}")
        with recorded():  # elements are no fields
            parts = Fields({str(i): part for i, part in enumerate(value)}, self.name(key))
            return np.array([parts.number(str(i), words, above=above) for i in range(size)])

    def numbers(self, record: Any, above: Container[str] = (), shares: Container[str] = ()) -> dict[str, Any]:
        """Numbers of at least 0 for the `int` and `float` fields of a NamedTuple, with its defaults and documentation.

        `above`: those of more than 0; `shares`: those of at most 1. Raises SceneError.
        """
        found: dict[str, Any] = {}
        for key, kind in get_type_hints(record).items():
            words, default = getattr(record, key).__doc__, record._field_defaults.get(key, ...)
            if kind is int:
                found[key] = self.integer(key, words, default)
            elif kind is float:
                low = {"above": 0.0} if key in above else {"minimum": 0.0}
                found[key] = self.number(key, words, default, maximum=1.0 if key in shares else math.inf, **low)
        return found

    def settings(self, key: str, words: str, record: Any) -> Any:
        """A NamedTuple of `numbers` that all have defaults, from the mapping `key`; raises SceneError."""
        part = Fields(self.mapping(key, words, {}), self.name(key))
        made = record(**part.numbers(record))
        part.finish()
        return made

    def timed_rows(
        self, key: str, words: str, columns: list[str], folder: Path | None, texts: int = 0
    ) -> tuple[np.ndarray, list[list[str]]]:
        """Rows of a CSV file in `folder`, or of a list: ascending times [s], then other numbers, then `texts` texts.

        The numbers (k, len(columns) - texts), and the texts of each row. `columns`: the header of the file. Raises
        SceneError.
        """
        rows, path = self.take(key, words, kind="CSV file, or list of rows"), self.name(key)
        if isinstance(rows, str):
            rows = _rows_of_file((folder or Path()) / rows, path, columns)
        if not isinstance(rows, list) or not rows:
            raise SceneError(f"{path}: needs the name of a CSV file, or a list of rows, got {quoted(rows)}")
        count = len(columns) - texts
        values = np.empty((len(rows), count))
        for i, row in enumerate(rows):
            try:
                values[i] = [float(number) for number in row[:count]]
                is_complete = len(row) == len(columns)
            except (ValueError, TypeError, OverflowError, LookupError):
                is_complete = False
            if not is_complete:
                raise SceneError(f"{path}[{i}]: needs {', '.join(columns)}, got {quoted(row)}")
            if not np.all(np.isfinite(values[i])):
                raise SceneError(f"{path}[{i}]: needs finite numbers, got {quoted(row)}")
            if i and values[i, 0] <= values[i - 1, 0]:
                raise SceneError(f"{path}[{i}]: time {values[i, 0]} s does not follow {values[i - 1, 0]} s")
        return values, [[str(text or "") for text in row[count:]] for row in rows]

    def mapping(self, key: str, words: str, default: Any = ...) -> Mapping:
        """A mapping, of further fields; raises SceneError."""
        value = self.take(key, words, default, "fields")
        if not isinstance(value, Mapping):
            raise SceneError(f"{self.name(key)}: needs fields, got {quoted(value)}")
        return value

    def sequence(self, key: str, words: str) -> list:
        """A list with at least one entry; raises SceneError."""
        value = self.take(key, words, kind="list", limits="at least one")
        if not isinstance(value, list) or not value:
            raise SceneError(f"{self.name(key)}: needs a list, got {quoted(value)}")
        return value

    def keys(self) -> list[Any]:
        """Fields not consumed yet, in the order of the file."""
        return list(self._left)

    def finish(self) -> None:
        """Raise SceneError if a field is left: it is unknown."""
        for key in self._left:
            advice = did_you_mean(str(key), self._known) or f"; there are {', '.join(self._known)}"
            raise SceneError(f"{self.name(shortened(str(key)))}: unknown field{advice}")


def read_text(file: Path, most_bytes: int) -> str:
    """The text of a regular file of at most `most_bytes`; raises SceneError."""
    try:
        if not file.is_file():  # a device or a pipe may never end
            raise SceneError(f"{file}: no such file")
        with file.open("rb") as stream:
            data = stream.read(most_bytes + 1)
    except (OSError, ValueError) as error:
        raise error if isinstance(error, SceneError) else SceneError(f"{file}: {error}") from error
    if len(data) > most_bytes:
        raise SceneError(f"{file}: more than {most_bytes} bytes")
    try:
        return data.decode("utf-8")
    except UnicodeDecodeError as error:
        raise SceneError(f"{file}: not UTF-8: {error}") from error


def read_yaml(file: Path) -> Any:
    """Content of a YAML file: mappings, lists, texts and numbers, no objects; raises SceneError."""
    try:
        return load_yaml(read_text(file, MAX_SCENE_BYTES))
    except YamlError as error:
        raise SceneError(f"{file}: {error}") from error


def _rows_of_file(file: Path, path: str, columns: list[str]) -> list[list[str]]:
    """Rows of a CSV file with the header `columns`; `path` is the field that names the file. Raises SceneError."""
    try:
        lines = read_text(file, MAX_TRACK_BYTES).splitlines(keepends=True)
        rows = [row for row in csv.reader(line for line in lines if not line.startswith("#")) if row]
    except (SceneError, csv.Error) as error:
        raise SceneError(f"{path}: {error}") from error
    if not rows or rows[0] != columns:
        raise SceneError(f"{path}: {file} does not begin with the columns {','.join(columns)}")
    return rows[1:]
