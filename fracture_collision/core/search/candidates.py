"""Samples of a pair that may be near: found among the leaves, queried, kept for later or chosen (sample_search.py)."""

from __future__ import annotations

import math

import numpy as np

from fracture_collision.core.contacts.contact_choice import (
    UNASKED,
    choose,
    is_final,
    keep,
    keep_answer,
    put_chosen,
    way_out_of_box,
)
from fracture_collision.core.contacts.deep_choice import choose_deep
from fracture_collision.core.contacts.known_samples import ask_sample, home_tetrahedron, placed
from fracture_collision.core.field.clearance import DEEP
from fracture_collision.core.field.elementary_queries import INSIDE, OUTSIDE, sphere_test
from fracture_collision.core.memory.compiled import query_kernel
from fracture_collision.core.memory.pools import LEAF
from fracture_collision.core.memory.prefetch import fetch
from fracture_collision.core.memory.rotations import to_other
from fracture_collision.core.samples.sample_leaves import sample_about_middle, worst_of_leaves, worst_of_samples
from fracture_collision.core.search.depth_limits import most_depth
from fracture_collision.core.separation.leaf_separation import half_spaces

# Columns of scratch.candidate_ids: index into the leaves' entries; for a sample of the same body, a tetrahedron that it
# was at in the unbroken body.
PLACE_OF, HOME = 0, 1


@query_kernel
def find_candidates(pools, pair, side, mine, approach, within, is_home, scratch):
    """Find the samples of a Side that may be within `within` [m] of the other fragment.

    mine: Leaves of the side's fragment; approach: an Approach; is_home: the samples are not far from where they were in
    the unbroken body. Writes to scratch.candidates (point in the other's frame, depth bound [m]) and
    scratch.candidate_ids. Returns (leaves searched, number of samples).
    """
    other, worst, m = side.other, scratch.along, mine.middle
    planes = scratch.planes
    used = half_spaces(pools, pair, side.number, m, approach, planes)
    worst_of_leaves(mine, planes, used, worst)
    first, middle = pools.fragment.sample_begin[side.own], scratch.point
    middle[0], middle[1], middle[2] = to_other(side.rotation, side.translation, m[0], m[1], m[2])
    points, ids = scratch.candidates, scratch.candidate_ids
    beyond, reaching, count = scratch.looked_at[3], scratch.leaves, 0
    reached = worst_of_samples(mine, planes, used, worst, scratch.looked_at, reaching)
    for turn in range(reached):
        for lane in range(LEAF):
            k = LEAF * reaching[turn] + lane
            if mine.entries[k] < 0:
                break
            if beyond[LEAF * turn + lane] > np.float32(0.0):
                continue
            # single precision first: it rejects most samples, and the rows of the others are far apart in memory
            x, y, z = sample_about_middle(mine, k)
            x, y, z = to_other(side.rotation, middle, x, y, z)
            depth = most_depth(pools, other, x, y, z, approach.plane) + m[3]
            if -depth > within or not sphere_test(pools, other, -depth, x, y, z, within + m[3], scratch):
                continue
            fetch(pools.samples.points, first + mine.entries[k])
            points[count, 0], points[count, 1], points[count, 2], points[count, 3] = x, y, z, depth
            ids[count, PLACE_OF] = k
            count += 1
    if is_home:
        shift = pools.fragment.tet_shift[other]
        for k in range(count):
            sample = pools.samples.numbers[first + mine.entries[ids[k, PLACE_OF]]]
            ids[k, HOME] = home_tetrahedron(pools, other, sample)
        for k in range(count):
            fetch(pools.mesh.walls, ids[k, HOME])
            fetch(pools.mesh.neighbours, ids[k, HOME])
            fetch(pools.body.regions, ids[k, HOME] + shift)
    return reached, count


@query_kernel
def ask(pools, side, rule, entry, looked, reached, count, scratch):
    """Query a sample of a Side, row `entry` of SamplePool, and store it as candidate number `count` if it is near.

    looked [m]: it is searched to at least that distance; reached: see bounded_probe. Returns (distance [m] from the
    other, whether it is within the tolerance and so was stored). The probe stops at depth epsilon, and the depth is
    computed later: minus infinity.
    """
    other, sample = side.other, placed(pools, side, entry)
    answer = ask_sample(pools, other, sample, looked, rule.epsilon, reached, scratch)
    if answer.status != INSIDE and (answer.status == OUTSIDE or answer.distance >= rule.near):
        return answer.distance, False
    out = way_out_of_box(pools.fragment.box[other], sample.x, sample.y, sample.z)
    most = min(answer.most_depth, sample.deep, out + side.slack)
    keep(pools, side, entry, sample, answer.distance, most, count, scratch)
    if is_final(answer, looked, rule):
        keep_answer(answer, count, sample, scratch)
    return answer.distance, True


@query_kernel
def keep_for_later(pools, side, rule, entry, where, count, scratch):
    """Store a sample as candidate number `count` if it may be deeper than epsilon; returns the new count.

    entry: its row of SamplePool; where: DEEP or UNKNOWN, see side_of_surface. Only at DEEP is it certainly deeper; else
    it is UNASKED.
    """
    sample = placed(pools, side, entry)
    out = way_out_of_box(pools.fragment.box[side.other], sample.x, sample.y, sample.z)
    deep = min(sample.deep, out + side.slack)
    if not deep > rule.epsilon:
        return count
    keep(pools, side, entry, sample, -math.inf if where == DEEP else UNASKED, deep, count, scratch)
    return count + 1


@query_kernel
def choose_contacts(pools, pair, rule, slack, found, sink, scratch):
    """Choose among the candidates of a Pair, by a Rule, and write the contacts to a Sink.

    slack [m]: rounding_slack of the pair; found: (number of candidates, how many of them are known to be deeper than
    epsilon). Returns (contacts, missed depth bound [m]).
    """
    count, deep = found
    if deep > rule.wanted:
        chosen, bound = choose_deep(pools, pair, rule, slack, count, scratch)
    else:
        chosen, bound = choose(rule, count, scratch)
    put_chosen(pools, pair, rule.near, slack, sink, min(chosen, len(sink.contacts)), scratch)
    return chosen, bound + slack
