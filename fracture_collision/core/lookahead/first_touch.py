"""Time of impact of two fragments that are apart and move at constant velocities, and their contacts at that moment.

Conservative advancement (Mirtich, "Impulse-based Dynamic Simulation of Rigid Body Systems", 1996): a pair cannot touch
before it has closed its distance, so that time is skipped and the distance computed again, until the two are within the
detection tolerance or the time ahead is over. The distance is that of the hulls along their separating plane, with the
closing speed bounded along its normal; where the hulls overlap, it is that of the samples. Contacts that no sample of
either meets are missed, as in a static query. Pairs that will penetrate no deeper than the penetration tolerance are
skipped, or dropped on the way: most slow pairs are.

The contacts are those of that moment. Their points are reported where they are now, on either fragment, with the normal
of that moment: the gap is the distance that the points still have to travel.

A pair that touches already, or is about to, may touch elsewhere before the time is over: a shard that hits with one
corner swings round. Fast and thin pairs are searched for this too, over samples that are not near yet, until a contact
found before would be so deep that the search stops (HELD).
"""

from __future__ import annotations

import math

from fracture_collision.core.contacts.facing_normal import turn_contacts
from fracture_collision.core.contacts.known_samples import ID_SAMPLE, ID_SIDE, rounding_slack
from fracture_collision.core.edges.ridge_contacts import least_apart
from fracture_collision.core.field.elementary_queries import INSIDE, bounded_probe
from fracture_collision.core.lookahead.motion import closing_along, closing_speed, put_pose, put_way
from fracture_collision.core.lookahead.staying_apart import THIN, gap_of_hulls, least_gap_ahead, thickness
from fracture_collision.core.memory.compiled import inlined_kernel, query_kernel
from fracture_collision.core.memory.kinds import SPHERE
from fracture_collision.core.memory.pools import FACING
from fracture_collision.core.memory.rotations import relative_pose, rotated, to_other, turned_back
from fracture_collision.core.search.neighbour_lists import MOST_AHEAD, NEAR_LAST, UNTIL, least_left
from fracture_collision.core.search.sample_search import may_search, query_listed, search_samples
from fracture_collision.core.search.traversal import query_pair
from fracture_collision.core.separation.approach import WAY

# Maximum number of moments evaluated. A pair uses them up where one fragment slides along a surface of the other: after
# the first FINE_MOMENTS, steps become so long that the rest suffices, and their length is reported.
MOST_MOMENTS, FINE_MOMENTS = 2400, 1200
# Where the distance allows no longer step, the pair closes by this many detection tolerances at a time: a point just
# outside one tolerance is then no deeper than one.
LEAST = 2.0
# And by at least this share of R, where the tolerance is zero.
SHORTEST = 1e-4
UNLIMITED = 1 << 40
# Sample distances are searched up to this share of R, or of the remaining path: searching farther costs more than a
# second query.
AHEAD, AHEAD_ON_WAY = 0.004, 0.05
# Samples are listed up to the largest of: a share of R, a share of the path, and a number of shortest steps. A search
# costs about ten queries of the list it makes.
REACH, REACH_ON_WAY, REACH_IN_STEPS = 0.05, 0.15, 4.0
# Upper limit of that reach, as a share of R: beyond it all samples are near. Where it is less than two steps, no list
# is made.
FARTHEST_REACH = 0.2
# A list for the whole remaining path reaches slightly farther, so that rounding does not end it before the time is
# over.
TO_THE_END = 1.001
# If more than MOST_AHEAD samples are within reach, it is reduced by this factor, at most so many times.
NARROWER, NARROWINGS = 0.25, 5
# The search stops where a contact found before would be as deep as this share of R, or as THIN.
HELD = 0.03
# Minimum step of pairs that touch already, as a share of the thinner one's thickness.
SHORTEST_OF_THIN = 0.1


@query_kernel
def first_touch(
    pools, edges, a, b, i, j, rotations, positions, motion, start, known, rule, contacts, ids, capacity, limit,
    rotation, translation, scratch, thread,
):  # fmt: skip
    """Contacts of fragments a and b, the i-th and j-th of `motion`, at the first moment after `start` [s] at which they
    are near. Points are reported where they are now, in rows after the `known` ones that contacts and ids already hold.
    With known > 0, the search covers all further contacts that are apart now, up to `limit` in all, and runs until
    earlier contacts hold the two: any of them, or only those found here if start is 0.

    rotations (n, 3, 3), positions (n, 3): current poses. rule, contacts, ids, capacity: see sample_search; rotation (2,
    3, 3), translation (2, 3): working space, as the relative poses.

    Returns (contacts, the moment [s], visits, distance [m] by which the two may have closed unobserved).
    """
    radius = min(pools.fragment.radius[a], pools.fragment.radius[b])
    of_world, place = scratch.world_rotation[thread], scratch.world_position[thread]
    visits, t, listed, ridges, lasts, touches, unseen = 0, start, -1, 0, 0.0, known > 0, 0.0
    apart = True
    new, held_by = 0, 0 if start > 0.0 else known
    shortest = max(LEAST * rule.near, SHORTEST * radius)
    is_round, deep = pools.fragment.kind[a] == SPHERE or pools.fragment.kind[b] == SPHERE, math.inf
    if touches:
        thin = thickness(pools.fragment.box, a, b)
        shortest, deep = max(shortest, SHORTEST_OF_THIN * thin), min(THIN * thin, HELD * radius)
    left = motion.time - start
    speed = listed_speed = closing_speed(motion, i, j, start, left)
    reach = min(max(REACH * radius, REACH_ON_WAY * speed * left, REACH_IN_STEPS * shortest), FARTHEST_REACH * radius)
    if reach < 2.0 * shortest:
        reach = 0.0
    toward = scratch.ahead_toward[thread]
    toward[0] = toward[1] = toward[2] = 0.0
    for moment in range(MOST_MOMENTS):
        if touches and known + new + max(rule.most, rule.wanted) > limit:
            break
        put_pose(motion, rotations, positions, i, t, of_world[0], place[0])
        put_pose(motion, rotations, positions, j, t, of_world[1], place[1])
        relative_pose(of_world[0], place[0], of_world[1], place[1], rotation[0], translation[0])
        relative_pose(of_world[1], place[1], of_world[0], place[0], rotation[1], translation[1])
        far, step = speed * left, 0.0
        gap, nx, ny, nz = -math.inf, 0.0, 0.0, 0.0
        is_known = touches and moment == 0
        if (listed < 0 or lasts <= 0.0) and apart and not is_known:
            gap, nx, ny, nz = gap_of_hulls(pools, a, b, rotation, translation, far, toward, scratch, thread)
        if gap > rule.near:
            x, y, z = rotated(of_world[1], nx, ny, nz)
            closing = min(closing_along(motion, i, j, t, left, x, y, z), speed)
            if gap + rule.epsilon > closing * left:
                return new, t, visits, unseen
            n, slack = (x, y, z), rounding_slack(pools, a, b, translation)
            least = least_gap_ahead(
                pools, a, b, i, j, rotations, positions, motion, t, gap, n, slack, scratch, thread
            )
            if least > -rule.epsilon:
                return new, t, visits, unseen
            step, listed = (gap - rule.near) / closing, -1
        elif is_known and reach == 0.0:
            pass  # no list is made
        else:
            apart = is_known
            if reach > 0.0 and (listed < 0 or lasts <= 0.0) and speed > 0.0:
                listed_speed, time = speed, min(TO_THE_END * far, reach) / speed
                put_way(motion, i, j, t, left, time, of_world[1], scratch.ahead_ways[thread, 0])
                put_way(motion, j, i, t, left, time, of_world[0], scratch.ahead_ways[thread, 1])
            room = 0 if is_known else capacity - known - new
            found, clear, listed, ridges, lasts, more = _near_now(
                pools, edges, a, b, rotation, translation, rule, far, radius, touches, reach, listed, ridges, lasts,
                contacts[known + new :], ids[known + new :], room, scratch, thread,
            )  # fmt: skip
            visits += more
            if is_known:
                found = 0
            if found > room:
                return new + found, t, visits, unseen
            if found > 0:
                out, out_ids = contacts[known + new :], ids[known + new :]
                if pools.normals == FACING:
                    turn_contacts(
                        pools, a, b, rotation, translation, rule.near, out, out_ids, found, scratch, thread
                    )
                _bring_back(rotations, positions, i, j, of_world, rotation, translation, out, out_ids, found)
                if not touches:
                    return found, t, visits, unseen
                new += _keep_new(contacts, ids, known + new, found, rule.near)
            if new > 0:
                held = contacts[held_by : known + new], ids[held_by : known + new]
                gap = _gap_then(*held, i, j, rotations, positions, rotation, translation)
                if is_round or gap < -deep:
                    return new, t, visits, unseen
            if clear + rule.near + rule.epsilon > far or not left > 0.0:
                return new, t, visits, unseen
            step = clear / speed
        if not speed > 0.0:
            return new, t, visits, unseen
        least = far / (MOST_MOMENTS - moment) if moment >= FINE_MOMENTS else 0.0
        if least > max(step * speed, shortest):
            unseen = max(unseen, least)
        step = min(max(step, max(shortest, least) / speed), left)
        lasts -= step * listed_speed
        t = motion.time if step == left else t + step
        left = motion.time - t
        speed = closing_speed(motion, i, j, t, left)
    return new, t, visits, unseen


@inlined_kernel
def _keep_new(contacts, ids, known, found, near):
    """Keep those of `found` contacts after the `known` ones that are apart now and not among them; returns how many."""
    kept = known
    for c in range(known, known + found):
        is_new = contacts[c, 9] > near
        for k in range(known):
            is_new &= ids[k, ID_SIDE] != ids[c, ID_SIDE] or ids[k, ID_SAMPLE] != ids[c, ID_SAMPLE]
        if is_new:
            for d in range(contacts.shape[1]):
                contacts[kept, d] = contacts[c, d]
            for d in range(ids.shape[1]):
                ids[kept, d] = ids[c, d]
            kept += 1
    return kept - known


@inlined_kernel
def _gap_then(contacts, ids, i, j, rotations, positions, rotation, translation):
    """The least gap [m] of contacts, given in current frames, at relative poses rotation (2, 3, 3), translation (2, 3);
    each along its normal, which turns with the fragment that does not own the sample.
    """
    least = math.inf
    for c in range(len(contacts)):
        side, row = ids[c, ID_SIDE], contacts[c]
        own, other = (i, j) if side == 0 else (j, i)
        x, y, z = to_other(rotations[other], positions[other], row[0], row[1], row[2])
        p = positions[own]
        x, y, z = turned_back(rotations[own], x - p[0], y - p[1], z - p[2])
        x, y, z = to_other(rotation[side], translation[side], x, y, z)
        least = min(least, row[6] * (x - row[3]) + row[7] * (y - row[4]) + row[8] * (z - row[5]))
    return least


@inlined_kernel
def _near_now(
    pools, edges, a, b, rotation, translation, rule, far, radius, touches, reach, count, crossings, lasts, contacts,
    ids, capacity, scratch, thread,
):  # fmt: skip
    """Contacts of a pair by a Rule at the given poses; `far` [m]: how far the two can still close. touches: some
    samples are near already, and only those that are not count; reach [m]: up to which samples are listed, 0: no list.

    Scratch lists `count` samples with their distances (-1: no list, or too many): all that can be near for another
    `lasts` [m] of motion along scratch.ahead_ways; likewise `crossings` pairs of ridges. Returns (contacts, lower bound
    [m] of the clearance beyond near, updated `count`, `crossings` and `lasts`, visits).
    """
    if not may_search(pools, a, b):
        clear = _clearance_of_sphere(pools, a, b, translation, rule.near, far, scratch, thread)
        if clear > 0.0:
            return 0, clear, -1, 0, 0.0, 1
        found, _, visits, _, clear = query_pair(
            pools, a, b, rotation, translation, rule.wanted, rule.epsilon, rule.near, 0, UNLIMITED, rule.most, contacts,
            ids, capacity, scratch, thread,
        )  # fmt: skip
        return found, clear, -1, 0, 0.0, visits
    listed, places, toward = scratch.ahead_listed[thread], scratch.ahead_places[thread], scratch.ahead_toward[thread]
    ways, ridges = scratch.ahead_ways[thread], scratch.ahead_ridges[thread]
    ahead = min(far, max(AHEAD * radius, AHEAD_ON_WAY * far))
    if count >= 0 and lasts > 0.0:
        found, _, visits = query_listed(
            pools, edges, a, b, rotation, translation, rule, ahead, listed[:count], places[:count], ridges[:crossings],
            contacts, ids, capacity, scratch, thread,
        )  # fmt: skip
    else:
        lasts, visits, found = min(TO_THE_END * far, reach), 0, 0
        for _ in range(NARROWINGS):
            found, _, more, count, crossings, clear = search_samples(
                pools, edges, a, b, rotation, translation, rule, lasts, ways, min(ahead, lasts), contacts, ids,
                capacity, listed, places, ridges, toward, scratch, thread,
            )  # fmt: skip
            visits += more
            if (count <= MOST_AHEAD and crossings <= MOST_AHEAD) or (found != 0 and not touches):
                break
            lasts *= NARROWER
            for side in range(2):
                for d in range(WAY):
                    ways[side, d] *= NARROWER
        if count > MOST_AHEAD or crossings > MOST_AHEAD or not lasts > 0.0:
            return found, 0.0, -1, 0, 0.0, visits
        if touches:
            count = _drop_near(listed, places, count)
        if count == 0 and crossings == 0:
            lasts = max(lasts, clear)
    middles = pools.fragment.middle
    left = least_left(listed, places, count, middles[a], middles[b], rotation, translation, touches)
    left = min(left, least_apart(edges, a, b, rotation, translation, ridges[:crossings], rule.near, touches, thread))
    return found, min(lasts, left), count, crossings, lasts, visits


@inlined_kernel
def _drop_near(listed, places, count):
    """Remove those of `count` listed samples that were near; returns how many remain."""
    kept = 0
    for k in range(count):
        if places[k, UNTIL] != NEAR_LAST:
            for d in range(listed.shape[1]):
                listed[kept, d] = listed[k, d]
            for d in range(places.shape[1]):
                places[kept, d] = places[k, d]
            kept += 1
    return kept


@inlined_kernel
def _clearance_of_sphere(pools, a, b, translation, near, far, scratch, thread):
    """Lower bound [m] of the clearance beyond `near` between a sphere and another fragment, up to `far`; 0: none."""
    sphere, other, p = (a, b, translation[0]) if pools.fragment.kind[a] == SPHERE else (b, a, translation[1])
    around = pools.fragment.radius[sphere] + near
    answer = bounded_probe(
        pools, other, p[0], p[1], p[2], around + far, 0.0, -1, False, scratch, thread
    )
    if answer[0] == INSIDE:
        return 0.0
    return max(answer[1] - around, 0.0)


@inlined_kernel
def _bring_back(rotations, positions, i, j, of_world, rotation, translation, contacts, ids, count):
    """Transform `count` contacts of a later moment of the i-th and j-th fragment, rows as query_pair's, to current
    frames.

    of_world (2, 3, 3), rotation (2, 3, 3), translation (2, 3): world rotations and relative poses at that moment.
    """
    for c in range(count):
        side, row = ids[c, ID_SIDE], contacts[c]
        own, other = (i, j) if side == 0 else (j, i)
        x, y, z = to_other(rotation[1 - side], translation[1 - side], row[0], row[1], row[2])
        x, y, z = to_other(rotations[own], positions[own], x, y, z)
        p, back = positions[other], rotations[other]
        row[0], row[1], row[2] = turned_back(back, x - p[0], y - p[1], z - p[2])
        x, y, z = rotated(of_world[1 - side], row[6], row[7], row[8])
        row[6], row[7], row[8] = turned_back(back, x, y, z)
        row[9] = row[6] * (row[0] - row[3]) + row[7] * (row[1] - row[4]) + row[8] * (row[2] - row[5])
