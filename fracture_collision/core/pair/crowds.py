"""Work limits for a step in which many fragments overlap each other, as bodies that push each other apart never do.

A hundred bodies in one place make five thousand pairs, each of which a search must traverse to the last sample. So
pairs whose boxes mostly coincide share a number of visits, and a pair whose share is too small to begin with is not
searched at all. All others share 25 times that number, which they rarely reach: for these, only nodes in the
other's box are counted, since the rest is culled early. A pair's share depends on the boxes and on the sizes of the
trees, and on no state kept from an earlier step.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fracture_collision.core.fracture.crack_seeds import MOST_SEEDS
from fracture_collision.core.memory.compiled import inlined_kernel, kernel
from fracture_collision.core.memory.kinds import SPHERE, TETRAHEDRA, TRIANGLES
from fracture_collision.core.memory.pools import Pools

UNSHARED = 0  # of visits: no limit
UNSEARCHED = -1
# Boxes coincide if their overlap has this share of the larger volume.
COINCIDENT = 0.5
# Cost of a visit relative to one whose sample is queried in closed form, measured where surfaces all but coincide.
COST_TETRAHEDRA, COST_TRIANGLES = 10, 40
# Visits that may find a few contacts; a search with fewer is futile.
LEAST_VISITS = 16
# Factor on the total cost allowed for pairs that do not coincide.
APART = 25
# For a pair that does not coincide, a search tests about this share of the nodes in the other's box; the rest is beyond
# a plane between the two.
ASKED = 0.4


class Overlaps(NamedTuple):
    """Overlaps of the boxes of pairs."""

    coincide: np.ndarray  # (p,) bool: whether they mostly coincide
    shares: np.ndarray  # (p, 2) float64: how much of either's volume is in the other


@kernel
def overlaps_of(boxes, pairs):
    """Overlaps of `pairs` (p, 2) of boxes (n, 6) [m] in the world, those of planes unbounded."""
    coincide, shares = np.zeros(len(pairs), np.bool_), np.ones((len(pairs), 2))
    for p in range(len(pairs)):
        a, b, share = boxes[pairs[p, 0]], boxes[pairs[p, 1]], 1.0
        for d in range(3):
            overlap = max(min(a[d + 3], b[d + 3]) - max(a[d], b[d]), 0.0)
            share *= overlap / max(a[d + 3] - a[d], b[d + 3] - b[d])
            shares[p, 0] *= overlap / (a[d + 3] - a[d])
            shares[p, 1] *= overlap / (b[d + 3] - b[d])
        coincide[p] = share > COINCIDENT
    return Overlaps(coincide, shares)


def most_visits(pools: Pools, rows: np.ndarray, pairs: np.ndarray) -> np.ndarray:
    """(p,) int64, the most visits that a search of each of `pairs` can take: every node of both trees, every seed."""
    entries = (pools.fragment.tree_end[rows] - pools.fragment.tree_begin[rows]).astype(np.int64)
    return entries[pairs[:, 0]] + entries[pairs[:, 1]] + MOST_SEEDS


@kernel
def _most_together(kinds, tree_begin, tree_end, rows, pairs, overlaps):
    """Upper bounds of the cost of all pairs that coincide, and of all others, in visits of a closed form."""
    coincide = apart = 0
    for p in range(len(pairs)):
        a, b = rows[pairs[p, 0]], rows[pairs[p, 1]]
        of_a, of_b = tree_end[a] - tree_begin[a], tree_end[b] - tree_begin[b]
        cost = max(_cost(kinds[a]), _cost(kinds[b]))
        if overlaps.coincide[p]:
            coincide += (of_a + of_b + MOST_SEEDS) * cost
        else:
            # not a number: a box without an extent
            x, y = overlaps.shares[p, 0], overlaps.shares[p, 1]
            within = of_a * (x if x < 1.0 else 1.0) + of_b * (y if y < 1.0 else 1.0)
            apart += np.int64(ASKED * within) * cost
    return coincide, apart


@inlined_kernel
def _cost(kind):
    return COST_TETRAHEDRA if kind == TETRAHEDRA else COST_TRIANGLES if kind == TRIANGLES else 1


def visit_shares(pools: Pools, rows: np.ndarray, pairs: np.ndarray, overlaps: Overlaps, visits: int) -> np.ndarray:
    """Visit limits (p,) int64 of `pairs` (p, 2) of indices into `rows`, or UNSHARED or UNSEARCHED.

    `visits`: for all that coincide together, in visits of a closed form.
    """
    fragment = pools.fragment
    return _visit_shares(fragment.kind, fragment.tree_begin, fragment.tree_end, rows, pairs, overlaps, visits)


@kernel
def _visit_shares(kinds, tree_begin, tree_end, rows, pairs, overlaps, visits):
    shares = np.full(len(pairs), UNSHARED)
    most = _most_together(kinds, tree_begin, tree_end, rows, pairs, overlaps)
    for do_coincide in (True, False):
        together = visits if do_coincide else APART * visits
        if most[0 if do_coincide else 1] <= together:
            continue
        count = np.count_nonzero(overlaps.coincide == do_coincide)
        for p in range(len(pairs)):
            if overlaps.coincide[p] != do_coincide:
                continue
            a, b = rows[pairs[p, 0]], rows[pairs[p, 1]]
            cost, least = max(_cost(kinds[a]), _cost(kinds[b])), LEAST_VISITS
            if cost > 1 and (kinds[a] == SPHERE or kinds[b] == SPHERE):
                # the centre of a sphere may be as far from all of a surface as can be
                least += tree_end[a] - tree_begin[a] + tree_end[b] - tree_begin[b] + MOST_SEEDS
            share = together // (count * cost)
            shares[p] = UNSEARCHED if share < least else share
    return shares
