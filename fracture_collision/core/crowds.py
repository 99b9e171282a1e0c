"""What a step may cost where many fragments lie in each other, as bodies that push each other apart never do.

A hundred bodies at one place are five thousand pairs, each of which a search has to go through to the last sample. So
pairs whose boxes mostly coincide share a number of visits, and a pair whose share would not do for a beginning is not
searched at all. All others share 25 times that number, which they hardly ever reach. What a pair gets depends on
where the boxes are and on the sizes of the trees, and on nothing that a step may have kept from an earlier one.
"""

from __future__ import annotations

import numpy as np

from fracture_collision.core.compiled import inlined_kernel, kernel
from fracture_collision.core.crack_seeds import MOST_SEEDS
from fracture_collision.core.kinds import SPHERE, TETRAHEDRA, TRIANGLES
from fracture_collision.core.pools import Pools

UNSHARED = 0  # of visits: no limit
UNSEARCHED = -1
# Boxes coincide if their overlap has this share of the larger volume.
COINCIDENT = 0.5
# What a visit costs more than one whose sample is asked of a closed form, measured where surfaces all but coincide.
COST_TETRAHEDRA, COST_TRIANGLES = 10, 40
# Visits that may find a few contacts; with fewer a search is in vain.
LEAST_VISITS = 16
# How many times as much pairs that do not coincide may cost.
APART = 25


@kernel
def coincident(boxes, pairs):
    """Which of `pairs` (p, 2) mostly coincide, (p,) bool; boxes (n, 6) [m] in the world, those of planes unbounded."""
    mostly = np.zeros(len(pairs), np.bool_)
    for p in range(len(pairs)):
        a, b, share = boxes[pairs[p, 0]], boxes[pairs[p, 1]], 1.0
        for d in range(3):
            overlap = min(a[d + 3], b[d + 3]) - max(a[d], b[d])
            share *= max(overlap, 0.0) / max(a[d + 3] - a[d], b[d + 3] - b[d])
        mostly[p] = share > COINCIDENT
    return mostly


def most_visits(pools: Pools, rows: np.ndarray, pairs: np.ndarray) -> np.ndarray:
    """(p,) int64 that a search of each of `pairs` can at most take: every node of both trees, every seed."""
    entries = (pools.fragment.tree_end[rows] - pools.fragment.tree_begin[rows]).astype(np.int64)
    return entries[pairs[:, 0]] + entries[pairs[:, 1]] + MOST_SEEDS


@kernel
def _most_together(kinds, tree_begin, tree_end, rows, pairs, is_coincident):
    """What all pairs that coincide, and all others, cost at most, in visits of a closed form."""
    coincide = apart = 0
    for p in range(len(pairs)):
        a, b = rows[pairs[p, 0]], rows[pairs[p, 1]]
        most = np.int64(tree_end[a]) - tree_begin[a] + tree_end[b] - tree_begin[b] + MOST_SEEDS
        most *= max(_cost(kinds[a]), _cost(kinds[b]))
        if is_coincident[p]:
            coincide += most
        else:
            apart += most
    return coincide, apart


@inlined_kernel
def _cost(kind):
    return COST_TETRAHEDRA if kind == TETRAHEDRA else COST_TRIANGLES if kind == TRIANGLES else 1


def visit_shares(
    pools: Pools, rows: np.ndarray, pairs: np.ndarray, is_coincident: np.ndarray, visits: int
) -> np.ndarray:
    """Visits (p,) int64 that each of `pairs` (p, 2) of indices into `rows` may take, UNSHARED or UNSEARCHED.

    `visits`: of all that coincide together, in visits of a closed form.
    """
    fragment = pools.fragment
    together = _most_together(fragment.kind, fragment.tree_begin, fragment.tree_end, rows, pairs, is_coincident)
    if together[0] <= visits and together[1] <= APART * visits:
        return np.zeros(len(pairs), np.int64)
    most = most_visits(pools, rows, pairs)
    kinds = fragment.kind[rows]
    ends = kinds[pairs]
    cost_of_ends = np.where(ends == TETRAHEDRA, COST_TETRAHEDRA, np.where(ends == TRIANGLES, COST_TRIANGLES, 1))
    cost = cost_of_ends.max(axis=1, initial=1)
    least = np.full(len(pairs), LEAST_VISITS)
    # the centre of a sphere may be as far from all of a surface as can be
    alone = (ends == SPHERE).any(axis=1) & (cost > 1)
    least[alone] += most[alone]
    shares = np.full(len(pairs), UNSHARED)
    for those, together in ((is_coincident, visits), (~is_coincident, APART * visits)):
        if int((most * cost)[those].sum()) > together:
            share = together // (int(np.count_nonzero(those)) * cost[those])
            shares[those] = np.where(share < least[those], UNSEARCHED, share)
    return shares
