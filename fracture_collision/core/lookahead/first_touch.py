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
from typing import NamedTuple

from fracture_collision.core.contacts.facing_normal import turn_contacts
from fracture_collision.core.contacts.known_samples import rounding_slack
from fracture_collision.core.contacts.sphere_contacts import sphere_contacts
from fracture_collision.core.edges.ridge_contacts import least_apart
from fracture_collision.core.field.elementary_queries import INSIDE, bounded_probe
from fracture_collision.core.lookahead.later_contacts import bring_back, gap_then, keep_new, put_poses
from fracture_collision.core.lookahead.motion import closing_along, closing_speed, put_way
from fracture_collision.core.lookahead.staying_apart import (
    THIN,
    gap_of_hulls,
    has_plane,
    least_gap_ahead,
    thickness,
)
from fracture_collision.core.memory.compiled import query_kernel
from fracture_collision.core.memory.kinds import SPHERE
from fracture_collision.core.memory.pair import Sink
from fracture_collision.core.memory.rotations import rotated
from fracture_collision.core.search.neighbour_lists import MOST_AHEAD, NEAR_LAST, UNTIL, Listing, least_left
from fracture_collision.core.search.sample_search import may_search, query_listed, search_samples
from fracture_collision.core.separation.approach import WAY

# Maximum number of moments evaluated. A pair uses them up where one fragment slides along a surface of the other: after
# the first FINE_MOMENTS, steps become so long that the rest suffices, and their length is reported.
MOST_MOMENTS, FINE_MOMENTS = 2400, 1200
# Where the distance allows no longer step, the pair closes by this many detection tolerances at a time: a point just
# outside one tolerance is then no deeper than one.
LEAST = 2.0
# And by at least this share of R, where the tolerance is zero.
SHORTEST = 1e-4
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
# If more than MOST_AHEAD samples are within reach, it is reduced by a factor, up to a number of times.
NARROWER, NARROWINGS = 0.25, 5
# The search stops where a contact found before would be as deep as this share of R, or as THIN. Ridges that cross no
# deeper before their ends are inside are left to the next query: there are many on smooth bodies.
HELD = 0.03
# Minimum step of pairs that touch already, as a share of the thinner one's thickness.
SHORTEST_OF_THIN = 0.1


class Listed(NamedTuple):
    """The list of a pair in scratch.ahead_samples, ahead_places and ahead_ridges at a moment."""

    samples: int  # -1: no list, or too many
    ridges: int
    lasts: float  # [m] motion along scratch.ahead_ways for which the list still holds


class Search(NamedTuple):
    """Limits of the search at one moment."""

    far: float  # [m] how far the two can still close
    reach: float  # [m] samples are listed up to it, 0: no list
    touches: bool  # some samples are near already, and only those that are not count


@query_kernel
def first_touch(pools, edges, pair, moving, since, rule, sink, scratch):
    """Contacts of the two fragments of a Moving at the first moment from a given one at which they are near, by a Rule.

    since: that moment [s], and how many contacts found before the Sink already holds: the new ones are written to the
    rows after them. With any, the search covers all further contacts that are apart now, and
    runs until earlier contacts hold the two: any of them, or only those found here if the moment is 0. Points are
    reported where they are now. pair: its relative poses are working space.

    Returns (new contacts, the moment [s], visits, distance [m] by which the two may have closed unobserved).
    """
    a, b, translation = pair.a, pair.b, pair.translation
    i, j, motion = moving.i, moving.j, moving.motion
    start, known = since
    contacts, ids = sink
    radius = min(pools.fragment.radius[a], pools.fragment.radius[b])
    of_world, place = scratch.world_rotation, scratch.world_position
    visits, t, listed, touches, unseen = 0, start, Listed(-1, 0, 0.0), known > 0, 0.0
    apart = True
    new, held_by = 0, 0 if start > 0.0 else known
    shortest = max(LEAST * rule.near, SHORTEST * radius)
    is_round, deep = pools.fragment.kind[a] == SPHERE or pools.fragment.kind[b] == SPHERE, math.inf
    if touches:
        thin = thickness(pools.fragment.box, a, b)
        deep = min(THIN * thin, HELD * radius)
        if not has_plane(pools, a, b):
            shortest = max(shortest, SHORTEST_OF_THIN * thin)
    left = motion.time - start
    speed = listed_speed = closing_speed(motion, i, j, start, left)
    reach = min(max(REACH * radius, REACH_ON_WAY * speed * left, REACH_IN_STEPS * shortest), FARTHEST_REACH * radius)
    if reach < 2.0 * shortest:
        reach = 0.0
    toward = scratch.ahead_toward
    toward[0] = toward[1] = toward[2] = 0.0
    for moment in range(MOST_MOMENTS):
        put_poses(moving, t, of_world, place, pair)
        far, step = speed * left, 0.0
        gap, nx, ny, nz = -math.inf, 0.0, 0.0, 0.0
        is_known = touches and moment == 0
        if (listed.samples < 0 or listed.lasts <= 0.0) and apart and not is_known:
            gap, nx, ny, nz = gap_of_hulls(pools, pair, far, toward, scratch)
        if gap > rule.near:
            x, y, z = rotated(of_world[1], nx, ny, nz)
            closing = min(closing_along(motion, i, j, t, left, x, y, z), speed)
            if gap + rule.epsilon > closing * left:
                return new, t, visits, unseen
            n, slack = (x, y, z), rounding_slack(pools, a, b, translation)
            least = least_gap_ahead(pools, pair, moving, t, gap, n, slack, scratch)
            if least > -rule.epsilon:
                return new, t, visits, unseen
            step, listed = (gap - rule.near) / closing, Listed(-1, listed.ridges, listed.lasts)
        elif is_known and reach == 0.0:
            pass  # no list is made
        else:
            apart = is_known
            if reach > 0.0 and (listed.samples < 0 or listed.lasts <= 0.0) and speed > 0.0:
                listed_speed, time = speed, min(TO_THE_END * far, reach) / speed
                put_way(motion, i, j, t, left, time, of_world[1], scratch.ahead_ways[0])
                put_way(motion, j, i, t, left, time, of_world[0], scratch.ahead_ways[1])
            at = known + new
            room = 0 if is_known else len(contacts) - at
            out = Sink(contacts[at : at + room], ids[at : at + room])
            search = Search(far, reach, touches)
            found, clear, listed, more = near_now(pools, edges, pair, rule, search, listed, out, scratch)
            visits += more
            if is_known:
                found = 0
            if found > room:
                return new + found, t, visits, unseen
            if found > 0:
                turn_contacts(pools, pair, rule.near, out, found, scratch)
                bring_back(pools, moving, of_world, pair, out, found)
                if not touches:
                    return found, t, visits, unseen
                new += keep_new(sink, at, found, rule.near)
            if new > 0:
                gap = gap_then(sink, held_by, known + new, moving, pair)
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
        listed = Listed(listed.samples, listed.ridges, listed.lasts - step * listed_speed)
        t = motion.time if step == left else t + step
        left = motion.time - t
        speed = closing_speed(motion, i, j, t, left)
    return new, t, visits, unseen


@query_kernel
def near_now(pools, edges, pair, rule, search, listed, sink, scratch):
    """Contacts of a Pair at its relative poses, by a Rule, written to a Sink.

    search: a Search; listed: Listed, which is used as long as it lasts, else made anew. Returns (contacts, lower bound
    [m] of the clearance beyond near, updated Listed, visits).
    """
    a, b, rotation, translation = pair
    far, touches = search.far, search.touches
    if not may_search(pools, a, b):
        clear = _clearance_of_sphere(pools, a, b, translation, rule.near, far, scratch)
        if clear > 0.0:
            return 0, clear, Listed(-1, 0, 0.0), 1
        found, _, _ = sphere_contacts(pools, pair, rule, sink, scratch)
        return found, 0.0, Listed(-1, 0, 0.0), 1
    radius = min(pools.fragment.radius[a], pools.fragment.radius[b])
    samples, places, ridges = scratch.ahead_samples, scratch.ahead_places, scratch.ahead_ridges
    ways, toward = scratch.ahead_ways, scratch.ahead_toward
    ahead = min(far, max(AHEAD * radius, AHEAD_ON_WAY * far))
    count, crossings, lasts = listed
    shallow = max(rule.epsilon, HELD * radius)
    if count >= 0 and lasts > 0.0:
        listing = Listing(0.0, ahead, ways, samples[:count], places[:count], ridges[:crossings], toward, shallow)
        searched = query_listed(pools, edges, pair, rule, listing, sink, scratch)
        found, visits = searched.count, searched.visits
    else:
        lasts, visits, found = min(TO_THE_END * far, search.reach), 0, 0
        for _ in range(NARROWINGS):
            listing = Listing(lasts, min(ahead, lasts), ways, samples, places, ridges, toward, shallow)
            searched = search_samples(pools, edges, pair, rule, listing, sink, scratch)
            found, count, crossings, clear = searched.count, searched.samples, searched.crossings, searched.clear
            visits += searched.visits
            if (count <= MOST_AHEAD and crossings <= MOST_AHEAD) or (found != 0 and not touches):
                break
            lasts *= NARROWER
            for side in range(2):
                for d in range(WAY):
                    ways[side, d] *= NARROWER
        if count > MOST_AHEAD or crossings > MOST_AHEAD or not lasts > 0.0:
            return found, 0.0, Listed(-1, 0, 0.0), visits
        if touches:
            count = _drop_near(samples, places, count)
        if count == 0 and crossings == 0:
            lasts = max(lasts, clear)
    middles = pools.fragment.middle
    left = least_left(samples, places, count, middles[a], middles[b], rotation, translation, touches)
    left = min(left, least_apart(edges, pair, ridges[:crossings], rule.near, touches, scratch))
    return found, min(lasts, left), Listed(count, crossings, lasts), visits


@query_kernel
def _drop_near(samples, places, count):
    """Remove those of `count` listed samples that were near; returns the number that remains."""
    kept = 0
    for k in range(count):
        if places[k, UNTIL] != NEAR_LAST:
            for d in range(samples.shape[1]):
                samples[kept, d] = samples[k, d]
            for d in range(places.shape[1]):
                places[kept, d] = places[k, d]
            kept += 1
    return kept


@query_kernel
def _clearance_of_sphere(pools, a, b, translation, near, far, scratch):
    """Lower bound [m] of the clearance beyond `near` between a sphere and another fragment, up to `far`; 0: none."""
    sphere, other, p = (a, b, translation[0]) if pools.fragment.kind[a] == SPHERE else (b, a, translation[1])
    around = pools.fragment.radius[sphere] + near
    answer = bounded_probe(pools, other, (p[0], p[1], p[2]), around + far, 0.0, -1, False, scratch)
    if answer.status == INSIDE:
        return 0.0
    return max(answer.distance - around, 0.0)
