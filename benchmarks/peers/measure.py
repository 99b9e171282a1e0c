"""Measures all methods in turn, so that a slow phase of the machine affects all of them alike."""

from __future__ import annotations

import gc
from collections.abc import Callable, Sequence
from statistics import median
from time import perf_counter
from typing import NamedTuple

import numpy as np

from benchmarks.peers.boxes import local_boxes, near_pairs
from benchmarks.peers.judging.score import FrameTruth, Score, score
from benchmarks.peers.judging.truth import Solids
from benchmarks.peers.method import EXACT, Contacts, Method, usable
from benchmarks.peers.worlds import World, make_world

KINDS = ("touch", "jitter", "pile")
# A round longer than this [s] is not repeated.
LONG_ROUND = 6.0


class Row(NamedTuple):
    """One method in one world; times in ms, medians over the rounds. nan: not measured, or nothing to measure."""

    world: str
    method: str
    surface: str  # exact or mesh: what the method gets and is judged against
    mesher: str  # source of the meshes: World.mesher
    fragments: int
    triangles: int  # of that surface, all fragments
    close_pairs: float  # with overlapping boxes, per jitter frame
    rounds: int
    failure: str  # empty: none
    update: float
    first_query: float  # in the first frame after the update
    query: dict[str, float]  # KINDS to the median over frames
    native: dict[str, float]  # part of it inside the library
    score: dict[str, Score]


Progress = Callable[[str], None]


def measure(
    worlds: Sequence[str | World], methods: Sequence[Method], repeats: int = 5, progress: Progress = lambda text: None
) -> list[Row]:
    """Measures `methods` in `worlds`, given by name or ready-made, in `repeats` rounds after a warm-up round.

    In a round each method in turn is updated at the fracture and queried in all frames. Answers are judged once.
    """
    rows = []
    for given in worlds:
        if isinstance(given, str):
            progress(f"{given}: fracture and surfaces")
        rows += _measure_world(make_world(given) if isinstance(given, str) else given, methods, repeats, progress)
    return rows


class _Times:
    """One method's times, by round [s]."""

    def __init__(self) -> None:
        self.answers: list[Contacts] = []  # of the first round, by frame
        self.failure = ""
        self.is_long = False
        self.forget()

    def forget(self) -> None:
        """Discards the times so far."""
        self.update: list[float] = []
        self.first: list[float] = []
        self.query: dict[str, list[float]] = {kind: [] for kind in KINDS}
        self.native: dict[str, list[float]] = {kind: [] for kind in KINDS}


def _measure_world(world: World, methods: Sequence[Method], repeats: int, progress: Progress) -> list[Row]:
    times = {method.name: _Times() for method in methods}
    for i in range(repeats + 1):
        for method in methods:
            its = times[method.name]
            if its.failure or its.is_long:
                continue
            progress(f"{world.name}: {method.name}, round {i} of {repeats}")
            if i == 1:
                its.forget()
            try:
                seconds = _one_round(world, method, its)
                its.is_long = i > 0 and seconds > LONG_ROUND  # the first compiles
            except Exception as error:  # raised by one peer; the others continue
                its.failure = f"{type(error).__name__}: {error}"
    progress(f"{world.name}: truth")
    solids, truths = {}, {}
    for kind in sorted({method.surface for method in methods}):
        solids[kind], truths[kind] = true_frames(world, kind)
    rows = []
    for method in methods:
        progress(f"{world.name}: {method.name} judged")
        rows.append(_row(world, method, times[method.name], solids[method.surface], truths[method.surface]))
    return rows


def _one_round(world: World, method: Method, times: _Times) -> float:
    """Returns its duration [s]."""
    before = method.prepare(world)
    gc.collect()
    began = perf_counter()
    state = method.update(world, before)
    times.update.append(perf_counter() - began)
    answers = []
    for i, frame in enumerate(world.frames if method.answers else ()):
        if i == 0:  # the first query after an update: of a jittered frame, like those it is compared with
            jittered = next(f for f in world.frames if f.kind == "jitter")
            started = perf_counter()
            method.query(world, state, jittered)
            times.first.append(perf_counter() - started)
        method.forget(state)
        started = perf_counter()
        answer = method.query(world, state, frame)
        times.query[frame.kind].append(perf_counter() - started)
        answers.append(usable(answer))
        times.native[frame.kind].append(answers[-1].native)
    times.answers = times.answers or answers
    seconds = perf_counter() - began
    method.release(state)
    return seconds


def _row(world: World, method: Method, times: _Times, solids: Solids, truths: list[FrameTruth]) -> Row:
    scores = {}
    for kind in KINDS if times.answers and not times.failure else ():
        chosen = [i for i, truth in enumerate(truths) if truth.frame.kind == kind]
        scores[kind] = score(solids, [truths[i] for i in chosen], [times.answers[i] for i in chosen])
    jittered = [len(truth.near) for truth in truths if truth.frame.kind == "jitter"]
    return Row(
        world.name, method.name, method.surface, world.mesher, len(world.fragments),
        sum(len(s.triangles) for s in solids.surfaces), float(np.mean(jittered)), len(times.update), times.failure,
        _milliseconds(times.update), _milliseconds(times.first),
        {kind: _milliseconds(times.query[kind]) for kind in KINDS},
        {kind: _milliseconds(times.native[kind]) for kind in KINDS}, scores,
    )  # fmt: skip


def _milliseconds(seconds: list[float]) -> float:
    return 1e3 * median(seconds) if seconds else np.nan


def true_frames(world: World, surface: str) -> tuple[Solids, list[FrameTruth]]:
    """The ground truth of all frames for one kind of surface."""
    surfaces = [f.exact if surface == EXACT else f.mesh for f in world.fragments]
    samples = [f.samples for f in world.fragments] if surface == EXACT else None
    solids, boxes = Solids(surfaces, samples), local_boxes(surfaces)
    return solids, [FrameTruth(f, solids.truth(f), set(near_pairs(boxes, f)), {}) for f in world.frames]
