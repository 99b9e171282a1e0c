"""The lines at the top of the panel: time, pace, contacts, and what is whole or broken."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Collection
from typing import NamedTuple

import viser

from fracture_collision.viewer.page.page_plots import Figures

SLOW = 0.5  # share of the requested pace
PATIENCE = 2.0  # [s] of the wall clock that a simulation may be slow without a message
SLOW_WORDS = (
    "**The simulation is slow.** To speed it up, choose a smaller scene, start over, or lower"
    " *contacts_per_pair*."
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
    others: int  # bodies that cannot break: balls, links of an arm, a hammer

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
