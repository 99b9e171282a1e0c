"""All pairs of a step, each searched by the quickest way that gives its contacts."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fracture_collision.core.contacts.contact_choice import Rule
from fracture_collision.core.contacts.facing_normal import turn_contacts
from fracture_collision.core.lookahead.motion import NO_MOTION, Motion, Moving, is_moving
from fracture_collision.core.memory.compiled import kernel, threaded_kernel
from fracture_collision.core.memory.crew import Crew
from fracture_collision.core.memory.pair import Sink, Step, put_pair
from fracture_collision.core.pair.pair_search import Geometry, Slot, look_ahead, patch_pair, search_pair
from fracture_collision.core.patches.interlocked import Close, SurfaceTable, part_interlocked
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
from fracture_collision.core.search.passes import Passes
from fracture_collision.core.search.scratch import Scratch
from fracture_collision.grouping import begins_of


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
    stamp: int = 0  # differs after any change of the pools
    whole: SurfaceTable | None = None  # surfaces of concave fragments; None: contacts of samples and ridges alone


class _Lists(NamedTuple):
    """The neighbour lists of the pairs."""

    lists: NeighbourLists
    slots: np.ndarray  # (p,) int64: a pair's slot, -1: none
    known: np.ndarray  # (p,) bool: whether it had the slot at the last step


@threaded_kernel
def _query_share(geometry, moving, rule, work, todo, out, own, part):
    """Process every pair of `todo` (m,) that is a thread's, see Crew.share.

    moving: a Step and its Motion, which pairs that are apart are searched along; rule: with epsilon and near as shares
    of the smaller R; work: _Lists; out: Results; own: Own.
    """
    (step, motion), pools, scratch = moving, geometry.pools, own.scratch
    thread, threads = part
    used, room = 0, len(own.sink.contacts)
    lists, slots = work.lists, work.slots
    for k in range(thread, len(todo), threads):
        p = todo[k]
        if k + threads < len(todo):
            fetch_slot(lists, slots[todo[k + threads]])
        pair = put_pair(step, p, scratch.rotation, scratch.translation)
        radius = min(pools.fragment.radius[pair.a], pools.fragment.radius[pair.b])
        its = Rule(rule.wanted, rule.most, rule.epsilon * radius, rule.near * radius, rule.every)
        slot = Slot(lists, slots[p], work.known[p], motion.time > 0.0)
        sink = Sink(own.sink.contacts[used:], own.sink.ids[used:])
        moving = Moving(step.pairs[p, 0], step.pairs[p, 1], step.rotations, step.positions, motion)
        is_patch, found, out.is_ahead[p] = patch_pair(geometry, pair, moving, its, slot, sink, scratch)
        if not is_patch:
            found = search_pair(geometry, pair, its, slot, sink, scratch)
            if 0 < found.count <= room - used:
                turn_contacts(pools, pair, its.near, sink, found.count, scratch)
            if motion.time > 0.0:
                found, out.is_ahead[p] = look_ahead(geometry, pair, moving, its, found, slot, sink, scratch)
        out.begin[p], out.counts[p] = used, found.count
        out.bounds[p], out.visits[p], out.exhausted[p] = found.bound, found.visits, found.exhausted
        if found.count > room - used:
            out.begin[p] = -1
            continue
        used += found.count


def query_pairs(
    scene: Scene, rule: Rule, scratch: tuple[Scratch, ...], crew: Crew, before: Remembered = NOTHING_REMEMBERED
) -> tuple[PairContacts, Remembered]:
    """Contacts of all pairs of a Scene, by a Rule whose epsilon and near are shares of the smaller R of the two bodies.

    before: state returned with the last answer from these pools, to speed up pairs that moved little; it is consumed.
    The answer does not depend on it, except for `visits`; an answer that is remembered must not be modified. Contacts
    that touch now are the same without scene.motion. With rule.every > 1 nothing is reused or remembered, and pairs
    are not searched for pieces that have run into each other.
    """
    geometry, step = scene.geometry, scene.step
    pools = geometry.pools
    search = Passes(step, scratch, crew)
    counts, bounds, visits, exhausted = search.out.counts, search.out.bounds, search.out.visits, search.out.exhausted
    stands_at, moved = np.full(len(counts), -1), np.arange(len(counts))
    if rule.every > 1:
        _run(search, scene, rule, _Lists(NO_LISTS, stands_at, stands_at >= 0), moved)
        return PairContacts(counts, bounds, visits, exhausted, *search.gather(begins_of(counts))), NOTHING_REMEMBERED
    lists, slots, known = with_pairs(before.lists, pair_keys(step.rows, step.pairs))
    poses = pose_bits(step.rotations, step.positions)
    if before.answer.stamp == scene.stamp:
        stands_at, moved = pairs_in_place(before.answer, step, poses, (slots, known), (counts, bounds))
        if scene.motion.time > 0.0:
            moved = _without_those_that_move(step, scene.motion, stands_at)
    _run(search, scene, rule, _Lists(lists, slots, known), moved)
    offsets = begins_of(counts)
    columns = search.gather(offsets)
    gather_kept(before.answer, stands_at, offsets, columns)
    found = PairContacts(counts, bounds, visits, exhausted, *columns)
    if scene.whole is not None:
        work = geometry.shapes, moved, Close(lists.close, lists.toward, slots)
        found, parted = part_interlocked(
            pools, scene.whole, step, scene.motion, work, rule, found, (scratch, crew)
        )
        search.out.is_ahead[parted] = True
    slots[search.out.is_ahead] = -1  # their look-ahead contacts hold for this step only
    index_of_row, pair_of_slot = indices_of_kept(step.rows, slots, len(lists.counts), found.exhausted)
    answer = KeptAnswer(scene.stamp, index_of_row, poses, pair_of_slot, begins_of(found.counts), found)
    return found, Remembered(lists, answer)


def _run(search: Passes, scene: Scene, rule: Rule, work: _Lists, todo: np.ndarray) -> None:
    slots = work.slots.copy()
    while len(todo):
        now = work._replace(slots=slots)
        todo = search.run(_query_share, todo, scene.geometry, (scene.step, scene.motion), rule, now)
        slots[todo] = -1  # only the first search of a pair uses its list


@kernel
def _without_those_that_move(step, motion, stands_at):
    """Drop moving pairs from those in place (see pairs_in_place); returns the pairs that are not in place then (m,)."""
    is_in_motion = is_moving(motion)
    for p in range(len(step.pairs)):
        if is_in_motion[step.pairs[p, 0]] or is_in_motion[step.pairs[p, 1]]:
            stands_at[p] = -1
    return np.flatnonzero(stands_at < 0)
