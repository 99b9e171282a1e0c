"""Cost of breaking one of many bodies, compared with breaking a single body."""

from __future__ import annotations

import gc
from time import perf_counter
from typing import NamedTuple

import numpy as np

from benchmarks.peers.worlds import World, empty_states
from benchmarks.scaling.growth import Progress, silent
from benchmarks.scaling.piles import copy_of
from fracture_collision.world import CollisionWorld, Settings


class UpdateRow(NamedTuple):
    """Medians [ms]; interleaved, with worlds that differ only in the number of bodies."""

    bodies: int
    nodes: int  # per body
    pieces: int
    broken_before: int  # bodies that had broken already
    check: float  # add_fracture
    update: float  # last_timings["update"] of the first states that need the event's registry
    masses: float  # fragments()
    whole: float  # sum of the three
    whole_over_alone: float  # median of the ratios of adjacent runs
    update_over_alone: float  # the same for check and update without masses


Part = tuple[float, float, float]


def measure_update_of_one(
    source: World, many: int = 27, repeats: int = 5, progress: Progress = silent
) -> list[UpdateRow]:
    """The last of one and of `many` bodies breaks while the others are whole; then with the others broken too."""
    cases = [(1, 0), (many, 0), (many, many - 1)]
    times: list[list[Part]] = [[] for _ in cases]
    for i in range(repeats + 1):
        progress(f"breaking one of {many}, round {i} of {repeats}")
        for its, (count, broken) in zip(times, cases, strict=True):
            part = _break_one(source, count, broken)
            if i:  # the first run is a warm-up
                its.append(part)
    alone = np.array(times[0])
    rows = []
    for its, (count, broken) in zip(times, cases, strict=True):
        its = np.array(its)
        check, update, masses = (1e3 * np.median(its, axis=0)).tolist()
        rows.append(
            UpdateRow(
                count, len(source.body.vertices), len(source.fragments), broken, check, update, masses,
                1e3 * float(np.median(its.sum(axis=1))),
                float(np.median(its.sum(axis=1) / alone.sum(axis=1))),
                float(np.median(its[:, :2].sum(axis=1) / alone[:, :2].sum(axis=1))),
            )
        )  # fmt: skip
    return rows


def _break_one(source: World, count: int, broken: int) -> Part:
    world = CollisionWorld(Settings(threads=1))
    copies = [copy_of(source, k) for k in range(count)]
    for body, _ in copies:
        world.add_body(body)
    for _, event in copies[:broken]:
        world.add_fracture(event)
    world.contacts(empty_states(broken))
    world.fragments()
    # copy_of numbers events by copy; this one must be the next in sequence
    event = copies[-1][1]._replace(sequence=broken + 1)
    gc.collect()
    began = perf_counter()
    world.add_fracture(event)
    checked = perf_counter()
    world.contacts(empty_states(broken + 1))
    asked = perf_counter()
    world.fragments()
    return checked - began, world.last_timings["update"], perf_counter() - asked
