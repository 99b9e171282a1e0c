"""Cost of another setting in the steps of a recorded scene: each answered on one core, without and with it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from rich.console import Console
from rich.table import Table

from benchmarks.frames.measure import BUSY, ours
from benchmarks.frames.recording import record
from fracture_collision.world import Settings

RUNS = 3


class Cost(NamedTuple):
    """Times of a query [ms]; each step's minimum of RUNS runs."""

    scene: str
    without_ms: float  # mean per step
    with_ms: float
    ratio: float
    busy_ratio: float  # of steps in which at least BUSY fragments move
    worst_ms: float
    worst_with_ms: float
    update_ms: float  # mean of the steps at fractures
    update_with_ms: float


def cost_in_scene(name: str, **other: object) -> Cost:
    """name: see recording.record; other: of Settings."""
    recording, plain = record(name), Settings(threads=1)
    query, update = [[], []], [[], []]
    for _ in range(RUNS):
        for k, settings in enumerate((plain, plain._replace(**other))):
            times = ours(recording, settings)
            query[k].append(times.query)
            update[k].append(times.update)
    without, changed = (np.min(times, axis=0) for times in query)
    updates = [np.min(times, axis=0) for times in update]
    busy = np.array([step.moving >= BUSY for step in recording.steps])
    at_fractures = updates[0] > 0.0
    return Cost(
        name, without.mean(), changed.mean(), changed.mean() / without.mean(),
        changed[busy].mean() / without[busy].mean(), without.max(), changed.max(),
        *(float(times[at_fractures].mean()) for times in updates),
    )  # fmt: skip


def show(title: str, rows: list[NamedTuple]) -> None:
    """A table of rows of one kind."""
    table = Table(title=title)
    for name in rows[0]._fields:
        table.add_column(name.replace("_", " "), justify="right")
    for row in rows:
        table.add_row(*(f"{value:.3g}" if isinstance(value, float) else str(value) for value in row))
    Console().print(table)
