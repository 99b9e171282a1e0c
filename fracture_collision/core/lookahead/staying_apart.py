"""Tests that two moving fragments neither touch nor pass through each other before the time ahead is over.

Boxes and separating planes of hulls settle most pairs of a step here, without first_touch.py. The change of a gap along
a direction is bounded in two ways: by the closing speed along it, and by the gap at the end of the time, where the spin
bounds how far the points' paths deviate from straight lines in between.
"""

from __future__ import annotations

import math

from fracture_collision.core.contacts.known_samples import rounding_slack
from fracture_collision.core.lookahead.later_contacts import gap_then, put_poses
from fracture_collision.core.lookahead.motion import closing_along, closing_speed, put_pose, turned_in
from fracture_collision.core.memory.compiled import query_kernel
from fracture_collision.core.memory.kinds import PLANE, SPHERE, is_bounded
from fracture_collision.core.memory.rotations import rotated, turned_back
from fracture_collision.core.samples.sample_leaves import farthest_sample, leaves_of
from fracture_collision.core.separation.leaf_separation import MOST_STEPS, parting_plane_of_leaves

# A pair that closes by no more than this share of the thinner one's thickness does not pass through it.
THIN = 0.2
# A pair with a gap below this share of R is about to touch: a solver treats it as touching.
ABOUT_TO = 0.1
# What touches a plane touches it elsewhere if it goes deeper there by more than this times as deep as where it touches.
SINKS = 2.0


@query_kernel
def boxes_stay_apart(pools, pair, moving, near):
    """Whether two boxes stay more than `near` [m] apart along one of their axes.

    near: negative: they penetrate no deeper than that. pair: with relative poses now; moving: a Moving.
    """
    a, b, rotation, translation = pair
    i, j, rotations, _, motion = moving
    if not (is_bounded(pools.fragment.kind[a]) and is_bounded(pools.fragment.kind[b])):
        return False
    near += rounding_slack(pools, a, b, translation)
    for side in range(2):
        own, other, k = (a, b, i) if side == 0 else (b, a, j)
        mine, box, turn, place = pools.fragment.box[own], pools.fragment.box[other], rotation[1 - side], translation
        for d in range(3):
            # offset of the other's centre along axis d of own box, and both half extents
            along, reach = place[1 - side, d] - 0.5 * (mine[d] + mine[d + 3]), 0.5 * (mine[d + 3] - mine[d])
            for q in range(3):
                along += turn[d, q] * 0.5 * (box[q] + box[q + 3])
                reach += abs(turn[d, q]) * 0.5 * (box[q + 3] - box[q])
            gap = abs(along) - reach
            if not gap > near:
                continue
            # from b to a
            sign = 1.0 if (along < 0.0) == (side == 0) else -1.0
            x, y, z = sign * rotations[k, 0, d], sign * rotations[k, 1, d], sign * rotations[k, 2, d]
            if gap - near > closing_along(motion, i, j, 0.0, motion.time, x, y, z) * motion.time:
                return True
    return False


@query_kernel
def hulls_stay_apart(pools, pair, moving, near, toward, scratch):
    """Whether two hulls stay more than `near` [m] apart along a direction.

    near: negative: they penetrate no deeper than that. The direction is `toward` (3,) in b's frame or, where that is
    zero, the line between box centres. pair: with relative poses now; moving: a Moving. A cheap test before
    first_touch: any direction is valid, and a pair it settles is never near.
    """
    a, b, _, translation = pair
    i, j, rotations, _, motion = moving
    gap, x, y, z = gap_of_hulls(pools, pair, 0.0, toward, scratch, 1)
    if not gap > near:
        return False
    n = rotated(rotations[j], x, y, z)
    if gap - near > closing_along(motion, i, j, 0.0, motion.time, n[0], n[1], n[2]) * motion.time:
        return True
    slack = rounding_slack(pools, a, b, translation)
    return least_gap_ahead(pools, pair, moving, 0.0, gap, n, slack, scratch) > near


@query_kernel
def may_touch_again(pools, pair, moving, moment, sink, epsilon, scratch):
    """Whether two fragments that touch, or are about to, may touch elsewhere before the time is over.

    Nothing goes right through a plane, but what touches it may swing into it: there, whatever would be deeper by more
    than epsilon [m] and SINKS counts. Of others, only those that may pass through each other do.

    pair: with relative poses at `moment` [s], changed; moving: a Moving; sink: their contacts at that moment.
    """
    a, b, _, translation = pair
    i, j, rotations, _, motion = moving
    least = ABOUT_TO * min(pools.fragment.radius[a], pools.fragment.radius[b])
    least_gap = math.inf
    for c in range(len(sink.contacts)):
        least_gap = min(least_gap, sink.contacts[c, 9])
    # a pair that already penetrates deeper than that may be anywhere
    thin, is_plane = THIN * thickness(pools.fragment.box, a, b), has_plane(pools, a, b)
    allowed = min(thin, epsilon) if is_plane else thin
    if least_gap > least or -least_gap > thin:
        return False
    if closing_speed(motion, i, j, 0.0, motion.time) * motion.time <= allowed:
        return False
    # most pairs slide along their separating plane, or separate
    toward = scratch.ahead_toward
    toward[0] = toward[1] = toward[2] = 0.0
    gap, x, y, z = gap_of_hulls(pools, pair, 0.0, toward, scratch)
    if gap < -thin:
        return True
    of_b = rotations[j] if moment == 0.0 else scratch.world_rotation[1]
    n = rotated(of_b, x, y, z)
    left = motion.time - moment
    if max(closing_along(motion, i, j, moment, left, n[0], n[1], n[2]), 0.0) * left - gap <= allowed:
        return False
    slack = rounding_slack(pools, a, b, translation)
    ahead = least_gap_ahead(pools, pair, moving, moment, gap, n, slack, scratch)
    if is_plane and ahead < -allowed:
        put_poses(moving, motion.time, scratch.world_rotation, scratch.world_position, pair)
        # what rests sinks by its weight alone, everywhere
        return ahead < SINKS * min(gap_then(sink, 0, len(sink.contacts), moving, pair), 0.0) - allowed
    return ahead < -allowed


@query_kernel
def has_plane(pools, a, b):
    """Whether one of two fragments is a plane."""
    return pools.fragment.kind[a] == PLANE or pools.fragment.kind[b] == PLANE


@query_kernel
def thickness(boxes, a, b):
    """Thickness [m] of the thinner of two: the shortest side of its box."""
    least = math.inf
    for f in (a, b):
        box = boxes[f]
        least = min(least, box[3] - box[0], box[4] - box[1], box[5] - box[2])
    return least


@query_kernel
def gap_of_hulls(pools, pair, enough, toward, scratch, most_steps=MOST_STEPS):
    """Lower bound [m] of the distance between the hulls of a Pair, and its direction.

    enough [m]: the search stops once the distance exceeds it; toward, most_steps: see leaf_separation. Returns (gap
    [m], x, y, z), the direction from b to a in b's frame; minus infinity: spheres, and fragments without samples, are
    not handled.
    """
    a, b, rotation, translation = pair
    kind_a, kind_b = pools.fragment.kind[a], pools.fragment.kind[b]
    if kind_a == SPHERE or kind_b == SPHERE:
        return -math.inf, 0.0, 0.0, 0.0
    slack = rounding_slack(pools, a, b, translation)
    if kind_a == PLANE or kind_b == PLANE:
        plane, other, side = (b, a, 0) if kind_b == PLANE else (a, b, 1)
        shape, t = pools.fragment.shape[plane], translation[side]
        x, y, z = rotated(rotation[1 - side], -shape[0], -shape[1], -shape[2])
        gap = shape[0] * t[0] + shape[1] * t[1] + shape[2] * t[2] - shape[3] - slack
        gap -= _reach_of_hull(pools, other, x, y, z, scratch.along)
        if side == 0:
            return gap, shape[0], shape[1], shape[2]
        return gap, x, y, z
    leaves = leaves_of(pools, a), leaves_of(pools, b)
    if len(leaves[0].entries) == 0 or len(leaves[1].entries) == 0:
        return -math.inf, 0.0, 0.0, 0.0
    rounding = slack + leaves[0].middle[3] + leaves[1].middle[3]
    n, low, high = parting_plane_of_leaves(pools, pair, leaves, enough + rounding, toward, scratch.along, most_steps)
    return low - high - rounding, n[0], n[1], n[2]


@query_kernel
def _reach_of_hull(pools, f, x, y, z, bounds):
    """Upper bound [m] of a fragment's extent along a unit vector (x, y, z) of its frame; bounds: working space."""
    leaves = leaves_of(pools, f)
    m = leaves.middle
    _, reach = farthest_sample(leaves, (x, y, z), 0, bounds)
    return reach + m[3] + x * m[0] + y * m[1] + z * m[2]


@query_kernel
def least_gap_ahead(pools, pair, moving, t, gap, n, slack, scratch):
    """Lower bound [m] of the gap between two hulls along a direction, from `t` [s] to the end of the time.

    pair: a Pair; moving: a Moving; gap [m]: the gap at t; n: world unit vector from b to a; slack [m]: rounding of
    poses.
    """
    a, b, _, _ = pair
    i, j, rotations, positions, motion = moving
    left = motion.time - t
    at_end, bend = -slack, 0.0
    for side in range(2):
        f, k, sign = (a, i, -1.0) if side == 0 else (b, j, 1.0)
        turn, place = scratch.world_rotation[2], scratch.world_position[2]
        put_pose(motion, rotations, positions, k, motion.time, turn, place)
        # a point's acceleration is at most its distance from the axis times the square of the spin
        spin = turned_in(motion, k, left)
        bend += 0.5 * spin * spin * motion.reach[k]
        at_end -= sign * (n[0] * place[0] + n[1] * place[1] + n[2] * place[2])
        x, y, z = turned_back(turn, sign * n[0], sign * n[1], sign * n[2])
        if not is_bounded(pools.fragment.kind[f]):  # it stands still, and n is its normal
            at_end -= pools.fragment.shape[f, 3]
            continue
        at_end -= _reach_of_hull(pools, f, x, y, z, scratch.along)
    # after a share s of the time left: gap + s (at_end - gap) - bend s (1 - s)
    change = at_end - gap
    if abs(change) >= bend:
        return min(gap, at_end)
    return gap - (bend - change) ** 2 / (4.0 * bend)
