"""Checks shared by all validators: sizes, ranges, finiteness; each error names the field."""

from __future__ import annotations

from typing import Literal, NoReturn

import numpy as np

from fracture_collision.world.gates.errors import InvalidMessage

UINT32_MAX = 0xFFFFFFFF
UINT64_MAX = 0xFFFFFFFFFFFFFFFF
# [m] Beyond it, doubles are more than 0.1 micrometres apart; within it, no fifth power of a length overflows.
LARGEST_LENGTH = 1e9
# [m] Products of four lengths lose bits to underflow only far below this, and no rigid body is that small.
SMALLEST_LENGTH = 1e-6


# Contiguous, aligned, writeable: numba compiles kernels again for arrays that are not, such as read-only ones.
KERNELS_TAKE: tuple[Literal["C", "A", "W"], ...] = ("C", "A", "W")


def refuse(kind: str, text: str) -> NoReturn:
    """Raise InvalidMessage."""
    raise InvalidMessage(kind, text)


def floats(name: str, values, columns: int = 0, limit: float = np.inf) -> np.ndarray:
    """`values`, flat or in rows, as float64, all finite, none beyond +-limit; (n, columns) if columns are given."""
    given = _array(name, values, columns)
    if given.dtype.kind not in "fiu":
        refuse("wrong_type", f"{name}: {given.dtype} instead of numbers; pass an array of float64")
    with np.errstate(over="ignore"):  # values too large for a double become infinite, and are rejected
        array = np.require(given, np.float64, KERNELS_TAKE).ravel()
    if not np.isfinite(array).all():
        i = int(np.flatnonzero(~np.isfinite(array))[0])
        refuse("not_finite", f"{name}: entry {i} is {array[i]}")
    if limit < np.inf and (np.abs(array) > limit).any():
        i = int(np.argmax(np.abs(array)))
        refuse("out_of_range", f"{name}: entry {i}, {array[i]}, is beyond {limit:g}")
    return _shaped(name, array, columns)


def indices(name: str, values, columns: int = 0, below: int | None = None, of: str = "") -> np.ndarray:
    """`values` as int64, each in 0 .. below - 1 (default: uint32); (n, columns) as in `floats`."""
    given = _array(name, values, columns)
    if not given.size:
        # an empty list has no integer type
        given = np.empty(0, dtype=np.int64)
    if given.dtype.kind not in "iu":
        refuse("wrong_type", f"{name}: {given.dtype} instead of integers; convert it, as by .astype(numpy.uint32)")
    limit = UINT32_MAX + 1 if below is None else below
    flat = given.ravel()
    if flat.size and (flat.min() < 0 or flat.max() >= limit):
        i = int(np.flatnonzero((flat < 0) | (flat >= limit))[0])
        what = "is negative" if flat[i] < 0 else f"is not below {limit}{' ' + of if of else ''}"
        from_one = below is not None and flat.min() == 1 and flat.max() == limit
        advice = "; the indices seem to start at 1: subtract 1 from all" if from_one else ""
        refuse("out_of_range", f"{name}: index {flat[i]} (entry {i}) {what}{advice}")
    return _shaped(name, np.require(flat, np.int64, KERNELS_TAKE), columns)


def _array(name: str, values, columns: int) -> np.ndarray:
    try:
        given = np.asarray(values)
    except (TypeError, ValueError, OverflowError):
        raise InvalidMessage(
            "wrong_type", f"{name}: not an array of numbers; pass a numpy array, or a list without gaps"
        ) from None
    # Rows in another order, or transposed, would be read as other numbers.
    if given.ndim > 2 or (given.ndim == 2 and given.size and given.shape[1] not in (1, columns)):
        rows = f"(n, {columns})" if columns else "(n,)"
        refuse("size_mismatch", f"{name}: shape {given.shape}; pass shape {rows}, or the same numbers flat")
    return given


def _shaped(name: str, array: np.ndarray, columns: int) -> np.ndarray:
    if not columns:
        return array
    if array.size % columns:
        refuse("size_mismatch", f"{name}: {array.size} numbers are not a multiple of {columns}")
    return array.reshape(-1, columns)


def same_length(name: str, array: np.ndarray, other: str, count: int) -> None:
    """Raise InvalidMessage unless `array` has one entry for each of `count` entries of `other`."""
    if len(array) != count:
        refuse("size_mismatch", f"{name}: {len(array)} entries for {count} {other}")


def number(name: str, value, low: float, high: float = np.inf, open_low: bool = False) -> float:
    """`value` as a finite float in [low, high], or in (low, high] with `open_low`."""
    try:
        number = float(value)
    except (TypeError, ValueError, OverflowError):
        raise InvalidMessage("wrong_type", f"{name}: {type(value).__name__} instead of a number") from None
    if not np.isfinite(number):
        refuse("not_finite", f"{name}: {number}")
    if number < low or number > high or (open_low and number == low):
        refuse("out_of_range", f"{name}: {number} is outside {'(' if open_low else '['}{low}, {high}]")
    return number


def identifier(name: str, value, maximum: int = UINT32_MAX) -> int:
    """`value` as an int in 0 .. maximum; booleans are rejected."""
    if isinstance(value, bool) or not isinstance(value, int | np.integer):
        refuse("wrong_type", f"{name}: {type(value).__name__} instead of an integer")
    if not 0 <= int(value) <= maximum:
        refuse("out_of_range", f"{name}: {value} is not in 0 .. {maximum}")
    return int(value)


def each_once(name: str, values: np.ndarray) -> None:
    """Raise InvalidMessage if an entry of `values` (n,) occurs more than once."""
    if (values[1:] > values[:-1]).all():
        return
    ordered = np.sort(values)
    twice = np.flatnonzero(ordered[1:] == ordered[:-1])
    if len(twice):
        refuse("doubled", f"{name}: {ordered[twice[0]]} occurs more than once; list each once")
