"""A query's time as a function of the size of a pile, and with one thread and two."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from statistics import median
from time import perf_counter
from typing import NamedTuple

import numpy as np

from benchmarks.peers.worlds import World
from benchmarks.scaling.machine import second_core
from benchmarks.scaling.piles import Pile, make_pile, world_of
from fracture_collision.world import CollisionWorld, Settings

ONE_THREAD = Settings(threads=1)

Progress = Callable[[str], None]


def silent(text: str) -> None:
    """Reports no progress."""


class GrowthRow(NamedTuple):
    """One pile, one thread; times in ms, medians."""

    fragments: int
    close_pairs: int  # found by the broad phase
    contact_pairs: int
    contacts: int
    visits: int
    broad_phase: float
    narrow_phase: float
    whole: float  # the call, from Python
    microseconds_a_pair: float  # whole / close pairs


class Exponents(NamedTuple):
    """b of time ~ n^b, a least-squares fit of the logarithms over all piles."""

    over_close_pairs: float  # the whole call
    over_contact_pairs: float
    broad_over_fragments: float
    steepest: float  # of the whole call over close pairs, between two successive piles


class ThreadsRow(NamedTuple):
    """One pile with one thread and two, interleaved; times in ms, medians."""

    fragments: int
    contacts: int
    one: float  # the whole call
    two: float
    speed_up: float  # median of the ratios of adjacent runs
    narrow_speed_up: float  # of the narrow phase alone
    machine_speed_up: float  # of a loop without memory access, shared by two threads: the machine's limit at that time
    same_bytes: bool


def measure_growth(
    source: World, sizes: Sequence[int], repeats: int = 7, progress: Progress = silent
) -> list[GrowthRow]:
    """Piles of `sizes` fragments, all made first and then queried in turn, so that a slow phase affects all of them.

    They do not move between queries; each is searched as if it had.
    """
    worlds: list[tuple[CollisionWorld, Pile]] = []
    for size in sizes:
        progress(f"a pile of {size}")
        pile = make_pile(source, size)
        worlds.append((world_of(pile, ONE_THREAD), pile))
    times: list[list[tuple[float, float, float]]] = [[] for _ in worlds]
    answers = [world.contacts(pile.states) for world, pile in worlds]  # warms up
    for i in range(repeats):
        progress(f"piles, round {i + 1} of {repeats}")
        for k, (world, pile) in enumerate(worlds):
            world.forget()
            began = perf_counter()
            world.contacts(pile.states)
            whole = perf_counter() - began
            times[k].append((world.last_timings["broad_phase"], world.last_timings["narrow_phase"], whole))
    rows = []
    for size, (world, _), answer, its in zip(sizes, worlds, answers, times, strict=True):
        broad, narrow, whole = (1e3 * median(column) for column in zip(*its, strict=True))
        with_contacts = int(np.count_nonzero(np.diff(answer.pair_begin)))
        rows.append(
            GrowthRow(
                size, world.last_pairs, with_contacts, len(answer.gaps), world.last_visits, broad, narrow, whole,
                1e3 * whole / world.last_pairs,
            )
        )  # fmt: skip
    return rows


def fit_exponents(rows: Sequence[GrowthRow]) -> Exponents:
    def slope(x: list[float], y: list[float]) -> float:
        return float(np.polyfit(np.log(x), np.log(y), 1)[0])

    pairs, whole = [row.close_pairs for row in rows], [row.whole for row in rows]
    steps = np.diff(np.log(whole)) / np.diff(np.log(pairs))
    return Exponents(
        slope(pairs, whole),
        slope([row.contact_pairs for row in rows], whole),
        slope([row.fragments for row in rows], [row.broad_phase for row in rows]),
        float(steps.max()),
    )


def measure_threads(source: World, size: int, repeats: int = 15, progress: Progress = silent) -> list[ThreadsRow]:
    """The same pile with one thread and two, in turn, in alternating order."""
    progress(f"a pile of {size} twice")
    pile = make_pile(source, size)
    worlds = [world_of(pile, ONE_THREAD._replace(threads=threads)) for threads in (1, 2)]
    answers = [world.contacts(pile.states) for world in worlds]
    times: list[list[float]] = [[], []]
    narrow: list[list[float]] = [[], []]
    machine = []
    for i in range(repeats):
        progress(f"threads, round {i + 1} of {repeats}")
        for k in (0, 1) if i % 2 else (1, 0):
            worlds[k].forget()
            began = perf_counter()
            worlds[k].contacts(pile.states)
            times[k].append(perf_counter() - began)
            narrow[k].append(worlds[k].last_timings["narrow_phase"])
        machine.append(second_core())
    one, two = np.array(times)
    row = ThreadsRow(
        size, len(answers[0].gaps), 1e3 * float(np.median(one)), 1e3 * float(np.median(two)),
        float(np.median(one / two)), float(np.median(np.divide(*narrow))), float(np.median(machine)),
        all(np.asarray(a).tobytes() == np.asarray(b).tobytes() for a, b in zip(*answers, strict=True)),
    )  # fmt: skip
    return [row]
