"""Figures of a run: plots of the last seconds, of any rows with a time, and a summary in words."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Collection, Sequence
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


SLOW = 0.5  # share of the requested pace
PATIENCE = 2.0  # [s] of the wall clock that a simulation may be slow without a message
SLOW_WORDS = (
    "**The simulation is slow.** To speed it up, choose a smaller scene, start over, or lower *contacts_per_pair*."
)
BUSY_WORDS = (
    "**The simulation is slow**, but its steps are not: the machine is busy. Close other programs, and other windows"
    " with this page."
)
PAUSED_WORDS = "paused: untick *pause* to go on"
WORK = 0.5  # share of the time for a step: shorter work is not why a simulation is slow
STEPS = 60  # about those of PATIENCE, as the page shows thirty a second


class Census(NamedTuple):
    """The bodies that are in the scene and not fixed."""

    unbroken: int  # breakable bodies in one piece
    broken: int  # bodies in pieces
    pieces: int  # of the broken ones
    others: int  # bodies that cannot break: balls, links of a robot, a hammer

    @property
    def fragments(self) -> int:
        """Fragments of breakable bodies."""
        return self.unbroken + self.pieces


class Pace:
    """Whether a simulation has been slow for a while."""

    def __init__(self) -> None:
        self._slow_since: float | None = None  # [s]

    def is_slow(self, now: float, achieved: float, requested: float, paused: bool) -> bool:
        """`now` [s] of any clock; achieved, requested: simulated time over real time, at present."""
        if paused or achieved >= SLOW * requested:
            self._slow_since = None
            return False
        if self._slow_since is None:
            self._slow_since = now
        return now - self._slow_since > PATIENCE


class Summary:
    """Writes the lines. Any thread may call."""

    def __init__(self, gui: viser.GuiApi) -> None:
        self._line = gui.add_markdown("")
        self._warning = gui.add_markdown("", visible=False)
        self._lock = threading.Lock()
        self._figures: Figures | None = None
        self._census: Census | None = None
        self._pace_words = ""  # none for a recording
        self._pace = Pace()
        self._work: deque[float] = deque(maxlen=STEPS)  # [ms] of steps
        self._said = ""

    def clear(self) -> None:
        """Drop what belongs to the last run."""
        with self._lock:
            self._figures = self._census = None
            self._work.clear()
            self._say()

    def show_figures(self, figures: Figures) -> None:
        """The time and the contacts of a step."""
        with self._lock:
            self._figures = figures
            self._work.append(sum(filter(None, (figures.collision_ms, figures.update_ms, figures.solver_ms))))
            self._say()

    def show_census(self, census: Census) -> None:
        """What is in the scene."""
        with self._lock:
            self._census = census
            self._say()

    def show_rate(self, now: float, achieved: float, requested: float, paused: bool, step_ms: float) -> None:
        """Arguments as in Pace.is_slow; to be called several times a second.

        `step_ms`: real time for each step at the requested pace; 0: unknown.
        """
        with self._lock:
            self._pace_words = PAUSED_WORDS if paused else f"{achieved:.2f} × real time"
            is_slow = self._pace.is_slow(now, achieved, requested, paused)
            words = BUSY_WORDS if has_time_left(self._work, step_ms) else SLOW_WORDS
            if is_slow and self._warning.content != words:
                self._warning.content = words
            if is_slow != self._warning.visible:
                self._warning.visible = is_slow
            self._say()

    def _say(self) -> None:
        figures = self._figures
        time = "" if figures is None else f"**{figures.time:.2f} s**"
        listed = "" if figures is None or figures.contacts is None else f"{figures.contacts} contacts"
        first = " · ".join(filter(None, (time, self._pace_words, listed)))
        text = "  \n".join(filter(None, (first, "" if self._census is None else words_of(self._census))))
        if text != self._said:
            self._line.content = self._said = text


def has_time_left(work: Collection[float], step_ms: float) -> bool:
    """Whether most steps take less than their time; then a simulation that is slow waits for the processor.

    `work`: [ms] of each step. Steps that were interrupted take longer, so it is the lower quartile that counts.
    """
    return len(work) > 0 and sorted(work)[len(work) // 4] < WORK * step_ms


def words_of(census: Census) -> str:
    """Such as "1 unbroken · 14 other bodies": breakable bodies first, apart from the others."""
    parts = []
    if census.unbroken:
        parts.append(f"{census.unbroken} unbroken")
    if census.broken:
        parts.append(f"{census.broken} in {census.pieces} pieces")
    if census.others:
        parts.append(f"{census.others} other bod{'y' if census.others == 1 else 'ies'}")
    return " · ".join(parts)
