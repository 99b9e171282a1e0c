"""All pairs of a step, each searched by the quickest way that gives its contacts."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fracture_collision.core.contacts.contact_choice import Rule
from fracture_collision.core.lookahead.motion import NO_MOTION, Motion, is_moving
from fracture_collision.core.memory.compiled import kernel
from fracture_collision.core.memory.crew import Crew
from fracture_collision.core.memory.pair import Step
from fracture_collision.core.pair.pair_search import (
    CONVEX,
    Work,
    by_kind,
    search_ahead,
    search_convex,
    search_round,
    search_sampled,
)
from fracture_collision.core.patches.interlocked import SurfaceTable, bound_unsearched, part_interlocked
from fracture_collision.core.patches.shapes import Geometry
from fracture_collision.core.search.kept_answer import (
    NOTHING_KEPT,
    KeptAnswer,
    PairContacts,
    gather_kept,
    indices_of_kept,
    pairs_in_place,
    pose_bits,
)
from fracture_collision.core.search.neighbour_lists import (
    NO_SLOTS,
    NeighbourLists,
    Slots,
    pair_keys,
    with_pairs,
)
from fracture_collision.core.search.passes import NO_ROOM, Passes, Results
from fracture_collision.core.search.scratch import Scratch, make_scratch
from fracture_collision.grouping import begins_of


class Remembered(NamedTuple):
    """State kept from the last step: it makes the next one faster and never changes its result."""

    slots: Slots
    answer: KeptAnswer


NOTHING_REMEMBERED = Remembered(NO_SLOTS, NOTHING_KEPT)


class Scene(NamedTuple):
    """The input of a step: geometry, poses, motion and pairs."""

    geometry: Geometry
    step: Step
    motion: Motion = NO_MOTION  # of the fragments of `step`
    stamp: int = 0  # differs after any change of the pools
    whole: SurfaceTable | None = None  # surfaces of concave fragments; None: contacts of samples and ridges alone


def query_pairs(
    scene: Scene, rule: Rule, scratch: tuple[Scratch, ...], crew: Crew, before: Remembered = NOTHING_REMEMBERED
) -> tuple[PairContacts, Remembered]:
    """Contacts of all pairs of a Scene, by a Rule whose epsilon and near are shares of the smaller R of the two bodies.

    before: state returned with the last answer from these pools, to speed up pairs that moved little; it is consumed.
    The answer does not depend on it, except for `visits`; an answer that is remembered must not be modified. Contacts
    that touch now are the same without scene.motion. With rule.every > 1 nothing is reused or remembered, and pairs
    are not searched for pieces that have run into each other: their bounds are how deep such pieces can be.
    """
    geometry, step = scene.geometry, scene.step
    search = Passes(step, scratch, crew)
    counts, bounds, visits, exhausted, clear, ahead = search.columns
    stands_at, todo = np.full(len(counts), -1), np.arange(len(counts))
    if rule.every > 1:
        _search(search, scene, rule, NO_SLOTS.lists, Work(todo, stands_at, stands_at >= 0, scene.motion.time > 0.0))
        if scene.whole is not None:
            bound_unsearched(geometry, (step, todo[clear <= 0.0]), rule, bounds, scratch[0])
        return PairContacts(counts, bounds, visits, exhausted, *search.gather(begins_of(counts))), NOTHING_REMEMBERED
    kept, slots, known = with_pairs(before.slots, pair_keys(step.rows, step.pairs))
    poses = pose_bits(step.rotations, step.positions)
    if before.answer.stamp == scene.stamp:
        stands_at, todo = pairs_in_place(before.answer, step, poses, (slots, known), (counts, bounds))
        if scene.motion.time > 0.0:
            todo = _without_those_that_move(step, scene.motion, stands_at)
    _search(search, scene, rule, kept.lists, Work(todo, slots, known, scene.motion.time > 0.0))
    offsets = begins_of(counts)
    columns = search.gather(offsets)
    gather_kept(before.answer, stands_at, offsets, columns)
    found = PairContacts(counts, bounds, visits, exhausted, *columns)
    if scene.whole is not None:
        found, parted = part_interlocked(
            geometry, scene.whole, (step, scene.motion), (kept.lists, slots, todo), rule, (found, ahead),
            (scratch, crew),
        )  # fmt: skip
        ahead[parted] = found.counts[parted]
    slots[ahead > 0] = -1  # their contacts hold for this step only
    index_of_row, pair_of_slot = indices_of_kept(step.rows, slots, len(kept.lists.counts), found.exhausted)
    answer = KeptAnswer(scene.stamp, index_of_row, poses, pair_of_slot, begins_of(found.counts), found)
    return found, Remembered(kept, answer)


def _search(search: Passes, scene: Scene, rule: Rule, lists: NeighbourLists, work: Work) -> None:
    """Search the pairs of a Work, each by the search of its kind, then ahead."""
    geometry, moving, step = scene.geometry, (scene.step, scene.motion), scene.step
    searches = (search_convex, moving), (search_round, step), (search_sampled, step)  # by kind
    again = False
    while len(work.todo):
        out = search.new(work.todo, again)
        todo, counts = by_kind(geometry, step, work.todo)
        for (query, at), own in zip(searches, np.split(todo, np.cumsum(counts)[:-1]), strict=True):
            if len(own):
                search.run(query, geometry, lists, at, rule, work._replace(todo=own), out)
        left = todo[out.begin[todo] == NO_ROOM]
        if work.for_motion:
            own = todo[counts[CONVEX] :]
            _search_ahead(search, scene, rule, lists, work._replace(todo=own[out.begin[own] != NO_ROOM]), out)
        work, again = Work(left, np.full(len(work.slots), -1), work.known, work.for_motion), True


def _search_ahead(
    search: Passes, scene: Scene, rule: Rule, lists: NeighbourLists, work: Work, now: Results
) -> None:  # fmt: skip
    """Search ahead for the pairs of a Work whose contacts of now are in `now`."""
    # a search that has no room writes how many contacts there are in all to the columns that all Results share
    now, again = now._replace(counts=now.counts.copy()), False
    while len(work.todo):
        out = search.new(work.todo, again)
        search.run(search_ahead, scene.geometry, lists, (scene.step, scene.motion), rule, (work, now), out)
        work, again = work._replace(todo=work.todo[out.begin[work.todo] == NO_ROOM]), True


def compile_largest(geometry: Geometry) -> None:
    """Compile the search of sampled pairs, a third of the compile time. `geometry` may have no bodies yet."""
    step = Step(np.zeros(0, np.int64), np.zeros((0, 3, 3)), np.zeros((0, 3)), np.zeros((0, 2), np.int64))
    search, todo = Passes(step, (make_scratch(0, 0),), Crew(1)), np.zeros(0, np.int64)
    work = Work(todo, np.zeros(0, np.int64), np.zeros(0, np.bool_), False)
    search.run(search_sampled, geometry, NO_SLOTS.lists, step, Rule(0, 0, 0.0, 0.0), work, search.new(todo, False))


@kernel
def _without_those_that_move(step, motion, stands_at):
    """Drop moving pairs from those in place (see pairs_in_place); returns the pairs that are not in place then (m,)."""
    is_in_motion = is_moving(motion)
    for p in range(len(step.pairs)):
        if is_in_motion[step.pairs[p, 0]] or is_in_motion[step.pairs[p, 1]]:
            stands_at[p] = -1
    return np.flatnonzero(stands_at < 0)
