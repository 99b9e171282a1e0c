"""All samples of a pair that may touch, found among the leaves of both fragments at once.

The search computes a separating plane of the two hulls, or the nearest to one; tests all leaves (sample_leaves.py)
against the other's half-space and box; and queries the samples of the leaves that reach in. Which of them are listed:
contact_choice.py.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from fracture_collision.core.contacts.deep_choice import may_wait
from fracture_collision.core.contacts.known_samples import query_seeds, rounding_slack, share_a_body, side_of
from fracture_collision.core.edges.ridge_contacts import Separation, add_crossings, add_listed_crossings, have_ridges
from fracture_collision.core.field.clearance import BEYOND, UNKNOWN, clearance, may_be_clear, side_of_surface
from fracture_collision.core.fracture.crack_seeds import find_seeds
from fracture_collision.core.memory.compiled import query_kernel
from fracture_collision.core.memory.kinds import SPHERE, is_bounded
from fracture_collision.core.memory.rotations import rotated, to_other
from fracture_collision.core.samples.sample_leaves import leaves_of, sample_about_middle
from fracture_collision.core.search.candidates import (
    HOME,
    PLACE_OF,
    ask,
    choose_contacts,
    find_candidates,
    keep_for_later,
)
from fracture_collision.core.search.depth_limits import depth_limit
from fracture_collision.core.search.neighbour_lists import (
    IN_PLACE,
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
from fracture_collision.core.search.work_limit import LEAST
from fracture_collision.core.separation.leaf_separation import Approach, parting_plane_of_leaves
from fracture_collision.core.separation.oriented_boxes import box_clearance

# If a pair has moved by less than this share of R, the search for a sample starts where the sample was.
HOME_SHARE = 0.1
# No plane is known behind which all of a fragment is; see Approach.
NO_PLANE = (0.0, 0.0, 0.0, 0.0)


class Searched(NamedTuple):
    """What a search of a pair's samples found."""

    count: int  # type: ignore[assignment]  # contacts
    bound: float  # [m] missed depth bound
    visits: int  # leaves and samples looked at
    samples: int = 0  # within reach; more than a Listing has room for: the list is incomplete
    crossings: int = 0  # pairs of ridges likewise
    clear: float = 0.0  # [m] lower bound, beyond rounding, of the distance in excess of rule.near; 0: unknown


@query_kernel
def may_search(pools, a, b):
    """Whether `search_samples` supports a pair."""
    return pools.fragment.kind[a] != SPHERE and pools.fragment.kind[b] != SPHERE


@query_kernel
def begins_with_seeds(pools, pair, rule):
    """Whether the two are so near to where they broke that the crack's seeds are queried first (crack_seeds.py)."""
    a, b, _, _ = pair
    if not share_a_body(pools, a, b):
        return False
    begin, end = find_seeds(pools.fragment, pools.seeds, a, b)
    return end - begin >= rule.wanted and displacement(pools, pair, IN_PLACE) <= rule.epsilon


@query_kernel
def search_samples(pools, edges, pair, rule, listing, sink, scratch):
    """All contacts of a Pair without spheres, by a Rule, written to a Sink.

    listing: with listing.reach > 0, samples that may be within near + reach are listed, except samples that cannot come
    near by listing.ways. Crossings of ridges are found too (`edges`: Ridges), and pairs that may cross are listed.
    listing.toward is replaced by the direction found. Returns a Searched.
    """
    a, b, rotation, translation = pair
    fragment = pools.fragment
    slack = rounding_slack(pools, a, b, translation)
    one_body = share_a_body(pools, a, b)
    within, samples, visits, count, deep = rule.near + listing.reach, 0, 0, 0, 0
    bounded = is_bounded(fragment.kind[a]) and is_bounded(fragment.kind[b])
    if bounded:
        parted = box_clearance(fragment.box[a], fragment.box[b], rotation[0], translation[0], within + slack)
        if parted > within + slack:
            return Searched(0, slack, 0, 0, 0, parted - rule.near - slack)
    apart = displacement(pools, pair, IN_PLACE) if one_body else math.inf
    if apart <= rule.epsilon:
        count, visits = query_seeds(pools, pair, rule.wanted, rule.near, sink, scratch)
        if count == rule.wanted:
            return Searched(count, apart + slack, visits, len(listing.samples) + 1, 0, 0.0)
        count = 0
    leaves = leaves_of(pools, a), leaves_of(pools, b)
    beyond_b, beyond_a = NO_PLANE, NO_PLANE
    if bounded and apart > within and len(leaves[0].entries) and len(leaves[1].entries):
        rounding = slack + leaves[0].middle[3] + leaves[1].middle[3]
        gap, beyond_b, beyond_a = _planes_between(pools, pair, leaves, within, rounding, listing.toward, scratch)
        if gap > within + rounding:
            return Searched(0, slack, visits, 0, 0, gap - rule.near - rounding)
    unasked = 0.0
    is_home = apart < HOME_SHARE * pools.fragment.radius[a]
    candidates, ids_of = scratch.candidates, scratch.candidate_ids
    for number in range(2):
        side = side_of(pair, number, one_body, slack)
        other, mine = side.other, leaves[number]
        if len(mine.entries) == 0:
            continue
        approach = Approach(
            beyond_b if number == 0 else beyond_a, rule.near + slack, listing.reach, listing.ways[number]
        )
        first, m = fragment.sample_begin[side.own], mine.middle
        at, may_be = -1, may_be_clear(pools, other)
        frame = frame_between(m, leaves[1 - number].middle, side.rotation, side.translation)
        reached, asked = find_candidates(pools, pair, side, mine, approach, within, is_home, scratch)
        visits += reached + asked
        every = min(rule.every, max(asked // LEAST, 1))
        for turn in range(asked):
            if turn % every:
                unasked = max(unasked, min(candidates[turn, 3], depth_limit(pools, other)))
                continue
            x, y, z, depth = candidates[turn, 0], candidates[turn, 1], candidates[turn, 2], candidates[turn, 3]
            k = ids_of[turn, PLACE_OF]
            if is_home:
                at = ids_of[turn, HOME]
            entry = first + mine.entries[k]
            distance, is_near = 0.0, may_wait(pools, other, rule, deep)
            if is_near:
                where = UNKNOWN
                if may_be:
                    where, at = side_of_surface(pools, other, at, (x, y, z), rule.epsilon, slack + m[3])
                if where != BEYOND:
                    count = keep_for_later(pools, side, rule, entry, where, count, scratch)
            elif -depth > rule.near + listing.ahead:
                distance = -depth
            elif may_be:
                distance, at = clearance(pools, other, at, (x, y, z), rule.near + listing.ahead, slack + m[3], scratch)
            if distance == 0.0 and not is_near:
                distance, is_near = ask(pools, side, rule, entry, rule.near + listing.ahead, True, count, scratch)
                count, deep = count + is_near, deep + (distance < -rule.epsilon)
            if listing.reach > 0.0:
                if samples < len(listing.samples):
                    listing.samples[samples, WHO], listing.samples[samples, WHERE] = 2 * entry + number, at
                    place = listing.places[samples]
                    place[OWN], place[OWN + 1], place[OWN + 2] = sample_about_middle(mine, k)
                    seen = NEAR_LAST if is_near else distance - 4.0 * slack
                    see(place, side.rotation, frame, seen, rule.near)
                samples += 1
    crossings = 0
    if have_ridges(edges, a, b):
        separation = Separation(beyond_b, beyond_a, apart, slack)
        count, deep, crossings = add_crossings(
            pools, edges, pair, rule, listing, separation, (count, deep), scratch
        )
    chosen, bound = choose_contacts(pools, pair, rule, slack, (count, deep), sink, scratch)
    return Searched(chosen, max(bound, unasked), visits, samples, crossings, 0.0)


@query_kernel
def _planes_between(pools, pair, leaves, within, rounding, toward, scratch):
    """Distance of the hulls of a Pair, by its Leaves, and planes that bound them; the search stops beyond `within` [m].

    Returns (distance [m] up to `rounding`, a lower bound; a plane that all of b is behind, in b's frame; likewise for
    a, in a's frame), planes as in Approach.
    """
    n, low, high = parting_plane_of_leaves(pools, pair, leaves, within + rounding, toward, scratch.along)
    x, y, z = n
    t = pair.translation[0]
    beyond_b = x, y, z, high + rounding
    x, y, z = rotated(pair.rotation[1], -x, -y, -z)
    beyond_a = x, y, z, n[0] * t[0] + n[1] * t[1] + n[2] * t[2] - low + rounding
    return low - high, beyond_b, beyond_a


@query_kernel
def query_listed(pools, edges, pair, rule, listing, sink, scratch):
    """search_samples for a Pair whose Listing holds all samples that can be near, and all ridges that can cross.

    The distance of a sample that is not near is searched listing.ahead [m] beyond the detection tolerance, and its row
    of places is renewed. Returns a Searched without what a list needs.
    """
    a, b, rotation, translation = pair
    listed, places = listing.samples, listing.places
    points, count, deep, visits, near = pools.samples.points, 0, 0, 0, rule.near
    middles = pools.fragment.middle
    slack, one_body = rounding_slack(pools, a, b, translation), share_a_body(pools, a, b)
    side = side_of(pair, 0, one_body, slack)
    frame = frame_between(middles[a], middles[b], rotation[0], translation[0])
    for i in range(len(listed)):
        if listed[i, WHO] & 1 != side.number:
            side = side_of(pair, 1, one_body, slack)
            frame = frame_between(middles[b], middles[a], rotation[1], translation[1])
        if not may_be_near(places[i], side.rotation, frame):
            continue
        visits += 1
        entry = listed[i, WHO] >> 1
        if may_wait(pools, side.other, rule, deep):
            places[i, UNTIL] = NEAR_LAST
            count = keep_for_later(pools, side, rule, entry, UNKNOWN, count, scratch)
            continue
        looked, distance, is_near = near, 0.0, False
        if places[i, UNTIL] != NEAR_LAST:
            looked = near + listing.ahead
            if may_be_clear(pools, side.other):
                c = points[entry]
                point = to_other(side.rotation, side.translation, c[0], c[1], c[2])
                distance, listed[i, WHERE] = clearance(
                    pools, side.other, listed[i, WHERE], point, looked, slack, scratch
                )
        if distance == 0.0:
            distance, is_near = ask(pools, side, rule, entry, looked, False, count, scratch)
        if not is_near:
            see(places[i], side.rotation, frame, distance - 4.0 * slack, near)
            continue
        places[i, UNTIL] = NEAR_LAST
        count, deep = count + 1, deep + (distance < -rule.epsilon)
    if len(listing.ridges) > 0:
        apart = displacement(pools, pair, IN_PLACE) if one_body else math.inf
        separation = Separation(NO_PLANE, NO_PLANE, apart, slack)
        count, deep = add_listed_crossings(
            pools, edges, pair, rule, listing, separation, (count, deep), scratch
        )
    chosen, bound = choose_contacts(pools, pair, rule, slack, (count, deep), sink, scratch)
    return Searched(chosen, bound, visits, 0, 0, 0.0)
