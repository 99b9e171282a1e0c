"""What is remembered of pairs from step to step, so that those which hardly move against each other cost little.

Which samples of a pair may touch (Verlet 1967): a search that is done with `reach` to spare lists all samples that may
be within the detection tolerance and `reach` of the other fragment. As long as no sample has moved farther against the
other than `reach`, those that are within the tolerance are among them. Of each that was asked and is not near it is
known how far the pair has to travel before it can be, and until then it is not asked again. What is left to ask gives
what the search would give: same contacts, same bytes. It is done for pairs with fewer than the contacts wanted; of
others a search takes some and leaves some, and what it takes depends on its way.

How far apart a pair is: where a search found it parted, by its boxes or a plane, its list is empty, and holds until the
two have moved by their clearance.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from fracture_collision.core.compiled import inlined_kernel, kernel
from fracture_collision.core.kinds import PLANE

# Samples a list has room for.
MOST_LISTED = 256
# A list is made of pairs that move by less than this share of the smaller R in a step.
FAST = 0.003
# How far beyond the tolerance it reaches: as far as the pair moves in so many steps, within these shares of R. More
# lasts longer and lists more.
LASTS, LEAST_REACH, MOST_REACH = 4.0, 0.005, 0.02
# How far beyond the tolerance a listed sample's distance is looked for, in steps likewise: more is asked less often.
AHEAD = 2.0
# Values of `counts` without a list.
NOT_LISTED = -1  # the pair moves too fast
FULL = -2  # as many contacts as were wanted, or more samples near than MOST_LISTED: no list is tried at the next step
# Value of `until`: it was near when it was asked last.
NEAR_LAST = -1.0
# Room for so many pairs at first.
LEAST_ROOM = 64


class NeighbourLists(NamedTuple):
    """Columns have a row for each slot; a pair keeps its slot for as long as its boxes meet."""

    keys: np.ndarray  # (p,) int64, ascending: of the pairs of the last step, pair_keys
    slots: np.ndarray  # (p,) int64: theirs
    poses: np.ndarray  # (room, 2, 12) float64: rotation (9), translation (3) [m] from a's frame to b's, and back
    listed_at: np.ndarray  # (room, 2, 12) float64: likewise when the list was made
    reach: np.ndarray  # (room,) float64 [m]: for how much motion since then it holds
    travelled: np.ndarray  # (room,) float64 [m]: by how much the pair has moved from step to step since then, in all
    counts: np.ndarray  # (room,) int32: listed samples, NOT_LISTED or FULL
    samples: np.ndarray  # (room, MOST_LISTED) int32: 2 (row of TreePool) + side
    until: np.ndarray  # (room, MOST_LISTED) float64 [m]: how far they travel before it can be near, or NEAR_LAST
    toward: np.ndarray  # (room, 3) float64: in b's frame, along which the two lay farthest apart; zeros: nobody knows


def _make_lists(room: int) -> NeighbourLists:
    nobody = np.empty(0, np.int64)
    return NeighbourLists(
        nobody, nobody, np.zeros((room, 2, 12)), np.zeros((room, 2, 12)), np.zeros(room), np.zeros(room),
        np.full(room, NOT_LISTED, np.int32), np.empty((room, MOST_LISTED), np.int32), np.empty((room, MOST_LISTED)),
        np.zeros((room, 3)),
    )  # fmt: skip


NO_LISTS = _make_lists(0)


def pair_keys(rows: np.ndarray, pairs: np.ndarray) -> np.ndarray:
    """Keys (p,) int64 of `pairs` (p, 2) of indices into `rows`."""
    return (rows[pairs[:, 0]].astype(np.int64) << 32) | rows[pairs[:, 1]].astype(np.int64)


def with_pairs(before: NeighbourLists, keys: np.ndarray) -> tuple[NeighbourLists, np.ndarray, np.ndarray]:
    """The lists of a step whose pairs have `keys` (p,), with the slot of each (p,), and whether it had it before (p,).

    `before` is not to be used any more: columns are shared.
    """
    order = np.argsort(keys, kind="stable")
    ordered = keys[order]
    room = len(before.counts)
    if room < len(keys):
        columns = _make_lists(max(len(keys) + len(keys) // 2, LEAST_ROOM))
        for old, new in zip(before[2:], columns[2:], strict=True):
            new[:room] = old
        before = columns._replace(keys=before.keys, slots=before.slots)
    slots, known = _take_slots(before.keys, before.slots, ordered, len(before.counts))
    before.counts[slots[~known]], before.toward[slots[~known]] = NOT_LISTED, 0.0
    of_pairs, were_known = np.empty_like(slots), np.empty_like(known)
    of_pairs[order], were_known[order] = slots, known
    return before._replace(keys=ordered, slots=slots), of_pairs, were_known


@kernel
def _take_slots(known_keys, known_slots, keys, room):
    """Slots (p,) of ascending `keys`, those that they had or free ones, and which they had (p,)."""
    slots, known = np.empty(len(keys), np.int64), np.zeros(len(keys), np.bool_)
    is_taken = np.zeros(room, np.bool_)
    i = 0
    for k in range(len(keys)):
        while i < len(known_keys) and known_keys[i] < keys[k]:
            i += 1
        if i < len(known_keys) and known_keys[i] == keys[k]:
            slots[k], known[k] = known_slots[i], True
            is_taken[slots[k]] = True
    free = 0
    for k in range(len(keys)):
        if not known[k]:
            while is_taken[free]:
                free += 1
            slots[k] = free
            free += 1
    return slots, known


@inlined_kernel
def reach_of(moves, radius):
    """(reach of a list, how far ahead a sample is looked for) [m] for a pair that moves by `moves` [m] a step; 0, 0: it
    is not to be listed. radius [m]: the smaller R.
    """
    if moves >= FAST * radius:
        return 0.0, 0.0
    reach = min(max(LASTS * moves, LEAST_REACH * radius), MOST_REACH * radius)
    return reach, min(max(AHEAD * moves, LEAST_REACH * radius), reach)


@inlined_kernel
def keep_pose(rotation, translation, out):
    """Relative poses (2, 3, 3), (2, 3) into (2, 12)."""
    for side in range(2):
        for i in range(3):
            for j in range(3):
                out[side, 3 * i + j] = rotation[side, i, j]
            out[side, 9 + i] = translation[side, i]


@inlined_kernel
def spin(rotation, before):
    """Largest displacement of a point at distance 1 from the origin between rotations (3, 3) and (9,).

    The difference of two rotations has two equal singular values and a zero.
    """
    total = 0.0
    for i in range(3):
        for j in range(3):
            d = rotation[i, j] - before[3 * i + j]
            total += d * d
    return math.sqrt(0.5 * total)


@inlined_kernel
def displacement(pools, a, b, rotation, translation, before):
    """Upper bound [m] of how far a point of either fragment has moved in the other's frame since poses (2, 12)."""
    farthest = 0.0
    for side in range(2):
        f = a if side == 0 else b
        if pools.fragment.kind[f] == PLANE:
            continue
        box = pools.fragment.box[f]
        half2 = moved2 = 0.0
        for i in range(3):
            half2 += 0.25 * (box[i + 3] - box[i]) ** 2
            d = translation[side, i] - before[side, 9 + i]
            for j in range(3):
                d += (rotation[side, i, j] - before[side, 3 * i + j]) * 0.5 * (box[j] + box[j + 3])
            moved2 += d * d
        farthest = max(farthest, math.sqrt(moved2) + spin(rotation[side], before[side]) * math.sqrt(half2))
    return farthest
