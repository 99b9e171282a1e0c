"""State kept per pair from step to step, so that pairs with little relative motion cost little.

Neighbour lists (Verlet 1967): a search with a margin `reach` lists all samples that may be within the detection
tolerance plus `reach` of the other fragment. Until a sample has moved farther than `reach` relative to the other, all
samples within the tolerance are in the list. For each sample that was queried and is not near, the list stores how far
it must move before it can be; until then it is not queried again. Querying the rest gives what the search would give:
same contacts, same bytes.

Clearance: where a search found the pair separated, by its boxes or a plane, its list is empty and holds until the two
have moved by their clearance.

Close triangles: where whole surfaces were found not to pierce each other, the pairs of triangles that may do so after a
motion within a reach are listed, and only these are looked at until the two have moved so far.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from fracture_collision.core.memory.compiled import kernel, query_kernel
from fracture_collision.core.memory.kinds import is_bounded
from fracture_collision.core.memory.prefetch import fetch
from fracture_collision.core.memory.rotations import to_other
from fracture_collision.core.memory.struct import Struct

# Capacity of a list: samples, and pairs of ridges (ridge_contacts.py).
MOST_LISTED, MOST_RIDGES = 256, 256
# Capacity for pairs of triangles that are close (patches/piercing.py).
MOST_CLOSE = 512
# The same for the one pair per thread that is searched ahead in time (first_touch.py).
MOST_AHEAD = 4096
# Lists are made for pairs that move by less than this share of the smaller R in a step.
FAST = 0.003
# Reach of a list beyond the tolerance: the pair's motion in LASTS steps, within the other two shares of R. A larger
# reach lasts longer and lists more.
LASTS, LEAST_REACH, MOST_REACH = 4.0, 0.005, 0.02
# How far beyond the tolerance a listed sample's distance is searched, likewise in steps: more means fewer queries.
AHEAD = 2.0
NOT_LISTED = -1  # value of `counts` without a list: the pair moves too fast, or has too many samples near
# Columns of `listed`: 2 (row of SamplePool) + side; a tetrahedron of the other near it, -1: unknown.
WHO, WHERE = 0, 1
# Columns of `places`: a sample's position from the middle of its fragment's leaves; from the other's, in the other's
# frame, at its last query [m], three each; how far it must move from there before it can be near [m].
OWN, SEEN, UNTIL, PLACE = 0, 3, 6, 7
# Value of UNTIL: it was near.
NEAR_LAST = -1.0
# Single-precision rounding of a distance between places, as a share of their sizes.
PLACE_ROUNDING = 1e-6
# Initial capacity, in pairs.
LEAST_ROOM = 64
UNTURNED = np.eye(3).ravel()
# Poses, as of keep_pose, of two fragments of one body in their places in the unbroken body.
IN_PLACE = np.tile(np.append(UNTURNED, np.zeros(3)), (2, 1))


class Listing(NamedTuple):
    """What a search of a pair lists for later queries, and how far it searches for the list."""

    reach: float  # [m] samples that may be within near + reach are listed; 0: no new list
    ahead: float  # [m] distances of samples are searched up to so far beyond near
    ways: np.ndarray  # (2, WAY) float64: motion of a's points relative to b, of b's relative to a (motion.put_way)
    samples: np.ndarray  # (n, 2) int32: WHO and WHERE, those of a before those of b
    places: np.ndarray  # (n, PLACE) float32 [m]
    ridges: np.ndarray  # (m, 2) int32: pairs of ridges that may cross
    toward: np.ndarray  # (3,) float64: a direction in b's frame that may separate the two, zeros: unknown
    shallow: float  # [m] crossings of ridges that get no deeper before samples do are left out


class CloseTriangles(Struct):
    """Pairs of triangles of whole surfaces that alone may pierce each other; a row per slot, see NeighbourLists."""

    counts: np.ndarray  # (room,) int32, or NOT_LISTED
    at: np.ndarray  # (room, 2, 12) float64: poses, see NeighbourLists, for which they were listed
    by: np.ndarray  # (room, 3) float64 [m] how far b was moved there, in its frame
    reach: np.ndarray  # (room,) float64 [m] motion since then for which the list holds
    surfaces: np.ndarray  # (room, 2) int64: stamps of the surfaces
    pairs: np.ndarray  # (room, MOST_CLOSE, 2) int32


class NeighbourLists(Struct):
    """Columns have one row per slot."""

    poses: np.ndarray  # (room, 2, 12) float64: rotation (9), translation (3) [m] from a's frame to b's, and back
    listed_at: np.ndarray  # (room, 2, 12) float64: likewise when the list was made
    reach: np.ndarray  # (room,) float64 [m]: motion since then for which the list holds
    counts: np.ndarray  # (room,) int32: listed samples, or NOT_LISTED
    listed: np.ndarray  # (room, MOST_LISTED, 2) int32: WHO, WHERE
    places: np.ndarray  # (room, MOST_LISTED, PLACE) float32 [m]
    ridges: np.ndarray  # (room,) int32: listed pairs of ridges
    ridge_pairs: np.ndarray  # (room, MOST_RIDGES, 2) int32: their numbers, of a and of b
    toward: np.ndarray  # (room, 3) float64: in b's frame, direction of greatest separation; zeros: unknown
    close: CloseTriangles


class Slots(NamedTuple):
    """Which pair has which slot of the lists; it keeps its slot as long as its boxes overlap."""

    keys: np.ndarray  # (p,) int64, ascending: pair_keys of the last step's pairs
    slots: np.ndarray  # (p,) int64: their slots
    lists: NeighbourLists


def _make_lists(room: int) -> NeighbourLists:
    return NeighbourLists(
        np.zeros((room, 2, 12)), np.zeros((room, 2, 12)), np.zeros(room),
        np.full(room, NOT_LISTED, np.int32), np.empty((room, MOST_LISTED, 2), np.int32),
        np.empty((room, MOST_LISTED, PLACE), np.float32), np.zeros(room, np.int32),
        np.empty((room, MOST_RIDGES, 2), np.int32), np.zeros((room, 3)),
        CloseTriangles(
            np.full(room, NOT_LISTED, np.int32), np.zeros((room, 2, 12)), np.zeros((room, 3)), np.zeros(room),
            np.zeros((room, 2), np.int64), np.empty((room, MOST_CLOSE, 2), np.int32),
        ),
    )  # fmt: skip


NO_SLOTS = Slots(np.empty(0, np.int64), np.empty(0, np.int64), _make_lists(0))


@kernel
def pair_keys(rows, pairs):
    """Keys (p,) int64 of `pairs` (p, 2), indices into `rows` (n,) int64 of FragmentPool."""
    keys = np.empty(len(pairs), np.int64)
    for p in range(len(pairs)):
        keys[p] = (rows[pairs[p, 0]] << 32) | rows[pairs[p, 1]]
    return keys


def with_pairs(before: Slots, keys: np.ndarray) -> tuple[Slots, np.ndarray, np.ndarray]:
    """The Slots of a step whose pairs have `keys` (p,).

    Returns (Slots, slot of each pair (p,), whether it had that slot before (p,)). `before` must not be used afterwards:
    the lists are shared.
    """
    lists = before.lists
    if len(lists.counts) < len(keys):
        lists = _make_lists(max(len(keys) + len(keys) // 2, LEAST_ROOM))
        _copy_lists(before.lists, lists)
    ordered, ordered_slots, slots, known = _take_slots(before.keys, before.slots, keys, lists)
    return Slots(ordered, ordered_slots, lists), slots, known


@kernel
def _copy_lists(old, new):
    """Copy columns into longer ones: of each slot only what is listed; the rest is memory that was never written."""
    for slot in range(len(old.counts)):
        new.counts[slot], new.reach[slot], new.toward[slot] = old.counts[slot], old.reach[slot], old.toward[slot]
        new.poses[slot], new.listed_at[slot] = old.poses[slot], old.listed_at[slot]
        _copy_close(old.close, new.close, slot)
        for k in range(old.counts[slot]):
            new.listed[slot, k], new.places[slot, k] = old.listed[slot, k], old.places[slot, k]
        if old.counts[slot] < 0:
            continue
        new.ridges[slot] = old.ridges[slot]
        for k in range(old.ridges[slot]):
            new.ridge_pairs[slot, k] = old.ridge_pairs[slot, k]


@kernel
def _copy_close(old, new, slot):
    new.counts[slot], new.reach[slot] = old.counts[slot], old.reach[slot]
    new.at[slot], new.by[slot], new.surfaces[slot] = old.at[slot], old.by[slot], old.surfaces[slot]
    for k in range(old.counts[slot]):
        new.pairs[slot, k] = old.pairs[slot, k]


@kernel
def _take_slots(known_keys, known_slots, keys, lists):
    """Assign slots to the pairs of a step: the ones they had, or free ones.

    A free slot drops the state of its previous pair. Returns (keys ascending, their slots, slots (p,) of `keys`,
    whether each pair had its slot before (p,)).
    """
    order = np.arange(len(keys))
    for k in range(1, len(keys)):
        if keys[k] < keys[k - 1]:
            order = np.argsort(keys, kind="mergesort")
            break
    slots, known = np.empty(len(keys), np.int64), np.zeros(len(keys), np.bool_)
    is_taken = np.zeros(len(lists.counts), np.bool_)
    i = 0
    for k in order:
        while i < len(known_keys) and known_keys[i] < keys[k]:
            i += 1
        if i < len(known_keys) and known_keys[i] == keys[k]:
            slots[k], known[k] = known_slots[i], True
            is_taken[slots[k]] = True
    free = 0
    for k in order:
        if not known[k]:
            while is_taken[free]:
                free += 1
            slots[k] = free
            lists.counts[free], lists.toward[free], lists.close.counts[free] = NOT_LISTED, 0.0, NOT_LISTED
            free += 1
    return keys[order], slots[order], slots, known


@query_kernel
def reach_of(moves, radius):
    """Reach of a list, and how far ahead a sample's distance is searched, for a pair that moves by `moves` [m] a step.

    radius [m]: the smaller R. Returns (reach, ahead) [m]; (0, 0): no list.
    """
    if moves >= FAST * radius:
        return 0.0, 0.0
    reach = min(max(LASTS * moves, LEAST_REACH * radius), MOST_REACH * radius)
    return reach, min(max(AHEAD * moves, LEAST_REACH * radius), reach)


@query_kernel
def fetch_slot(lists, slot):
    """Prefetch the state of the next pair; no effect where it has no slot (-1)."""
    if slot >= 0:
        fetch(lists.poses, slot)
        fetch(lists.listed_at, slot)
        fetch(lists.listed, slot)
        fetch(lists.places, slot)
        fetch(lists.counts, slot)
        fetch(lists.reach, slot)


@query_kernel
def frame_between(own, other, rotation, translation):
    """Transform of a place relative to own's middle into one relative to the other's, in the other's frame.

    own, other (4,): middles of Leaves; rotation (3, 3), translation (3,) [m]: from own's body frame to the other's.
    Returns (x, y, z, rounding) float32 [m]: an offset, and the rounding error bound of the distance of two such places.
    """
    x, y, z = to_other(rotation, translation, own[0], own[1], own[2])
    x, y, z = x - other[0], y - other[1], z - other[2]
    rounding = own[3] + PLACE_ROUNDING * (abs(x) + abs(y) + abs(z))
    return np.float32(x), np.float32(y), np.float32(z), np.float32(rounding)


@query_kernel
def place_of(row, rotation, frame):
    """Place of the sample of a row of `places` relative to the other's middle: (x, y, z) float32 [m]."""
    x, y, z = row[OWN], row[OWN + 1], row[OWN + 2]
    return (
        np.float32(rotation[0, 0]) * x + np.float32(rotation[0, 1]) * y + np.float32(rotation[0, 2]) * z + frame[0],
        np.float32(rotation[1, 0]) * x + np.float32(rotation[1, 1]) * y + np.float32(rotation[1, 2]) * z + frame[1],
        np.float32(rotation[2, 0]) * x + np.float32(rotation[2, 1]) * y + np.float32(rotation[2, 2]) * z + frame[2],
    )


@query_kernel
def see(row, rotation, frame, distance, near):
    """Record that the sample of a row of `places` is `distance` [m] from the other, where it is near at `near` [m].

    distance: NEAR_LAST if it is near now; frame: of frame_between.
    """
    row[SEEN], row[SEEN + 1], row[SEEN + 2] = place_of(row, rotation, frame)
    row[UNTIL] = NEAR_LAST if distance == NEAR_LAST else max(np.float32(distance - near) - frame[3], np.float32(0.0))


@query_kernel
def may_be_near(row, rotation, frame):
    """Whether the sample of a row of `places` may be near by now."""
    left = row[UNTIL] - frame[3]
    if left <= 0.0:
        return True
    x, y, z = place_of(row, rotation, frame)
    x, y, z = x - row[SEEN], y - row[SEEN + 1], z - row[SEEN + 2]
    return x * x + y * y + z * z >= left * left


@query_kernel
def least_left(listed, places, count, middle_a, middle_b, rotation, translation, of_far):
    """Lower bound [m] of how far the listed samples of a pair must still move before one can be near.

    listed, places: `count` rows; middle_a, middle_b: of Leaves; rotation (2, 3, 3), translation (2, 3): current
    relative poses, see Pair; of_far: only samples that were not near. Infinity: there is none.
    """
    left, side = np.float32(np.inf), 0
    frame = frame_between(middle_a, middle_b, rotation[0], translation[0])
    for k in range(count):
        if listed[k, WHO] & 1 != side:
            side = 1
            frame = frame_between(middle_b, middle_a, rotation[1], translation[1])
        row = places[k]
        if of_far and row[UNTIL] == NEAR_LAST:
            continue
        x, y, z = place_of(row, rotation[side], frame)
        x, y, z = x - row[SEEN], y - row[SEEN + 1], z - row[SEEN + 2]
        left = min(left, row[UNTIL] - frame[3] - np.float32(1.0 + PLACE_ROUNDING) * np.sqrt(x * x + y * y + z * z))
    return max(np.float64(left), 0.0)


@query_kernel
def keep_pose(rotation, translation, out):
    """Write relative poses (2, 3, 3), (2, 3) to (2, 12)."""
    for side in range(2):
        for i in range(3):
            for j in range(3):
                out[side, 3 * i + j] = rotation[side, i, j]
            out[side, 9 + i] = translation[side, i]


@query_kernel
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


@query_kernel
def displacement(pools, pair, before):
    """Upper bound [m] of how far a point of either fragment has moved in the other's frame since poses (2, 12)."""
    a, b, rotation, translation = pair
    farthest = 0.0
    for side in range(2):
        f = a if side == 0 else b
        if not is_bounded(pools.fragment.kind[f]):
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
