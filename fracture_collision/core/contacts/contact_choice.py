"""Choice of the contacts to list among a pair's near samples: Glondu 2014, section 5.2, independent of visit order.

The paper's rule depends on the order of visits. This one depends only on the samples' positions and depths, so any
search may find them. Candidates wait in scratch, a row each, until all are known.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from fracture_collision.core.contacts.deepest_contacts import sort_by_sample
from fracture_collision.core.contacts.known_samples import (
    ask_sample,
    placed,
    put_contact,
    share_a_body,
    side_of,
)
from fracture_collision.core.field.elementary_queries import NEAR
from fracture_collision.core.memory.compiled import query_kernel

# Columns of scratch.node_int, node_float and spread, for candidate samples.
ENTRY, SIDE, NUMBER, ANSWER = 0, 1, 2, 3
DISTANCE = 3  # [m] from the other's surface; minus infinity: deeper than epsilon, exact depth unknown
FAR, MOST_DEPTH = 0, 1
# Value of DISTANCE: not computed yet.
UNASKED = math.inf
# `choose` treats scores of at least this share of the best as ties.
EQUAL = 1.0 - 1e-3


class Rule(NamedTuple):
    """Which of a pair's contacts are listed (Glondu 2014, section 5.2, and `choose`)."""

    wanted: int  # m
    most: int  # contacts listed where more than m are deeper than epsilon, at least m; without effect on Algorithm 1
    epsilon: float  # [m]
    near: float  # [m] the detection tolerance
    every: int = 1  # of the samples that may be near, one in so many is queried (work_limit.py)


@query_kernel
def way_out_of_box(box, x, y, z):
    """Distance [m] from a point to the nearest side of the box (6,) around it: an upper bound on its depth."""
    return min(x - box[0], y - box[1], z - box[2], box[3] - x, box[4] - y, box[5] - z)


@query_kernel
def keep(pools, side, entry, sample, distance, deep, k, scratch):
    """Store a Placed sample of a Side as candidate k, without an answer.

    entry: its row of SamplePool; distance [m]: from the other fragment, or UNASKED; deep [m]: it is no deeper than
    that.
    """
    node, point = scratch.node_int[k], scratch.node_float[k]
    node[ENTRY], node[SIDE], node[NUMBER], node[ANSWER] = entry, side.number, sample.number, -1
    point[0], point[1], point[2], point[DISTANCE] = sample.x, sample.y, sample.z, distance
    if side.number == 1:
        own = pools.samples.points[entry]
        point[0], point[1], point[2] = own[0], own[1], own[2]
    scratch.spread[MOST_DEPTH, k] = deep


@query_kernel
def keep_answer(answer, k, sample, scratch):
    """Store the Probe of a Placed sample, candidate k, as final."""
    node = scratch.node_int[k]
    node[ANSWER] = k
    put_contact(scratch.kept, np.int64(k), np.int64(node[SIDE]), sample.number, (sample.x, sample.y, sample.z), answer)


@query_kernel
def is_final(answer, looked, rule):
    """Whether put_chosen would get the same Probe as this search, which covered `looked` [m] from outside.

    It may not if the probe searched farther than the tolerance, or less deep than the point may be: of surfaces equally
    near it may then find another.
    """
    return answer.status == NEAR and looked == rule.near


@query_kernel
def choose(rule, count, scratch):
    """Choose which of `count` near samples to list, where at most rule.wanted are deeper than epsilon.

    The chosen ones are moved to the front. Returns (number chosen, bound [m] on the depth of the others).

    All are chosen if there are no more than wanted. Otherwise all deeper than epsilon, then, up to the contacts wanted,
    the one farthest from those already chosen. A distance is weighted by how far the sample is within the detection
    tolerance, up to epsilon: a contact that hardly touches supports nothing (as in Jolt's manifolds). Ties are broken
    by side and sample. So that rounding does not change the contacts of a resting body, scores of at least EQUAL of the
    best are ties; and where none is deeper than epsilon, the first is one of those within half of epsilon of the
    deepest.
    """
    if count <= rule.wanted:
        return count, 0.0
    point, spread = scratch.node_float, scratch.spread
    deep, nearest = 0, math.inf
    for k in range(count):
        nearest = min(nearest, point[k, DISTANCE])
        spread[FAR, k] = math.inf
        if point[k, DISTANCE] < -rule.epsilon:
            swap(scratch, k, deep)
            deep += 1
    for chosen in range(rule.wanted):
        pick = chosen if chosen < deep else -1
        if pick < 0 and chosen == 0:
            limit = nearest + 0.5 * rule.epsilon
            for k in range(count):
                if point[k, DISTANCE] <= limit and (pick < 0 or is_before(scratch, k, pick)):
                    pick = k
        elif pick < 0:
            best = 0.0
            for k in range(chosen, count):
                best = max(best, _worth(rule, point[k, DISTANCE], spread[FAR, k]))
            for k in range(chosen, count):
                its = _worth(rule, point[k, DISTANCE], spread[FAR, k])
                if its >= EQUAL * best and (pick < 0 or is_before(scratch, k, pick)):
                    pick = k
        swap(scratch, pick, chosen)
        _see_chosen(chosen, count, scratch)
    missed = 0.0
    for k in range(rule.wanted, count):
        missed = max(missed, spread[MOST_DEPTH, k])
    return rule.wanted, missed


@query_kernel
def _see_chosen(chosen, end, scratch):
    """Update how far the samples up to `end` are from the chosen ones; the last chosen is row `chosen`."""
    point, far = scratch.node_float, scratch.spread[FAR]
    x, y, z = point[chosen, 0], point[chosen, 1], point[chosen, 2]
    for k in range(chosen + 1, end):
        dx, dy, dz = point[k, 0] - x, point[k, 1] - y, point[k, 2] - z
        far[k] = min(far[k], dx * dx + dy * dy + dz * dz)


@query_kernel
def _worth(rule, distance, far):
    """Score. far [m2]: squared distance of a sample from the chosen ones; distance [m]: to the other's surface."""
    return far * (rule.near + min(-distance, rule.epsilon)) ** 2


@query_kernel
def is_before(scratch, i, j):
    """Whether candidate i precedes candidate j in the order by side and sample."""
    one, other = scratch.node_int[i], scratch.node_int[j]
    return one[SIDE] < other[SIDE] or (one[SIDE] == other[SIDE] and one[NUMBER] < other[NUMBER])


@query_kernel
def swap(scratch, i, j):
    """Swap candidates i and j in scratch."""
    node, point, spread = scratch.node_int, scratch.node_float, scratch.spread
    for c in range(4):
        node[i, c], node[j, c] = node[j, c], node[i, c]
    for c in range(4):
        point[i, c], point[j, c] = point[j, c], point[i, c]
    for c in range(2):
        spread[c, i], spread[c, j] = spread[c, j], spread[c, i]


@query_kernel
def put_chosen(pools, pair, near, slack, sink, count, scratch):
    """Write the first `count` candidates of a Pair to a Sink as contacts, sorted by side and sample.

    near [m]: detection tolerance; slack [m]: rounding_slack of the pair. Candidates without an answer are queried.
    """
    contacts, ids = sink
    one_body = share_a_body(pools, pair.a, pair.b)
    for k in range(count):
        kept = scratch.node_int[k, ANSWER]
        if kept >= 0:
            for i in range(contacts.shape[1]):
                contacts[k, i] = scratch.kept.contacts[kept, i]
            for i in range(ids.shape[1]):
                ids[k, i] = scratch.kept.ids[kept, i]
            continue
        side = side_of(pair, np.int64(scratch.node_int[k, SIDE]), one_body, slack)
        sample = placed(pools, side, scratch.node_int[k, ENTRY])
        point = sample.x, sample.y, sample.z
        answer = ask_sample(pools, side.other, sample, near, math.inf, True, scratch)
        put_contact(sink, k, side.number, sample.number, point, answer)
    sort_by_sample(contacts, ids, count)
