"""Which of a pair's samples that may touch are listed: Glondu 2014, section 5.2, made free of the order of visits.

The paper's rule depends on the order of visits; this one on the samples' positions and depths alone, so any search may
find them. They wait in scratch, a row each, until all are known.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from fracture_collision.core.compiled import inlined_kernel
from fracture_collision.core.deepest_contacts import sort_by_sample
from fracture_collision.core.elementary_queries import INSIDE, NEAR
from fracture_collision.core.hull_separation import lowest_corner
from fracture_collision.core.known_samples import (
    ask_sample,
    home_tetrahedron,
    moved_since,
    put_contact,
    share_a_body,
)
from fracture_collision.core.pools import SAMPLE
from fracture_collision.core.rotations import to_other
from fracture_collision.core.sample_leaves import farthest_sample, leaves_of, nearest_sample

# Columns of scratch.node_int, node_float and spread, of the samples that are to choose from.
ENTRY, SIDE, NUMBER, ANSWER = 0, 1, 2, 3
DISTANCE = 3
FAR, MOST_DEPTH = 0, 1
# What comes to this share of the best is as good to `choose`.
EQUAL = 1.0 - 1e-3


class Rule(NamedTuple):
    """Which of a pair's contacts are listed (Glondu 2014, section 5.2, and `choose`)."""

    wanted: int  # m
    most: int  # that are listed where more than m are deeper than epsilon; 0: the paper's rule
    epsilon: float  # [m]
    near: float  # [m] the detection tolerance


@inlined_kernel
def keep(rule, looked, entry, side, sample, x, y, z, own, answer, ceiling, k, scratch, thread):
    """A sample that is near, as the k-th to choose from: at (x, y, z) in the other's frame, at `own` in its own, no
    deeper than `ceiling` [m]; it was looked for within `looked` [m].

    The answer is kept too, unless put_chosen might get another: of a point that was looked for farther than the
    tolerance, or not as deep as it may be, another of surfaces that are equally near.
    """
    node, point = scratch.node_int[thread, k], scratch.node_float[thread, k]
    is_final = (answer[0] == NEAR and looked == rule.near) or (answer[0] == INSIDE and rule.most == 0)
    node[ENTRY], node[SIDE], node[NUMBER], node[ANSWER] = entry, side, sample, k if is_final else -1
    if is_final:
        put_contact(scratch.kept[thread], scratch.kept_ids[thread], k, side, sample, x, y, z, answer)
    point[0], point[1], point[2], point[DISTANCE] = x, y, z, answer[1]
    if side == 1:
        point[0], point[1], point[2] = own[0], own[1], own[2]
    scratch.spread[thread, MOST_DEPTH, k] = min(answer[8], ceiling)


@inlined_kernel
def _ask_as_listed(pools, a, b, rotation, translation, k, near, slack, one_body, scratch, thread):
    """Of the k-th of the samples kept: (its number, x, y, z, the answer), asked as query_pair would ask it: of surfaces
    that are equally near it finds the same.
    """
    entry, side = scratch.node_int[thread, k, ENTRY], scratch.node_int[thread, k, SIDE]
    other = b if side == 0 else a
    c, sample = pools.tree.spheres[entry], pools.tree.entries[entry, SAMPLE]
    x, y, z = to_other(rotation[side], translation[side], c[0], c[1], c[2])
    start = home_tetrahedron(pools, other, sample) if one_body else -1
    deep = moved_since(c, x, y, z) + slack if one_body else math.inf
    return sample, x, y, z, ask_sample(pools, other, x, y, z, near, deep, start, True, scratch, thread)


@inlined_kernel
def find_deepest(pools, a, b, rotation, translation, rule, slack, count, scratch, thread):
    """Where more of `count` samples than wanted are deeper than epsilon, find out how deep those are that may be the
    deepest; of the others it is known how deep they are at most.

    What is inside is no deeper than it is far from the nearest of the other's samples, which are of its surface. And
    what is at n . x along a direction n is no deeper than the way from there to the other's farthest point along it;
    the way out for a deep sample is a good direction for those beside it.
    """
    point, spread, node = scratch.node_float[thread], scratch.spread[thread], scratch.node_int[thread]
    deep, deepest = 0, 0.0
    for k in range(count):
        deep += point[k, DISTANCE] < -rule.epsilon
        if point[k, DISTANCE] > -math.inf:
            deepest = max(deepest, -point[k, DISTANCE])
    if deep <= rule.wanted:
        return
    one_body = share_a_body(pools, a, b)
    for k in range(count):
        if point[k, DISTANCE] == -math.inf:
            side = node[k, SIDE]
            leaves = leaves_of(pools, b if side == 0 else a)
            x, y, z = point[k, 0], point[k, 1], point[k, 2]
            if side == 1:
                x, y, z = to_other(rotation[1], translation[1], x, y, z)
            m = leaves.middle
            away = nearest_sample(leaves, x - m[0], y - m[1], z - m[2], scratch.along[thread])
            spread[MOST_DEPTH, k] = min(spread[MOST_DEPTH, k], away + slack)
    while True:
        at = -1
        for k in range(count):
            may_be_deepest = point[k, DISTANCE] == -math.inf and spread[MOST_DEPTH, k] >= deepest
            if may_be_deepest and (at < 0 or spread[MOST_DEPTH, k] > spread[MOST_DEPTH, at]):
                at = k
        if at < 0:
            return
        side = node[at, SIDE]
        other = b if side == 0 else a
        sample, x, y, z, answer = _ask_as_listed(
            pools, a, b, rotation, translation, at, rule.near, slack, one_body, scratch, thread
        )
        point[at, DISTANCE], spread[MOST_DEPTH, at] = answer[1], answer[8]
        node[at, ANSWER] = at
        put_contact(scratch.kept[thread], scratch.kept_ids[thread], at, side, sample, x, y, z, answer)
        deepest = max(deepest, -answer[1])
        n, leaves = (answer[2], answer[3], answer[4]), leaves_of(pools, other)
        m = leaves.middle
        _, reach = farthest_sample(leaves, n, scratch.along[thread])
        farthest = n[0] * m[0] + n[1] * m[1] + n[2] * m[2] + reach + m[3] + slack
        rows = pools.fragment.corners[other]
        corners = pools.body.corners[rows[0] : rows[1]]
        farthest = -lowest_corner(corners, (-n[0], -n[1], -n[2]), -farthest)
        for k in range(count):
            if point[k, DISTANCE] == -math.inf and node[k, SIDE] == side:
                x, y, z = point[k, 0], point[k, 1], point[k, 2]
                if side == 1:
                    x, y, z = to_other(rotation[1], translation[1], x, y, z)
                along = n[0] * x + n[1] * y + n[2] * z
                spread[MOST_DEPTH, k] = min(spread[MOST_DEPTH, k], farthest - along)


@inlined_kernel
def choose(rule, count, scratch, thread):
    """Which of `count` samples that are near are listed: they come first. Returns (how many, how deep others may be).

    All, if they are no more than wanted. Else all that are deeper than epsilon, and of the others those farthest from
    what was chosen before, up to the contacts wanted. If more than wanted are deeper than epsilon: the deepest, then
    those of them farthest from what was chosen before, up to `most`. A distance counts in proportion to how far the
    sample is within the detection tolerance, to epsilon: what hardly touches holds nothing (as in Jolt's manifolds).
    Ties go by side and sample. So that what rests does not change its contacts by rounding, all that come to EQUAL of
    the best are a tie; and where none is deeper than epsilon, the first is one of those within half of epsilon of the
    deepest.
    """
    if count <= rule.wanted:
        return count, 0.0
    point, spread = scratch.node_float[thread], scratch.spread[thread]
    deep, nearest = 0, math.inf
    for k in range(count):
        deep += point[k, DISTANCE] < -rule.epsilon
        if point[k, DISTANCE] > -math.inf:
            nearest = min(nearest, point[k, DISTANCE])
        spread[FAR, k] = math.inf
    chosen, pool, aim = 0, count, rule.wanted
    if deep > rule.wanted:
        pool, aim = deep, min(deep, max(rule.most, rule.wanted))
    if deep:
        end = 0  # those that are deeper come first
        for k in range(count):
            if point[k, DISTANCE] < -rule.epsilon:
                _swap(scratch, thread, k, end)
                end += 1
    limit = nearest if deep > rule.wanted else nearest + 0.5 * rule.epsilon
    while chosen < aim:
        pick = -1
        if chosen < deep <= rule.wanted:
            pick = chosen
        elif chosen == 0:
            for k in range(pool):
                if -math.inf < point[k, DISTANCE] <= limit and (pick < 0 or _is_before(scratch, thread, k, pick)):
                    pick = k
        else:
            best = 0.0
            for k in range(chosen, pool):
                best = max(best, _worth(rule, point[k, DISTANCE], spread[FAR, k]))
            for k in range(chosen, pool):
                worth = _worth(rule, point[k, DISTANCE], spread[FAR, k])
                if worth >= EQUAL * best and (pick < 0 or _is_before(scratch, thread, k, pick)):
                    pick = k
        _swap(scratch, thread, pick, chosen)
        x, y, z = point[chosen, 0], point[chosen, 1], point[chosen, 2]
        chosen += 1
        for k in range(chosen, pool):
            dx, dy, dz = point[k, 0] - x, point[k, 1] - y, point[k, 2] - z
            spread[FAR, k] = min(spread[FAR, k], dx * dx + dy * dy + dz * dz)
    missed = 0.0
    for k in range(chosen, count):
        missed = max(missed, spread[MOST_DEPTH, k])
    return chosen, missed


@inlined_kernel
def _worth(rule, distance, far):
    """`far` [m2]: the square of how far a sample is from those chosen; `distance` [m] from the other's surface."""
    return far * (rule.near + min(-distance, rule.epsilon)) ** 2


@inlined_kernel
def _is_before(scratch, thread, i, j):
    """By side and sample."""
    one, other = scratch.node_int[thread, i], scratch.node_int[thread, j]
    return one[SIDE] < other[SIDE] or (one[SIDE] == other[SIDE] and one[NUMBER] < other[NUMBER])


@inlined_kernel
def _swap(scratch, thread, i, j):
    node, point, spread = scratch.node_int[thread], scratch.node_float[thread], scratch.spread[thread]
    for c in range(4):
        node[i, c], node[j, c] = node[j, c], node[i, c]
    for c in range(4):
        point[i, c], point[j, c] = point[j, c], point[i, c]
    for c in range(2):
        spread[c, i], spread[c, j] = spread[c, j], spread[c, i]


@inlined_kernel
def put_chosen(pools, a, b, rotation, translation, near, slack, contacts, ids, count, scratch, thread):
    """The first `count` of the samples kept, as contacts by side and sample."""
    one_body = share_a_body(pools, a, b)
    for k in range(count):
        kept = scratch.node_int[thread, k, ANSWER]
        if kept >= 0:
            for i in range(contacts.shape[1]):
                contacts[k, i] = scratch.kept[thread, kept, i]
            for i in range(ids.shape[1]):
                ids[k, i] = scratch.kept_ids[thread, kept, i]
            continue
        side = scratch.node_int[thread, k, SIDE]
        sample, x, y, z, answer = _ask_as_listed(
            pools, a, b, rotation, translation, k, near, slack, one_body, scratch, thread
        )
        put_contact(contacts, ids, k, side, sample, x, y, z, answer)
    sort_by_sample(contacts, ids, count)
