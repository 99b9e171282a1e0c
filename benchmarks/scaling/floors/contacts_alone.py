"""Our time when the contacting samples are known in advance: an answer's samples are queried again, and no others."""

from __future__ import annotations

from collections.abc import Callable
from statistics import median
from time import perf_counter
from typing import NamedTuple

import numpy as np

from fracture_collision.core.contacts.contact_choice import ANSWER, ENTRY, SIDE, put_chosen
from fracture_collision.core.contacts.facing_normal import turn_contacts
from fracture_collision.core.contacts.known_samples import rounding_slack
from fracture_collision.core.memory.compiled import threaded_kernel
from fracture_collision.core.memory.crew import Crew
from fracture_collision.core.memory.pools import OWN_SAMPLE, SAMPLE, SURFACE, Pools
from fracture_collision.core.pair.narrow_phase import PairContacts, query_pairs, relative_pose
from fracture_collision.core.search.scratch import make_scratch
from fracture_collision.records import ContactConstraintArray, FragmentStates
from fracture_collision.world import CollisionWorld
from fracture_collision.world.settings import most_listed

ROUNDS = 9


class Placed(NamedTuple):
    """The first arguments of query_pairs."""

    pools: Pools
    rows: np.ndarray
    rotations: np.ndarray
    positions: np.ndarray
    pairs: np.ndarray


class Known(NamedTuple):
    """The samples known in advance."""

    begin: np.ndarray  # (p + 1,) of each pair
    entries: np.ndarray  # (n,) in neighbour-list format


class Rows(NamedTuple):
    """Contacts and their ids, as query_pair writes them."""

    contacts: np.ndarray  # (n, 10)
    ids: np.ndarray  # (n, 5)


def contacts_alone(service: CollisionWorld, states: FragmentStates, answer: ContactConstraintArray) -> float:
    """[ms], one thread, median: each sample of `answer` located, its nearest surface found and its normal turned."""
    here, pools, settings = service.present(states), service.geometry.pools, service.settings
    order = np.argsort(here.ids)
    ends = (order[np.searchsorted(here.ids[order], end)] for end in (answer.fragment_a, answer.fragment_b))
    pairs = np.column_stack(tuple(ends)).astype(np.int64)
    nodes = 2 * max(service.geometry.tree_entries(row) for row in here.rows.tolist()) + 2
    scratch = make_scratch(1, len(pools.mesh.tetrahedra), nodes)
    placed = Placed(pools, here.rows, here.rotations, here.positions, pairs)
    found, _ = query_pairs(
        *placed, settings.contacts_per_pair, most_listed(settings), settings.penetration_tolerance,
        settings.detection_tolerance, 0, scratch, Crew(1),
    )  # fmt: skip
    begin = np.concatenate(([0], np.cumsum(found.counts)))
    known = Known(begin, _entries(pools, here.rows, pairs, found))
    out = Rows(np.empty((begin[-1], 10)), np.empty((begin[-1], 5), np.int64))

    def ask() -> None:
        asked = _ask(placed, known, settings.detection_tolerance, out, scratch)
        assert asked == begin[-1] == len(answer.gaps)

    ask()
    return 1e3 * median(_seconds(ask) for _ in range(ROUNDS))


def _seconds(once: Callable[[], None]) -> float:
    began = perf_counter()
    once()
    return perf_counter() - began


def _entries(pools: Pools, rows: np.ndarray, pairs: np.ndarray, found: PairContacts) -> np.ndarray:
    """(n,) int32 in neighbour-list format: 2 (row of TreePool that holds the sample) + side."""
    of_pair = np.repeat(pairs, found.counts, axis=0)
    own = rows[np.where(found.samples[:, 0] == 0, of_pair[:, 0], of_pair[:, 1])]
    listed = np.empty(len(own), np.int32)
    for row in np.unique(own):
        begin, end = pools.fragment.tree_begin[row], pools.fragment.tree_end[row]
        entries = pools.tree.entries[begin:end]
        on_sample = np.flatnonzero(entries[:, SURFACE] == OWN_SAMPLE)
        order = on_sample[np.argsort(entries[on_sample, SAMPLE], kind="stable")]
        its = np.flatnonzero(own == row)
        listed[its] = 2 * (begin + order[np.searchsorted(entries[order, SAMPLE], found.samples[its, 1])])
    return listed + found.samples[:, 0].astype(np.int32)


@threaded_kernel
def _ask(placed, known, near, found, scratch):
    """Fills `found` like query_pair; returns the number of contacts."""
    pools, rows, rotations, positions, pairs = placed
    begin, listed = known
    rotation, translation = scratch.rotation[0], scratch.translation[0]
    total = 0
    for p in range(len(pairs)):
        i, j, first, last = pairs[p, 0], pairs[p, 1], begin[p], begin[p + 1]
        a, b = rows[i], rows[j]
        relative_pose(rotations[i], positions[i], rotations[j], positions[j], rotation[0], translation[0])
        relative_pose(rotations[j], positions[j], rotations[i], positions[i], rotation[1], translation[1])
        within = near * min(pools.fragment.radius[a], pools.fragment.radius[b])
        out, out_ids = found.contacts[first:last], found.ids[first:last]
        count = last - first
        for k in range(count):
            scratch.node_int[0, k, ENTRY], scratch.node_int[0, k, SIDE] = listed[first + k] >> 1, listed[first + k] & 1
            scratch.node_int[0, k, ANSWER] = -1
        slack = rounding_slack(pools, a, b, translation)
        put_chosen(pools, a, b, rotation, translation, within, slack, out, out_ids, count, scratch, 0)
        turn_contacts(pools, a, b, rotation, translation, within, out, out_ids, count, scratch, 0)
        total += count
    return total
