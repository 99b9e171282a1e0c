"""Plots of the last seconds: milliseconds per step, contacts, fragments, and any other rows with a time."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import viser

SHOWN = 4.0  # [s] of simulated time that a plot covers
INTERVAL = 0.25  # [s]
Y_TICKS = 62  # [px] room for labels such as 200,000
PADDING = (8, 16, 0, 4)  # [px] top, right, bottom, left
NO_TICKS = viser.uplot.Axis_Ticks(show=False)  # on a logarithmic axis marks and grid would be black bars
FLOORS = {"_ms": 1e-2, "_mm": 1e-4}  # by suffix of the name: a logarithmic axis has no zero

Group = tuple[str, tuple[str, ...]]  # a plot: its title, and the names of its curves


class Figures(NamedTuple):
    """Of one step; None: not known to the caller."""

    time: float  # [s] simulated
    collision_ms: float | None = None
    update_ms: float | None = None  # at fractures; else 0
    solver_ms: float | None = None
    ros_ms: float | None = None  # rest of the round trip
    contacts: int | None = None  # listed
    fragments: int | None = None  # of bodies that can break; by the page itself if None


CURVES = {
    "collision_ms": ("collision", "#1f77b4"), "update_ms": ("update", "#ff7f0e"), "solver_ms": ("solver", "#d62728"),
    "ros_ms": ("ROS", "#7f7f7f"), "contacts": ("contacts listed", "#2ca02c"),
    "colliding": ("colliding points", "#8c564b"), "fragments": ("fragments", "#9467bd"),
    "promised_mm": ("bound", "#1f77b4"), "unlisted_mm": ("unlisted", "#d62728"),
}  # fmt: skip
PLOTS: tuple[Group, ...] = (
    ("milliseconds per step", ("collision_ms", "update_ms", "solver_ms", "ros_ms")),
    ("contacts", ("contacts",)),
    ("fragments of breakable bodies", ("fragments",)),
)


def plots_of(told: frozenset[str]) -> list[Group]:
    """The groups of PLOTS with curves in `told`, and only those curves.

    `told`: names of the fields of Figures that will not be None; `time` may be omitted.
    """
    groups = [(title, tuple(name for name in names if name in told)) for title, names in PLOTS]
    return [(title, names) for title, names in groups if names]


def check_told(told: frozenset[str]) -> None:
    """Raise ValueError if one of them is not a field of Figures."""
    unknown = told - set(Figures._fields)
    if unknown:
        raise ValueError(f"no figures {', '.join(sorted(unknown))}; there are {', '.join(Figures._fields)}")


class Plots:
    """A plot for each group, from rows with a `time` [s] and all the groups' curves. One thread at a time."""

    def __init__(
        self, gui: viser.GuiApi, groups: Sequence[Group], visible: bool = True, interval: float = INTERVAL
    ) -> None:
        """`interval`: least [s] of the wall clock between two drawings."""
        self._rows: deque[Any] = deque()
        self._interval = interval
        self._next = 0.0  # [s] of the wall clock
        self._begin: float | None = None  # [s] of the axis of time; None: it fits the rows
        self._plots = [(_plot(gui, title, names, visible), names) for title, names in groups]

    def show(self, visible: Sequence[bool]) -> None:
        """Set which groups are visible."""
        for (plot, _), is_seen in zip(self._plots, visible, strict=True):
            plot.visible = is_seen

    def clear(self) -> None:
        """Remove all rows."""
        self._rows.clear()
        self._next = 0.0

    def add(self, row: Any) -> None:
        """A row at the same time as the last one replaces it: the scene is paused and was queried in another way."""
        if self._rows and not 0.0 <= row.time - self._rows[-1].time <= SHOWN:
            self._rows.clear()  # a jump in time
        if self._rows and row.time == self._rows[-1].time:
            self._rows.pop()
        self._rows.append(row)
        while row.time - self._rows[0].time > SHOWN:
            self._rows.popleft()

    def draw(self) -> None:
        """Draw at most once per interval: often enough to read. Earlier rows wait for the next drawing."""
        now = time.monotonic()
        if now < self._next or not self._rows:
            return
        self._next = now + self._interval
        moments = np.array([row.time for row in self._rows])
        # An axis fitted to one point would end at 100 s.
        begin = float(max(moments[0] - SHOWN, 0.0)) if len(moments) == 1 else None
        for plot, names in self._plots:
            if begin != self._begin:
                plot.scales = _scales(names, begin)
            floor = _floor(names)
            columns = [[np.nan if (v := getattr(row, name)) is None else max(v, floor) for row in self._rows]
                       for name in names]  # fmt: skip
            plot.data = (moments, *map(np.array, columns))
        self._begin = begin


def _floor(names: tuple[str, ...]) -> float:
    return next((floor for ending, floor in FLOORS.items() if names[0].endswith(ending)), 0.0)


def _scales(names: tuple[str, ...], begin: float | None) -> dict[str, Any]:
    scale = viser.uplot.Scale
    return {
        "x": scale(time=False, auto=True) if begin is None else scale(time=False, range=(begin, begin + SHOWN)),
        "y": scale(distr=3) if _floor(names) else scale(auto=True),
    }


def _plot(gui: viser.GuiApi, title: str, names: tuple[str, ...], visible: bool) -> viser.GuiUplotHandle:
    uplot = viser.uplot
    series = [uplot.Series(label="time, s")]
    for name in names:
        label, colour = CURVES[name]
        series.append(uplot.Series(label=label, stroke=colour, width=1.5))
    across = uplot.Axis(space=40, ticks=NO_TICKS)
    upward = uplot.Axis(size=Y_TICKS, ticks=NO_TICKS, grid=uplot.Axis_Grid(show=not _floor(names)))
    return gui.add_uplot(
        data=tuple(np.zeros(1) for _ in series), series=tuple(series), title=title, height=150, visible=visible,
        scales=_scales(names, None), axes=(across, upward), padding=PADDING,
    )  # fmt: skip
