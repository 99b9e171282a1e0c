"""Equal rows of a table, by hashing: no sorting, and a row is compared with few besides its equals."""

from __future__ import annotations

import numpy as np

from fracture_collision.kernel_sources import cached_njit

_EMPTY = -1
_FACTOR = 0x9E3779B97F4A7C15  # odd, its bits all over (Knuth, "Sorting and Searching", section 6.4)


def unique_rows(rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(m,) the first row of each kind, ascending, and (n,) each row's kind, 0 .. m - 1; rows (n, k) numbers.

    Rows are compared as float64, bit by bit, but zeros of either sign are equal; NaN is not a valid number.
    """
    numbers = np.ascontiguousarray(rows, dtype=np.float64) + 0.0  # one zero
    chosen, kind = np.empty(len(rows), np.int64), np.empty(len(rows), np.int64)
    slots = np.full(1 << (2 * len(rows)).bit_length(), _EMPTY, np.int64)
    return chosen[: _group(numbers.view(np.uint64), slots, chosen, kind)], kind


@cached_njit
def _group(bits, slots, chosen, kind):
    """Fill `chosen` and `kind` from bits (n, k); returns the number of kinds. len(slots): a power of two above 2 n."""
    count, last = 0, np.uint64(len(slots) - 1)
    for i in range(len(bits)):
        key = np.uint64(0)
        for d in range(bits.shape[1]):
            key = (key ^ bits[i, d]) * np.uint64(_FACTOR)
            key ^= key >> np.uint64(32)
        slot = key & last
        while slots[slot] != _EMPTY and not _same(bits, i, chosen[slots[slot]]):
            slot = (slot + np.uint64(1)) & last
        if slots[slot] == _EMPTY:
            slots[slot], chosen[count] = count, i
            count += 1
        kind[i] = slots[slot]
    return count


@cached_njit
def _same(bits, i, j):
    d = 0
    while d < bits.shape[1] and bits[i, d] == bits[j, d]:
        d += 1
    return d == bits.shape[1]
