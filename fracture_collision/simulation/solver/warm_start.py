"""Warm starting: a step's impulses are where the next step's iterations begin (Catto 2005, see contact_solver).

Scaled down where they overshoot (`apply_warm_start` in contact_step).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fracture_collision.kernel_sources import cached_njit


class WarmStart(NamedTuple):
    """Impulses of one step, for the next: matched by (fragment_a, fragment_b, contact id)."""

    fragment_a: np.ndarray  # (p,) uint32, ascending by (a, b)
    fragment_b: np.ndarray
    pair_begin: np.ndarray  # (p + 1,)
    contact_ids: np.ndarray  # (N,) uint64
    impulses: np.ndarray  # (N, 3) on b, world axes [N s]
    rolling: np.ndarray  # (p, 3) angular, on b, world axes [N m s]


NO_WARM_START = WarmStart(
    np.zeros(0, np.uint32), np.zeros(0, np.uint32), np.zeros(1, np.int64),
    np.zeros(0, np.uint64), np.zeros((0, 3)), np.zeros((0, 3)),
)  # fmt: skip


@cached_njit
def carried_impulses(fragment_a, fragment_b, begin, contact_ids, warm_start):
    """Impulses (N, 3), world axes, and rolling (p, 3) from the last step where it had the same contact; else zero.

    Pairs are merged in their common order; the few contacts of a pair are compared one by one.
    """
    old_a, old_b, old_begin, old_ids, old_impulses, old_rolling = warm_start
    impulses = np.zeros((contact_ids.size, 3))
    rolling = np.zeros((fragment_a.size, 3))
    old = 0
    for pair in range(fragment_a.size):
        a, b = fragment_a[pair], fragment_b[pair]
        while old < old_a.size and (old_a[old] < a or (old_a[old] == a and old_b[old] < b)):
            old += 1
        if old == old_a.size:
            break
        if old_a[old] != a or old_b[old] != b:
            continue
        rolling[pair] = old_rolling[old]
        for c in range(begin[pair], begin[pair + 1]):
            for o in range(old_begin[old], old_begin[old + 1]):
                if old_ids[o] == contact_ids[c]:
                    impulses[c] = old_impulses[o]
                    break
    return impulses, rolling
