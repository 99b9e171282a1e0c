"""Algorithm 1 of Glondu 2014 with self-adapting contact selection (section 5.2), both trees of a pair at once.

Two queues, swapped after each level; a node that has more children goes back into Q1 behind the others, so that
children of different parents are visited alternately (section 5.3). The search ends when Q2 is empty (the printed
algorithm has the test reversed). Both roots start in Q1, so the pair's contacts come from both sides level by level.

Up to m contacts within the detection tolerance are taken as they come; from then on only those deeper than epsilon,
and m grows by one with each. A branch is left when nothing below can count. What is left is bounded: depth is
1-Lipschitz, so no point of a sphere is deeper than the depth at its centre plus its radius.
"""

from __future__ import annotations

import math

import numpy as np

from fracture_collision.core.compiled import inlined_kernel, query_kernel
from fracture_collision.core.elementary_queries import INSIDE, OUTSIDE, least_distance, probe, sphere_test
from fracture_collision.core.kinds import SPHERE

# Rounding of coordinates near the scale of the fragment must not make a bound lie.
BOUND_SLACK = 1e-12

# queue_int columns
ENTRY, SIDE, NEXT_CHILD, STATUS = 0, 1, 2, 3
# queue_float columns: the node's point in the other's frame, then its depth bound (minus a distance outside)
DEPTH = 3


@inlined_kernel
def to_other(rotation, translation, x, y, z):
    """rotation (3, 3) applied, then translation (3,)."""
    return (
        rotation[0, 0] * x + rotation[0, 1] * y + rotation[0, 2] * z + translation[0],
        rotation[1, 0] * x + rotation[1, 1] * y + rotation[1, 2] * z + translation[1],
        rotation[2, 0] * x + rotation[2, 1] * y + rotation[2, 2] * z + translation[2],
    )


@inlined_kernel
def _depth_limit(pools, f):
    """No point of fragment f is deeper than half its box's shortest side [m]."""
    b = pools.fragment.box[f]
    return 0.5 * min(b[3] - b[0], b[4] - b[1], b[5] - b[2])


@inlined_kernel
def sphere_contact(pools, ball, other, x, y, z, near, contacts, ids, count, side, scratch, thread):
    """The one contact of an analytic sphere, centre (x, y, z) in the other's frame: its deepest point."""
    radius = pools.fragment.shape[ball, 0]
    status, d, nx, ny, nz, qx, qy, qz = probe(pools, other, x, y, z, radius + near, math.inf, scratch, thread)
    if status == OUTSIDE or d - radius > near:
        return count
    row = contacts[count]
    row[0], row[1], row[2] = x - radius * nx, y - radius * ny, z - radius * nz
    row[3], row[4], row[5] = qx, qy, qz
    row[6], row[7], row[8] = nx, ny, nz
    row[9] = d - radius
    ids[count, 0], ids[count, 1] = side, -1
    return count + 1


@query_kernel
def query_pair(
    pools, a, b, rotation, translation, wanted, epsilon, near, budget, contacts, ids, capacity, scratch, thread
):
    """All contacts of fragments `a` and `b`.

    rotation (2, 3, 3), translation (2, 3): [0] from a's body frame to b's, [1] back. `wanted` m, `epsilon` and `near`
    [m], `budget` visits (0: none). Fills contacts (capacity, 10): sample point, witness on the other, the other's
    outward normal, all in the other's frame, gap [m]; ids (capacity, 2): side (0: a's sample in b), sample (-1: a
    sphere's own). Returns (contacts found, missed depth bound [m], visits, exhausted); more found than `capacity`
    means: call again with room.
    """
    tree = pools.tree
    queue_i, queue_f = scratch.queue_int[thread], scratch.queue_float[thread]
    current, following = 0, 1
    sizes0, sizes1 = 0, 0
    count = 0
    visits = 0
    bound = 0.0
    for side in range(2):
        own, other = (a, b) if side == 0 else (b, a)
        if pools.fragment.kind[own] == SPHERE:
            if side == 0 or pools.fragment.kind[other] != SPHERE:
                p = translation[side]
                count = sphere_contact(
                    pools, own, other, p[0], p[1], p[2], near, contacts, ids, count, side, scratch, thread
                )
        elif pools.fragment.tree_end[own] > pools.fragment.tree_begin[own]:
            queue_i[0, sizes0, ENTRY] = pools.fragment.tree_begin[own]
            queue_i[0, sizes0, SIDE] = side
            queue_i[0, sizes0, NEXT_CHILD] = -1
            queue_i[0, sizes0, STATUS] = -1
            queue_f[0, sizes0, DEPTH] = math.inf
            sizes0 += 1
    m = max(wanted, count)
    slack = BOUND_SLACK * min(pools.fragment.radius[a], pools.fragment.radius[b])
    exhausted = False
    size = sizes0
    while size and not exhausted:
        sizes1 = 0
        head = 0
        while head < size:
            item, point = queue_i[current, head], queue_f[current, head]
            head += 1
            entry, side = item[ENTRY], item[SIDE]
            other = b if side == 0 else a
            radius = tree.radius[entry]
            if item[NEXT_CHILD] < 0:
                # first time on this level: test
                if budget and visits >= budget:
                    exhausted = True
                    head -= 1
                    break
                visits += 1
                if item[STATUS] < 0:
                    c = tree.center[entry]
                    x, y, z = to_other(rotation[side], translation[side], c[0], c[1], c[2])
                    point[0], point[1], point[2] = x, y, z
                    if tree.on_surface[entry] == 0:
                        # an interior node is no contact; whether it is inside would cull nothing
                        d = least_distance(pools, other, x, y, z)
                        item[STATUS] = INSIDE if d == -math.inf else OUTSIDE
                    else:
                        full = count < m
                        status, d, nx, ny, nz, qx, qy, qz = probe(
                            pools, other, x, y, z, near, math.inf if full else epsilon, scratch, thread
                        )
                        if status == INSIDE and d == -math.inf:
                            status, d, nx, ny, nz, qx, qy, qz = probe(
                                pools, other, x, y, z, near, math.inf, scratch, thread
                            )
                        item[STATUS] = INSIDE if status == INSIDE else OUTSIDE
                        if status != OUTSIDE:
                            if full or -d > epsilon:
                                if count < capacity:
                                    row = contacts[count]
                                    row[0], row[1], row[2] = x, y, z
                                    row[3], row[4], row[5] = qx, qy, qz
                                    row[6], row[7], row[8] = nx, ny, nz
                                    row[9] = d
                                    ids[count, 0], ids[count, 1] = side, tree.sample[entry]
                                count += 1
                                m = max(m, count)
                            else:
                                bound = max(bound, -d)
                    point[DEPTH] = min(-d, _depth_limit(pools, other))
                if tree.size[entry] == 1:
                    continue
                depth = point[DEPTH]
                least = -near if count < m else epsilon
                reach = radius - least
                if item[STATUS] == INSIDE and tree.on_surface[entry] == 1:
                    enter = depth + radius > least
                else:
                    enter = reach > 0.0 and sphere_test(
                        pools, other, -depth, point[0], point[1], point[2], reach, scratch, thread
                    )
                if not enter:
                    # inside: 1-Lipschitz; outside: the test says no point below is deeper than `least`
                    bound = max(bound, min(depth + radius, max(least, 0.0)))
                    continue
                item[NEXT_CHILD] = entry + 1
            child = item[NEXT_CHILD]
            queue_i[following, sizes1, ENTRY] = child
            queue_i[following, sizes1, SIDE] = side
            queue_i[following, sizes1, NEXT_CHILD] = -1
            if tree.sample[child] == tree.sample[entry]:
                queue_i[following, sizes1, STATUS] = item[STATUS]
                for k in range(4):
                    queue_f[following, sizes1, k] = point[k]
            else:
                queue_i[following, sizes1, STATUS] = -1
                # what can be said of the child before its test, should the budget end
                queue_f[following, sizes1, DEPTH] = point[DEPTH] + radius - tree.radius[child]
            sizes1 += 1
            child += tree.size[child]
            if child < entry + tree.size[entry]:
                item[NEXT_CHILD] = child
                for k in range(4):
                    queue_i[current, size, k] = item[k]
                    queue_f[current, size, k] = point[k]
                size += 1
        if exhausted:
            for i in range(head, size):
                bound = max(bound, _left_bound(tree, queue_i[current, i, ENTRY], queue_f[current, i, DEPTH]))
            for i in range(sizes1):
                bound = max(bound, _left_bound(tree, queue_i[following, i, ENTRY], queue_f[following, i, DEPTH]))
            deepest = max(_depth_limit(pools, a), _depth_limit(pools, b))
            bound = min(bound, deepest)
        current, following = following, current
        size = sizes1
    return count, bound + slack, visits, exhausted


@inlined_kernel
def _left_bound(tree, entry, depth):
    return depth + tree.radius[entry]
