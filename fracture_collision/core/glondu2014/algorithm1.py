"""Algorithm 1 of Glondu 2014 with self-adapting contact selection (section 5.2), both trees of a pair at once.

Two queues, swapped after each level; a node that has more children goes back into Q1 behind the others, so that
children of different parents are visited alternately (section 5.3); in the paper's earlier version [27] it stays at the
head of Q1 until all its children are in Q2. The search ends when Q2 is empty (the printed algorithm has the test
reversed). Both roots start in Q1, so the pair's contacts come from both sides level by level.

Up to m contacts within the detection tolerance are taken as they come; from then on only those deeper than epsilon, and
m grows by one with each. A branch is skipped when nothing below it can count. Skipped branches are bounded: depth is
1-Lipschitz, so no point of a sphere is deeper than the depth at its centre plus its radius.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from fracture_collision.core.contacts.known_samples import put_contact, rounding_slack
from fracture_collision.core.contacts.sphere_contacts import sphere_contacts
from fracture_collision.core.field.elementary_queries import INSIDE, OUTSIDE, least_distance, sphere_test
from fracture_collision.core.glondu2014.paper_pools import NONE_BELOW, OWN_SAMPLE, SAMPLE, SIZE, SURFACE
from fracture_collision.core.glondu2014.paper_probe import paper_probe
from fracture_collision.core.memory.compiled import query_kernel
from fracture_collision.core.memory.kinds import SPHERE, TRIANGLES, is_bounded
from fracture_collision.core.memory.rotations import to_other
from fracture_collision.core.search.depth_limits import depth_limit
from fracture_collision.core.separation.oriented_boxes import box_clearance

# columns of scratch.node_int, a row for each node in a queue
ENTRY, SIDE, NEXT_CHILD, STATUS = 0, 1, 2, 3
# columns of scratch.node_float: the node's point in the other's frame, then an upper bound of its depth
DEPTH = 3
UNTESTED = -1


class Selected(NamedTuple):
    """The contacts of a pair so far; m of the paper is the larger of this number and the contacts wanted."""

    count: int  # type: ignore[assignment]  # tuple's method
    bound: float  # [m] upper bound of the depth of everything left out


@query_kernel
def algorithm1(pools, paper, pair, rule, budget, sink, scratch):
    """All contacts of a Pair by a Rule, in the order of the search, written to a Sink as far as it has room.

    budget: nodes visited at most, 0: no limit. Returns (contacts, missed depth bound [m], visits, whether the budget
    ended the search). A child whose sphere is out of reach of the other counts as visited but is not queued.
    """
    entries, queue = paper.trees.entries, scratch.queue
    slack = rounding_slack(pools, pair.a, pair.b, pair.translation)
    if _boxes_are_apart(pools, pair, rule.near + slack):
        return 0, slack, 0, False
    found, is_cut = _spheres(pools, pair, rule, sink, scratch)
    nodes = size = _put_roots(pools, paper, pair, scratch)
    visits, current, following = 0, 0, 1
    while size and not is_cut:
        next_size, head = 0, 0
        while head < size:
            if budget and visits >= budget:
                is_cut = True
                break
            k = queue[current, head]
            head += 1
            entry, child = scratch.node_int[k, ENTRY], scratch.node_int[k, NEXT_CHILD]
            other = pair.b if scratch.node_int[k, SIDE] == 0 else pair.a
            if child < 0:
                # first time on this level
                visits += 1
                found = _test_point(pools, paper, other, k, rule, found, sink, scratch)
                least = -rule.near if found.count < rule.wanted else rule.epsilon
                if entries[entry, SIZE] == 1:
                    continue
                if not _may_count_below(pools, paper, other, k, least, found.count < rule.wanted, scratch):
                    below = scratch.node_float[k, DEPTH] + paper.trees.spheres[entry, 3]
                    found = Selected(found.count, max(found.bound, min(below, max(least, 0.0))))
                    continue
                child = entry + 1
            after = child + entries[child, SIZE]
            scratch.node_int[k, NEXT_CHILD] = after
            if after < entry + entries[entry, SIZE]:
                if paper.in_a_row:
                    head -= 1
                else:
                    queue[current, size] = k
                    size += 1
            if not _put_child(pools, paper, pair, k, child, nodes, scratch):
                continue
            if not _may_reach(pools, paper, other, nodes, rule.near if found.count < rule.wanted else 0.0, scratch):
                visits += 1
                continue
            queue[following, next_size] = nodes
            nodes, next_size = nodes + 1, next_size + 1
        if is_cut:
            rest = _bound_of_rest(pools, paper, pair, queue[current, head:size], scratch)
            rest = max(rest, _bound_of_rest(pools, paper, pair, queue[following, :next_size], scratch))
            found = Selected(found.count, max(found.bound, rest))
        current, following, size = following, current, next_size
    return found.count, found.bound + slack, visits, is_cut


@query_kernel
def _spheres(pools, pair, rule, sink, scratch):
    """(Selected, whether a limit left something out) of a Pair with a sphere: nothing, if it has none."""
    kinds = pools.fragment.kind
    if kinds[pair.a] != SPHERE and kinds[pair.b] != SPHERE:
        return Selected(0, 0.0), False
    count, bound, is_cut = sphere_contacts(pools, pair, rule, sink, scratch)
    return Selected(count, bound), is_cut


@query_kernel
def _put_roots(pools, paper, pair, scratch):
    """Put the roots of both trees into the first queue; returns their number, 0 if one of the two is a sphere."""
    nodes, trees, kinds = 0, paper.trees, pools.fragment.kind
    for side in range(2):
        own, other = (pair.a, pair.b) if side == 0 else (pair.b, pair.a)
        if kinds[own] != SPHERE and kinds[other] != SPHERE and trees.ranges[own, 1] > trees.ranges[own, 0]:
            _put_node(pools, paper, pair, (trees.ranges[own, 0], side), nodes, scratch)
            scratch.queue[0, nodes] = nodes
            nodes += 1
    return nodes


@query_kernel
def _put_node(pools, paper, pair, reached, k, scratch):
    """Write node k for a tree entry and side that has not been tested."""
    entry, side = reached
    node, place, c = scratch.node_int[k], scratch.node_float[k], paper.trees.spheres[entry]
    node[ENTRY], node[SIDE], node[NEXT_CHILD], node[STATUS] = entry, side, -1, UNTESTED
    x, y, z = to_other(pair.rotation[side], pair.translation[side], c[0], c[1], c[2])
    place[0], place[1], place[2] = x, y, z
    place[DEPTH] = -least_distance(pools, pair.b if side == 0 else pair.a, x, y, z)


@query_kernel
def _put_child(pools, paper, pair, parent, child, k, scratch):
    """Write node k for a `child`, a tree entry, of node `parent`; returns whether there is anything to visit."""
    entries, node = paper.trees.entries, scratch.node_int[parent]
    if entries[child, SURFACE] == NONE_BELOW:
        return False
    if entries[child, SAMPLE] != entries[node[ENTRY], SAMPLE]:
        _put_node(pools, paper, pair, (child, node[SIDE]), k, scratch)
        return True
    # the same point, one level down
    to, place, of = scratch.node_int[k], scratch.node_float[k], scratch.node_float[parent]
    to[ENTRY], to[SIDE], to[NEXT_CHILD], to[STATUS] = child, node[SIDE], -1, node[STATUS]
    for c in range(4):
        place[c] = of[c]
    return entries[child, SIZE] > 1


@query_kernel
def _boxes_are_apart(pools, pair, near):
    """Whether the boxes of a Pair are more than `near` [m] apart; never those of planes."""
    a, b, rotation, translation = pair
    if not (is_bounded(pools.fragment.kind[a]) and is_bounded(pools.fragment.kind[b])):
        return False
    return box_clearance(pools.fragment.box[a], pools.fragment.box[b], rotation[0], translation[0], near) > near


@query_kernel
def _test_point(pools, paper, other, k, rule, found, sink, scratch):
    """Test the point of node k in `other` and take it as a contact if it counts; returns the new Selected."""
    node, p = scratch.node_int[k], scratch.node_float[k]
    if node[STATUS] != UNTESTED:
        return found
    node[STATUS] = OUTSIDE
    most = p[DEPTH]
    p[DEPTH] = min(most, depth_limit(pools, other))
    # an interior node is no contact, and whether it is inside would cull nothing
    if paper.trees.entries[node[ENTRY], SURFACE] != OWN_SAMPLE or -most > rule.near:
        return found
    point = p[0], p[1], p[2]
    answer = paper_probe(pools, paper, other, point, rule.near, math.inf, scratch)
    node[STATUS], p[DEPTH] = answer.status, min(answer.most_depth, depth_limit(pools, other))
    if answer.status == OUTSIDE:
        return found
    if found.count >= rule.wanted and -answer.distance <= rule.epsilon:
        return Selected(found.count, max(found.bound, answer.most_depth))
    if found.count < len(sink.contacts):
        number = paper.trees.entries[node[ENTRY], SAMPLE]
        put_contact(sink, found.count, node[SIDE], number, point, answer)
    return Selected(found.count + 1, found.bound)


@query_kernel
def _may_count_below(pools, paper, other, k, least, was_tested, scratch):
    """Whether a point below node k may be deeper in `other` than `least` [m], minus a distance outside.

    was_tested: _may_reach has just shown it of the whole sphere.
    """
    entry, p = scratch.node_int[k, ENTRY], scratch.node_float[k]
    radius = paper.trees.spheres[entry, 3]
    if scratch.node_int[k, STATUS] == INSIDE:
        return p[DEPTH] + radius > least
    around = radius - least
    if paper.trees.entries[entry, SURFACE] != OWN_SAMPLE:
        # an untested node may be deep inside, however small its sphere
        around = max(around, 0.0)
    if not (around >= -p[DEPTH] and around >= 0.0):
        return False
    return was_tested or sphere_test(pools, other, -p[DEPTH], p[0], p[1], p[2], around, scratch)


@query_kernel
def _may_reach(pools, paper, other, k, near, scratch):
    """Whether the sphere of node k may be within `near` [m] of `other`."""
    node, p = scratch.node_int[k], scratch.node_float[k]
    entry = node[ENTRY]
    # on a rigid mesh, the sphere test of a lone sample does the same work as its probe
    if node[STATUS] == INSIDE or (
        paper.trees.entries[entry, SIZE] == 1 and pools.fragment.kind[other] == TRIANGLES
    ):
        return True
    return sphere_test(pools, other, -p[DEPTH], p[0], p[1], p[2], paper.trees.spheres[entry, 3] + near, scratch)


@query_kernel
def _bound_of_rest(pools, paper, pair, queued, scratch):
    """Upper bound [m] of the depth of all samples at and below the `queued` nodes (n,)."""
    bound = 0.0
    for k in queued:
        other = pair.b if scratch.node_int[k, SIDE] == 0 else pair.a
        depth = scratch.node_float[k, DEPTH] + paper.trees.spheres[scratch.node_int[k, ENTRY], 3]
        bound = max(bound, min(depth, depth_limit(pools, other)))
    return bound
