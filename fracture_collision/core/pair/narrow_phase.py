"""All pairs of a step: relative poses, Algorithm 1 for each pair in parallel, contacts gathered in pair order.

A pair writes only to its own slot, so the answer is the same bytes for any number of threads.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fracture_collision.core.contacts.contact_choice import Rule
from fracture_collision.core.contacts.contact_places import put_in_world
from fracture_collision.core.contacts.facing_normal import turn_contacts
from fracture_collision.core.contacts.known_samples import rounding_slack
from fracture_collision.core.edges.ridge_contacts import NO_RIDGE_SEARCH, RidgeSearch, least_apart
from fracture_collision.core.lookahead.first_touch import first_touch
from fracture_collision.core.lookahead.motion import NO_MOTION, Motion, between_balls, closing_speed, is_moving
from fracture_collision.core.lookahead.staying_apart import (
    boxes_stay_apart,
    hulls_stay_apart,
    may_get_through,
    may_touch_again,
)
from fracture_collision.core.memory.compiled import inlined_kernel, kernel, threaded_kernel
from fracture_collision.core.memory.crew import Crew
from fracture_collision.core.memory.pools import FACING
from fracture_collision.core.memory.rotations import relative_pose
from fracture_collision.core.pair.crowds import UNSEARCHED, UNSHARED, Overlaps, most_visits, visit_shares
from fracture_collision.core.search.kept_answer import (
    NOTHING_KEPT,
    KeptAnswer,
    PairContacts,
    gather_kept,
    keep,
    pairs_in_place,
    pose_bits,
)
from fracture_collision.core.search.neighbour_lists import (
    FAST,
    FULL,
    MOST_LISTED,
    MOST_RIDGES,
    NO_LISTS,
    NOT_LISTED,
    NeighbourLists,
    displacement,
    fetch_slot,
    keep_pose,
    least_left,
    pair_keys,
    reach_of,
    with_pairs,
)
from fracture_collision.core.search.sample_search import begins_with_seeds, may_search, query_listed, search_samples
from fracture_collision.core.search.traversal import BY_FURTHER, BY_LIMIT, COMPLETE, depth_limit, query_pair
from fracture_collision.core.surfaces.surface_pass import Surfaces, judge_pairs

# Initial capacity for contacts: per pair on average, and at least for a thread's share of pairs. Pairs that overflow it
# are searched again. Memory that is never written costs nothing.
FIRST_ROOM = 64
LEAST_ROOM = 1 << 15
UNLIMITED = 1 << 60
_NONE = np.zeros(0, np.int64)


class WorkLimits(NamedTuple):
    """Work limits for all pairs of a step. A pair's share depends only on numbers of pairs, tree nodes and contacts."""

    visits: int = UNLIMITED  # for pairs that coincide; the others get 25 times as many: crowds.visit_shares
    further_visits: int = UNLIMITED  # for pairs that already have the contacts wanted; see query_pairs
    contacts_per_pair: int = UNLIMITED
    contacts: int = UNLIMITED


NO_LIMITS = WorkLimits()


class Remembered(NamedTuple):
    """State kept from the last step: it makes the next one faster and never changes its result."""

    lists: NeighbourLists
    answer: KeptAnswer


NOTHING_REMEMBERED = Remembered(NO_LISTS, NOTHING_KEPT)


@inlined_kernel
def put_rotation(x, y, z, w, out):
    """Write the rotation matrix (3, 3) of a quaternion of any length."""
    s = 2.0 / (x * x + y * y + z * z + w * w)
    out[0, 0] = 1.0 - s * (y * y + z * z)
    out[0, 1] = s * (x * y - z * w)
    out[0, 2] = s * (x * z + y * w)
    out[1, 0] = s * (x * y + z * w)
    out[1, 1] = 1.0 - s * (x * x + z * z)
    out[1, 2] = s * (y * z - x * w)
    out[2, 0] = s * (x * z - y * w)
    out[2, 1] = s * (y * z + x * w)
    out[2, 2] = 1.0 - s * (x * x + y * y)


@threaded_kernel
def _query_share(
    pools, edges, rows, rotations, positions, motion, pairs, todo, is_first, wanted, most, epsilon, near, shares,
    further, limit, contacts, ids, begin, counts, bounds, visits, exhausted, is_ahead, lists, slots, known, scratch,
    threads, thread,
):  # fmt: skip
    """Process every `threads`-th pair of `todo`, starting at `thread`; pairs that are apart now also along `motion`.

    most: see contact_choice.Rule; limit, shares (p,), further (p,): limits of each pair, see query_pair. A pair's
    contacts fill consecutive rows of contacts[thread] from begin[pair] on; begin is -1 where there was no room. lists:
    NeighbourLists; slots (p,): a pair's slot, -1: none; known (p,): whether it had the slot at the last step. Only the
    first search of a pair uses them. is_ahead (p,): whether some of its contacts lie in the future.
    """
    rotation, translation = scratch.rotation[thread], scratch.translation[thread]
    used, room = 0, contacts.shape[1]
    for k in range(thread, len(todo), threads):
        p = todo[k]
        if k + threads < len(todo):
            fetch_slot(lists, slots[todo[k + threads]])
        i, j, is_ahead[p] = pairs[p, 0], pairs[p, 1], False
        a, b = rows[i], rows[j]
        relative_pose(rotations[i], positions[i], rotations[j], positions[j], rotation[0], translation[0])
        relative_pose(rotations[j], positions[j], rotations[i], positions[i], rotation[1], translation[1])
        radius = min(pools.fragment.radius[a], pools.fragment.radius[b])
        if shares[p] == UNSEARCHED:
            bounds[p] = max(depth_limit(pools, a), depth_limit(pools, b))
            begin[p], counts[p], visits[p], exhausted[p] = used, 0, 0, BY_LIMIT
            continue
        out, out_ids = contacts[thread, used:], ids[thread, used:]
        slot = slots[p] if is_first else -1
        # under the paper's rule, a pair without a list runs the paper's algorithm
        is_quick = shares[p] == UNSHARED and limit >= wanted and may_search(pools, a, b) and (most > 0 or slot >= 0)
        rule = Rule(wanted, min(most, limit), epsilon * radius, near * radius)
        found, moves, clear = -1, FAST * radius, 0.0
        if slot >= 0 and known[p]:
            n, rounding = lists.counts[slot], 2.0 * rounding_slack(pools, a, b, translation)
            moves = displacement(pools, a, b, rotation, translation, lists.poses[slot]) + rounding
            if n >= 0:
                moved = displacement(pools, a, b, rotation, translation, lists.listed_at[slot])
                if moved + rounding < lists.reach[slot] and not (
                    n > 0 and most > 0 and begins_with_seeds(pools, a, b, rotation, translation, rule)
                ):
                    ahead = min(reach_of(moves, radius)[1], lists.reach[slot] - moved)
                    ridges = lists.ridge_pairs[slot, : lists.ridges[slot]]
                    found, bounds[p], visits[p] = query_listed(
                        pools, edges, a, b, rotation, translation, rule, ahead, lists.listed[slot, :n],
                        lists.places[slot, :n], ridges, out, out_ids, room - used, scratch, thread,
                    )  # fmt: skip
                    exhausted[p] = BY_LIMIT if found == limit < most else COMPLETE
                    if motion.time > 0.0 and found == 0:
                        middles = pools.fragment.middle
                        left = least_left(
                            lists.listed[slot], lists.places[slot], n, middles[a], middles[b], rotation, translation,
                            False,
                        )  # fmt: skip
                        left = min(
                            left, least_apart(edges, a, b, rotation, translation, ridges, rule.near, False, thread)
                        )
                        clear = min(left, lists.reach[slot] - moved - rounding)
            is_quick = is_quick and n != FULL
        if slot >= 0:
            keep_pose(rotation, translation, lists.poses[slot])
        if found < 0 and is_quick:
            listed, places, ridges = scratch.none_listed, scratch.no_places, scratch.none_listed
            toward, reach, ahead = scratch.toward[thread], 0.0, 0.0
            if slot >= 0:
                listed, places, toward = lists.listed[slot], lists.places[slot], lists.toward[slot]
                ridges = lists.ridge_pairs[slot]
                reach, ahead = reach_of(moves, radius)
            else:
                toward[0] = toward[1] = toward[2] = 0.0
            found, bounds[p], visits[p], samples, crossings, clear = search_samples(
                pools, edges, a, b, rotation, translation, rule, reach, scratch.any_way, ahead, out, out_ids,
                room - used, listed, places, ridges, toward, scratch, thread,
            )  # fmt: skip
            exhausted[p] = BY_LIMIT if found == limit < most else COMPLETE
            if slot >= 0:
                lists.counts[slot] = NOT_LISTED if found >= 0 else FULL
                has_room = samples <= MOST_LISTED and crossings <= MOST_RIDGES
                if found >= 0 and has_room and max(reach, clear) > 0.0:
                    lists.counts[slot], lists.ridges[slot] = samples, crossings
                    lists.reach[slot] = max(reach, clear)
                    keep_pose(rotation, translation, lists.listed_at[slot])
                    if motion.time > 0.0 and found == 0:
                        middles = pools.fragment.middle
                        left = least_left(
                            listed, places, samples, middles[a], middles[b], rotation, translation, False
                        )
                        crossing = ridges[:crossings]
                        left = min(
                            left, least_apart(edges, a, b, rotation, translation, crossing, rule.near, False, thread)
                        )
                        clear = min(left, lists.reach[slot])
        if found < 0:
            found, bounds[p], visits[p], exhausted[p], clear = query_pair(
                pools, a, b, rotation, translation, wanted, epsilon * radius, near * radius, shares[p],
                further[p], limit, out, out_ids, room - used, scratch, thread,
            )  # fmt: skip
            if slot >= 0:
                lists.counts[slot] = FULL if found >= wanted else NOT_LISTED
                if clear > 0.0:
                    lists.counts[slot], lists.ridges[slot], lists.reach[slot] = 0, 0, clear
                    keep_pose(rotation, translation, lists.listed_at[slot])
        if 0 < found <= room - used and pools.normals == FACING:
            turn_contacts(pools, a, b, rotation, translation, near * radius, out, out_ids, found, scratch, thread)
        if motion.time > 0.0:
            # look-ahead runs its own searches: remembered state cannot change its result
            moment, ahead = 0.0, Rule(wanted, min(max(most, wanted), limit), rule.epsilon, rule.near)
            toward = scratch.toward[thread]
            if found == 0:
                clear = max(clear, between_balls(motion, i, j) - rule.near)
                if slot >= 0:
                    toward = lists.toward[slot]
                else:
                    toward[0] = toward[1] = toward[2] = 0.0
            if not (
                found != 0
                or closing_speed(motion, i, j, 0.0, motion.time) * motion.time <= clear + rule.near + rule.epsilon
                or boxes_stay_apart(pools, a, b, i, j, rotation, translation, rotations, motion, -rule.epsilon)
                or hulls_stay_apart(
                    pools, a, b, i, j, rotation, translation, rotations, positions, motion, -rule.epsilon, toward,
                    scratch, thread,
                )
            ):
                found, moment, more, unseen = first_touch(
                    pools, edges, a, b, i, j, rotations, positions, motion, 0.0, 0, ahead, out, out_ids, room - used,
                    limit, rotation, translation, scratch, thread,
                )  # fmt: skip
                visits[p] += more
                is_ahead[p] = found > 0
                for d in range(3):
                    toward[d] = scratch.ahead_toward[thread, d]  # warm start of hulls_stay_apart at the next step
                if found == 0 and unseen > 0.0:
                    exhausted[p], bounds[p] = BY_LIMIT, max(bounds[p], unseen)
            if 0 < found <= room - used and may_touch_again(
                pools, a, b, i, j, rotation, translation, rotations, positions, motion, moment, out, found, scratch,
                thread,
            ):
                again, _, more, _ = first_touch(
                    pools, edges, a, b, i, j, rotations, positions, motion, moment, found, ahead, out, out_ids,
                    room - used, limit, rotation, translation, scratch, thread,
                )  # fmt: skip
                visits[p] += more
                found, is_ahead[p] = found + again, is_ahead[p] or again > 0
        begin[p], counts[p] = used, found
        if found > room - used:
            begin[p] = -1
            continue
        used += counts[p]


@kernel
def _gather(
    pairs, rotations, positions, todo, contacts, ids, begin, counts, offsets, points_a, points_b, normals, gaps, samples
):
    for k in range(len(todo)):
        p, thread = todo[k], k % len(contacts)
        if begin[p] < 0:
            continue
        for c in range(counts[p]):
            put_in_world(
                pairs[p], rotations, positions, contacts[thread, begin[p] + c], ids[thread, begin[p] + c],
                offsets[p] + c, points_a, points_b, normals, gaps, samples,
            )  # fmt: skip


def query_pairs(
    pools, rows, rotations, positions, pairs, wanted, most, epsilon, near, budget, scratch, crew: Crew,
    before: Remembered | None = None, stamp: int = 0, limits: WorkLimits = NO_LIMITS,
    overlaps: Overlaps | None = None, motion: Motion = NO_MOTION, surfaces: Surfaces | None = None,
    edges: RidgeSearch = NO_RIDGE_SEARCH,
) -> tuple[PairContacts, Remembered]:  # fmt: skip
    """Contacts of `pairs` (p, 2) of indices into `rows` (n,), with poses rotations (n, 3, 3), positions (n, 3) [m].

    wanted: m of section 5.2; most: see contact_choice.Rule; epsilon, near: shares of the smaller R of the two bodies;
    budget: visits per pair, 0: no budget. before: state returned with the last answer from these pools, to speed up
    pairs that moved little; it is consumed. With a budget, or with None, nothing is reused or remembered. The answer
    does not depend on it, except for `visits`; an answer that is remembered must not be modified. stamp: differs after
    any change of the pools. Pairs with limited visits are searched by the paper's rule. motion: of `rows`; contacts
    that touch now are the same without it. surfaces: for pairs with unlimited visits, surfaces between samples are
    searched too. edges: ridges of all rows; by our rule their crossings are contacts like those of samples.

    limits: all pairs share half of the further visits evenly; pairs whose share was too small share the other half. If
    there are too many contacts, the pairs with the most lose their shallowest ones, down to a common maximum. overlaps:
    see crowds.visit_shares; a budget replaces it. No share depends on lists: a pair answered from a list has fewer
    contacts than wanted, and a pair that a limit might cut short is not listed.
    """
    p = len(pairs)
    slots, known, stands_at = np.full(p, -1), np.zeros(p, np.bool_), np.full(p, -1)
    lists, listed, moved = NO_LISTS, slots, np.arange(p)
    shares = np.full(p, budget)
    if not budget and overlaps is not None:
        shares = visit_shares(pools, rows, pairs, overlaps, limits.visits)
    if before is not None and not budget:
        lists, slots, known = with_pairs(before.lists, pair_keys(rows, pairs))
        listed = slots
        if shares.any():
            listed = np.where((shares != UNSHARED) & (shares < most_visits(pools, rows, pairs)), -1, slots)
    counts, visits = np.zeros(p, np.int64), np.zeros(p, np.int64)
    bounds, exhausted, is_ahead = np.zeros(p), np.zeros(p, np.uint8), np.zeros(p, np.bool_)
    share = limits.further_visits // (2 * max(p, 1))
    further = np.full(p, share)
    passes = []
    poses = pose_bits(rotations, positions)
    if lists is not NO_LISTS and before.answer.stamp == stamp:
        stands_at, moved = pairs_in_place(
            before.answer, pools.fragment.kind, rows, poses, pairs, slots, known, shares, share, counts, bounds
        )
        if motion.time > 0.0:
            moved = _without_those_that_leave(pools.fragment.box, rows, pairs, motion, counts, stands_at)

    def search(todo: np.ndarray, limit: int, room: int) -> np.ndarray:
        """Search the pairs `todo` with room for `room` contacts per thread; returns the pairs that did not fit."""
        contacts, ids = np.empty((crew.threads, room, 10)), np.empty((crew.threads, room, 5), np.int64)
        begin = np.empty(p, np.int64)
        crew.share(
            _query_share, pools, edges, rows, rotations, positions, motion, pairs, todo, not passes, wanted, most,
            epsilon, near, shares, further, limit, contacts, ids, begin, counts, bounds, visits, exhausted, is_ahead,
            lists, listed, known, scratch,
        )  # fmt: skip
        for earlier in passes:
            earlier[-1][todo] = -1
        passes.append((todo, contacts, ids, begin))
        return todo[begin[todo] < 0]

    def most_kept() -> int:
        return _level(counts, limits.contacts) if int(counts.sum()) > limits.contacts else UNLIMITED

    def first_room(count: int) -> int:
        return max(LEAST_ROOM, min(FIRST_ROOM * count, limits.contacts) // crew.threads)

    if len(moved):
        search(moved, limits.contacts_per_pair, first_room(len(moved)))
    cuts, total, unstored = _tally(counts, exhausted, moved, passes[0][-1] if passes else counts)
    cut = np.flatnonzero(exhausted == BY_FURTHER) if cuts else _NONE
    if cuts or unstored or total > limits.contacts:
        if cuts and limits.further_visits // (2 * cuts) > share:
            further[cut] = limits.further_visits // (2 * cuts)
            search(cut, limits.contacts_per_pair, first_room(cuts))
        level = most_kept()
        is_stored = stands_at >= 0
        for todo, _, _, begin in passes:
            is_stored[todo] |= begin[todo] >= 0
        todo = np.flatnonzero(~is_stored | (counts > level))
        while len(todo):
            needed = np.minimum(counts[todo], level)
            room = max(int(needed[t :: crew.threads].sum()) for t in range(crew.threads))
            stands_at[todo] = -1
            todo = search(todo, min(level, limits.contacts_per_pair), room)
            if not len(todo):  # pairs that did not fit had more contacts than counted before
                level = most_kept()
                todo = np.flatnonzero(counts > level)
    offsets = np.zeros(p + 1, np.int64)
    np.cumsum(counts, out=offsets[1:])
    total = int(offsets[-1])
    points_a, points_b, normals = np.empty((total, 3)), np.empty((total, 3)), np.empty((total, 3))
    gaps, samples = np.empty(total), np.empty((total, 2), np.int64)
    for todo, contacts, ids, begin in passes:
        _gather(
            pairs, rotations, positions, todo, contacts, ids, begin, counts, offsets,
            points_a, points_b, normals, gaps, samples,
        )  # fmt: skip
    found = PairContacts(counts, bounds, visits, exhausted, points_a, points_b, normals, gaps, samples)
    searched = visits * (counts >= wanted)
    if lists is not NO_LISTS:
        gather_kept(before.answer, stands_at, offsets, points_a, points_b, normals, gaps, samples, searched)
    if surfaces is not None:
        found = judge_pairs(
            pools, surfaces, rows, rotations, positions, pairs, moved, shares == UNSHARED, epsilon, near, found,
            offsets, scratch, crew,
        )  # fmt: skip
        np.cumsum(found.counts, out=offsets[1:])
    if lists is NO_LISTS:
        return found, NOTHING_REMEMBERED
    if cuts:
        slots[cut] = -1  # their second share may be smaller at the next step
    if is_ahead.any():
        slots[is_ahead] = -1  # their look-ahead contacts hold for this step only
    answer = keep(stamp, rows, poses, slots, len(lists.counts), searched, shares, share, offsets, found)
    return found, Remembered(lists, answer)


@kernel
def _without_those_that_leave(boxes, rows, pairs, motion, counts, stands_at):
    """Drop moving pairs from those in place (see pairs_in_place), unless they touch and move so slowly that their
    present contacts are all they can have; returns the pairs that are not in place then (m,). boxes (F, 6) [m]: of all
    fragments.
    """
    is_in_motion = is_moving(motion)
    for p in range(len(pairs)):
        i, j = pairs[p, 0], pairs[p, 1]
        if stands_at[p] < 0 or not (is_in_motion[i] or is_in_motion[j]):
            continue
        if counts[p] == 0 or may_get_through(boxes, rows[i], rows[j], i, j, motion):
            stands_at[p] = -1
    return np.flatnonzero(stands_at < 0)


@kernel
def _tally(counts, exhausted, searched, begin):
    """Returns (pairs that ended BY_FURTHER, contacts of all pairs, how many of the pairs `searched` did not fit)."""
    cuts = total = unstored = 0
    for p in range(len(counts)):
        total += counts[p]
        cuts += exhausted[p] == BY_FURTHER
    for p in searched:
        unstored += begin[p] < 0
    return cuts, total, unstored


def _level(counts: np.ndarray, most: int) -> int:
    """The largest cap for which `counts` (p,), each clipped to it, sum to at most `most`."""
    if int(counts.sum()) <= most:
        return int(counts.max(initial=0))
    ordered = np.sort(counts)
    fewer = np.cumsum(ordered) - ordered
    levels = (most - fewer) // np.arange(len(counts), 0, -1)
    return int(levels[np.argmax(levels < ordered)])
