"""All samples of a pair that may touch, found among the leaves of both fragments at once; and which are listed.

What algorithm 1 finds of a pair with fewer contacts than are wanted are all samples within the detection tolerance, in
the order of their numbers: so any search that finds them all gives the same bytes. This one looks for a plane between
the two hulls, or the nearest to one; asks all leaves (sample_leaves.py) which of them reach into the other's half of
the space and into its box; and asks the samples of those that do. Where more are near than are wanted, the paper's rule
depends on the order of visits; ours (`_choose`) on the samples' positions and depths alone.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from fracture_collision.core.clearance import clearance, may_be_clear
from fracture_collision.core.compiled import inlined_kernel, query_kernel
from fracture_collision.core.crack_seeds import find_seeds
from fracture_collision.core.deepest_contacts import sort_by_sample
from fracture_collision.core.elementary_queries import INSIDE, NEAR, OUTSIDE, bounded_probe, sphere_test
from fracture_collision.core.hull_separation import (
    MOST_STEPS,
    SETTLED,
    encloses_origin,
    lowest_corner,
    nearest_to_origin,
)
from fracture_collision.core.kinds import PLANE, SPHERE
from fracture_collision.core.known_samples import (
    ask_sample,
    home_tetrahedron,
    moved_since,
    put_contact,
    query_seeds,
    rounding_slack,
    share_a_body,
)
from fracture_collision.core.neighbour_lists import (
    MOST_LISTED,
    NEAR_LAST,
    OWN,
    UNTIL,
    WHERE,
    WHO,
    displacement,
    frame_between,
    may_be_near,
    see,
)
from fracture_collision.core.oriented_boxes import box_clearance
from fracture_collision.core.pools import LEAF, SAMPLE
from fracture_collision.core.rotations import rotated, to_other
from fracture_collision.core.sample_leaves import (
    farthest_sample,
    is_beyond,
    leaves_of,
    sample_about_middle,
    worst_of_leaves,
)
from fracture_collision.core.traversal import IN_PLACE, NO_PLANE, most_depth, way_between

# Columns of scratch.node_int, node_float and spread, of the samples that are to choose from.
ENTRY, SIDE, NUMBER, ANSWER = 0, 1, 2, 3
DISTANCE = 3
FAR, MOST_DEPTH = 0, 1
# What comes to this share of the best is as good to `_choose`.
EQUAL = 1.0 - 1e-3


class Rule(NamedTuple):
    """Which of a pair's contacts are listed (Glondu 2014, section 5.2, and `_choose`)."""

    wanted: int  # m
    most: int  # that are listed where more than m are deeper than epsilon; 0: the paper's rule
    epsilon: float  # [m]
    near: float  # [m] the detection tolerance


@inlined_kernel
def may_search(pools, a, b):
    """Whether `search_samples` can tell the contacts of a pair."""
    return pools.fragment.kind[a] != SPHERE and pools.fragment.kind[b] != SPHERE


@inlined_kernel
def begins_with_seeds(pools, a, b, rotation, translation, rule):
    """Whether the two are so near to where they broke that the crack's seeds are asked first (crack_seeds.py)."""
    if not share_a_body(pools, a, b):
        return False
    begin, end = find_seeds(pools.fragment, pools.seeds, a, b)
    return (
        end - begin >= rule.wanted and displacement(pools, a, b, rotation, translation, IN_PLACE) <= rule.epsilon
    )


@query_kernel
def search_samples(
    pools, a, b, rotation, translation, rule, reach, ahead, contacts, ids, capacity, listed, places, toward, scratch,
    thread,
):  # fmt: skip
    """All contacts of fragments `a` and `b`, no spheres, by a Rule; poses, contacts, ids and capacity as query_pair.

    `reach` [m], 0: none: samples that may be no farther than near + reach are put into `listed` (room, 2) and `places`
    (room, PLACE), see neighbour_lists.py, those of a before those of b; how far each is looked for no more than `ahead`
    [m] farther.
    toward (3,): a direction in b's frame along which the two may lie apart, zeros if none is known; replaced by the one
    that was found.

    Returns (contacts, missed depth bound [m], visits, samples near, clearance [m]), as query_pair does, the visits
    counting leaves and samples; -1 contacts: as many as wanted by the paper's rule, so query_pair must say.
    """
    fragment, tree = pools.fragment, pools.tree
    slack = rounding_slack(pools, a, b, translation)
    one_body = share_a_body(pools, a, b)
    near = rule.near
    within, samples, visits, count = near + reach, 0, 0, 0
    bounded = fragment.kind[a] != PLANE and fragment.kind[b] != PLANE
    if bounded:
        parted = box_clearance(fragment.box[a], fragment.box[b], rotation[0], translation[0], within + slack)
        if parted > within + slack:
            return 0, slack, 0, 0, parted - near - slack
    apart = displacement(pools, a, b, rotation, translation, IN_PLACE) if one_body else math.inf
    if apart <= rule.epsilon:
        count, visits = query_seeds(
            pools, a, b, rotation, translation, rule.wanted, near, 0, contacts, ids, capacity, scratch, thread
        )
        if count == rule.wanted:
            return count, apart + slack, visits, MOST_LISTED + 1, 0.0
        count = 0
    leaves = leaves_of(pools, a), leaves_of(pools, b)
    beyond_b, beyond_a = NO_PLANE, NO_PLANE
    if bounded and apart > within and len(leaves[0].entries) and len(leaves[1].entries):
        rounding = slack + leaves[0].middle[3] + leaves[1].middle[3]
        n, low, high = _parting_plane(
            pools, a, b, leaves, rotation, translation, within + rounding, toward, scratch, thread
        )
        if low - high > within + rounding:
            return 0, slack, visits, 0, low - high - near - rounding
        x, y, z = n
        t = translation[0]
        beyond_b = x, y, z, high + rounding
        x, y, z = rotated(rotation[1], -x, -y, -z)
        beyond_a = x, y, z, n[0] * t[0] + n[1] * t[1] + n[2] * t[2] - low + rounding
    worst = scratch.along[thread]
    for side in range(2):
        own, other = (a, b) if side == 0 else (b, a)
        mine = leaves[side]
        n = len(mine.entries) // LEAF
        if n == 0:
            continue
        plane = beyond_b if side == 0 else beyond_a
        planes = scratch.planes[thread]
        used = _half_spaces(pools, own, other, mine.middle, side, rotation, translation, plane, within + slack, planes)
        worst_of_leaves(mine, planes, used, worst)
        first, middle = fragment.tree_begin[own], scratch.point[thread]
        m = mine.middle
        middle[0], middle[1], middle[2] = to_other(rotation[side], translation[side], m[0], m[1], m[2])
        at, may_be = -1, may_be_clear(pools, other)
        frame = frame_between(m, leaves[1 - side].middle, rotation[side], translation[side])
        for leaf in range(n):
            if worst[leaf] > np.float32(0.0):
                continue
            visits += 1
            for k in range(LEAF * leaf, LEAF * leaf + LEAF):
                if mine.entries[k] < 0:
                    break
                if is_beyond(mine, k, planes, used):
                    continue
                # from single precision first: most samples end here, and the tree's rows are far apart in memory
                x, y, z = sample_about_middle(mine, k)
                x, y, z = to_other(rotation[side], middle, x, y, z)
                depth = most_depth(pools, other, x, y, z, plane) + mine.middle[3]
                if -depth > within or not sphere_test(
                    pools, other, -depth, x, y, z, within + mine.middle[3], scratch, thread
                ):
                    continue
                visits += 1
                entry = first + mine.entries[k]
                distance, is_near = 0.0, False
                if -depth > near + ahead:
                    distance = -depth
                elif may_be:
                    distance, at = clearance(
                        pools, other, at, x, y, z, near + ahead, slack + mine.middle[3], scratch, thread
                    )
                if distance == 0.0:
                    c, sample = tree.spheres[entry], tree.entries[entry, SAMPLE]
                    x, y, z = to_other(rotation[side], translation[side], c[0], c[1], c[2])
                    deep = moved_since(c, x, y, z) + slack if one_body else math.inf
                    start = home_tetrahedron(pools, other, sample) if one_body else -1
                    answer = _ask(pools, other, x, y, z, near + ahead, deep, rule, start, True, scratch, thread)
                    distance = answer[1]
                    is_near = answer[0] == INSIDE or (answer[0] != OUTSIDE and distance <= near)
                if reach > 0.0:
                    if samples < len(listed):
                        listed[samples, WHO], listed[samples, WHERE] = 2 * entry + side, at
                        place = places[samples]
                        place[OWN], place[OWN + 1], place[OWN + 2] = sample_about_middle(mine, k)
                        seen = NEAR_LAST if is_near else distance - 4.0 * slack
                        see(place, rotation[side], frame, seen, near)
                    samples += 1
                if is_near:
                    if rule.most == 0 and count + 1 >= rule.wanted:
                        return -1, slack, visits, samples, 0.0
                    ceiling = min(deep, _way_out_of_box(fragment.box[other], x, y, z) + slack)
                    _keep(entry, side, sample, x, y, z, c, answer, ceiling, count, scratch, thread)
                    _keep_answer(rule, near + ahead, answer, count, side, sample, x, y, z, scratch, thread)
                    count += 1
    _find_deepest(pools, a, b, rotation, translation, rule, slack, count, scratch, thread)
    chosen, bound = _choose(rule, count, scratch, thread)
    put_chosen(pools, a, b, rotation, translation, near, slack, contacts, ids, min(chosen, capacity), scratch, thread)
    return chosen, bound + slack, visits, samples, 0.0


@query_kernel
def query_listed(
    pools, a, b, rotation, translation, rule, ahead, listed, places, contacts, ids, capacity, scratch, thread,
):  # fmt: skip
    """search_samples of a pair of which `listed` and `places` (n, .) are all samples that can be near.

    Where one is no nearer than the detection tolerance, it is looked for `ahead` [m] farther, and what is noted of it
    is renewed. Returns (contacts, missed depth bound [m], visits), -1 contacts as search_samples does.
    """
    tree, count, visits, near = pools.tree, 0, 0, rule.near
    middles = pools.fragment.middle
    slack, one_body = rounding_slack(pools, a, b, translation), share_a_body(pools, a, b)
    side, other = 0, b
    frame = frame_between(middles[a], middles[b], rotation[0], translation[0])
    for i in range(len(listed)):
        if listed[i, WHO] & 1 != side:
            side, other = 1, a
            frame = frame_between(middles[b], middles[a], rotation[1], translation[1])
        if not may_be_near(places[i], rotation[side], frame):
            continue
        visits += 1
        entry = listed[i, WHO] >> 1
        c = tree.spheres[entry]
        x, y, z = to_other(rotation[side], translation[side], c[0], c[1], c[2])
        looked = near
        if places[i, UNTIL] != NEAR_LAST:
            looked = near + ahead
            if may_be_clear(pools, other):
                distance, listed[i, WHERE] = clearance(
                    pools, other, listed[i, WHERE], x, y, z, looked, slack, scratch, thread
                )
                if distance > 0.0:
                    see(places[i], rotation[side], frame, distance - 4.0 * slack, near)
                    continue
        sample = tree.entries[entry, SAMPLE]
        start = home_tetrahedron(pools, other, sample) if one_body else -1
        deep = moved_since(c, x, y, z) + slack if one_body else math.inf
        answer = _ask(pools, other, x, y, z, looked, deep, rule, start, False, scratch, thread)
        if answer[0] != INSIDE and (answer[0] == OUTSIDE or answer[1] > near):
            see(places[i], rotation[side], frame, answer[1] - 4.0 * slack, near)
            continue
        places[i, UNTIL] = NEAR_LAST
        if rule.most == 0 and count + 1 >= rule.wanted:
            return -1, slack, visits
        ceiling = min(deep, _way_out_of_box(pools.fragment.box[other], x, y, z) + slack)
        _keep(entry, side, sample, x, y, z, c, answer, ceiling, count, scratch, thread)
        _keep_answer(rule, looked, answer, count, side, sample, x, y, z, scratch, thread)
        count += 1
    _find_deepest(pools, a, b, rotation, translation, rule, slack, count, scratch, thread)
    chosen, bound = _choose(rule, count, scratch, thread)
    put_chosen(pools, a, b, rotation, translation, near, slack, contacts, ids, min(chosen, capacity), scratch, thread)
    return chosen, bound + slack, visits


@inlined_kernel
def _ask(pools, other, x, y, z, near, deep, rule, start, reached, scratch, thread):
    """bounded_probe of a sample that may be near; by our rule no deeper than epsilon, how deep it is matters later."""
    if rule.most > 0:
        return bounded_probe(pools, other, x, y, z, near, min(deep, rule.epsilon), start, reached, scratch, thread)
    return ask_sample(pools, other, x, y, z, near, deep, start, reached, scratch, thread)


@inlined_kernel
def _way_out_of_box(box, x, y, z):
    """[m] from a point to the nearest side of a box (6,) around it: what is in the box is no deeper."""
    return min(x - box[0], y - box[1], z - box[2], box[3] - x, box[4] - y, box[5] - z)


@inlined_kernel
def _keep(entry, side, sample, x, y, z, own, answer, ceiling, k, scratch, thread):
    """A sample that is near, as the k-th to choose from: at (x, y, z) in the other's frame, at `own` in its own, no
    deeper than `ceiling` [m].
    """
    node, point = scratch.node_int[thread, k], scratch.node_float[thread, k]
    node[ENTRY], node[SIDE], node[NUMBER] = entry, side, sample
    point[0], point[1], point[2], point[DISTANCE] = x, y, z, answer[1]
    if side == 1:
        point[0], point[1], point[2] = own[0], own[1], own[2]
    scratch.spread[thread, MOST_DEPTH, k] = min(answer[8], ceiling)


@inlined_kernel
def _keep_answer(rule, looked, answer, k, side, sample, x, y, z, scratch, thread):
    """Keep the answer of the k-th too, unless put_chosen might get another: of a point that was looked for farther than
    the tolerance, or not as deep as it may be, another of surfaces that are equally near.
    """
    is_final = (answer[0] == NEAR and looked == rule.near) or (answer[0] == INSIDE and rule.most == 0)
    scratch.node_int[thread, k, ANSWER] = k if is_final else -1
    if is_final:
        put_contact(scratch.kept[thread], scratch.kept_ids[thread], k, side, sample, x, y, z, answer)


@inlined_kernel
def _find_deepest(pools, a, b, rotation, translation, rule, slack, count, scratch, thread):
    """Where more of `count` samples than wanted are deeper than epsilon, find out how deep those are that may be the
    deepest; of the others it is known how deep they are at most.

    What is at n . x along a direction n is no deeper than the way from there to the other's farthest point along it.
    The way out for a deep sample is a good direction for those beside it.
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
    while True:
        at = -1
        for k in range(count):
            may_be_deepest = point[k, DISTANCE] == -math.inf and spread[MOST_DEPTH, k] >= deepest
            if may_be_deepest and (at < 0 or spread[MOST_DEPTH, k] > spread[MOST_DEPTH, at]):
                at = k
        if at < 0:
            return
        entry, side = node[at, ENTRY], node[at, SIDE]
        other = b if side == 0 else a
        c, sample = pools.tree.spheres[entry], pools.tree.entries[entry, SAMPLE]
        x, y, z = to_other(rotation[side], translation[side], c[0], c[1], c[2])
        start = home_tetrahedron(pools, other, sample) if one_body else -1
        deep_at_most = moved_since(c, x, y, z) + slack if one_body else math.inf
        answer = ask_sample(pools, other, x, y, z, rule.near, deep_at_most, start, True, scratch, thread)
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
def _choose(rule, count, scratch, thread):
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
    """The first `count` of the samples kept, as contacts by side and sample.

    Each is asked, or was, as query_pair would ask it: of surfaces that are equally near it finds the same.
    """
    one_body = share_a_body(pools, a, b)
    for k in range(count):
        kept = scratch.node_int[thread, k, ANSWER]
        if kept >= 0:
            for i in range(contacts.shape[1]):
                contacts[k, i] = scratch.kept[thread, kept, i]
            for i in range(ids.shape[1]):
                ids[k, i] = scratch.kept_ids[thread, kept, i]
            continue
        entry, side = scratch.node_int[thread, k, ENTRY], scratch.node_int[thread, k, SIDE]
        other = b if side == 0 else a
        c, sample = pools.tree.spheres[entry], pools.tree.entries[entry, SAMPLE]
        x, y, z = to_other(rotation[side], translation[side], c[0], c[1], c[2])
        start = home_tetrahedron(pools, other, sample) if one_body else -1
        deep = moved_since(c, x, y, z) + slack if one_body else math.inf
        answer = ask_sample(pools, other, x, y, z, near, deep, start, True, scratch, thread)
        put_contact(contacts, ids, k, side, sample, x, y, z, answer)
    sort_by_sample(contacts, ids, count)


@inlined_kernel
def _half_spaces(pools, own, other, middle, side, rotation, translation, plane, within, planes):
    """Where of `own` samples may be within `within` [m] of `other`: half-spaces n . x <= o about own's middle, into
    `planes` (8, 4) float32; returns how many.
    """
    kind, box, used = pools.fragment.kind[other], pools.fragment.box[other], 0
    mx, my, mz = to_other(rotation[side], translation[side], middle[0], middle[1], middle[2])
    within += middle[3]
    if kind == PLANE:
        shape, back = pools.fragment.shape[other], rotation[1 - side]
        return _put_half_space(back, shape[0], shape[1], shape[2], shape[3] + within, mx, my, mz, planes, 0)
    back = rotation[1 - side]
    if plane[0] != 0.0 or plane[1] != 0.0 or plane[2] != 0.0:  # most samples are beyond this one
        x, y, z, offset = plane
        used = _put_half_space(back, x, y, z, offset + within, mx, my, mz, planes, used)
    for d in range(3):
        x, y, z = 1.0 if d == 0 else 0.0, 1.0 if d == 1 else 0.0, 1.0 if d == 2 else 0.0
        used = _put_half_space(back, x, y, z, box[d + 3] + within, mx, my, mz, planes, used)
        used = _put_half_space(back, -x, -y, -z, -box[d] + within, mx, my, mz, planes, used)
    return used


@inlined_kernel
def _put_half_space(back, nx, ny, nz, offset, mx, my, mz, planes, row):
    """n . x <= offset of the other's frame about own's middle, which is at m there; back (3, 3): to own's frame."""
    x, y, z = rotated(back, nx, ny, nz)
    planes[row, 0], planes[row, 1], planes[row, 2] = np.float32(x), np.float32(y), np.float32(z)
    planes[row, 3] = np.float32(offset - (nx * mx + ny * my + nz * mz))
    return row + 1


@inlined_kernel
def _parting_plane(pools, a, b, leaves, rotation, translation, distance, toward, scratch, thread):
    """hull_separation.parting_plane over leaves: ((x, y, z), low, high), that rounding of single precision may falsify
    by what both middles say.

    toward (3,): see search_samples.
    """
    bounds = scratch.along[thread]
    of_a, of_b = leaves
    ax, ay, az = to_other(rotation[0], translation[0], of_a.middle[0], of_a.middle[1], of_a.middle[2])
    # the middles' way, in b's frame
    mx, my, mz = ax - of_b.middle[0], ay - of_b.middle[1], az - of_b.middle[2]
    v = (toward[0], toward[1], toward[2])
    if v[0] == 0.0 and v[1] == 0.0 and v[2] == 0.0:
        v = way_between(pools.fragment.box[a], pools.fragment.box[b], rotation[0], translation[0])
    k0, k1, k2 = v, v, v
    found, best, best_low, best_high = v, -math.inf, 0.0, 0.0
    for step in range(MOST_STEPS):
        length = math.sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2])
        if not length > 0.0:
            break
        n = v[0] / length, v[1] / length, v[2] / length
        own = rotated(rotation[1], -n[0], -n[1], -n[2])
        at_a, reach_a = farthest_sample(of_a, own, bounds)
        at_b, reach_b = farthest_sample(of_b, n, bounds)
        low = n[0] * ax + n[1] * ay + n[2] * az - reach_a
        high = n[0] * of_b.middle[0] + n[1] * of_b.middle[1] + n[2] * of_b.middle[2] + reach_b
        along = low - high
        if along > best:
            best, found, best_low, best_high = along, n, low, high
        if along > distance:
            break
        px, py, pz = sample_about_middle(of_a, at_a)
        px, py, pz = rotated(rotation[0], px, py, pz)
        qx, qy, qz = sample_about_middle(of_b, at_b)
        new = mx + px - qx, my + py - qy, mz + pz - qz
        if step == 0:
            k0, k1, k2, v = new, new, new, new
            continue
        if length - along <= SETTLED * length or encloses_origin(new, k0, k1, k2):
            break
        least, x, y, z, _ = nearest_to_origin(new, k0, k1)
        v, dropped = (x, y, z), 2
        nearer, x, y, z, _ = nearest_to_origin(new, k1, k2)
        if nearer < least:
            least, v, dropped = nearer, (x, y, z), 0
        nearer, x, y, z, _ = nearest_to_origin(new, k0, k2)
        if nearer < least:
            least, v, dropped = nearer, (x, y, z), 1
        if dropped == 0:
            k0 = new
        elif dropped == 1:
            k1 = new
        else:
            k2 = new
    toward[0], toward[1], toward[2] = found
    if best == -math.inf:
        return found, -math.inf, math.inf
    rows, corners = pools.fragment.corners, pools.body.corners
    corners_a, corners_b = corners[rows[a, 0] : rows[a, 1]], corners[rows[b, 0] : rows[b, 1]]
    t = translation[0]
    own = rotated(rotation[1], found[0], found[1], found[2])
    along_t = found[0] * t[0] + found[1] * t[1] + found[2] * t[2]
    best_low = lowest_corner(corners_a, own, best_low - along_t) + along_t
    best_high = -lowest_corner(corners_b, (-found[0], -found[1], -found[2]), -best_high)
    return found, best_low, best_high
