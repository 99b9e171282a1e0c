"""Rows of a table that are equal, many times faster than np.unique finds them, which compares row by row."""

from __future__ import annotations

import numpy as np


def unique_rows(rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(m,) a row of each kind, the kinds ascending lexicographically, and (n,) each row's kind; rows (n, k) numbers.

    Zeros are equal whatever their sign.
    """
    order = np.lexsort(rows.T[::-1])
    ordered = rows[order]
    begins = np.ones(len(rows), dtype=np.bool_)
    begins[1:] = np.any(ordered[1:] != ordered[:-1], axis=1)
    kind = np.empty(len(rows), dtype=np.int64)
    kind[order] = np.cumsum(begins) - 1
    return order[begins], kind
