"""Which samples of a pair may touch, remembered while the two hardly move against each other (Verlet 1967).

A search that is done with `reach` to spare lists all samples within the detection tolerance and `reach` of the other
fragment. As long as no sample has moved farther against the other than `reach`, those that are within the tolerance
are among them, and asking them gives what the search would give: same contacts, same bytes. It is done for pairs with
fewer than the contacts wanted; of others a search takes some and leaves some, and what it takes depends on its way.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from fracture_collision.core.compiled import inlined_kernel
from fracture_collision.core.kinds import PLANE, SPHERE

# Samples a list has room for.
MOST_LISTED = 256
# How far beyond the tolerance a list reaches, as a share of the smaller R: more lasts longer and lists more.
REACH = 0.005
# A list is made once a pair moves by less than this share of `reach` a step, so that it lasts a few steps.
SLOW = 0.25
# Values of `counts` without a list.
NOT_LISTED = -1  # the pair moves too fast
FULL = -2  # as many contacts as were wanted, or more samples near than MOST_LISTED: no list is tried at the next step


class NeighbourLists(NamedTuple):
    """Of the pairs of a step, in ascending order of `keys`."""

    keys: np.ndarray  # (p,) int64: of each pair of rows of FragmentPool, pair_keys
    poses: np.ndarray  # (p, 2, 12) float64: rotation (9), translation (3) [m] from a's frame to b's, and back
    listed_at: np.ndarray  # (p, 2, 12) float64: likewise when the list was made
    counts: np.ndarray  # (p,) int32: listed samples, NOT_LISTED or FULL
    samples: np.ndarray  # (p, MOST_LISTED) int32: 2 (row of TreePool) + side, ascending by side and sample


def make_lists(keys: np.ndarray) -> NeighbourLists:
    """Room for pairs with ascending `keys` (p,)."""
    p = len(keys)
    return NeighbourLists(
        keys, np.empty((p, 2, 12)), np.empty((p, 2, 12)), np.full(p, NOT_LISTED, np.int32),
        np.empty((p, MOST_LISTED), np.int32),
    )  # fmt: skip


def pair_keys(rows: np.ndarray, pairs: np.ndarray) -> np.ndarray:
    """Keys (p,) int64 of `pairs` (p, 2) of indices into `rows`."""
    return (rows[pairs[:, 0]].astype(np.int64) << 32) | rows[pairs[:, 1]].astype(np.int64)


def match(lists: NeighbourLists, keys: np.ndarray) -> np.ndarray:
    """Where each of `keys` stands in `lists`, -1: nowhere."""
    if not len(lists.keys):
        return np.full(len(keys), -1)
    at = np.minimum(np.searchsorted(lists.keys, keys), len(lists.keys) - 1)
    return np.where(lists.keys[at] == keys, at, -1)


NO_LISTS = make_lists(np.empty(0, np.int64))


@inlined_kernel
def can_be_listed(pools, a, b):
    """Whether all contacts of a pair are samples."""
    return pools.fragment.kind[a] != SPHERE and pools.fragment.kind[b] != SPHERE


@inlined_kernel
def keep_pose(rotation, translation, out):
    """Relative poses (2, 3, 3), (2, 3) into (2, 12)."""
    for side in range(2):
        for i in range(3):
            for j in range(3):
                out[side, 3 * i + j] = rotation[side, i, j]
            out[side, 9 + i] = translation[side, i]


@inlined_kernel
def keep_list(before, last, lists, slot):
    """Take the list of pair `last` over into the next step's."""
    lists.counts[slot] = before.counts[last]
    for side in range(2):
        for i in range(12):
            lists.listed_at[slot, side, i] = before.listed_at[last, side, i]
    for i in range(before.counts[last]):
        lists.samples[slot, i] = before.samples[last, i]


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
