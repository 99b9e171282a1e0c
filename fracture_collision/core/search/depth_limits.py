"""Bounds on the depth of points of a fragment in another, from boxes, planes and motion alone."""

from __future__ import annotations

import math

from fracture_collision.core.contacts.known_samples import rounding_slack, share_a_body
from fracture_collision.core.field.elementary_queries import least_distance
from fracture_collision.core.memory.compiled import query_kernel
from fracture_collision.core.memory.kinds import SPHERE, is_bounded
from fracture_collision.core.memory.rotations import to_other
from fracture_collision.core.search.neighbour_lists import IN_PLACE, displacement


@query_kernel
def depth_limit(pools, f):
    """No point of fragment f is deeper than half its box's shortest side [m]."""
    b = pools.fragment.box[f]
    return 0.5 * min(b[3] - b[0], b[4] - b[1], b[5] - b[2])


@query_kernel
def depth_limit_of_pair(pools, pair):
    """No point of either of a Pair is deeper in the other [m], whatever a search would find."""
    a, b, rotation, translation = pair
    limit = displacement(pools, pair, IN_PLACE) if share_a_body(pools, a, b) else math.inf
    deepest = 0.0
    for side in range(2):
        own, other = (a, b) if side == 0 else (b, a)
        if is_bounded(pools.fragment.kind[own]):
            box = pools.fragment.box[own]
            dx, dy, dz = box[3] - box[0], box[4] - box[1], box[5] - box[2]
            x, y, z = 0.5 * (box[0] + box[3]), 0.5 * (box[1] + box[4]), 0.5 * (box[2] + box[5])
            x, y, z = to_other(rotation[side], translation[side], x, y, z)
            within = 0.5 * math.sqrt(dx * dx + dy * dy + dz * dz) - least_distance(pools, other, x, y, z)
            beyond = pools.fragment.shape[own, 0] if pools.fragment.kind[own] == SPHERE else 0.0
            deepest = max(deepest, min(within, depth_limit(pools, other) + beyond))
    return min(limit, deepest) + rounding_slack(pools, a, b, translation)


@query_kernel
def most_depth(pools, other, x, y, z, plane):
    """A cheap upper bound [m] of the depth of a point in `other`, which lies behind `plane`.

    plane: unit normal and offset [m], see Approach.
    """
    least = least_distance(pools, other, x, y, z)
    beyond = plane[0] * x + plane[1] * y + plane[2] * z - plane[3]
    return -max(least, beyond) if beyond > 0.0 else -least
