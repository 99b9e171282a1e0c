"""Choice of the contacts to list where more than wanted are deeper than epsilon: Glondu 2014, section 5.2.

The deepest sample comes first, then of the other deep ones those farthest from the ones already chosen, as in
contact_choice.py. Only a few need to be queried: those that may be the deepest, and those far from the chosen. So most
wait here UNASKED.
"""

from __future__ import annotations

import math

import numpy as np

from fracture_collision.core.contacts.contact_choice import (
    DISTANCE,
    ENTRY,
    EQUAL,
    FAR,
    MOST_DEPTH,
    SIDE,
    UNASKED,
    is_before,
    keep_answer,
    swap,
)
from fracture_collision.core.contacts.known_samples import ask_sample, placed, share_a_body, side_of
from fracture_collision.core.field.elementary_queries import INSIDE
from fracture_collision.core.field.flood import EVERYTHING, nearest_in_tetrahedron, nothing_within
from fracture_collision.core.memory.compiled import query_kernel
from fracture_collision.core.memory.heap import pop, push
from fracture_collision.core.memory.kinds import is_mesh
from fracture_collision.core.samples.sample_leaves import farthest_sample, leaves_of, nearest_sample

# Maximum number of exit directions of deep samples, kept to bound the depth of others.
MOST_WAYS = 8
# The nearest sample of the other is rarely closer to a point inside than this share of R.
SAMPLES_HELP = 0.02


@query_kernel
def may_wait(pools, other, rule, deep):
    """Whether the query of a sample in `other` may be deferred, with `deep` others deeper than epsilon.

    Only where queries are slow.
    """
    return deep > rule.wanted and is_mesh(pools.fragment.kind[other])


@query_kernel
def choose_deep(pools, pair, rule, slack, count, scratch):
    """contact_choice.choose where more than rule.wanted of the samples are deeper than epsilon.

    Chooses the deepest, then of these those farthest from the ones already chosen, up to rule.most.
    Returns (number chosen, bound [m] on the depth of the others).
    """
    point = scratch.node_float
    picked = scratch.queue[1]
    deepest = _find_deepest(pools, pair, slack, count, scratch)
    first, aim = -1, rule.most
    for k in range(count):
        if point[k, DISTANCE] == -deepest and (first < 0 or is_before(scratch, k, first)):
            first = k
    picked[0] = first
    waiting = _line_up(rule, count, first, scratch)
    # one more than is listed, to find out whether any is left
    chosen = 1
    while chosen <= aim:
        pick, waiting = _farthest(pools, pair, rule, slack, count, chosen, waiting, scratch)
        if pick < 0:
            break
        picked[chosen] = pick
        chosen += 1
    bound = deepest if chosen > aim else rule.epsilon
    chosen = min(chosen, aim)
    for k in range(chosen):
        swap(scratch, picked[k], k)
        for later in range(k + 1, chosen):
            if picked[later] == k:
                picked[later] = picked[k]
    return chosen, bound


@query_kernel
def _line_up(rule, count, first, scratch):
    """Queue those of `count` samples that may be deeper than epsilon, except `first`, by their distance from it.

    The queue is a heap, farthest first. Returns its length.
    """
    point, most_depth = scratch.node_float, scratch.spread[MOST_DEPTH]
    keys, items, known = scratch.spread[FAR], scratch.queue[0], scratch.queue[0, count:]
    waiting = 0
    for k in range(count):
        distance = point[k, DISTANCE]
        if k != first and (distance < -rule.epsilon or (distance == UNASKED and most_depth[k] > rule.epsilon)):
            push(keys, items, waiting, -_apart(point, k, first), k)
            known[k] = 1
            waiting += 1
    return waiting


@query_kernel
def _farthest(pools, pair, rule, slack, count, chosen, waiting, scratch):
    """The queued sample farthest from the `chosen` ones.

    Returns (sample, -1: none is deeper than epsilon; length of the queue). Ties as in contact_choice.choose. A sample's
    key is its distance from the first `known` chosen ones, an upper bound of the present distance (as in the lazy
    greedy algorithm of Minoux 1978).
    """
    point, keys, items = scratch.node_float, scratch.spread[FAR], scratch.queue[0]
    known, picked, ties = scratch.queue[0, count:], scratch.queue[1], scratch.queue[1, count:]
    best, tied, pick = -1.0, 0, -1
    while waiting and -keys[0] >= EQUAL * best:
        k, far = items[0], -keys[0]
        pop(keys, items, waiting)
        waiting -= 1
        if known[k] < chosen:
            for i in range(known[k], chosen):
                far = min(far, _apart(point, k, picked[i]))
            known[k] = chosen
            push(keys, items, waiting, -far, k)
            waiting += 1
            continue
        if point[k, DISTANCE] == UNASKED:
            if not _is_deep(pools, pair, rule, slack, k, scratch):
                continue
            point[k, DISTANCE] = -math.inf
        best = max(best, far)
        ties[tied] = k
        tied += 1
        if pick < 0 or is_before(scratch, k, pick):
            pick = k
    for i in range(tied):
        if ties[i] != pick:
            push(keys, items, waiting, -best, ties[i])
            known[ties[i]] = 0
            waiting += 1
    return pick, waiting


@query_kernel
def _apart(point, i, j):
    """Squared distance of two samples [m2]."""
    dx, dy, dz = point[i, 0] - point[j, 0], point[i, 1] - point[j, 1], point[i, 2] - point[j, 2]
    return dx * dx + dy * dy + dz * dz


@query_kernel
def _is_deep(pools, pair, rule, slack, k, scratch):
    """Whether the k-th sample is deeper than epsilon."""
    side = side_of(pair, np.int64(scratch.node_int[k, SIDE]), share_a_body(pools, pair.a, pair.b), slack)
    sample = placed(pools, side, scratch.node_int[k, ENTRY])
    answer = ask_sample(pools, side.other, sample, 0.0, rule.epsilon, True, scratch)
    return answer.status == INSIDE and answer.distance < -rule.epsilon


@query_kernel
def _find_deepest(pools, pair, slack, count, scratch):
    """Query those of the first `count` samples that may be the deepest; returns its depth [m].

    The depth of a sample inside is at most its distance from any part of the other's surface: the part in the
    tetrahedron that held the sample in the unbroken body, or the nearest of the other's samples. It is also at most the
    distance along a direction n from n . x to the other's farthest point; the exit direction of a deep sample is a good
    n for its neighbours.
    """
    a, b = pair.a, pair.b
    point, spread, node = scratch.node_float, scratch.spread, scratch.node_int
    keys, items, ways = spread[FAR], scratch.queue[0], scratch.ways
    one_body, deepest, waiting, known = share_a_body(pools, a, b), 0.0, 0, 0
    for k in range(count):
        if -math.inf < point[k, DISTANCE] < UNASKED:
            deepest = max(deepest, -point[k, DISTANCE])
        else:
            push(keys, items, waiting, -spread[MOST_DEPTH, k], k)
            waiting += 1
    while waiting and -keys[0] >= deepest:
        k, key = items[0], -keys[0]
        pop(keys, items, waiting)
        waiting -= 1
        side = side_of(pair, np.int64(node[k, SIDE]), one_body, slack)
        other, sample = side.other, placed(pools, side, node[k, ENTRY])
        x, y, z = sample.x, sample.y, sample.z
        leaves = leaves_of(pools, other)
        m = leaves.middle
        if key == spread[MOST_DEPTH, k]:  # its key is still the initial bound
            deep = key
            if one_body:
                best = nearest_in_tetrahedron(pools, other, sample.start, x, y, z, EVERYTHING, nothing_within(key))
                deep = min(key, math.sqrt(best[0]) + slack)
            if deep == key and key > SAMPLES_HELP * pools.fragment.radius[other]:
                deep = min(key, nearest_sample(leaves, x - m[0], y - m[1], z - m[2], scratch.along) + slack)
            for w in range(known):
                if ways[w, 4] == side.number:
                    along = ways[w, 0] * x + ways[w, 1] * y + ways[w, 2] * z
                    deep = min(deep, ways[w, 3] - along)
            if deep < key:
                if deep >= deepest:
                    push(keys, items, waiting, -deep, k)
                    waiting += 1
                continue
        # a probe down to `deepest` is faster than one for the exact depth
        answer = ask_sample(pools, other, sample, 0.0, deepest, True, scratch)
        if answer.status != INSIDE:
            point[k, DISTANCE] = 0.0
            continue
        if answer.distance == -math.inf:
            answer = ask_sample(pools, other, sample, 0.0, math.inf, True, scratch)
            keep_answer(answer, k, sample, scratch)
        point[k, DISTANCE], spread[MOST_DEPTH, k] = answer.distance, min(answer.most_depth, sample.deep)
        deepest = max(deepest, -answer.distance)
        if known < MOST_WAYS:
            n, way = (answer.nx, answer.ny, answer.nz), ways[known]
            _, reach = farthest_sample(leaves, n, 0, scratch.along)
            farthest = n[0] * m[0] + n[1] * m[1] + n[2] * m[2] + reach + m[3] + slack
            way[0], way[1], way[2], way[3], way[4] = n[0], n[1], n[2], farthest, side.number
            known += 1
    return deepest
