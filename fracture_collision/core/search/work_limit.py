"""The one limit of work, for a step in which many fragments overlap each other, as bodies that push each other do not.

A hundred bodies in one place make five thousand pairs, each of which a search must follow to the last sample. So where
more samples may lie in the box of another fragment than the limit, every pair is searched coarsely by the same factor,
and its bound says what that may miss. The factor depends on the boxes and on numbers of samples, and on no state kept
from an earlier step.
"""

from __future__ import annotations

import numpy as np

from fracture_collision.core.memory.compiled import kernel
from fracture_collision.core.memory.kinds import SPHERE
from fracture_collision.core.memory.pools import Pools

# How a search ended.
COMPLETE, BY_LIMIT = 0, 1
# Samples of a pair that are queried however small its share is: fewer find no contact.
LEAST = 16
# A triangle near a sphere costs as much as so many samples: it is compared with all others there.
OF_SPHERE = 16


def share_work(
    pools: Pools, rows: np.ndarray, pairs: np.ndarray, boxes: np.ndarray, most: int
) -> tuple[int, np.ndarray]:
    """(one in so many samples is to be queried; about how many samples of each pair lie in the other's box (p,) int64).

    rows (n,): of the fragments; pairs (p, 2): of indices into them; boxes (n, 6) [m] in the world, those of planes
    unbounded; most: samples that may be queried in all.
    """
    within = _samples_within(pools.fragment, rows, pairs, boxes)
    return max(-(-int(within.sum()) // most), 1), within


@kernel
def _samples_within(fragment, rows, pairs, boxes):
    within, begin, end = np.zeros(len(pairs), np.int64), fragment.sample_begin, fragment.sample_end
    for p in range(len(pairs)):
        for side in range(2):
            i, j, share = pairs[p, side], pairs[p, 1 - side], 1.0
            for d in range(3):
                own = boxes[i, d + 3] - boxes[i, d]
                overlap = min(boxes[i, d + 3], boxes[j, d + 3]) - max(boxes[i, d], boxes[j, d])
                if 0.0 <= overlap < own:  # else also: a box without an extent, or without bounds
                    share *= overlap / own
            samples = share * (end[rows[i]] - begin[rows[i]])
            within[p] += np.int64(OF_SPHERE * samples if fragment.kind[rows[j]] == SPHERE else samples)
    return within
