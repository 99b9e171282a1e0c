"""Our time when the contacting samples are known in advance: they are queried again, and no others."""

from __future__ import annotations

from collections.abc import Callable
from statistics import median
from time import perf_counter

import numpy as np

from fracture_collision.core.contacts.contact_choice import ANSWER, ENTRY, SIDE, Rule, put_chosen
from fracture_collision.core.contacts.facing_normal import turn_contacts
from fracture_collision.core.contacts.known_samples import rounding_slack
from fracture_collision.core.edges.ridges import NO_RIDGES
from fracture_collision.core.memory.compiled import threaded_kernel
from fracture_collision.core.memory.crew import Crew
from fracture_collision.core.memory.pair import Sink, Step, make_sink, put_pair
from fracture_collision.core.memory.pools import Pools
from fracture_collision.core.pair.narrow_phase import Scene, query_pairs
from fracture_collision.core.patches.shapes import Geometry
from fracture_collision.core.search.kept_answer import PairContacts
from fracture_collision.core.search.scratch import make_scratch
from fracture_collision.records import ContactConstraintArray, FragmentStates
from fracture_collision.world import CollisionWorld

ROUNDS = 9


def contacts_alone(service: CollisionWorld, states: FragmentStates, answer: ContactConstraintArray) -> float:
    """[ms], one thread, median: each sample in contact located, its nearest surface found and its normal turned.

    Of the pairs of `answer`, all as if both were concave: its own patches and crossings of edges are of no sample.
    """
    here, pools, settings = service.present(states), service.geometry.pools, service.settings
    order = np.argsort(here.ids)
    ends = (order[np.searchsorted(here.ids[order], end)] for end in (answer.fragment_a, answer.fragment_b))
    pairs = np.column_stack(tuple(ends)).astype(np.int64)
    samples = pools.fragment.sample_end - pools.fragment.sample_begin
    scratch = make_scratch(len(pools.mesh.tetrahedra), 2 * int(samples[here.rows].max()) + 2)
    step = Step(here.rows, here.rotations, here.positions, pairs)
    rule = Rule(
        settings.contacts_per_pair, 2 * settings.contacts_per_pair, settings.penetration_tolerance,
        settings.detection_tolerance,
    )  # fmt: skip
    found, _ = query_pairs(Scene(Geometry(pools, NO_RIDGES), step), rule, (scratch,), Crew(1))
    begin = np.concatenate(([0], np.cumsum(found.counts)))
    listed = _entries(pools, here.rows, pairs, found)
    sink = make_sink(int(begin[-1]))

    def ask() -> None:
        asked = _ask(pools, step, begin, listed, settings.detection_tolerance, sink, scratch)
        assert asked == begin[-1]

    ask()
    return 1e3 * median(_seconds(ask) for _ in range(ROUNDS))


def _seconds(once: Callable[[], None]) -> float:
    began = perf_counter()
    once()
    return perf_counter() - began


def _entries(pools: Pools, rows: np.ndarray, pairs: np.ndarray, found: PairContacts) -> np.ndarray:
    """(n,) int32 in neighbour-list format: 2 (row of SamplePool) + side."""
    of_pair = np.repeat(pairs, found.counts, axis=0)
    own = rows[np.where(found.samples[:, 0] == 0, of_pair[:, 0], of_pair[:, 1])]
    listed = np.empty(len(own), np.int32)
    for row in np.unique(own):
        begin, end = pools.fragment.sample_begin[row], pools.fragment.sample_end[row]
        numbers = pools.samples.numbers[begin:end]
        order = np.argsort(numbers, kind="stable")
        its = np.flatnonzero(own == row)
        listed[its] = 2 * (begin + order[np.searchsorted(numbers[order], found.samples[its, 1])])
    return listed + found.samples[:, 0].astype(np.int32)


@threaded_kernel
def _ask(pools, step, begin, listed, near, found, scratch):
    """Fill the Sink `found`, each pair's from begin[p] on; returns the number of contacts."""
    total = 0
    for p in range(len(step.pairs)):
        pair = put_pair(step, p, scratch.rotation, scratch.translation)
        first, last = begin[p], begin[p + 1]
        within = near * min(pools.fragment.radius[pair.a], pools.fragment.radius[pair.b])
        sink, count = Sink(found.contacts[first:last], found.ids[first:last]), last - first
        for k in range(count):
            scratch.node_int[k, ENTRY], scratch.node_int[k, SIDE] = listed[first + k] >> 1, listed[first + k] & 1
            scratch.node_int[k, ANSWER] = -1
        slack = rounding_slack(pools, pair.a, pair.b, pair.translation)
        put_chosen(pools, pair, within, slack, sink, count, scratch)
        turn_contacts(pools, pair, within, sink, count, scratch)
        total += count
    return total
