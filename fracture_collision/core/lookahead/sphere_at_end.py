"""Contacts of a sphere and another fragment by where they will be at the end of the time ahead.

The nearest point of a rim leans towards a sphere that comes along the surface beside it, and holds it up where nothing
is. At the end of the step the sphere is over that surface, or beyond the rim, and the direction there is that in which
the two really meet. It is taken if the sphere is outside along it now, and hardly inside then: else it starts on
another side, or may have passed through, and contacts of now and of the first touch hold.
"""

from __future__ import annotations

from fracture_collision.core.contacts.sphere_contacts import sphere_contacts
from fracture_collision.core.lookahead.later_contacts import put_poses
from fracture_collision.core.lookahead.motion import MOST_TURN, closing_speed, turned_in
from fracture_collision.core.memory.compiled import query_kernel
from fracture_collision.core.memory.kinds import PLANE, SPHERE
from fracture_collision.core.memory.pair import Sink
from fracture_collision.core.memory.vectors import dot, minus, scaled, vector, vector_at

# The sphere may be deeper now along a direction of the end, by this share of the detection tolerance: rounding.
DEEPER = 0.05
# A sphere that would be deeper at the end, by this share of its radius, may be nearest to another place than it enters.
DEEPEST = 0.05


@query_kernel
def sphere_at_end(pools, pair, moving, rule, count, sink, scratch):
    """Replace the `count` contacts of now in a Sink, of a Pair with a sphere, by those of the end of a Moving's time.

    Points are where they are now, directions as if fixed to the other; gaps along these. pair: its relative poses are
    left as they were. Returns (contacts, more than the Sink has rows if it must be larger; whether they are the end's).
    """
    a, b, _, translation = pair
    number = 0 if pools.fragment.kind[a] == SPHERE else 1
    ball, other = (a, b) if number == 0 else (b, a)
    i, j, _, _, motion = moving
    of_other = j if number == 0 else i
    if pools.fragment.kind[other] == PLANE or turned_in(motion, of_other, motion.time) > MOST_TURN:
        return count, False
    if not closing_speed(motion, i, j, 0.0, motion.time) > 0.0:
        return count, False
    contacts, ids = sink
    least = 0.0
    for k in range(min(count, len(contacts))):
        least = min(least, contacts[k, 9])
    center = vector(translation, number)
    radius = pools.fragment.shape[ball, 0]
    put_poses(moving, motion.time, scratch.world_rotation, scratch.world_position, pair)
    out = Sink(contacts[count:], ids[count:])
    found, _, _ = sphere_contacts(pools, pair, rule, out, scratch)
    put_poses(moving, 0.0, scratch.world_rotation, scratch.world_position, pair)
    if count + found > len(contacts):
        return count + found, False
    kept = 0
    for k in range(count, count + found):
        if contacts[k, 9] < -DEEPEST * radius:
            return count, False
    for k in range(count, count + found):
        row = contacts[k]
        n = vector_at(row, 6)
        gap = dot(minus(center, vector_at(row, 3)), n) - radius
        if gap < least - DEEPER * rule.near:
            continue
        for d in range(ids.shape[1]):
            ids[kept, d] = ids[k, d]
        to = contacts[kept]
        to[0], to[1], to[2] = minus(center, scaled(radius, n))
        to[3], to[4], to[5] = minus(to, scaled(gap, n))
        to[6], to[7], to[8] = n
        to[9] = gap
        kept += 1
    if kept == 0:
        return count, False
    return kept, True
