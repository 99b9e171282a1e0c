"""Plots of the last seconds: milliseconds a step, contacts, fragments."""

from __future__ import annotations

import time
from collections import deque
from typing import NamedTuple

import numpy as np
import viser

SHOWN = 4.0  # [s] of simulated time that a plot reaches back
INTERVAL = 0.25  # [s] of the wall clock between two drawings
SMALLEST_MS = 1e-2  # a logarithmic axis has no zero


class Figures(NamedTuple):
    """Of one step; None: not known to whoever tells."""

    time: float  # [s] simulated
    collision_ms: float | None = None
    update_ms: float | None = None  # at fractures; else 0
    solver_ms: float | None = None
    ros_ms: float | None = None  # round trip beyond those
    contacts: int | None = None  # listed
    colliding_points: int | None = None  # contacts there would be without a limit
    fragments: int | None = None


CURVES = {
    "collision_ms": ("collision", "#1f77b4"), "update_ms": ("update", "#ff7f0e"), "solver_ms": ("solver", "#d62728"),
    "ros_ms": ("ROS", "#7f7f7f"), "contacts": ("contacts listed", "#2ca02c"),
    "colliding_points": ("colliding points", "#8c564b"), "fragments": ("fragments", "#9467bd"),
}  # fmt: skip
PLOTS = (
    ("milliseconds a step", ("collision_ms", "update_ms", "solver_ms", "ros_ms")),
    ("contacts", ("contacts", "colliding_points")),
    ("fragments", ("fragments",)),
)


def check_told(told: frozenset[str]) -> None:
    """Raises ValueError where one of them is no field of Figures."""
    unknown = told - set(Figures._fields)
    if unknown:
        raise ValueError(f"no figures of these names: {', '.join(sorted(unknown))}")


class Plots:
    """One plot for each group of figures that are told. One thread at a time."""

    def __init__(self, server: viser.ViserServer, told: frozenset[str]) -> None:
        """`told`: names of the fields of Figures that will not be None; of `time` there need be no word."""
        self._rows: deque[Figures] = deque()
        self._next = 0.0  # [s] of the wall clock
        self._plots: list[tuple[viser.GuiUplotHandle, tuple[str, ...]]] = []
        groups = [(title, tuple(name for name in names if name in told)) for title, names in PLOTS]
        if not any(names for _, names in groups):
            return
        with server.gui.add_folder("The last seconds"):
            for title, names in groups:
                if names:
                    self._plots.append((_plot(server, title, names), names))

    def clear(self) -> None:
        self._rows.clear()
        self._next = 0.0

    def add(self, figures: Figures) -> None:
        if self._rows and not 0.0 <= figures.time - self._rows[-1].time <= SHOWN:
            self._rows.clear()  # somewhere else in time
        if not self._rows or figures.time > self._rows[-1].time:
            self._rows.append(figures)
        while figures.time - self._rows[0].time > SHOWN:
            self._rows.popleft()

    def draw(self) -> None:
        """Now and then: several times a second is often enough to read."""
        now = time.monotonic()
        if now < self._next or not self._rows:
            return
        self._next = now + INTERVAL
        moments = np.array([row.time for row in self._rows])
        for plot, names in self._plots:
            floor = SMALLEST_MS if names[0].endswith("_ms") else 0.0
            columns = [[np.nan if (v := getattr(row, name)) is None else max(v, floor) for row in self._rows]
                       for name in names]  # fmt: skip
            plot.data = (moments, *map(np.array, columns))


def _plot(server: viser.ViserServer, title: str, names: tuple[str, ...]) -> viser.GuiUplotHandle:
    uplot = viser.uplot
    series = [uplot.Series(label="time, s")]
    for name in names:
        label, colour = CURVES[name]
        series.append(uplot.Series(label=label, stroke=colour, width=1.5))
    scale = uplot.Scale(distr=3) if names[0].endswith("_ms") else uplot.Scale(auto=True)
    return server.gui.add_uplot(
        data=tuple(np.zeros(1) for _ in series), series=tuple(series), title=title, height=150,
        scales={"x": uplot.Scale(time=False, auto=True), "y": scale},
    )  # fmt: skip
