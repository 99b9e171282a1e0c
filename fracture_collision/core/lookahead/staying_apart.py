"""What two moving fragments cannot do before the time ahead is over: touch, or get through each other.

Most pairs of a step are settled here, by boxes and planes between hulls, and first_touch.py is not asked. How a gap
along a direction changes is bounded in two ways: by how fast points come nearer along it, and by the gap at the end of
the time: how far from straight the ways of points are in between is known from the spin.
"""

from __future__ import annotations

import math

from fracture_collision.core.contacts.known_samples import rounding_slack
from fracture_collision.core.lookahead.motion import closing_along, closing_speed, put_pose, turned_in
from fracture_collision.core.memory.compiled import inlined_kernel
from fracture_collision.core.memory.kinds import PLANE, SPHERE
from fracture_collision.core.memory.rotations import rotated, turned_back
from fracture_collision.core.separation.hull_separation import MOST_STEPS
from fracture_collision.core.separation.leaf_separation import parting_plane_of_leaves
from fracture_collision.core.tree.sample_leaves import farthest_sample, leaves_of

# A pair that comes nearer by no more than this share of what is thinner does not get through it.
THIN = 0.2
# A pair with so small a gap, as a share of R, is about to touch: to a solver it touches.
ABOUT_TO = 0.1


@inlined_kernel
def boxes_stay_apart(pools, a, b, i, j, rotation, translation, rotations, motion, near):
    """Whether two stay apart by more than `near` [m] along a side of either box; negative: no deeper than that in each
    other. rotation (2, 3, 3), translation (2, 3): their relative poses now; rotations (n, 3, 3): theirs in the world.
    """
    if pools.fragment.kind[a] == PLANE or pools.fragment.kind[b] == PLANE:
        return False
    near += rounding_slack(pools, a, b, translation)
    for side in range(2):
        own, other, k = (a, b, i) if side == 0 else (b, a, j)
        mine, box, turn, place = pools.fragment.box[own], pools.fragment.box[other], rotation[1 - side], translation
        for d in range(3):
            # the other's middle and reach along side d of own box
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


@inlined_kernel
def hulls_stay_apart(
    pools, a, b, i, j, rotation, translation, rotations, positions, motion, near, toward, scratch, thread
):  # fmt: skip
    """Likewise whether their hulls do along `toward` (3,), b's frame, or where there is none along the way between
    their boxes. A quick look before first_touch: it may be any direction, and what it settles is never near.
    """
    gap, x, y, z = gap_of_hulls(pools, a, b, rotation, translation, 0.0, toward, scratch, thread, 1)
    if not gap > near:
        return False
    n = rotated(rotations[j], x, y, z)
    if gap - near > closing_along(motion, i, j, 0.0, motion.time, n[0], n[1], n[2]) * motion.time:
        return True
    slack = rounding_slack(pools, a, b, translation)
    return least_gap_ahead(pools, a, b, i, j, rotations, positions, motion, 0.0, gap, n, slack, scratch, thread) > near


@inlined_kernel
def may_get_through(boxes, a, b, i, j, motion):
    """Whether fragments a and b, the i-th and j-th of `motion`, come nearer by more than a part of the thinner one;
    boxes (F, 6) [m]: of all.
    """
    return closing_speed(motion, i, j, 0.0, motion.time) * motion.time > THIN * thickness(boxes, a, b)


@inlined_kernel
def may_touch_again(
    pools, a, b, i, j, rotation, translation, rotations, positions, motion, moment, contacts, count, scratch, thread
):  # fmt: skip
    """Whether two that touch after `moment` [s], or are about to, by their `count` contacts, may be through each other
    elsewhere before the time is over. rotation, translation: their relative poses at that moment; rotations (n, 3, 3),
    positions (n, 3): theirs in the world now.
    """
    least = ABOUT_TO * min(pools.fragment.radius[a], pools.fragment.radius[b])
    least_gap = math.inf
    for c in range(count):
        least_gap = min(least_gap, contacts[c, 9])
    # who is in the other as deep as that already may be anywhere
    thin = THIN * thickness(pools.fragment.box, a, b)
    if least_gap > least or -least_gap > thin or not may_get_through(pools.fragment.box, a, b, i, j, motion):
        return False
    # most slide along what parts them, or part
    toward = scratch.ahead_toward[thread]
    toward[0] = toward[1] = toward[2] = 0.0
    gap, x, y, z = gap_of_hulls(pools, a, b, rotation, translation, 0.0, toward, scratch, thread)
    if gap < -thin:
        return True
    of_b = rotations[j] if moment == 0.0 else scratch.world_rotation[thread, 1]
    n = rotated(of_b, x, y, z)
    left = motion.time - moment
    if max(closing_along(motion, i, j, moment, left, n[0], n[1], n[2]), 0.0) * left - gap <= thin:
        return False
    slack = rounding_slack(pools, a, b, translation)
    return (
        least_gap_ahead(pools, a, b, i, j, rotations, positions, motion, moment, gap, n, slack, scratch, thread) < -thin
    )


@inlined_kernel
def thickness(boxes, a, b):
    """[m] of the thinner one's box."""
    least = math.inf
    for f in (a, b):
        box = boxes[f]
        least = min(least, box[3] - box[0], box[4] - box[1], box[5] - box[2])
    return least


@inlined_kernel
def gap_of_hulls(pools, a, b, rotation, translation, enough, toward, scratch, thread, most_steps=MOST_STEPS):
    """How far apart the hulls of two fragments are at least [m], `enough` is enough, and the direction from b to a
    along which they are (x, y, z), in b's frame; minus infinity: spheres are not looked at.

    toward, most_steps: see leaf_separation.
    """
    kind_a, kind_b = pools.fragment.kind[a], pools.fragment.kind[b]
    if kind_a == SPHERE or kind_b == SPHERE:
        return -math.inf, 0.0, 0.0, 0.0
    slack = rounding_slack(pools, a, b, translation)
    if kind_a == PLANE or kind_b == PLANE:
        plane, other, side = (b, a, 0) if kind_b == PLANE else (a, b, 1)
        shape, t = pools.fragment.shape[plane], translation[side]
        x, y, z = rotated(rotation[1 - side], -shape[0], -shape[1], -shape[2])
        gap = shape[0] * t[0] + shape[1] * t[1] + shape[2] * t[2] - shape[3] - slack
        gap -= _reach_of_hull(pools, other, x, y, z, scratch.along[thread])
        if side == 0:
            return gap, shape[0], shape[1], shape[2]
        return gap, x, y, z
    leaves = leaves_of(pools, a), leaves_of(pools, b)
    if len(leaves[0].entries) == 0 or len(leaves[1].entries) == 0:
        return -math.inf, 0.0, 0.0, 0.0
    rounding = slack + leaves[0].middle[3] + leaves[1].middle[3]
    n, low, high = parting_plane_of_leaves(
        pools, a, b, leaves, rotation, translation, enough + rounding, toward, scratch, thread, most_steps
    )
    return low - high - rounding, n[0], n[1], n[2]


@inlined_kernel
def _reach_of_hull(pools, f, x, y, z, bounds):
    """How far [m] a fragment reaches along a unit vector (x, y, z) of its frame, at most; bounds: working space."""
    leaves = leaves_of(pools, f)
    m = leaves.middle
    _, reach = farthest_sample(leaves, (x, y, z), 0, bounds)
    return reach + m[3] + x * m[0] + y * m[1] + z * m[2]


@inlined_kernel
def least_gap_ahead(pools, a, b, i, j, rotations, positions, motion, t, gap, n, slack, scratch, thread):
    """How far apart [m] two hulls are along n, a unit vector of the world from b to a, at least from `t` [s] on, when
    they are `gap` [m] apart along it, to the end of the time. slack [m]: rounding of poses.
    """
    left = motion.time - t
    at_end, bend = -slack, 0.0
    for side in range(2):
        f, k, sign = (a, i, -1.0) if side == 0 else (b, j, 1.0)
        turn, place = scratch.world_rotation[thread, 2], scratch.world_position[thread, 2]
        put_pose(motion, rotations, positions, k, motion.time, turn, place)
        # the second derivative of a point's way is no more than its distance from the axis times the square of the spin
        spin = turned_in(motion, k, left)
        bend += 0.5 * spin * spin * motion.reach[k]
        at_end -= sign * (n[0] * place[0] + n[1] * place[1] + n[2] * place[2])
        x, y, z = turned_back(turn, sign * n[0], sign * n[1], sign * n[2])
        if pools.fragment.kind[f] == PLANE:  # it stands still, and n is its normal
            at_end -= pools.fragment.shape[f, 3]
            continue
        at_end -= _reach_of_hull(pools, f, x, y, z, scratch.along[thread])
    # after a share s of the time left: gap + s (at_end - gap) - bend s (1 - s)
    change = at_end - gap
    if abs(change) >= bend:
        return min(gap, at_end)
    return gap - (bend - change) ** 2 / (4.0 * bend)
