"""The searches of pairs, by kind: convex, with a sphere, all others; then the search of the time ahead."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from fracture_collision.core.contacts.contact_choice import Rule
from fracture_collision.core.contacts.deepest_contacts import copy_contact
from fracture_collision.core.contacts.facing_normal import turn_contacts
from fracture_collision.core.contacts.known_samples import rounding_slack, share_a_body
from fracture_collision.core.contacts.sphere_contacts import sphere_contacts
from fracture_collision.core.edges.ridge_contacts import least_apart
from fracture_collision.core.lookahead.first_touch import first_touch
from fracture_collision.core.lookahead.motion import Moving, between_balls, closing_speed
from fracture_collision.core.lookahead.sphere_at_end import sphere_at_end
from fracture_collision.core.lookahead.staying_apart import boxes_stay_apart, hulls_stay_apart, may_touch_again
from fracture_collision.core.memory.compiled import kernel, query_kernel, threaded_kernel
from fracture_collision.core.memory.kinds import is_bounded
from fracture_collision.core.memory.pair import Sink, put_pair
from fracture_collision.core.patches.pair_contacts import Wanted, put_patch
from fracture_collision.core.patches.shapes import have_patches
from fracture_collision.core.search.neighbour_lists import (
    FAST,
    IN_PLACE,
    MOST_LISTED,
    MOST_RIDGES,
    NOT_LISTED,
    Listing,
    NeighbourLists,
    displacement,
    fetch_slot,
    keep_pose,
    least_left,
    reach_of,
)
from fracture_collision.core.search.passes import ELSEWHERE, NO_ROOM, Found, keep_found, room_of
from fracture_collision.core.search.sample_search import begins_with_seeds, may_search, query_listed, search_samples
from fracture_collision.core.search.work_limit import BY_LIMIT, COMPLETE
from fracture_collision.core.separation.oriented_boxes import box_clearance

NOT_FOUND = -1  # contacts, where another search must be run
# Which search a pair gets; by_kind sorts them in this order.
CONVEX, ROUND, SAMPLED = 0, 1, 2
KINDS = 3


class Work(NamedTuple):
    """Pairs to be searched, and where the lists of all pairs are."""

    todo: np.ndarray  # (m,) int64
    slots: np.ndarray  # (p,) int64: a pair's slot of the lists, -1: none
    known: np.ndarray  # (p,) bool: whether it had the slot at the last step
    for_motion: bool  # whether the search goes on ahead


class Slot(NamedTuple):
    """A pair's row of the NeighbourLists."""

    lists: NeighbourLists
    row: int  # -1: nowhere
    is_known: bool  # whether the pair had the slot at the last step
    for_motion: bool  # whether the clearance beyond the list is wanted, too


@kernel
def by_kind(geometry, step, todo):
    """Pairs `todo` (m,) of a Step, sorted by the search that they get, and how many get each (KINDS,)."""
    kinds, counts = np.empty(len(todo), np.int64), np.zeros(KINDS, np.int64)
    for k in range(len(todo)):
        a, b = step.rows[step.pairs[todo[k], 0]], step.rows[step.pairs[todo[k], 1]]
        kinds[k] = ROUND
        if have_patches(geometry.shapes, a, b):
            kinds[k] = CONVEX
        elif may_search(geometry.pools, a, b):
            kinds[k] = SAMPLED
        counts[kinds[k]] += 1
    ordered, at = np.empty_like(todo), np.cumsum(counts) - counts
    for k in range(len(todo)):
        ordered[at[kinds[k]]] = todo[k]
        at[kinds[k]] += 1
    return ordered, counts


@threaded_kernel
def search_convex(geometry, lists, moving, rule, work, out, scratch, part):
    """Patches of all convex pairs of a Work that are a thread's, see Crew.share.

    moving: a Step and its Motion, which they are searched along; rule: with epsilon and near as shares of the smaller
    R; lists: NeighbourLists; out: Results.
    """
    (step, motion), pools, (thread, threads) = moving, geometry.pools, part
    for k in range(thread, len(work.todo), threads):
        p = work.todo[k]
        pair = put_pair(step, p, scratch.rotation, scratch.translation)
        its, row, moved, remembered = _scaled(pools, pair, rule), work.slots[p], math.inf, scratch.toward
        if share_a_body(pools, pair.a, pair.b):
            moved = displacement(pools, pair, IN_PLACE)
        if row >= 0:
            remembered = lists.toward[row]
            lists.counts[row] = NOT_LISTED
            keep_pose(pair.rotation, pair.translation, lists.poses[row])
        else:
            remembered[0] = 0.0
        wanted = Wanted(its.near, moved, its.wanted)
        two = Moving(step.pairs[p, 0], step.pairs[p, 1], step.rotations, step.positions, motion)
        count, bound, is_ahead = put_patch(geometry.shapes, pair, two, wanted, remembered, room_of(out, thread))
        out.ahead[p] = count if is_ahead else 0
        keep_found(out, p, thread, Found(count, bound, 0, COMPLETE, 0.0))


@threaded_kernel
def search_round(geometry, lists, step, rule, work, out, scratch, part):
    """As search_convex, of pairs with a sphere, at the poses of a Step."""
    pools, (thread, threads) = geometry.pools, part
    for k in range(thread, len(work.todo), threads):
        p = work.todo[k]
        pair, sink = put_pair(step, p, scratch.rotation, scratch.translation), room_of(out, thread)
        its, slot = _scaled(pools, pair, rule), Slot(lists, work.slots[p], work.known[p], work.for_motion)
        found = Found(NOT_FOUND, 0.0, 0, COMPLETE, 0.0)
        if slot.row >= 0:
            if slot.is_known and lists.counts[slot.row] == 0:
                found = _still_far(pools, pair, slot)
            keep_pose(pair.rotation, pair.translation, lists.poses[slot.row])
        if found.count == NOT_FOUND:
            found = _of_sphere(pools, pair, its, slot, sink, scratch)
        if 0 < found.count <= len(sink.contacts):
            turn_contacts(pools, pair, its.near, sink, found.count, scratch)
        keep_found(out, p, thread, found)


@threaded_kernel
def search_sampled(geometry, lists, step, rule, work, out, scratch, part):
    """As search_convex, of all other pairs, at the poses of a Step."""
    pools, (thread, threads) = geometry.pools, part
    for k in range(thread, len(work.todo), threads):
        p = work.todo[k]
        if k + threads < len(work.todo):
            fetch_slot(lists, work.slots[work.todo[k + threads]])
        pair, sink = put_pair(step, p, scratch.rotation, scratch.translation), room_of(out, thread)
        its, slot = _scaled(pools, pair, rule), Slot(lists, work.slots[p], work.known[p], work.for_motion)
        found, moves = Found(NOT_FOUND, 0.0, 0, COMPLETE, 0.0), FAST * _smaller_radius(pools, pair)
        if slot.row >= 0 and slot.is_known:
            rounding = 2.0 * rounding_slack(pools, pair.a, pair.b, pair.translation)
            moves = displacement(pools, pair, lists.poses[slot.row]) + rounding
            if lists.counts[slot.row] >= 0:
                found = _from_list(geometry, pair, its, moves, slot, sink, scratch)
        if slot.row >= 0:
            keep_pose(pair.rotation, pair.translation, lists.poses[slot.row])
        if found.count == NOT_FOUND:
            found = _among_samples(geometry, pair, its, moves, slot, sink, scratch)
        if 0 < found.count <= len(sink.contacts):
            turn_contacts(pools, pair, its.near, sink, found.count, scratch)
        keep_found(out, p, thread, found)


@threaded_kernel
def search_ahead(geometry, lists, moving, rule, work, out, scratch, part):
    """Search the time ahead for the pairs of a Work that search_round or search_sampled has been through.

    work: the Work, and their Results. Contacts ahead of a pair are written to `out`, after copies of those of now.
    """
    (step, motion), pools, (thread, threads), (work, now) = moving, geometry.pools, part, work
    for k in range(thread, len(work.todo), threads):
        p = work.todo[k]
        pair, sink = put_pair(step, p, scratch.rotation, scratch.translation), room_of(out, thread)
        count, first = now.counts[p], now.begin[p]
        if count > len(sink.contacts):
            out.begin[p], out.counts[p] = NO_ROOM, count
            continue
        for c in range(count):
            copy_contact(now, first + c, sink, c)
        two = Moving(step.pairs[p, 0], step.pairs[p, 1], step.rotations, step.positions, motion)
        found = Found(count, out.bounds[p], out.visits[p], out.exhausted[p], out.clear[p])
        its, slot = _scaled(pools, pair, rule), Slot(lists, work.slots[p], False, True)
        found, out.ahead[p] = _look_ahead(geometry, pair, two, its, found, slot, sink, scratch)
        out.begin[p] = ELSEWHERE
        if out.ahead[p] > 0 and found.count > len(sink.contacts):
            out.begin[p], out.counts[p] = NO_ROOM, found.count
        elif out.ahead[p] > 0:
            now.begin[p] = ELSEWHERE
            keep_found(out, p, thread, found)
        else:  # the contacts of now are where they were
            out.counts[p], out.bounds[p] = count, found.bound
            out.visits[p], out.exhausted[p] = found.visits, found.exhausted


@query_kernel
def _smaller_radius(pools, pair):
    return min(pools.fragment.radius[pair.a], pools.fragment.radius[pair.b])


@query_kernel
def _scaled(pools, pair, rule):
    """A Rule with lengths, from one with shares of R."""
    radius = _smaller_radius(pools, pair)
    return Rule(rule.wanted, rule.most, rule.epsilon * radius, rule.near * radius, rule.every)


@query_kernel
def _still_far(pools, pair, slot):
    """The Found of a Pair that was so far apart that its motion since then does not matter; NOT_FOUND if it does."""
    lists, row, slack = slot.lists, slot.row, rounding_slack(pools, pair.a, pair.b, pair.translation)
    moved, rounding = displacement(pools, pair, lists.listed_at[row]), 2.0 * slack
    if not moved + rounding < lists.reach[row]:
        return Found(NOT_FOUND, 0.0, 0, COMPLETE, 0.0)
    return Found(0, slack, 0, COMPLETE, lists.reach[row] - moved - rounding if slot.for_motion else 0.0)


@query_kernel
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


@query_kernel
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


@query_kernel
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


@query_kernel
def _left_of(geometry, pair, rule, listing, count, scratch):
    """Lower bound [m] of how far the first `count` listed samples, and all listed ridges, are from being near."""
    middles = geometry.pools.fragment.middle
    left = least_left(
        listing.samples, listing.places, count, middles[pair.a], middles[pair.b], pair.rotation, pair.translation, False
    )
    return min(left, least_apart(geometry.edges, pair, listing.ridges, rule.near, False, scratch))


@query_kernel
def _look_ahead(geometry, pair, moving, rule, found, slot, sink, scratch):
    """Search the time ahead for contacts of the two fragments of a Moving, after the `found` of now.

    The contacts are written to the Sink after those found now. Returns (the Found of both, how many lie in the future).

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
    later = 0
    if not is_settled and not may_search(pools, pair.a, pair.b):
        count, is_of_end = sphere_at_end(pools, pair, moving, ahead, count, sink, scratch)
        later = count if is_of_end else 0
    if not (
        count != 0
        or is_settled
        or boxes_stay_apart(pools, pair, moving, -rule.epsilon)
        or hulls_stay_apart(pools, pair, moving, rule.near, toward, scratch)
    ):
        count, moment, more, unseen = first_touch(pools, edges, pair, moving, (0.0, 0), ahead, sink, scratch)
        visits += more
        later = count
        for d in range(3):
            toward[d] = scratch.ahead_toward[d]  # warm start of hulls_stay_apart at the next step
        if count == 0 and unseen > 0.0:
            exhausted, bound = BY_LIMIT, max(bound, unseen)
    has_room = 0 < count <= room
    known = Sink(sink.contacts[: max(count, 0)], sink.ids[: max(count, 0)])
    if has_room and may_touch_again(pools, pair, moving, moment, known, rule.epsilon, scratch):
        again, _, more, _ = first_touch(pools, edges, pair, moving, (moment, count), ahead, sink, scratch)
        visits += more
        count, later = count + again, later + again
    return Found(count, bound, visits, exhausted, clear), later
