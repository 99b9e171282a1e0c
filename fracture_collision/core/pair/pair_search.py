"""The search of one pair: from its neighbour list or among its leaves of samples, which only saves work; then ahead."""

from __future__ import annotations

import math
from typing import NamedTuple

from fracture_collision.core.contacts.contact_choice import Rule
from fracture_collision.core.contacts.known_samples import rounding_slack, share_a_body
from fracture_collision.core.contacts.sphere_contacts import sphere_contacts
from fracture_collision.core.edges.ridge_contacts import least_apart
from fracture_collision.core.edges.ridges import Ridges
from fracture_collision.core.lookahead.first_touch import first_touch
from fracture_collision.core.lookahead.motion import between_balls, closing_speed
from fracture_collision.core.lookahead.sphere_at_end import sphere_at_end
from fracture_collision.core.lookahead.staying_apart import boxes_stay_apart, hulls_stay_apart, may_touch_again
from fracture_collision.core.memory.compiled import spliced_kernel
from fracture_collision.core.memory.kinds import is_bounded
from fracture_collision.core.memory.pair import Sink
from fracture_collision.core.memory.pools import Pools
from fracture_collision.core.patches.pair_contacts import Wanted, put_patch
from fracture_collision.core.patches.shapes import NO_SHAPES, Shapes, have_patches
from fracture_collision.core.search.neighbour_lists import (
    FAST,
    IN_PLACE,
    MOST_LISTED,
    MOST_RIDGES,
    NOT_LISTED,
    Listing,
    NeighbourLists,
    displacement,
    keep_pose,
    least_left,
    reach_of,
)
from fracture_collision.core.search.sample_search import begins_with_seeds, may_search, query_listed, search_samples
from fracture_collision.core.search.work_limit import BY_LIMIT, COMPLETE
from fracture_collision.core.separation.oriented_boxes import box_clearance

NOT_FOUND = -1  # contacts, where another search must be run


class Geometry(NamedTuple):
    """The pools and the ridges that a search reads."""

    pools: Pools
    edges: Ridges  # of all rows; NO_RIDGES where crossings are not searched
    shapes: Shapes = NO_SHAPES  # of all rows; NO_SHAPES where no contacts are patches


class Slot(NamedTuple):
    """A pair's row of the NeighbourLists."""

    lists: NeighbourLists
    row: int  # -1: nowhere
    is_known: bool  # whether the pair had the slot at the last step
    for_motion: bool  # whether the clearance beyond the list is wanted, too


class Found(NamedTuple):
    """Result of a search."""

    count: int  # type: ignore[assignment] # contacts, NOT_FOUND: none was run
    bound: float  # [m] missed depth bound
    visits: int
    exhausted: int  # COMPLETE, BY_LIMIT or BY_FURTHER
    clear: float  # [m] lower bound of the distance in excess of the detection tolerance, 0: unknown


@spliced_kernel
def patch_pair(geometry, pair, moving, rule, slot, sink, scratch):
    """(whether the contacts of a Pair are patches; their Found; whether they depend on the motion of the Moving)."""
    if not have_patches(geometry.shapes, pair.a, pair.b):
        return False, Found(0, 0.0, 0, COMPLETE, 0.0), False
    moved, remembered = math.inf, scratch.toward
    if share_a_body(geometry.pools, pair.a, pair.b):
        moved = displacement(geometry.pools, pair, IN_PLACE)
    if slot.row >= 0:
        remembered = slot.lists.toward[slot.row]
        slot.lists.counts[slot.row] = NOT_LISTED
        keep_pose(pair.rotation, pair.translation, slot.lists.poses[slot.row])
    else:
        remembered[0] = 0.0
    wanted = Wanted(rule.near, moved, rule.wanted)
    count, bound, is_ahead = put_patch(geometry.shapes, pair, moving, wanted, remembered, sink)
    return True, Found(count, bound, 0, COMPLETE, 0.0), is_ahead


@spliced_kernel
def search_pair(geometry, pair, rule, slot, sink, scratch):
    """The Found of a Pair at its present relative poses, by a Rule; the contacts are written to a Sink.

    slot: the pair's Slot, whose list is used and renewed.
    """
    pools = geometry.pools
    radius = min(pools.fragment.radius[pair.a], pools.fragment.radius[pair.b])
    found, moves = Found(NOT_FOUND, 0.0, 0, COMPLETE, 0.0), FAST * radius
    if slot.row >= 0 and slot.is_known:
        rounding = 2.0 * rounding_slack(pools, pair.a, pair.b, pair.translation)
        moves = displacement(pools, pair, slot.lists.poses[slot.row]) + rounding
        if slot.lists.counts[slot.row] >= 0:
            found = _from_list(geometry, pair, rule, moves, slot, sink, scratch)
    if slot.row >= 0:
        keep_pose(pair.rotation, pair.translation, slot.lists.poses[slot.row])
    if found.count == NOT_FOUND and may_search(pools, pair.a, pair.b):
        found = _among_samples(geometry, pair, rule, moves, slot, sink, scratch)
    elif found.count == NOT_FOUND:
        found = _of_sphere(pools, pair, rule, slot, sink, scratch)
    return found


@spliced_kernel
def _of_sphere(pools, pair, rule, slot, sink, scratch):
    """The Found of a Pair with a sphere."""
    a, b, rotation, translation = pair
    slack, parted = rounding_slack(pools, a, b, translation), -math.inf
    if is_bounded(pools.fragment.kind[a]) and is_bounded(pools.fragment.kind[b]):
        boxes = pools.fragment.box
        parted = box_clearance(boxes[a], boxes[b], rotation[0], translation[0], rule.near + slack)
    clear = parted - rule.near - slack
    if slot.row >= 0:
        slot.lists.counts[slot.row] = NOT_LISTED
        if clear > 0.0:
            slot.lists.counts[slot.row], slot.lists.ridges[slot.row], slot.lists.reach[slot.row] = 0, 0, clear
            keep_pose(rotation, translation, slot.lists.listed_at[slot.row])
    if clear > 0.0:
        return Found(0, slack, 0, COMPLETE, clear)
    count, bound, is_cut = sphere_contacts(pools, pair, rule, sink, scratch)
    return Found(count, bound + slack, 0, BY_LIMIT if is_cut else COMPLETE, 0.0)


@spliced_kernel
def _from_list(geometry, pair, rule, moves, slot, sink, scratch):
    """The Found of a Pair that has a list; NOT_FOUND if the list does not hold any more.

    moves [m]: how far the two moved since the last step.
    """
    pools = geometry.pools
    a, b, _, translation = pair
    lists, row = slot.lists, slot.row
    n, rounding = lists.counts[row], 2.0 * rounding_slack(pools, a, b, translation)
    moved = displacement(pools, pair, lists.listed_at[row])
    if not moved + rounding < lists.reach[row]:
        return Found(NOT_FOUND, 0.0, 0, COMPLETE, 0.0)
    if n > 0 and begins_with_seeds(pools, pair, rule):
        return Found(NOT_FOUND, 0.0, 0, COMPLETE, 0.0)
    radius = min(pools.fragment.radius[a], pools.fragment.radius[b])
    ahead = min(reach_of(moves, radius)[1], lists.reach[row] - moved)
    listing = Listing(
        0.0, ahead, scratch.any_way, lists.listed[row, :n], lists.places[row, :n],
        lists.ridge_pairs[row, : lists.ridges[row]], lists.toward[row], rule.epsilon,
    )  # fmt: skip
    found = query_listed(pools, geometry.edges, pair, rule, listing, sink, scratch)
    clear = 0.0
    if slot.for_motion and found.count == 0:
        clear = min(_left_of(geometry, pair, rule, listing, n, scratch), lists.reach[row] - moved - rounding)
    return Found(found.count, found.bound, found.visits, COMPLETE, clear)


@spliced_kernel
def _among_samples(geometry, pair, rule, moves, slot, sink, scratch):
    """The Found of a Pair whose samples are searched, with a new list if it has a slot; moves [m]: see _from_list."""
    pools = geometry.pools
    radius = min(pools.fragment.radius[pair.a], pools.fragment.radius[pair.b])
    listed, places, ridges = scratch.none_listed, scratch.no_places, scratch.none_listed
    toward, reach, ahead = scratch.toward, 0.0, 0.0
    lists, row = slot.lists, slot.row
    if row >= 0:
        listed, places, toward = lists.listed[row], lists.places[row], lists.toward[row]
        ridges = lists.ridge_pairs[row]
        reach, ahead = reach_of(moves, radius)
    else:
        toward[0] = toward[1] = toward[2] = 0.0
    listing = Listing(reach, ahead, scratch.any_way, listed, places, ridges, toward, rule.epsilon)
    found = search_samples(pools, geometry.edges, pair, rule, listing, sink, scratch)
    clear, samples, crossings = found.clear, found.samples, found.crossings
    if row >= 0:
        lists.counts[row] = NOT_LISTED
        has_room = samples <= MOST_LISTED and crossings <= MOST_RIDGES
        if has_room and max(reach, clear) > 0.0:
            lists.counts[row], lists.ridges[row] = samples, crossings
            lists.reach[row] = max(reach, clear)
            keep_pose(pair.rotation, pair.translation, lists.listed_at[row])
            if slot.for_motion and found.count == 0:
                made = Listing(
                    reach, ahead, scratch.any_way, listed, places, ridges[:crossings], toward, rule.epsilon
                )
                clear = min(_left_of(geometry, pair, rule, made, samples, scratch), lists.reach[row])
    return Found(found.count, found.bound, found.visits, BY_LIMIT if rule.every > 1 else COMPLETE, clear)


@spliced_kernel
def _left_of(geometry, pair, rule, listing, count, scratch):
    """Lower bound [m] of how far the first `count` listed samples, and all listed ridges, are from being near."""
    middles = geometry.pools.fragment.middle
    left = least_left(
        listing.samples, listing.places, count, middles[pair.a], middles[pair.b], pair.rotation, pair.translation, False
    )
    return min(left, least_apart(geometry.edges, pair, listing.ridges, rule.near, False, scratch))


@spliced_kernel
def look_ahead(geometry, pair, moving, rule, found, slot, sink, scratch):
    """Search the time ahead for contacts of the two fragments of a Moving, after the `found` of now.

    The contacts are written to the Sink after those found now. Returns (the Found of both, whether any was added).

    It runs its own searches. What is remembered (the clearance of lists, a separating direction) may only prove that a
    pair never comes near: that is true whatever proved it. That a pair comes near but no deeper than epsilon must be
    proved from this step alone: the search lists such a pair where its own proof fails.
    """
    pools, edges = geometry.pools, geometry.edges
    i, j, _, _, motion = moving
    room, count, visits, bound, exhausted = len(sink.contacts), found.count, found.visits, found.bound, found.exhausted
    moment, clear = 0.0, found.clear
    ahead = Rule(rule.wanted, rule.most, rule.epsilon, rule.near, 1)
    toward = scratch.toward
    is_settled = False
    if count == 0:
        closes = closing_speed(motion, i, j, 0.0, motion.time) * motion.time
        between = between_balls(motion, i, j)
        is_settled = closes <= clear or closes <= between + rule.epsilon
        clear = max(clear, between - rule.near)
        if slot.row >= 0:
            toward = slot.lists.toward[slot.row]
        else:
            toward[0] = toward[1] = toward[2] = 0.0
    is_ahead = False
    if not is_settled and not may_search(pools, pair.a, pair.b):
        count, is_ahead = sphere_at_end(pools, pair, moving, ahead, count, sink, scratch)
    if not (
        count != 0
        or is_settled
        or boxes_stay_apart(pools, pair, moving, -rule.epsilon)
        or hulls_stay_apart(pools, pair, moving, rule.near, toward, scratch)
    ):
        count, moment, more, unseen = first_touch(pools, edges, pair, moving, (0.0, 0), ahead, sink, scratch)
        visits += more
        is_ahead = count > 0
        for d in range(3):
            toward[d] = scratch.ahead_toward[d]  # warm start of hulls_stay_apart at the next step
        if count == 0 and unseen > 0.0:
            exhausted, bound = BY_LIMIT, max(bound, unseen)
    has_room = 0 < count <= room
    known = Sink(sink.contacts[: max(count, 0)], sink.ids[: max(count, 0)])
    if has_room and may_touch_again(pools, pair, moving, moment, known, rule.epsilon, scratch):
        again, _, more, _ = first_touch(pools, edges, pair, moving, (moment, count), ahead, sink, scratch)
        visits += more
        count, is_ahead = count + again, is_ahead or again > 0
    return Found(count, bound, visits, exhausted, clear), is_ahead
