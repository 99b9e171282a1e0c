"""All samples of a pair that may touch, found among the leaves of both fragments at once.

For a pair with fewer contacts than wanted, algorithm 1 finds all samples within the detection tolerance, ordered by
number: any search that finds them all gives the same bytes. This one computes a separating plane of the two hulls, or
the nearest to one; tests all leaves (sample_leaves.py) against the other's half-space and box; and queries the samples
of the leaves that reach in. Which of them are listed: contact_choice.py.
"""

from __future__ import annotations

import math

import numpy as np

from fracture_collision.core.contacts.contact_choice import (
    UNASKED,
    choose,
    is_final,
    keep,
    keep_answer,
    placed,
    put_chosen,
    way_out_of_box,
)
from fracture_collision.core.contacts.deep_choice import choose_deep, may_wait
from fracture_collision.core.contacts.known_samples import (
    ask_sample,
    home_tetrahedron,
    query_seeds,
    rounding_slack,
    share_a_body,
)
from fracture_collision.core.edges.ridge_contacts import add_crossings, add_listed_crossings, have_ridges
from fracture_collision.core.field.clearance import (
    BEYOND,
    DEEP,
    UNKNOWN,
    clearance,
    may_be_clear,
    side_of_surface,
)
from fracture_collision.core.field.elementary_queries import INSIDE, OUTSIDE, bounded_probe, sphere_test
from fracture_collision.core.fracture.crack_seeds import find_seeds
from fracture_collision.core.memory.compiled import inlined_kernel, query_kernel
from fracture_collision.core.memory.kinds import PLANE, SPHERE
from fracture_collision.core.memory.pools import LEAF, SAMPLE
from fracture_collision.core.memory.prefetch import fetch
from fracture_collision.core.memory.rotations import rotated, to_other
from fracture_collision.core.search.neighbour_lists import (
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
from fracture_collision.core.search.traversal import IN_PLACE, NO_PLANE, most_depth
from fracture_collision.core.separation.leaf_separation import half_spaces, parting_plane_of_leaves
from fracture_collision.core.separation.oriented_boxes import box_clearance
from fracture_collision.core.tree.sample_leaves import (
    leaves_of,
    sample_about_middle,
    worst_of_leaves,
    worst_of_samples,
)

# If a pair has moved by less than this share of R, the search for a sample starts where the sample was.
HOME_SHARE = 0.1
# Columns of scratch.candidate_ids: index into the leaves' entries; for a sample of the same body, a tetrahedron that it
# was at in the unbroken body.
PLACE_OF, HOME = 0, 1


@inlined_kernel
def may_search(pools, a, b):
    """Whether `search_samples` supports a pair."""
    return pools.fragment.kind[a] != SPHERE and pools.fragment.kind[b] != SPHERE


@inlined_kernel
def begins_with_seeds(pools, a, b, rotation, translation, rule):
    """Whether the two are so near to where they broke that the crack's seeds are queried first (crack_seeds.py)."""
    if not share_a_body(pools, a, b):
        return False
    begin, end = find_seeds(pools.fragment, pools.seeds, a, b)
    return (
        end - begin >= rule.wanted and displacement(pools, a, b, rotation, translation, IN_PLACE) <= rule.epsilon
    )


@query_kernel
def search_samples(
    pools, edges, a, b, rotation, translation, rule, reach, ways, ahead, contacts, ids, capacity, listed, places,
    ridges, toward, scratch, thread,
):  # fmt: skip
    """All contacts of fragments `a` and `b`, no spheres, by a Rule; poses, contacts, ids and capacity as query_pair.

    `reach` [m], 0: no list: samples that may be within near + reach are written to `listed` (room, 2) and `places`
    (room, PLACE), see neighbour_lists.py, those of a before those of b, except samples that cannot come near by `ways`
    (2, WAY), the motion of a's points relative to b and of b's relative to a (motion.put_way). Distances are searched
    at most `ahead` [m] beyond near. By our rule, crossings of ridges are found too (`edges`:
    ridge_contacts.RidgeSearch), and `ridges` (room, 2) lists pairs that may cross. toward (3,): a direction in b's
    frame that may separate the two, zeros if unknown; it is replaced by the one found.

    Returns (contacts, missed depth bound [m], visits, samples within reach, pairs of ridges likewise, clearance [m]),
    as query_pair does, with leaves and samples counted as visits; -1 contacts: there are as many as wanted by the
    paper's rule, and query_pair must be run.
    """
    fragment = pools.fragment
    slack = rounding_slack(pools, a, b, translation)
    one_body = share_a_body(pools, a, b)
    near = rule.near
    within, samples, visits, count, deep = near + reach, 0, 0, 0, 0
    bounded = fragment.kind[a] != PLANE and fragment.kind[b] != PLANE
    if bounded:
        parted = box_clearance(fragment.box[a], fragment.box[b], rotation[0], translation[0], within + slack)
        if parted > within + slack:
            return 0, slack, 0, 0, 0, parted - near - slack
    apart = displacement(pools, a, b, rotation, translation, IN_PLACE) if one_body else math.inf
    if apart <= rule.epsilon:
        count, visits = query_seeds(
            pools, a, b, rotation, translation, rule.wanted, near, 0, contacts, ids, capacity, scratch, thread
        )
        if count == rule.wanted:
            return count, apart + slack, visits, len(listed) + 1, 0, 0.0
        count = 0
    leaves = leaves_of(pools, a), leaves_of(pools, b)
    beyond_b, beyond_a = NO_PLANE, NO_PLANE
    if bounded and apart > within and len(leaves[0].entries) and len(leaves[1].entries):
        rounding = slack + leaves[0].middle[3] + leaves[1].middle[3]
        n, low, high = parting_plane_of_leaves(
            pools, a, b, leaves, rotation, translation, within + rounding, toward, scratch, thread
        )
        if low - high > within + rounding:
            return 0, slack, visits, 0, 0, low - high - near - rounding
        x, y, z = n
        t = translation[0]
        beyond_b = x, y, z, high + rounding
        x, y, z = rotated(rotation[1], -x, -y, -z)
        beyond_a = x, y, z, n[0] * t[0] + n[1] * t[1] + n[2] * t[2] - low + rounding
    worst, is_home = scratch.along[thread], apart < HOME_SHARE * pools.fragment.radius[a]
    candidates, ids_of = scratch.candidates[thread], scratch.candidate_ids[thread]
    for side in range(2):
        own, other = (a, b) if side == 0 else (b, a)
        mine = leaves[side]
        n = len(mine.entries) // LEAF
        if n == 0:
            continue
        plane = beyond_b if side == 0 else beyond_a
        planes = scratch.planes[thread]
        used = half_spaces(
            pools, own, other, mine.middle, side, rotation, translation, plane, near + slack, reach, ways[side], planes
        )
        worst_of_leaves(mine, planes, used, worst)
        first, middle = fragment.tree_begin[own], scratch.point[thread]
        m = mine.middle
        middle[0], middle[1], middle[2] = to_other(rotation[side], translation[side], m[0], m[1], m[2])
        at, may_be = -1, may_be_clear(pools, other)
        frame = frame_between(m, leaves[1 - side].middle, rotation[side], translation[side])
        reached, asked = _candidates(
            pools, mine, other, side, rotation, translation, planes, used, plane, within, first, is_home, worst,
            middle, scratch, thread,
        )  # fmt: skip
        visits += reached + asked
        for turn in range(asked):
            x, y, z, depth = candidates[turn, 0], candidates[turn, 1], candidates[turn, 2], candidates[turn, 3]
            k = ids_of[turn, PLACE_OF]
            if is_home:
                at = ids_of[turn, HOME]
            entry = first + mine.entries[k]
            distance, is_near = 0.0, may_wait(pools, other, rule, deep)
            if is_near:
                where = UNKNOWN
                if may_be:
                    where, at = side_of_surface(
                        pools, other, at, x, y, z, rule.epsilon, slack + mine.middle[3]
                    )
                if where != BEYOND:
                    count = _keep_for_later(
                        pools, rotation, translation, rule, entry, side, other, one_body, slack, where, count,
                        scratch, thread,
                    )  # fmt: skip
            elif -depth > near + ahead:
                distance = -depth
            elif may_be:
                distance, at = clearance(
                    pools, other, at, x, y, z, near + ahead, slack + mine.middle[3], scratch, thread
                )
            if distance == 0.0 and not is_near:
                distance, is_near = _ask(
                    pools, rotation, translation, rule, entry, side, other, one_body, near + ahead, slack, True,
                    count, scratch, thread,
                )  # fmt: skip
                count, deep = count + is_near, deep + (distance < -rule.epsilon)
                if rule.most == 0 and count == rule.wanted:
                    return -1, slack, visits, samples, 0, 0.0
            if reach > 0.0:
                if samples < len(listed):
                    listed[samples, WHO], listed[samples, WHERE] = 2 * entry + side, at
                    place = places[samples]
                    place[OWN], place[OWN + 1], place[OWN + 2] = sample_about_middle(mine, k)
                    seen = NEAR_LAST if is_near else distance - 4.0 * slack
                    see(place, rotation[side], frame, seen, near)
                samples += 1
    crossings = 0
    if rule.most > 0 and have_ridges(edges, a, b):
        count, deep, crossings = add_crossings(
            pools, edges, a, b, rotation, translation, (beyond_b, beyond_a), rule, reach, ways, slack, apart, count,
            deep, ridges, scratch, thread,
        )  # fmt: skip
    chosen, bound = _choose(
        pools, a, b, rotation, translation, rule, slack, count, deep, contacts, ids, capacity, scratch, thread
    )
    return chosen, bound, visits, samples, crossings, 0.0


@inlined_kernel
def _candidates(
    pools, mine, other, side, rotation, translation, planes, used, plane, within, first, is_home, worst, middle,
    scratch, thread,
):  # fmt: skip
    """Write those of the samples `mine` (Leaves) that may be within `within` [m] of `other` to scratch.candidates
    (point in the other's frame, depth bound [m]) and scratch.candidate_ids: (leaves searched, how many).

    is_home: the samples are not far from where they were in the unbroken body.
    """
    points, ids = scratch.candidates[thread], scratch.candidate_ids[thread]
    beyond, reaching, count = scratch.looked_at[thread, 3], scratch.leaves[thread], 0
    reached = worst_of_samples(mine, planes, used, worst, scratch.looked_at[thread], reaching)
    for turn in range(reached):
        for lane in range(LEAF):
            k = LEAF * reaching[turn] + lane
            if mine.entries[k] < 0:
                break
            if beyond[LEAF * turn + lane] > np.float32(0.0):
                continue
            # single precision first: it rejects most samples, and the tree's rows are far apart in memory
            x, y, z = sample_about_middle(mine, k)
            x, y, z = to_other(rotation[side], middle, x, y, z)
            depth = most_depth(pools, other, x, y, z, plane) + mine.middle[3]
            if -depth > within or not sphere_test(
                pools, other, -depth, x, y, z, within + mine.middle[3], scratch, thread
            ):
                continue
            fetch(pools.tree.spheres, first + mine.entries[k])
            fetch(pools.tree.entries, first + mine.entries[k])
            points[count, 0], points[count, 1], points[count, 2], points[count, 3] = x, y, z, depth
            ids[count, PLACE_OF] = k
            count += 1
    if is_home:
        shift = pools.fragment.tet_shift[other]
        for k in range(count):
            sample = pools.tree.entries[first + mine.entries[ids[k, PLACE_OF]], SAMPLE]
            ids[k, HOME] = home_tetrahedron(pools, other, sample)
        for k in range(count):
            fetch(pools.mesh.walls, ids[k, HOME])
            fetch(pools.mesh.neighbours, ids[k, HOME])
            fetch(pools.body.regions, ids[k, HOME] + shift)
    return reached, count


@query_kernel
def query_listed(
    pools, edges, a, b, rotation, translation, rule, ahead, listed, places, ridges, contacts, ids, capacity, scratch,
    thread,
):  # fmt: skip
    """search_samples for a pair where `listed` and `places` (n, .) hold all samples that can be near, and `ridges` (m,
    2) all pairs of ridges that can cross.

    The distance of a sample that is not near is searched `ahead` [m] beyond the detection tolerance, and its row of
    `places` is renewed. Returns (contacts, missed depth bound [m], visits), -1 contacts as search_samples does.
    """
    tree, count, deep, visits, near = pools.tree, 0, 0, 0, rule.near
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
        if may_wait(pools, other, rule, deep):
            places[i, UNTIL] = NEAR_LAST
            count = _keep_for_later(
                pools, rotation, translation, rule, entry, side, other, one_body, slack, UNKNOWN, count, scratch,
                thread,
            )  # fmt: skip
            continue
        looked, distance, is_near = near, 0.0, False
        if places[i, UNTIL] != NEAR_LAST:
            looked = near + ahead
            if may_be_clear(pools, other):
                c = tree.spheres[entry]
                x, y, z = to_other(rotation[side], translation[side], c[0], c[1], c[2])
                distance, listed[i, WHERE] = clearance(
                    pools, other, listed[i, WHERE], x, y, z, looked, slack, scratch, thread
                )
        if distance == 0.0:
            distance, is_near = _ask(
                pools, rotation, translation, rule, entry, side, other, one_body, looked, slack, False, count, scratch,
                thread,
            )  # fmt: skip
        if not is_near:
            see(places[i], rotation[side], frame, distance - 4.0 * slack, near)
            continue
        places[i, UNTIL] = NEAR_LAST
        count, deep = count + 1, deep + (distance < -rule.epsilon)
        if rule.most == 0 and count == rule.wanted:
            return -1, slack, visits
    if rule.most > 0 and len(ridges) > 0:
        apart = displacement(pools, a, b, rotation, translation, IN_PLACE) if one_body else math.inf
        count, deep = add_listed_crossings(
            pools, edges, a, b, rotation, translation, rule, slack, apart, ridges, count, deep, scratch, thread
        )
    chosen, bound = _choose(
        pools, a, b, rotation, translation, rule, slack, count, deep, contacts, ids, capacity, scratch, thread
    )
    return chosen, bound, visits


@inlined_kernel
def _ask(
    pools, rotation, translation, rule, entry, side, other, one_body, looked, slack, reached, count, scratch, thread
):
    """(distance [m] of a sample from the other, searched to at least `looked` [m]; whether it is within the tolerance:
    then it is stored as candidate number `count`).

    By our rule the probe stops at depth epsilon, and the depth is computed later: minus infinity.
    """
    sample, x, y, z, start, deep = placed(pools, rotation, translation, entry, side, other, one_body, slack)
    if rule.most > 0:
        answer = bounded_probe(
            pools, other, x, y, z, looked, min(deep, rule.epsilon), start, reached, scratch, thread
        )
    else:
        answer = ask_sample(pools, other, x, y, z, looked, deep, start, reached, scratch, thread)
    if answer[0] != INSIDE and (answer[0] == OUTSIDE or answer[1] > rule.near):
        return answer[1], False
    most = min(answer[8], deep, way_out_of_box(pools.fragment.box[other], x, y, z) + slack)
    keep(pools, entry, side, sample, x, y, z, answer[1], most, count, scratch, thread)
    if is_final(answer, looked, rule):
        keep_answer(answer, count, sample, x, y, z, scratch, thread)
    return answer[1], True


@inlined_kernel
def _keep_for_later(
    pools, rotation, translation, rule, entry, side, other, one_body, slack, where, count, scratch, thread
):
    """Store a sample as candidate number `count` if it may be deeper than epsilon, UNASKED if that is not certain;
    returns the new count. where: DEEP or UNKNOWN, see side_of_surface.
    """
    sample, x, y, z, _, deep = placed(pools, rotation, translation, entry, side, other, one_body, slack)
    deep = min(deep, way_out_of_box(pools.fragment.box[other], x, y, z) + slack)
    if not deep > rule.epsilon:
        return count
    distance = -math.inf if where == DEEP else UNASKED
    keep(pools, entry, side, sample, x, y, z, distance, deep, count, scratch, thread)
    return count + 1


@inlined_kernel
def _choose(
    pools, a, b, rotation, translation, rule, slack, count, deep, contacts, ids, capacity, scratch, thread
):
    """Write the contacts to list among `count` candidates, of which `deep` are known to be deeper than epsilon; returns
    (contacts, missed depth bound [m]).
    """
    if rule.most > 0 and deep > rule.wanted:
        chosen, bound = choose_deep(pools, a, b, rotation, translation, rule, slack, count, scratch, thread)
    else:
        chosen, bound = choose(rule, count, scratch, thread)
    put_chosen(
        pools, a, b, rotation, translation, rule.near, slack, contacts, ids, min(chosen, capacity), scratch, thread
    )
    return chosen, bound + slack
