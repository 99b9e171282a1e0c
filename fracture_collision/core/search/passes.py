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
# Where the contacts of a pair are not.
NO_ROOM, ELSEWHERE = -1, -2


class Found(NamedTuple):
    """What the search of a pair found."""

    count: int  # type: ignore[assignment] # contacts
    bound: float  # [m] missed depth bound
    visits: int
    exhausted: int  # COMPLETE or BY_LIMIT
    clear: float  # [m] lower bound of the distance in excess of the detection tolerance, 0: unknown


class Results(NamedTuple):
    """What threads write: each thread its rows of contacts and ids, and of a pair the other columns."""

    contacts: np.ndarray  # (threads * room, 10) float64: rows of Sink
    ids: np.ndarray  # (threads * room, 5) int64
    used: np.ndarray  # (threads, 16) int64: how many of its rows a thread has used, then padding
    begin: np.ndarray  # (p,) int64: first row of a pair's contacts, NO_ROOM, or ELSEWHERE: not here
    counts: np.ndarray  # (p,) int64
    bounds: np.ndarray  # (p,) float64 [m]
    visits: np.ndarray  # (p,) int64
    exhausted: np.ndarray  # (p,) uint8
    clear: np.ndarray  # (p,) float64 [m]
    ahead: np.ndarray  # (p,) int64: of its contacts, how many lie in the future, the last ones


@query_kernel
def room_of(out, thread):
    """A Sink of the rows of Results that a thread has left."""
    room = len(out.contacts) // len(out.used)
    begin, end = thread * room + out.used[thread, 0], (thread + 1) * room
    return Sink(out.contacts[begin:end], out.ids[begin:end])


@query_kernel
def keep_found(out, p, thread, found):
    """Write the Found of pair p to Results; its contacts fill the first rows of room_of a thread, or had no room."""
    out.counts[p], out.bounds[p], out.visits[p] = found.count, found.bound, found.visits
    out.exhausted[p], out.clear[p] = found.exhausted, found.clear
    room = len(out.contacts) // len(out.used)
    if found.count <= room - out.used[thread, 0]:
        out.begin[p] = thread * room + out.used[thread, 0]
        out.used[thread, 0] += found.count


class Passes:
    """The query of a step's pairs. A pair whose contacts did not fit is searched again with room for them."""

    def __init__(self, step: Step, scratch: tuple[Scratch, ...], crew: Crew) -> None:
        p = len(step.pairs)
        self._step, self._scratch, self._crew, self._passes = step, scratch, crew, list[tuple[np.ndarray, Results]]()
        self.columns = (
            np.zeros(p, np.int64), np.zeros(p), np.zeros(p, np.int64), np.zeros(p, np.uint8), np.zeros(p),
            np.zeros(p, np.int64),
        )  # fmt: skip

    def new(self, todo: np.ndarray, again: bool) -> Results:
        """Results for pairs `todo` (m,); again: their columns say how many contacts they have."""
        threads = self._crew.threads
        room = int(self.columns[0][todo].sum()) if again else max(LEAST_ROOM, FIRST_ROOM * len(todo) // threads)
        out = Results(
            np.empty((threads * room, 10)), np.empty((threads * room, 5), np.int64), np.zeros((threads, 16), np.int64),
            np.full(len(self._step.pairs), NO_ROOM), *self.columns,
        )  # fmt: skip
        self._passes.append((todo, out))
        return out

    def run(self, query: Callable[..., None], *arguments: object) -> None:
        """Call query(*arguments, Scratch, part) in each thread, see Crew.share."""
        self._crew.share(query, *arguments, own=self._scratch)

    def gather(self, offsets: np.ndarray) -> WorldContacts:
        """Contacts of all pairs searched, from offsets[p] on; offsets (p + 1,) int64."""
        columns = make_world_contacts(int(offsets[-1]))
        for todo, out in self._passes:
            _gather(self._step, todo, out, offsets, columns)
        return columns


@kernel
def _gather(step, todo, found, offsets, columns):
    """Write the contacts of pairs `todo`, Results of their search, to WorldContacts, from offsets[p] on."""
    sink = Sink(found.contacts, found.ids)
    for p in todo:
        if found.begin[p] >= 0:
            for c in range(found.counts[p]):
                put_in_world(step, p, sink, found.begin[p] + c, columns, offsets[p] + c)


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
    bound_by_thickness(pools, step, cut, bounds, scratch)
    exhausted[cut] = BY_LIMIT
    columns = (column[stays] for column in (found.points_a, found.points_b, found.normals, found.gaps, found.samples))
    return PairContacts(np.minimum(counts, level), bounds, found.visits, exhausted, *columns)


@query_kernel
def bound_by_thickness(pools, step, todo, bounds, scratch):
    """Raise the bounds (p,) [m] of pairs `todo` of a Step to the depth that their boxes, or a plane, allow."""
    for p in todo:
        pair = put_pair(step, p, scratch.rotation, scratch.translation)
        bounds[p] = max(bounds[p], depth_limit_of_pair(pools, pair))


def _level(counts: np.ndarray, most: int) -> int:
    """The largest cap for which `counts` (p,), each clipped to it, sum to at most `most`."""
    ordered = np.sort(counts)
    fewer = np.cumsum(ordered) - ordered
    levels = (most - fewer) // np.arange(len(counts), 0, -1)
    return int(levels[np.argmax(levels < ordered)])
