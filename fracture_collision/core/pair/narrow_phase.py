"""All pairs of a step: Algorithm 1 or a faster search for each pair in parallel, contacts gathered in pair order.

A pair writes only to its own slot, so the answer is the same bytes for any number of threads.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fracture_collision.core.contacts.contact_choice import Rule
from fracture_collision.core.contacts.contact_places import WorldContacts, make_world_contacts, put_in_world
from fracture_collision.core.contacts.facing_normal import turn_contacts
from fracture_collision.core.lookahead.motion import NO_MOTION, Motion, Moving, is_moving
from fracture_collision.core.lookahead.staying_apart import may_get_through
from fracture_collision.core.memory.compiled import kernel, threaded_kernel
from fracture_collision.core.memory.crew import Crew
from fracture_collision.core.memory.kinds import PLANE, SPHERE
from fracture_collision.core.memory.pair import Sink, Step, put_pair
from fracture_collision.core.memory.pools import FACING
from fracture_collision.core.mesh.surface_elements import ElementTable
from fracture_collision.core.pair.crowds import UNSEARCHED, UNSHARED, Overlaps, most_visits, visit_shares
from fracture_collision.core.pair.pair_search import Geometry, Slot, look_ahead, patch_pair, search_pair
from fracture_collision.core.patches.interlocked import Close, SurfaceTable, part_interlocked
from fracture_collision.core.search.depth_limits import depth_limit_of_pair
from fracture_collision.core.search.kept_answer import (
    NOTHING_KEPT,
    KeptAnswer,
    PairContacts,
    gather_kept,
    indices_of_kept,
    pairs_in_place,
    pose_bits,
)
from fracture_collision.core.search.neighbour_lists import NO_LISTS, NeighbourLists, fetch_slot, pair_keys, with_pairs
from fracture_collision.core.search.scratch import Scratch
from fracture_collision.core.search.traversal import BY_FURTHER, BY_LIMIT, VisitLimits
from fracture_collision.core.surfaces.surface_pass import judge_pairs
from fracture_collision.grouping import begins_of

# Initial capacity for contacts: per pair on average, and at least for a thread's share of pairs. Pairs that overflow it
# are searched again. Memory that is never written costs nothing.
FIRST_ROOM = 64
LEAST_ROOM = 1 << 15
UNLIMITED = 1 << 60
_NONE = np.zeros(0, np.int64)


class WorkLimits(NamedTuple):
    """Work limits for all pairs of a step. A pair's share depends only on numbers of pairs, tree nodes and contacts."""

    budget: int = 0  # visits of each pair, by the paper's rule; 0: the limits below
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


class Scene(NamedTuple):
    """The input of a step: geometry, poses, motion and pairs."""

    geometry: Geometry
    step: Step
    motion: Motion = NO_MOTION  # of the fragments of `step`
    overlaps: Overlaps | None = None  # of the boxes of its pairs, see crowds.visit_shares
    whole: SurfaceTable | None = None  # surfaces of concave fragments, where some contacts are of them
    elements: ElementTable | None = None  # surface elements, if surfaces between samples are searched, too
    stamp: int = 0  # differs after any change of the pools


class _Work(NamedTuple):
    """The pairs to be searched, their limits and their lists."""

    todo: np.ndarray  # (m,) int64
    shares: np.ndarray  # (p,) int64: visits of each pair, see traversal.VisitLimits, or UNSEARCHED
    further: np.ndarray  # (p,) int64, likewise
    lists: NeighbourLists
    slots: np.ndarray  # (p,) int64: a pair's slot, -1: none
    known: np.ndarray  # (p,) bool: whether it had the slot at the last step


class _Results(NamedTuple):
    """What threads write, each pair its own row."""

    begin: np.ndarray  # (p,) int64: a pair's contacts fill consecutive rows of its thread's Sink; -1: there was no room
    counts: np.ndarray  # (p,) int64
    bounds: np.ndarray  # (p,) float64 [m]
    visits: np.ndarray  # (p,) int64
    exhausted: np.ndarray  # (p,) uint8
    is_ahead: np.ndarray  # (p,) bool: whether some of its contacts lie in the future


class _Pass(NamedTuple):
    """A search of some pairs, and where their contacts are."""

    todo: np.ndarray  # (m,) int64
    contacts: np.ndarray  # (threads, room, 10) float64: rows of each thread's Sink
    ids: np.ndarray  # (threads, room, 5) int64
    begin: np.ndarray  # (p,) int64: first row of each pair, -1: not here


class _Own(NamedTuple):
    """What only one thread writes."""

    sink: Sink
    scratch: Scratch


@threaded_kernel
def _query_share(geometry, step, motion, rule, work, out, own, part):
    """Process every pair of work.todo that is a thread's, see Crew.share; pairs that are apart now also along `motion`.

    rule: with epsilon and near as shares of the smaller R; work: _Work; out: _Results; own: _Own.
    """
    pools, scratch = geometry.pools, own.scratch
    thread, threads = part
    used, room = 0, len(own.sink.contacts)
    todo, lists, slots = work.todo, work.lists, work.slots
    for k in range(thread, len(todo), threads):
        p = todo[k]
        if k + threads < len(todo):
            fetch_slot(lists, slots[todo[k + threads]])
        pair = put_pair(step, p, scratch.rotation, scratch.translation)
        out.is_ahead[p] = False
        if work.shares[p] == UNSEARCHED:
            out.bounds[p] = depth_limit_of_pair(pools, pair)
            out.begin[p], out.counts[p], out.visits[p], out.exhausted[p] = used, 0, 0, BY_LIMIT
            continue
        radius = min(pools.fragment.radius[pair.a], pools.fragment.radius[pair.b])
        its = Rule(rule.wanted, rule.most, rule.epsilon * radius, rule.near * radius, rule.limit)
        slot = Slot(lists, slots[p], work.known[p], motion.time > 0.0)
        sink = Sink(own.sink.contacts[used:], own.sink.ids[used:])
        limits = VisitLimits(work.shares[p], work.further[p])
        moving = Moving(step.pairs[p, 0], step.pairs[p, 1], step.rotations, step.positions, motion)
        is_patch, found, out.is_ahead[p] = patch_pair(geometry, pair, moving, its, slot, sink, scratch)
        if not is_patch:
            found = search_pair(geometry, pair, its, limits, slot, sink, scratch)
            if 0 < found.count <= room - used and pools.normals == FACING:
                turn_contacts(pools, pair, its.near, sink, found.count, scratch)
            if motion.time > 0.0:
                found, out.is_ahead[p] = look_ahead(geometry, pair, moving, its, found, slot, sink, scratch)
        out.begin[p], out.counts[p] = used, found.count
        out.bounds[p], out.visits[p], out.exhausted[p] = found.bound, found.visits, found.exhausted
        if found.count > room - used:
            out.begin[p] = -1
            continue
        used += found.count


@kernel
def _gather(step, todo, contacts, ids, begin, counts, offsets, out):
    """Write the contacts that a search has left to WorldContacts, from offsets[p] on."""
    for k in range(len(todo)):
        p, thread = todo[k], k % len(contacts)
        if begin[p] < 0:
            continue
        sink = Sink(contacts[thread], ids[thread])
        for c in range(counts[p]):
            put_in_world(step, p, sink, begin[p] + c, out, offsets[p] + c)


class _Search:
    """The passes over the pairs of a step. A pair that did not fit, or whose limits changed, is searched again."""

    def __init__(
        self, scene: Scene, rule: Rule, work: _Work, limits: WorkLimits, scratch: tuple[Scratch, ...], crew: Crew
    ) -> None:
        p = len(scene.step.pairs)
        self._scene, self._rule, self._work, self._limits = scene, rule, work, limits
        self._scratch, self._crew = scratch, crew
        self.passes: list[_Pass] = []
        self.out = _Results(
            np.empty(0, np.int64), np.zeros(p, np.int64), np.zeros(p), np.zeros(p, np.int64), np.zeros(p, np.uint8),
            np.zeros(p, np.bool_),
        )  # fmt: skip

    def run(self, moved: np.ndarray, stands_at: np.ndarray) -> np.ndarray:
        """Search the pairs `moved` (m,); returns the pairs cut short by their further visits.

        stands_at (p,): where the others stand in the last answer; -1 is written for those searched here to drop
        contacts.
        """
        counts, limits = self.out.counts, self._limits
        if len(moved):
            self._pass(moved, limits.contacts_per_pair, self._first_room(len(moved)))
        begin = self.passes[0].begin if self.passes else counts
        cuts, total, unstored = _tally(counts, self.out.exhausted, moved, begin)
        cut = np.flatnonzero(self.out.exhausted == BY_FURTHER) if cuts else _NONE
        if not (cuts or unstored or total > limits.contacts):
            return cut
        share = limits.further_visits // (2 * max(len(counts), 1))
        if cuts and limits.further_visits // (2 * cuts) > share:
            self._work.further[cut] = limits.further_visits // (2 * cuts)
            self._pass(cut, limits.contacts_per_pair, self._first_room(cuts))
        level = self._most_kept()
        is_stored = stands_at >= 0
        for searched in self.passes:
            is_stored[searched.todo] |= searched.begin[searched.todo] >= 0
        todo = np.flatnonzero(~is_stored | (counts > level))
        while len(todo):
            needed = np.minimum(counts[todo], level)
            room = max(int(needed[t :: self._crew.threads].sum()) for t in range(self._crew.threads))
            stands_at[todo] = -1
            todo = self._pass(todo, min(level, limits.contacts_per_pair), room)
            if not len(todo):  # pairs that did not fit had more contacts than counted before
                level = self._most_kept()
                todo = np.flatnonzero(counts > level)
        return cut

    def _pass(self, todo: np.ndarray, limit: int, room: int) -> np.ndarray:
        """Search the pairs `todo` with room for `room` contacts per thread; returns the pairs that did not fit."""
        threads, p = self._crew.threads, len(self.out.counts)
        contacts, ids = np.empty((threads, room, 10)), np.empty((threads, room, 5), np.int64)
        begin, its = np.empty(p, np.int64), self._work
        # only the first search of a pair uses its list
        slots = np.full(p, -1) if self.passes else its.slots
        work = _Work(todo, its.shares, its.further, its.lists, slots, its.known)
        own = [_Own(Sink(contacts[t], ids[t]), self._scratch[t]) for t in range(threads)]
        scene, rule, out = self._scene, Rule(*self._rule[:-1], limit), _Results(begin, *self.out[1:])
        self._crew.share(_query_share, scene.geometry, scene.step, scene.motion, rule, work, out, own=own)
        for earlier in self.passes:
            earlier.begin[todo] = -1
        self.passes.append(_Pass(todo, contacts, ids, begin))
        return todo[begin[todo] < 0]

    def _most_kept(self) -> int:
        counts, most = self.out.counts, self._limits.contacts
        return _level(counts, most) if int(counts.sum()) > most else UNLIMITED

    def _first_room(self, count: int) -> int:
        return max(LEAST_ROOM, min(FIRST_ROOM * count, self._limits.contacts) // self._crew.threads)

    def gather(self, offsets: np.ndarray) -> WorldContacts:
        """Contacts of all pairs searched, from offsets[p] on; offsets (p + 1,) int64."""
        columns = make_world_contacts(int(offsets[-1]))
        for searched in self.passes:
            _gather(self._scene.step, *searched, self.out.counts, offsets, columns)
        return columns


def query_pairs(
    scene: Scene, rule: Rule, scratch: tuple[Scratch, ...], crew: Crew, before: Remembered | None = None,
    limits: WorkLimits = NO_LIMITS,
) -> tuple[PairContacts, Remembered]:  # fmt: skip
    """Contacts of all pairs of a Scene, by a Rule whose epsilon and near are shares of the smaller R of the two bodies.

    before: state returned with the last answer from these pools, to speed up pairs that moved little; it is consumed.
    With a budget, or with None, nothing is reused or remembered. The answer does not depend on it, except for `visits`;
    an answer that is remembered must not be modified. Contacts that touch now are the same without scene.motion; pairs
    with limited visits are searched by the paper's rule, and not between samples. By our rule, crossings of ridges are
    contacts like those of samples.

    limits: all pairs share half of the further visits evenly; pairs whose share was too small share the other half. If
    there are too many contacts, the pairs with the most lose their shallowest ones, down to a common maximum;
    rule.limit has no effect. A budget replaces scene.overlaps. No share depends on lists: a pair answered from a list
    has fewer contacts than wanted, and a pair that a limit might cut short is not listed.
    """
    pools, step = scene.geometry.pools, scene.step
    p = len(step.pairs)
    slots, known, stands_at = np.full(p, -1), np.zeros(p, np.bool_), np.full(p, -1)
    lists, listed, moved = NO_LISTS, slots, np.arange(p)
    shares = np.full(p, limits.budget)
    if not limits.budget and scene.overlaps is not None:
        shares = visit_shares(pools, step.rows, step.pairs, scene.overlaps, limits.visits)
    if before is not None and not limits.budget:
        lists, slots, known = with_pairs(before.lists, pair_keys(step.rows, step.pairs))
        listed = slots
        if shares.any():
            is_limited = (shares != UNSHARED) & (shares < most_visits(pools, step.rows, step.pairs))
            listed = np.where(is_limited, -1, slots)
    share = limits.further_visits // (2 * max(p, 1))
    search = _Search(
        scene, rule, _Work(moved, shares, np.full(p, share), lists, listed, known), limits, scratch, crew
    )
    counts, bounds, visits, exhausted = search.out.counts, search.out.bounds, search.out.visits, search.out.exhausted
    poses = pose_bits(step.rotations, step.positions)
    if before is not None and lists is not NO_LISTS and before.answer.stamp == scene.stamp:
        stands_at, moved = pairs_in_place(
            before.answer, pools.fragment.kind, step, poses, (slots, known), (shares, share), (counts, bounds)
        )
        if scene.motion.time > 0.0:
            has_patches = len(scene.geometry.shapes.size) > 0
            moved = _without_those_that_leave(pools.fragment, step, scene.motion, counts, stands_at, has_patches)
    cut = search.run(moved, stands_at)
    offsets = begins_of(counts)
    columns = search.gather(offsets)
    searched = visits * (counts >= rule.wanted)
    if before is not None and lists is not NO_LISTS:
        gather_kept(before.answer, stands_at, offsets, columns, searched)
    found = PairContacts(counts, bounds, visits, exhausted, *columns)
    if scene.whole is not None:
        unlimited = np.flatnonzero((stands_at < 0) & (shares == UNSHARED))
        work = scene.geometry.shapes, unlimited, Close(lists.close, lists.toward, slots)
        rules = Rule(*rule[:-1], limits.contacts_per_pair), limits.contacts
        found, parted = part_interlocked(pools, scene.whole, step, scene.motion, work, rules, found, (scratch, crew))
        search.out.is_ahead[parted] = True
        offsets = begins_of(found.counts)
    if scene.elements is not None:
        judged = np.flatnonzero(stands_at < 0), shares == UNSHARED  # `run` marks those in place that it searched
        found = judge_pairs(pools, scene.elements, step, judged, rule, found, scratch, crew)
        offsets = begins_of(found.counts)
    if lists is NO_LISTS:
        return found, NOTHING_REMEMBERED
    slots[cut] = -1  # their second share may be smaller at the next step
    slots[search.out.is_ahead] = -1  # their look-ahead contacts hold for this step only
    index_of_row, pair_of_slot = indices_of_kept(step.rows, slots, len(lists.counts), found.exhausted)
    answer = KeptAnswer(
        scene.stamp, index_of_row, poses, pair_of_slot, searched, shares, share, offsets, found
    )
    return found, Remembered(lists, answer)


@kernel
def _without_those_that_leave(fragments, step, motion, counts, stands_at, has_patches):
    """Drop moving pairs from those in place (see pairs_in_place); returns the pairs that are not in place then (m,).

    Pairs that touch stay if they move so slowly that their present contacts are all they can have: not spheres, planes
    and patches, whose contacts are those of the end, too.
    """
    boxes, kinds = fragments.box, fragments.kind
    is_in_motion = is_moving(motion)
    for p in range(len(step.pairs)):
        i, j = step.pairs[p, 0], step.pairs[p, 1]
        if stands_at[p] < 0 or not (is_in_motion[i] or is_in_motion[j]):
            continue
        a, b = step.rows[i], step.rows[j]
        is_of_end = has_patches or kinds[a] in (SPHERE, PLANE) or kinds[b] in (SPHERE, PLANE)
        if counts[p] == 0 or is_of_end or may_get_through(boxes, a, b, i, j, motion):
            stands_at[p] = -1
    return np.flatnonzero(stands_at < 0)


@kernel
def _tally(counts, exhausted, searched, begin):
    """(pairs that ended BY_FURTHER, contacts of all pairs, pairs of `searched` that did not fit), numbers of each."""
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
