"""A query of all pairs of a step in parallel.

Each pair writes to its own slot only, and contacts are gathered in pair order, so the answer is the same bytes for any
number of threads.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from fracture_collision.core.contacts.contact_places import WorldContacts, make_world_contacts, put_in_world
from fracture_collision.core.memory.compiled import kernel, query_kernel
from fracture_collision.core.memory.crew import Crew
from fracture_collision.core.memory.pair import Sink, Step, put_pair
from fracture_collision.core.memory.pools import Pools
from fracture_collision.core.search.depth_limits import depth_limit_of_pair
from fracture_collision.core.search.kept_answer import PairContacts
from fracture_collision.core.search.scratch import Scratch
from fracture_collision.core.search.work_limit import BY_LIMIT
from fracture_collision.grouping import begins_of

# Initial capacity for contacts: per pair on average, and at least for a thread's share of pairs. Pairs that overflow it
# are searched again. Memory that is never written costs nothing.
FIRST_ROOM = 64
LEAST_ROOM = 1 << 15


class Results(NamedTuple):
    """What threads write, each pair its own row."""

    begin: np.ndarray  # (p,) int64: a pair's contacts fill consecutive rows of its thread's Sink; -1: there was no room
    counts: np.ndarray  # (p,) int64
    bounds: np.ndarray  # (p,) float64 [m]
    visits: np.ndarray  # (p,) int64
    exhausted: np.ndarray  # (p,) uint8
    is_ahead: np.ndarray  # (p,) bool: whether some of its contacts lie in the future


class Own(NamedTuple):
    """What only one thread writes."""

    sink: Sink
    scratch: Scratch


class _Pass(NamedTuple):
    """A search of some pairs, and where their contacts are."""

    todo: np.ndarray  # (m,) int64
    contacts: np.ndarray  # (threads, room, 10) float64: rows of each thread's Sink
    ids: np.ndarray  # (threads, room, 5) int64
    begin: np.ndarray  # (p,) int64: first row of each pair, -1: not here


class Passes:
    """The query of a step's pairs. A pair whose contacts did not fit is searched again with room for them."""

    def __init__(self, step: Step, scratch: tuple[Scratch, ...], crew: Crew) -> None:
        p = len(step.pairs)
        self._step, self._scratch, self._crew, self._passes = step, scratch, crew, list[_Pass]()
        self.out = Results(
            np.empty(0, np.int64), np.zeros(p, np.int64), np.zeros(p), np.zeros(p, np.int64), np.zeros(p, np.uint8),
            np.zeros(p, np.bool_),
        )  # fmt: skip

    def run(self, query: Callable[..., None], todo: np.ndarray, *arguments: object) -> np.ndarray:
        """Call query(*arguments, todo, Results, Own, part) in each thread, see Crew.share; returns those without room.

        Pairs `todo` (m,): a thread has those at its number, its number + threads, and so on.
        """
        threads, p = self._crew.threads, len(self.out.counts)
        room = max(LEAST_ROOM, FIRST_ROOM * len(todo) // threads)
        if self._passes:  # how many each has is known
            room = max(int(self.out.counts[todo][t::threads].sum()) for t in range(threads))
        contacts, ids, begin = np.empty((threads, room, 10)), np.empty((threads, room, 5), np.int64), np.full(p, -1)
        own = [Own(Sink(contacts[t], ids[t]), self._scratch[t]) for t in range(threads)]
        self._crew.share(query, *arguments, todo, Results(begin, *self.out[1:]), own=own)
        self._passes.append(_Pass(todo, contacts, ids, begin))
        return todo[begin[todo] < 0]

    def gather(self, offsets: np.ndarray) -> WorldContacts:
        """Contacts of all pairs searched, from offsets[p] on; offsets (p + 1,) int64."""
        columns = make_world_contacts(int(offsets[-1]))
        for searched in self._passes:
            _gather(self._step, *searched, self.out.counts, offsets, columns)
        return columns


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


def within_limit(pools: Pools, step: Step, found: PairContacts, most: int, scratch: Scratch) -> PairContacts:
    """`found` with at most `most` contacts: the pairs with the most keep only their deepest, and have a bound."""
    if len(found.gaps) <= most:
        return found
    counts = found.counts
    level = _level(counts, most)
    pair = np.repeat(np.arange(len(counts)), counts)
    by_depth = np.lexsort((found.gaps, pair))
    rank = np.arange(len(pair)) - begins_of(counts)[:-1][pair]
    stays = np.zeros(len(pair), np.bool_)
    stays[by_depth[rank < level]] = True
    bounds, exhausted = found.bounds.copy(), found.exhausted.copy()
    cut = np.flatnonzero(counts > level)
    _bound_by_thickness(pools, step, cut, bounds, scratch)
    exhausted[cut] = BY_LIMIT
    columns = (column[stays] for column in (found.points_a, found.points_b, found.normals, found.gaps, found.samples))
    return PairContacts(np.minimum(counts, level), bounds, found.visits, exhausted, *columns)


@query_kernel
def _bound_by_thickness(pools, step, todo, bounds, scratch):
    for p in todo:
        pair = put_pair(step, p, scratch.rotation, scratch.translation)
        bounds[p] = max(bounds[p], depth_limit_of_pair(pools, pair))


def _level(counts: np.ndarray, most: int) -> int:
    """The largest cap for which `counts` (p,), each clipped to it, sum to at most `most`."""
    ordered = np.sort(counts)
    fewer = np.cumsum(ordered) - ordered
    levels = (most - fewer) // np.arange(len(counts), 0, -1)
    return int(levels[np.argmax(levels < ordered)])
