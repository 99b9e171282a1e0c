"""Cost of breaking a small fragment of a large body in many pieces: it depends on the size of what breaks."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import islice
from time import perf_counter
from typing import NamedTuple

import numpy as np

from benchmarks.peers.worlds import DENSITY, empty_states
from benchmarks.scaling.growth import Progress, silent
from fracture_collision.fracture.pattern import PatternSettings
from fracture_collision.geometry.generators import TetGeometry
from fracture_collision.geometry.sampled_bodies import sampled_ball
from fracture_collision.records import CollisionBody, FractureEvent
from fracture_collision.simulation.breakable_body import BreakableBody
from fracture_collision.world import CollisionWorld, Settings

PIECES, SMALL_PIECES = 150, 4  # seeds of the first fracture, and of each fracture that is timed
MIDDLE = 0.75, 1.3  # sizes of the fragments that are broken, relative to the mean
WARM_UPDATES = 4


class SmallUpdateRow(NamedTuple):
    """Medians over the timed events, one thread; times in ms."""

    nodes: int
    fragments: int  # before the first timed event
    events: int
    broken_nodes: float  # of the fragment that breaks
    pieces: float  # that it breaks into
    check: float  # add_fracture
    update: float  # last_timings["update"] of the first states that need the event's registry
    masses: float  # fragments()
    whole: float  # sum of the three
    worst: float  # the largest of `whole`


def body_of_30000() -> TetGeometry:
    """30,764 nodes, in PIECES pieces of about 200 each."""
    return sampled_ball(1.0, 26, 24_000)


def measure_small_updates(
    geometry: TetGeometry, pieces: int = PIECES, events: int = 24, progress: Progress = silent
) -> list[SmallUpdateRow]:
    """The fragments break one after the other; each is a piece of the first fracture.

    Each event is made just before it is timed, so that caches are as a simulator leaves them.
    """
    progress(f"a body of {len(geometry.vertices)} nodes in {pieces} pieces")
    world = CollisionWorld(Settings(threads=1))
    world.add_body(
        CollisionBody(
            1, 1, vertices=geometry.vertices, tetrahedra=geometry.tetrahedra, density=DENSITY
        )
    )
    breaks = _breaks(geometry, pieces)
    world.add_fracture(next(breaks))
    world.contacts(empty_states(1))
    fragments = len(world.fragments().fragment_ids)
    times, sizes = [], []
    for event in islice(breaks, WARM_UPDATES + events):
        began = perf_counter()
        world.add_fracture(event)
        checked = perf_counter()
        world.contacts(empty_states(event.sequence))
        asked = perf_counter()
        world.fragments()
        times.append((checked - began, world.last_timings["update"], perf_counter() - asked))
        sizes.append((len(event.nodes), len(event.new_fragment_ids)))
    timed = 1e3 * np.array(times[WARM_UPDATES:])
    whole = timed.sum(axis=1)
    return [
        SmallUpdateRow(
            len(geometry.vertices), fragments, len(timed), *np.median(sizes[WARM_UPDATES:], axis=0).tolist(),
            *np.median(timed, axis=0).tolist(), float(np.median(whole)), float(whole.max()),
        )
    ]  # fmt: skip


def _breaks(geometry: TetGeometry, pieces: int) -> Iterator[FractureEvent]:
    """Breaks the body into about `pieces` pieces, by seeds throughout it, then each piece near the mean size."""
    body, random = BreakableBody(1, 1, geometry), np.random.default_rng(0)

    def fracture(fragment_id: int, sequence: int, first_new_id: int, seeds: int) -> FractureEvent | None:
        evenly = PatternSettings(seeds=seeds, seeds_per_overload=seeds, concentration=0.0)
        return body.fracture(fragment_id, sequence, first_new_id, np.zeros(3), 1.0, evenly, random)

    last = fracture(1, 1, 2, pieces)
    yield last
    first_ids = last.new_fragment_ids.tolist()
    mean = len(geometry.vertices) / len(first_ids)
    for fragment_id in first_ids:
        if not MIDDLE[0] * mean < body.node_count(fragment_id) < MIDDLE[1] * mean:
            continue
        event = fracture(fragment_id, last.sequence + 1, int(last.new_fragment_ids.max()) + 1, SMALL_PIECES)
        if event is not None:
            last = event
            yield event
