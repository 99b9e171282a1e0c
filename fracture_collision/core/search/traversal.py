"""Algorithm 1 of Glondu 2014 with self-adapting contact selection (section 5.2), both trees of a pair at once.

Two queues, swapped after each level; a node that has more children goes back into Q1 behind the others, so that
children of different parents are visited alternately (section 5.3); with QUEUE it stays at the head of Q1 until all its
children are in Q2, as in the paper's earlier version [27]. The search ends when Q2 is empty (the printed algorithm has
the test reversed). Both roots start in Q1, so the pair's contacts come from both sides level by level.

Up to m contacts within the detection tolerance are taken as they come; from then on only those deeper than epsilon, and
m grows by one with each. A branch is skipped when nothing below it can count. Skipped branches are bounded: depth is
1-Lipschitz, so no point of a sphere is deeper than the depth at its centre plus its radius.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from fracture_collision.core.contacts.deepest_contacts import keep_if_deeper, make_heap, sort_by_sample, sort_heap
from fracture_collision.core.contacts.known_samples import (
    Placed,
    ask_sample,
    home_tetrahedron,
    moved_since,
    put_contact,
    query_seeds,
    rounding_slack,
    share_a_body,
)
from fracture_collision.core.contacts.sphere_contacts import sphere_contacts
from fracture_collision.core.field.elementary_queries import INSIDE, OUTSIDE, sphere_test
from fracture_collision.core.memory.compiled import inlined_kernel, query_kernel
from fracture_collision.core.memory.kinds import SPHERE, TRIANGLES, has_faces, is_bounded
from fracture_collision.core.memory.pools import NONE_BELOW, OWN_SAMPLE, QUEUE, SAMPLE, SIZE, SURFACE
from fracture_collision.core.memory.rotations import rotated, to_other
from fracture_collision.core.search.depth_limits import depth_limit, most_depth
from fracture_collision.core.search.neighbour_lists import IN_PLACE, UNTURNED, displacement, spin
from fracture_collision.core.separation.hull_separation import hull_of, parting_plane
from fracture_collision.core.separation.oriented_boxes import box_clearance, way_between

# columns of scratch.node_int
ENTRY, SIDE, NEXT_CHILD, STATUS = 0, 1, 2, 3
# columns of scratch.node_float: the node's point in the other's frame, then an upper bound of its depth
DEPTH = 3
UNTESTED = -1
NO_PLANE = (0.0, 0.0, 0.0, 0.0)
# How a search ended: complete; cut short by a limit on visits or contacts; cut short by the limit on further visits,
# those after a pair has the contacts wanted.
COMPLETE, BY_LIMIT, BY_FURTHER = 0, 1, 2
# Minimum number of triangles searched for a sphere's contacts, even if fewer further visits are left.
LEAST_WITHIN = 32
UNKNOWN = 3  # in addition to INSIDE, NEAR, OUTSIDE: not tested, because no depth it can have would count


class VisitLimits(NamedTuple):
    """How many tree nodes a search may visit."""

    budget: int  # in all, 0: no limit
    further: int  # once there are the contacts wanted


@query_kernel
def query_pair(pools, pair, rule, limits, sink, scratch):
    """All contacts of a Pair, by the paper's rule, written to a Sink; limits: VisitLimits.

    Returns (contacts, missed depth bound [m], visits, one of COMPLETE, BY_LIMIT, BY_FURTHER, clearance [m]); the
    rule.limit deepest contacts are kept. Fewer contacts than wanted are sorted by side and sample; those kept of more
    than rule.limit, by depth; others are in search order. The clearance is a lower bound, beyond rounding, of the
    distance in excess of rule.near; 0: unknown.

    The queues hold rows of node_int and node_float, one per node reached. A child whose sphere is out of reach of the
    other counts as visited but takes no row.

    Fragments of one body share a frame, and in place no sample of one is inside the other: none is deeper than it has
    moved since. That bounds all samples below a node at once. Two that have hardly moved against each other need only
    their m contacts, which are searched first where the two touch in place (crack_seeds.py); they are no farther apart
    than they have moved. For all other pairs a separating plane of the hulls is searched (hull_separation.py). If there
    is none, the best plane found still bounds the depth of everything beyond the other along it.
    """
    a, b, rotation, translation = pair
    wanted, epsilon, near, limit = rule.wanted, rule.epsilon, rule.near, rule.limit
    budget, further = limits
    contacts, ids = sink
    capacity = len(contacts)
    fragment, tree = pools.fragment, pools.tree
    slack = rounding_slack(pools, a, b, translation)
    one_body = share_a_body(pools, a, b)
    turned = spin(rotation[0], UNTURNED) if one_body else 0.0
    parted = _clearance_of_boxes(pools, pair, near + slack)
    if parted > near + slack:
        return 0, slack, 0, COMPLETE, parted - near - slack
    visits, apart = 0, math.inf
    if one_body:
        apart = displacement(pools, pair, IN_PLACE)
        if apart <= epsilon:
            count, visits = query_seeds(pools, pair, min(wanted, limit), near, budget, sink, scratch)
            if count == min(wanted, limit) or (budget and visits >= budget):
                return count, apart + slack, visits, COMPLETE if count == wanted else BY_LIMIT, 0.0
    parted, beyond_b, beyond_a = 0.0, NO_PLANE, NO_PLANE
    if apart > near and has_faces(fragment.kind[a]) and has_faces(fragment.kind[b]):
        parted, beyond_b, beyond_a = _planes_between(pools, pair, near, slack)
        if parted > 0.0:
            return 0, slack, visits, COMPLETE, parted
    node, node_point = scratch.node_int, scratch.node_float
    queue = scratch.queue
    spare = scratch.places
    current, following = 0, 1
    nodes, size = 0, 0
    count = 0
    bound = dropped = 0.0
    deeper_by = 0.0  # by which a sample may be deeper than its contact: 0 with the exact field
    exhausted = COMPLETE
    for side in range(2):
        own, other = (a, b) if side == 0 else (b, a)
        if fragment.kind[own] == SPHERE:
            if side == 0 or fragment.kind[other] != SPHERE:
                most_within = max(further, LEAST_WITHIN)
                count, bound, left_out = sphere_contacts(pools, pair, side, rule, most_within, sink, scratch)
                exhausted = BY_LIMIT if left_out else COMPLETE
        elif fragment.kind[other] != SPHERE and fragment.tree_end[own] > fragment.tree_begin[own]:
            root = fragment.tree_begin[own]
            c = tree.spheres[root]
            x, y, z = to_other(rotation[side], translation[side], c[0], c[1], c[2])
            depth = most_depth(pools, other, x, y, z, beyond_b if side == 0 else beyond_a)
            _reach_node(node, node_point, nodes, (root, side, UNTESTED), (x, y, z), depth)
            queue[current, size] = nodes
            nodes += 1
            size += 1
    m = max(wanted, count)
    cut = COMPLETE
    while size and cut == COMPLETE:
        next_size = 0
        head = 0
        while head < size:
            # testing a node and rejecting its first child are two visits
            if budget and visits + 2 > max(budget, 2):
                cut = BY_LIMIT
                break
            if count >= wanted:
                if further <= 0:
                    cut = BY_FURTHER
                    break
                further -= 1
            k = queue[current, head]
            entry, side = node[k, ENTRY], node[k, SIDE]
            other = b if side == 0 else a
            x, y, z = node_point[k, 0], node_point[k, 1], node_point[k, 2]  # its first child may be the same point
            end = entry + tree.entries[entry, SIZE]
            if node[k, NEXT_CHILD] < 0:
                # first time on this level: test
                radius = tree.spheres[entry, 3]
                moved = moved_since(tree.spheres[entry], x, y, z) if one_body else math.inf
                visits += 1
                status = node[k, STATUS]
                if status == UNTESTED:
                    status = OUTSIDE
                    if tree.entries[entry, SURFACE] != OWN_SAMPLE:
                        # an interior node is no contact, and whether it is inside would cull nothing
                        node_point[k, DEPTH] = min(node_point[k, DEPTH], depth_limit(pools, other))
                    elif moved <= epsilon and count >= m:
                        status = UNKNOWN
                        node_point[k, DEPTH] = min(node_point[k, DEPTH], moved)
                        bound = max(bound, node_point[k, DEPTH])
                    elif -node_point[k, DEPTH] <= near:
                        full, leaf = count < m, end == entry + 1
                        number = np.int64(tree.entries[entry, SAMPLE])
                        start = np.int64(home_tetrahedron(pools, other, number) if one_body else -1)
                        sample = Placed(number, x, y, z, start, moved, moved + slack)
                        deep = math.inf if full or one_body else epsilon
                        # with m contacts, a sample outside counts only for the branch below it, however near
                        outside = 0.0 if leaf and not full else near
                        answer = ask_sample(pools, other, sample, outside, deep, leaf, scratch)
                        if answer.distance == -math.inf:
                            answer = ask_sample(pools, other, sample, outside, math.inf, True, scratch)
                        status, most = answer.status, answer.most_depth
                        if status != OUTSIDE:
                            if full or -answer.distance > epsilon:
                                if count < min(capacity, limit):
                                    put_contact(sink, count, np.int64(side), number, (x, y, z), answer)
                                elif capacity >= limit:
                                    if count == limit:
                                        make_heap(contacts, ids, limit)
                                    put_contact(spare, 0, np.int64(side), number, (x, y, z), answer)
                                    lost = keep_if_deeper(contacts, ids, limit, spare.contacts[0], spare.ids[0])
                                    dropped = max(dropped, lost)
                                deeper_by = max(deeper_by, min(most, sample.deep) + answer.distance)
                                count += 1
                                m = max(m, count)
                            else:
                                bound = max(bound, min(most, sample.deep))
                        node_point[k, DEPTH] = min(most, depth_limit(pools, other))
                    node[k, STATUS] = status
                head += 1
                if end == entry + 1:
                    continue
                depth = node_point[k, DEPTH]
                least = -near if count < m else epsilon
                moved = moved + turned * radius if count >= m else math.inf
                if status == INSIDE:
                    enter = depth + radius > least
                else:
                    around = radius - least
                    if tree.entries[entry, SURFACE] != OWN_SAMPLE or status == UNKNOWN:
                        # an untested node may be deep inside, however small its sphere
                        around = max(around, 0.0)
                    enter = around >= -depth and around >= 0.0 and moved > least
                    if enter and count >= m:
                        # with fewer, this is the sphere test that the node passed when it was reached
                        enter = sphere_test(pools, other, -depth, x, y, z, around, scratch)
                if not enter or moved <= least:
                    # inside: 1-Lipschitz; outside: the test shows that no point below is deeper than `least`
                    bound = max(bound, min(depth + radius, moved, max(least, 0.0)))
                    continue
                child = entry + 1
            else:
                head += 1
                child = node[k, NEXT_CHILD]
            child_size = tree.entries[child, SIZE]
            if child + child_size < end:
                node[k, NEXT_CHILD] = child + child_size
                if pools.traversal == QUEUE:
                    head -= 1
                else:
                    queue[current, size] = k
                    size += 1
            else:
                node[k, NEXT_CHILD] = end
            if tree.entries[child, SURFACE] == NONE_BELOW:
                continue
            c = tree.spheres[child]
            status, depth = UNTESTED, math.inf
            if tree.entries[child, SAMPLE] == tree.entries[entry, SAMPLE]:
                if child_size == 1:
                    continue
                status, depth = node[k, STATUS], node_point[k, DEPTH]
            else:
                x, y, z = to_other(rotation[side], translation[side], c[0], c[1], c[2])
                depth = most_depth(pools, other, x, y, z, beyond_b if side == 0 else beyond_a)
            # on a rigid mesh, the sphere test of a lone sample does the same work as its probe
            asked = status != INSIDE and (child_size > 1 or fragment.kind[other] != TRIANGLES)
            around = c[3] + near if count < m else c[3]  # with m contacts, only samples inside count
            if asked and not sphere_test(pools, other, -depth, x, y, z, around, scratch):
                visits += 1
                continue
            _reach_node(node, node_point, nodes, (child, side, status), (x, y, z), depth)
            queue[following, next_size] = nodes
            nodes += 1
            next_size += 1
        if cut != COMPLETE:
            exhausted = cut
            rest = one_body, turned, a, b
            bound = max(bound, _bound_of_rest(pools, rest, node, node_point, queue, current, head, size))
            bound = max(bound, _bound_of_rest(pools, rest, node, node_point, queue, following, 0, next_size))
        current, following = following, current
        size = next_size
    if count > limit:
        if capacity >= limit:
            sort_heap(contacts, ids, limit)
        return limit, max(bound, dropped + deeper_by) + slack, visits, max(exhausted, BY_LIMIT), 0.0
    if count < m:
        sort_by_sample(contacts, ids, min(count, capacity))
    return count, bound + slack, visits, exhausted, 0.0


@inlined_kernel
def _clearance_of_boxes(pools, pair, enough):
    """oriented_boxes.box_clearance [m] of a Pair; minus infinity: one is a plane."""
    a, b, rotation, translation = pair
    if not (is_bounded(pools.fragment.kind[a]) and is_bounded(pools.fragment.kind[b])):
        return -math.inf
    return box_clearance(pools.fragment.box[a], pools.fragment.box[b], rotation[0], translation[0], enough)


@inlined_kernel
def _planes_between(pools, pair, near, slack):
    """Distance of the hulls of a Pair beyond `near` and the rounding `slack` [m], and planes that bound the hulls.

    Returns (distance [m], 0: none; a plane that all of b is behind, in b's frame; likewise for a, in a's frame), planes
    as in Approach.
    """
    a, b, rotation, translation = pair
    way = way_between(pools.fragment.box[a], pools.fragment.box[b], rotation[0], translation[0])
    x, y, z, low, high = parting_plane(hull_of(pools, a), hull_of(pools, b), way, rotation, translation, near + slack)
    if low - high > near + slack:
        return low - high - near - slack, NO_PLANE, NO_PLANE
    t = translation[0]
    beyond_b = x, y, z, high + slack
    x, y, z = rotated(rotation[1], -x, -y, -z)
    return 0.0, beyond_b, (x, y, z, beyond_b[0] * t[0] + beyond_b[1] * t[1] + beyond_b[2] * t[2] - low + slack)


@inlined_kernel
def _reach_node(node, node_point, k, reached, point, depth):
    """Write row k of the queues' nodes; reached: its tree entry, side and status; point, depth: see DEPTH."""
    entry, side, status = reached
    node[k, ENTRY], node[k, SIDE], node[k, NEXT_CHILD], node[k, STATUS] = entry, side, -1, status
    node_point[k, 0], node_point[k, 1], node_point[k, 2], node_point[k, DEPTH] = point[0], point[1], point[2], depth


@inlined_kernel
def _bound_of_rest(pools, two, node, node_point, queue, which, begin, end):
    """Upper bound [m] of the depth of all samples below the nodes still queued when a budget ends.

    two: (whether a and b are of one body, spin between their frames, a, b); the nodes are entries begin .. end - 1 of
    queue[which].
    """
    one_body, turned, a, b = two
    bound = 0.0
    for i in range(begin, end):
        k = queue[which, i]
        other = b if node[k, SIDE] == 0 else a
        sphere, p = pools.tree.spheres[node[k, ENTRY]], node_point[k]
        depth = p[DEPTH] + sphere[3]
        if one_body:
            depth = min(depth, moved_since(sphere, p[0], p[1], p[2]) + turned * sphere[3])
        bound = max(bound, min(depth, depth_limit(pools, other)))
    return bound
