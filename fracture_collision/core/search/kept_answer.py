"""The last answer, reused for pairs whose fragments have not moved since: it is the same to the last bit."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fracture_collision.core.memory.compiled import kernel


class PairContacts(NamedTuple):
    """Contacts of p pairs, N in all; those of each pair are contiguous."""

    counts: np.ndarray  # (p,) int64
    bounds: np.ndarray  # (p,) float64 [m], missed depth bound
    visits: np.ndarray  # (p,) int64, tree nodes tested
    exhausted: np.ndarray  # (p,) uint8, not 0: cut short by a limit
    points_a: np.ndarray  # (N, 3) float64 [m], world
    points_b: np.ndarray  # (N, 3) float64 [m], world
    normals: np.ndarray  # (N, 3) float64, from a to b
    gaps: np.ndarray  # (N,) float64 [m]
    samples: np.ndarray  # (N, 2) int64: side whose sample it is (0: a), sample index, see Sink


class KeptAnswer(NamedTuple):
    """An answer and what it depends on."""

    stamp: int  # of the geometry queried: after any change of it the answer is invalid
    index_of_row: np.ndarray  # (r,) int64: index into `poses` for a row of FragmentPool, -1: none
    poses: np.ndarray  # (n, 12) uint64: the bits of rotations and positions in the world
    pair_of_slot: np.ndarray  # (s,) int64: index into `contacts` of the pair with this slot of NeighbourLists, or -1
    offsets: np.ndarray  # (p + 1,) int64, of each pair's contacts
    contacts: PairContacts


_NOBODY = np.zeros(0, np.int64)
NOTHING_KEPT = KeptAnswer(
    -1, _NOBODY, np.zeros((0, 12), np.uint64), _NOBODY, _NOBODY,
    PairContacts(
        _NOBODY, np.zeros(0), _NOBODY, np.zeros(0, np.uint8), np.zeros((0, 3)), np.zeros((0, 3)), np.zeros((0, 3)),
        np.zeros(0), np.zeros((0, 2), np.int64),
    ),
)  # fmt: skip


@kernel
def indices_of_kept(rows, slots, room, exhausted):
    """index_of_row and pair_of_slot of a KeptAnswer for fragments `rows` (n,).

    slots (p,), -1: do not keep the pair; `room` slots in all; exhausted (p,): of PairContacts, others are not kept.
    """
    index_of_row, pair_of_slot = np.full(rows.max() + 1 if len(rows) else 0, -1), np.full(room, -1)
    for i in range(len(rows)):
        index_of_row[rows[i]] = i
    for p in range(len(slots)):
        if slots[p] >= 0 and exhausted[p] == 0:
            pair_of_slot[slots[p]] = p
    return index_of_row, pair_of_slot


@kernel
def pose_bits(rotations, positions):
    """Bits of rotations (n, 3, 3) and positions (n, 3): (n, 12) uint64."""
    poses = np.empty((len(positions), 12))
    for i in range(len(positions)):
        for d in range(3):
            for k in range(3):
                poses[i, 3 * d + k] = rotations[i, d, k]
            poses[i, 9 + d] = positions[i, d]
    return poses.view(np.uint64)


@kernel
def pairs_in_place(kept, step, poses, slots, out):
    """Find the pairs of a Step whose answer in `kept` still holds, and write their counts and bounds (p,) to `out`.

    poses (n, 12): pose_bits; slots: slots and known (p,) of with_pairs.

    Returns (index in `kept` of each pair (p,), -1: absent, or the answer may differ; the pairs with -1 (m,)).
    """
    rows, pairs = step.rows, step.pairs
    slot_of, known = slots
    counts, bounds = out
    has_moved = np.ones(len(rows), np.bool_)
    for i in range(len(rows)):
        before = kept.index_of_row[rows[i]] if rows[i] < len(kept.index_of_row) else -1
        if before >= 0:
            has_moved[i] = False
            for k in range(12):
                if kept.poses[before, k] != poses[i, k]:
                    has_moved[i] = True
    stands_at = np.full(len(pairs), -1)
    for p in range(len(pairs)):
        i, j = pairs[p, 0], pairs[p, 1]
        if slot_of[p] < 0 or not known[p] or slot_of[p] >= len(kept.pair_of_slot) or has_moved[i] or has_moved[j]:
            continue
        q = kept.pair_of_slot[slot_of[p]]
        if q >= 0:
            stands_at[p], counts[p], bounds[p] = q, kept.contacts.counts[q], kept.contacts.bounds[q]
    return stands_at, np.flatnonzero(stands_at < 0)


@kernel
def gather_kept(kept, stands_at, offsets, out):
    """Copy the contacts of pairs from `kept` to WorldContacts, from offsets[p] on.

    stands_at (p,): of pairs_in_place; pairs with -1 are left out.
    """
    points_a, points_b, normals, gaps, samples = out
    old = kept.contacts
    for p in range(len(stands_at)):
        q = stands_at[p]
        if q < 0:
            continue
        for c in range(offsets[p + 1] - offsets[p]):
            o, k = offsets[p] + c, kept.offsets[q] + c
            for d in range(3):
                points_a[o, d], points_b[o, d] = old.points_a[k, d], old.points_b[k, d]
                normals[o, d] = old.normals[k, d]
            gaps[o] = old.gaps[k]
            samples[o, 0], samples[o, 1] = old.samples[k, 0], old.samples[k, 1]
