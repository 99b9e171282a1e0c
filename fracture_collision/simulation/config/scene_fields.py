"""Fields of a scene file, consumed one by one; every error is a SceneError that names the field."""

from __future__ import annotations

import math
import reprlib
import sys
from collections.abc import Mapping
from typing import Any

import numpy as np


class SceneError(ValueError):
    """An invalid scene file; the text begins with the field's path."""


MOST_QUOTED = 40  # characters of a value: enough to find it, and little of a file that is no scene


def quoted(value: Any) -> str:
    """The value, shortened for an error."""
    return shortened(reprlib.repr(value))


def shortened(text: str) -> str:
    """`text`, cut to MOST_QUOTED characters."""
    return text if len(text) <= MOST_QUOTED else f"{text[: MOST_QUOTED - 3]}..."


class Fields:
    """A mapping consumed field by field; a field left at the end is an error, probably a typo."""

    def __init__(self, content: Any, path: str) -> None:
        if not isinstance(content, Mapping):
            raise SceneError(f"{path or 'scene'}: needs fields, got {quoted(content)}")
        self._left = dict(content)
        self._path = path

    def name(self, key: str) -> str:
        """Full name of a field, as errors print it."""
        return f"{self._path}.{key}" if self._path else key

    def take(self, key: str, default: Any = ...) -> Any:
        """The value of a field, consumed; SceneError if it is missing and has no default."""
        if key in self._left:
            return self._left.pop(key)
        if default is ...:
            raise SceneError(f"{self.name(key)}: missing")
        return default

    def number(self, key: str, default: Any = ..., minimum: float = -math.inf, above: float = -math.inf) -> float:
        """A finite number of at least `minimum` and more than `above`; raises SceneError."""
        value = self.take(key, default)
        if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) <= sys.float_info.max:
            raise SceneError(f"{self.name(key)}: needs a finite number, got {quoted(value)}")
        if value < minimum or value <= above:
            limit = f"at least {minimum}" if value < minimum else f"more than {above}"
            raise SceneError(f"{self.name(key)}: needs {limit}, got {value}")
        return float(value)

    def text(self, key: str) -> str:
        """A text, or a number as text."""
        value = self.take(key)
        if isinstance(value, bool) or not isinstance(value, str | int | float):
            raise SceneError(f"{self.name(key)}: needs a text, got {quoted(value)}")
        return str(value)

    def integer(self, key: str, default: Any = ..., minimum: int = 0) -> int:
        """A whole number of at least `minimum`; raises SceneError."""
        value = self.take(key, default)
        if isinstance(value, bool) or not isinstance(value, int) or value < minimum:
            raise SceneError(f"{self.name(key)}: needs a whole number of at least {minimum}, got {quoted(value)}")
        return value

    def vector(self, key: str, size: int, default: Any = ...) -> np.ndarray:
        """`size` finite numbers, (size,) float64; raises SceneError."""
        value = self.take(key, default)
        if not isinstance(value, list | tuple) or len(value) != size:
            raise SceneError(f"{self.name(key)}: needs {size} numbers, got {quoted(value)}")
        parts = Fields({str(i): part for i, part in enumerate(value)}, self.name(key))
        return np.array([parts.number(str(i)) for i in range(size)])

    def mapping(self, key: str, default: Any = ...) -> Mapping:
        """A mapping, of further fields; raises SceneError."""
        value = self.take(key, default)
        if not isinstance(value, Mapping):
            raise SceneError(f"{self.name(key)}: needs fields, got {quoted(value)}")
        return value

    def sequence(self, key: str) -> list:
        """A list with at least one entry; raises SceneError."""
        value = self.take(key)
        if not isinstance(value, list) or not value:
            raise SceneError(f"{self.name(key)}: needs a list, got {quoted(value)}")
        return value

    def keys(self) -> list[Any]:
        """Fields not consumed yet, in the order of the file."""
        return list(self._left)

    def finish(self) -> None:
        """Raise SceneError if a field is left: it is unknown."""
        for key in self._left:
            raise SceneError(f"{self.name(shortened(str(key)))}: unknown field")


def numbers(fields: Fields, defaults: Any) -> Any:
    """A NamedTuple of non-negative numbers from fields of the same names."""
    values = {
        key: fields.integer(key, default) if isinstance(default, int) else fields.number(key, default, minimum=0.0)
        for key, default in defaults._asdict().items()
    }
    fields.finish()
    return type(defaults)(**values)
