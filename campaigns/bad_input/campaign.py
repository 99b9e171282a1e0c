"""Many cases, by number: the same number and seed give the same case on any machine with any number of workers."""

from __future__ import annotations

import ctypes
import faulthandler
import gc
import os
from collections import Counter
from collections.abc import Iterable, Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from multiprocessing import get_context
from pathlib import Path
from time import perf_counter
from typing import NamedTuple

import numpy as np

from campaigns.bad_input.clean_scene import SETTINGS
from campaigns.bad_input.mutations import Pick
from campaigns.bad_input.trial import TABLES, Bench, Case, fixed_cases, several, single, spoilt
from fracture_collision.world import Settings

CHUNK = 500
PATIENCE = 300.0  # [s] for a chunk, which takes a second; after that, something hangs
TOPICS = tuple(TABLES)
DOORS = ("records", "messages")


class Problem(NamedTuple):
    case: str
    door: str
    name: str
    text: str


class Tally(NamedTuple):
    """The results of some cases; tallies can be added."""

    outcomes: Counter[tuple[str, str, str]]  # topic, door, outcome
    kinds: Counter[tuple[str, str]]  # topic, kind
    sites: Counter[tuple[str, int]]  # file, line
    readers: Counter[tuple[str, str]]  # topic, which readers accept a message's bytes
    problems: list[Problem]
    slowest: tuple[float, str]  # [s], case
    resident: dict[int, list[int]]  # process -> resident memory after each chunk [bytes]

    @property
    def cases(self) -> int:
        return sum(self.outcomes.values())

    def __add__(self, other: Tally) -> Tally:
        return Tally(
            self.outcomes + other.outcomes, self.kinds + other.kinds, self.sites + other.sites,
            self.readers + other.readers, self.problems + other.problems, max(self.slowest, other.slowest),
            {pid: self.resident.get(pid, []) + other.resident.get(pid, [])
             for pid in {**self.resident, **other.resident}},
        )  # fmt: skip


def nothing() -> Tally:
    return Tally(Counter(), Counter(), Counter(), Counter(), [], (0.0, ""), {})


def numbered(seed: int, number: int) -> tuple[str, Case]:
    """Door and case: single mutations, in table order, alternate with two or three at once.

    At the message door they also alternate with corrupted bytes.
    """
    turn, rest = divmod(number, len(TOPICS) * len(DOORS))
    topic, door = TOPICS[rest % len(TOPICS)], DOORS[rest // len(TOPICS)]
    pick = picking(seed, number)
    entry, form = divmod(turn, 2)
    if form == 0:
        case = single(topic, entry, pick)
    elif door == "messages":
        case = spoilt(topic, pick)
    else:
        case = several(topic, entry, pick, 2 + entry % 2)
    return (door if case.on_the_wire else "records"), case


def picking(*seed: int) -> Pick:
    generator = np.random.default_rng(seed)
    return lambda below: int(generator.integers(0, below - 1, dtype=np.uint64, endpoint=True))


def every_case(seed: int) -> Iterator[tuple[str, Case]]:
    """All fixed cases, and every mutation of the tables once through each door."""
    for case in fixed_cases():
        for door in DOORS[: 1 + case.on_the_wire]:
            yield door, case
    for topic, table in TABLES.items():
        for entry in range(len(table)):
            case = single(topic, entry, picking(seed, entry))
            for door in DOORS[: 1 + case.on_the_wire]:
                yield door, case


def run(cases: Iterable[tuple[str, Case]]) -> Tally:
    """Judges the cases one after the other."""
    tally = nothing()
    slowest = tally.slowest
    benches: dict[tuple[str, Settings], Bench] = {}
    for number, (door, case) in enumerate(cases):
        if number % CHUNK == 0:
            faulthandler.dump_traceback_later(PATIENCE, exit=True)
        bench = benches.setdefault((door, case.settings), None) or Bench(door, case.settings)
        benches[door, case.settings] = bench
        started = perf_counter()
        problem = bench.judge(case)
        slowest = max(slowest, (perf_counter() - started, f"{case.topic}: {case.name}"))
        verdict = bench.verdict
        tally.outcomes[case.topic, door, verdict.outcome] += 1
        if verdict.kind:
            tally.kinds[case.topic, verdict.kind] += 1
        if verdict.site:
            tally.sites[verdict.site] += 1
        if bench.readers:
            tally.readers[case.topic, bench.readers] += 1
        if problem:
            tally.problems.append(Problem(str(number), door, f"{case.topic}: {case.name}", problem))
    faulthandler.cancel_dump_traceback_later()
    for (door, settings), bench in benches.items():
        problem = bench.retire() if settings == SETTINGS else ""
        if problem:
            tally.problems.append(Problem("", door, "the clean scene", problem))
    return tally._replace(slowest=slowest, resident={os.getpid(): [resident_bytes()]})


def run_chunk(seed: int, first: int, last: int) -> Tally:
    """Cases `first` .. `last` - 1."""
    tally = run(numbered(seed, number) for number in range(first, last))
    problems = [p._replace(case=str(first + int(p.case)) if p.case else f"{first}-{last}") for p in tally.problems]
    return tally._replace(problems=problems)


def run_campaign(cases: int, seed: int, workers: int) -> Iterator[Tally]:
    """One tally per chunk, as they finish; the death of a process is reported as a problem of its chunks."""
    chunks = [(first, min(first + CHUNK, cases)) for first in range(0, cases, CHUNK)]
    if workers == 1:
        for chunk in chunks:
            yield run_chunk(seed, *chunk)
        return
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
        futures = {pool.submit(run_chunk, seed, *chunk): chunk for chunk in chunks}
        for future in as_completed(futures):
            try:
                yield future.result()
            except Exception as error:  # the pool reports a worker's death this way, too
                first, last = futures[future]
                yield nothing()._replace(problems=[Problem(f"{first}-{last}", "", "a worker", f"died: {error!r}")])


def resident_bytes() -> int:
    """Resident memory [bytes], without memory that only awaits collection or reuse.

    That grows for a long time without indicating a leak: cycles that Python rarely collects, and freed memory kept by
    glibc.
    """
    gc.collect()
    ctypes.CDLL(None).malloc_trim(0)
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGESIZE")
