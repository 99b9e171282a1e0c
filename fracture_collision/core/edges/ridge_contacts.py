"""Contacts where ridges of two fragments cross between samples, found among all ridges of both.

Ridges of a that may reach b are tested one by one against b's leaves and then against the lines in these, in single
precision with an allowance for its rounding (ridge_leaves.py); the remaining pairs are tested exactly
(ridge_crossing.py). Contacts wait beside the candidate samples (contact_choice.py).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from fracture_collision.core.contacts.contact_choice import ANSWER, DISTANCE, ENTRY, MOST_DEPTH, NUMBER, SIDE
from fracture_collision.core.contacts.known_samples import put_contact
from fracture_collision.core.edges.ridge_crossing import MATTERS, crossing, may_cross, overlap
from fracture_collision.core.edges.ridge_leaves import (
    OF_CHORD,
    ROUNDING,
    Window,
    carry_leaf,
    keep_near,
    leaves_that_may,
    may_reach,
    see_boxes,
    see_lines,
)
from fracture_collision.core.edges.ridges import BEGIN, END, FIRST_FACE, LENGTH, OUTWARD, TURN
from fracture_collision.core.field.elementary_queries import INSIDE, Probe
from fracture_collision.core.field.flood import NO_SOURCE
from fracture_collision.core.memory.compiled import query_kernel
from fracture_collision.core.memory.pools import LEAF
from fracture_collision.core.memory.rotations import rotated, to_other
from fracture_collision.core.mesh.closest_point import segment_distance
from fracture_collision.core.mesh.sample_numbers import FIRST_OF_RIDGES
from fracture_collision.core.separation.leaf_separation import Approach

# Crossings deeper than this share of R are not searched: such a pair has samples inside, or came through in one step.
DEEPEST = 0.1
# Between fragments of one body, nor are crossings deeper than this factor times how far a point of either has moved
# since they were one: in place they do not overlap, so no point is deeper than it has moved.
MOVED = 1.5
# Maximum number of contacts of a pair's ridges; sample numbers reserved for each ridge of a.
MOST_CROSSINGS, RIDGES_EACH = 512, 1 << 24
# Candidates are ordered by sample number: those of crossings come after all of a's samples.
_AFTER_SAMPLES = 1 << 30


class Separation(NamedTuple):
    """Relative position of two fragments: bounds that cull ridges."""

    beyond_b: tuple[float, float, float, float]  # all of b is behind it, in b's frame; see Approach.plane
    beyond_a: tuple[float, float, float, float]  # likewise for a
    apart: float  # [m] no point of either has moved farther since they were one; infinity: they never were
    slack: float  # [m] rounding


class RidgePair(NamedTuple):
    """A ridge of a and one of b, both in b's frame."""

    i: int  # number among a's
    j: int  # among b's
    r: np.ndarray  # (RIDGE,) float64
    s: np.ndarray  # (RIDGE,) float64


@query_kernel
def have_ridges(edges, a, b):
    """Whether both fragments have ridges (`edges`, of all rows: NO_RIDGES where crossings are not searched)."""
    return len(edges.count) > 0 and edges.count[a] > 0 and edges.count[b] > 0


@query_kernel
def add_crossings(pools, edges, pair, rule, listing, separation, found, scratch):
    """Store the contacts of crossing ridges of a Pair as candidates in scratch, by a Rule.

    found: (number of samples stored before, how many of them are deeper than epsilon). listing: with listing.reach > 0,
    pairs of ridges that may cross after a relative motion of no more than that are listed. Returns (count, deep, number
    of pairs to list), the first two updated from `found`; the number may exceed the capacity.
    """
    a, b, rotation, translation = pair
    count, deep = found
    work, reach, slack = scratch.ridge_work, listing.reach, separation.slack
    of_a, of_b, near_b, row = work.of_a, work.of_b[0], work.of_b[1], work.row
    boxes, near_boxes, ends = work.boxes[0], work.boxes[1], work.ends
    within = rule.near + slack
    turn = OF_CHORD * reach / max(_half_diagonal(pools.fragment.box[a]), _half_diagonal(pools.fragment.box[b]))
    most, leaves, pairs = count + MOST_CROSSINGS, 0, 0
    approach = Approach(separation.beyond_b, within, reach, listing.ways[0])
    many = may_reach(pools, edges, pair, 0, approach, of_a, scratch)
    if many > 0:
        approach = Approach(separation.beyond_a, within, reach, listing.ways[1])
        leaves = leaves_that_may(pools, edges, pair, 1, approach, of_b, boxes, scratch)
    if leaves == 0:
        return count, deep, 0
    deepest = _deepest(pools, a, b, separation)
    # the possible overlap of fragments of one body grows as they move
    farthest = max(rule.near, deepest + MOVED * reach)
    margin, excess, lanes = farthest + reach + slack, work.excess, work.lanes
    m = pools.fragment.middle[b]
    size = 2.0 * (_half_diagonal(pools.fragment.box[a]) + _half_diagonal(pools.fragment.box[b]))
    origin = pools.fragment.middle[a]
    origin = to_other(rotation[0], translation[0], origin[0], origin[1], origin[2])
    around, enough = margin + ROUNDING * size, MATTERS * listing.shallow * (1.0 - ROUNDING)
    window = Window(margin, reach, turn, farthest, size, enough)
    group, first_of_group, near_leaves = -1, 0, 0
    for i in range(many):
        if of_a[i] // LEAF != group:
            group, first_of_group = of_a[i] // LEAF, i
            carry_leaf(edges.lines[edges.first[a] + group], of_a[i:many], rotation[0], origin, ends)
            see_boxes(ends[LEAF], m, boxes, leaves, around, enough, excess)
            near_leaves = keep_near(of_b, boxes, leaves, excess, near_b, near_boxes)
        if near_leaves == 0:
            continue
        it, box = ends[i - first_of_group], ends[LEAF + 1]
        for d in range(3):
            box[d], box[3 + d] = min(it[d], it[3 + d]), max(it[d], it[3 + d])
        box[6], box[7] = it[6], it[7]
        see_boxes(box, m, near_boxes, near_leaves, around, enough, excess)
        is_carried = False
        for l in range(near_leaves):  # noqa: E741
            if excess[l] > np.float32(0.0):
                continue
            see_lines(it, m, edges.lines[edges.first[b] + near_b[l]], window, lanes)
            for lane in range(LEAF):
                j = LEAF * near_b[l] + lane
                if not lanes[lane] <= np.float32(0.0) or j >= edges.count[b]:
                    continue
                if not is_carried:
                    is_carried = True
                    _carry_ridge(edges.rows[LEAF * edges.first[a] + of_a[i]], rotation[0], translation[0], row)
                other = edges.rows[LEAF * edges.first[b] + j]
                if reach > 0.0 and may_cross(row, other, listing.shallow, rule.near + reach, farthest + reach, turn):
                    if pairs < len(listing.ridges):
                        listing.ridges[pairs, 0], listing.ridges[pairs, 1] = of_a[i], j
                    pairs += 1
                ridges = RidgePair(np.int64(of_a[i]), np.int64(j), row, other)
                limits = listing.shallow, deepest, most
                count, deep = _add(pools, pair, ridges, rule, limits, (count, deep), scratch)
    return count, deep, pairs


@query_kernel
def add_listed_crossings(pools, edges, pair, rule, listing, separation, found, scratch):
    """add_crossings for a Pair where listing.ridges holds all pairs of ridges that can cross; returns (count, deep)."""
    a, b, rotation, translation = pair
    count, deep = found
    row, carried = scratch.ridge_work.row, -1
    deepest, most = _deepest(pools, a, b, separation), count + MOST_CROSSINGS
    for k in range(len(listing.ridges)):
        i, j = listing.ridges[k, 0], listing.ridges[k, 1]
        own, other = edges.rows[LEAF * edges.first[a] + i], edges.rows[LEAF * edges.first[b] + j]
        if i != carried:
            _carry_ridge(own, rotation[0], translation[0], row)
            carried = i
        ridges = RidgePair(np.int64(i), np.int64(j), row, other)
        count, deep = _add(pools, pair, ridges, rule, (listing.shallow, deepest, most), (count, deep), scratch)
    return count, deep


@query_kernel
def least_apart(edges, pair, listed, near, of_far, scratch):
    """Lower bound [m] of the distance beyond `near` between the ridges of all `listed` pairs (n, 2), no less than 0.

    of_far: only of those that are not near. Infinity: there is none.
    """
    a, b, rotation, translation = pair
    row, least = scratch.ridge_work.row, math.inf
    for k in range(len(listed)):
        _carry_ends(edges.rows[LEAF * edges.first[a] + listed[k, 0]], rotation[0], translation[0], row)
        apart = segment_distance(row, edges.rows[LEAF * edges.first[b] + listed[k, 1]]) - near
        if apart > 0.0 or not of_far:
            least = min(least, apart)
    return max(least, 0.0)


@query_kernel
def _deepest(pools, a, b, separation):
    """Depth [m] down to which crossings of fragments a and b are searched, see DEEPEST and MOVED."""
    moved = MOVED * separation.apart + separation.slack
    return min(DEEPEST * min(pools.fragment.radius[a], pools.fragment.radius[b]), moved)


@query_kernel
def _half_diagonal(box):
    return 0.5 * math.sqrt((box[3] - box[0]) ** 2 + (box[4] - box[1]) ** 2 + (box[5] - box[2]) ** 2)


@query_kernel
def _carry_ends(own, rotation, translation, row):
    for k in range(BEGIN, END + 3, 3):
        row[k], row[k + 1], row[k + 2] = to_other(rotation, translation, own[k], own[k + 1], own[k + 2])


@query_kernel
def _carry_ridge(own, rotation, translation, row):
    _carry_ends(own, rotation, translation, row)
    for k in range(FIRST_FACE, OUTWARD + 3, 3):
        row[k], row[k + 1], row[k + 2] = rotated(rotation, own[k], own[k + 1], own[k + 2])
    row[LENGTH], row[TURN] = own[LENGTH], own[TURN]


@query_kernel
def _add(pools, pair, ridges, rule, limits, found, scratch):
    """Store the contact of a RidgePair, if there is one; returns the new `found` (count, deep).

    limits: Listing.shallow, depth [m] down to which crossings are searched, and how many candidates are stored at most.
    """
    count, deep = found
    shallow, deepest, most = limits
    c = scratch.ridge_work.meeting
    if count >= most or not crossing(ridges.r, ridges.s, shallow, rule.near, deepest, c):
        return count, deep
    gap = c[9]
    if gap < 0.0 and not overlap(pools, pair, ridges.r, ridges.s, c, scratch):
        return count, deep
    node, point = scratch.node_int[count], scratch.node_float[count]
    node[ENTRY], node[SIDE], node[NUMBER], node[ANSWER] = -1, 0, _AFTER_SAMPLES + count, count
    point[0], point[1], point[2], point[DISTANCE] = c[0], c[1], c[2], gap
    scratch.spread[MOST_DEPTH, count] = max(-gap, 0.0)
    number = FIRST_OF_RIDGES + RIDGES_EACH * ridges.i + ridges.j
    answer = Probe(INSIDE, gap, c[6], c[7], c[8], c[3], c[4], c[5], -gap, NO_SOURCE, -1, -1)
    put_contact(scratch.kept, count, 0, number, (c[0], c[1], c[2]), answer)
    return count + 1, deep + (gap < -rule.epsilon)
