"""The last seconds of a live scene, kept as copies of its state, to go back to.

A copy of a hundred fragments takes 0.3 ms. The alternative, recorded commands and a second run through all steps since,
would let the user wait. Meshes and descriptions of bodies are shared by all copies. A scene that continues from a copy
takes the same course, byte for byte, if its user does the same.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from typing import NamedTuple

from fracture_collision.records import FractureEvent
from fracture_collision.simulation.live import LiveScene

INTERVAL = 0.5  # [s] of simulated time between two copies
REACH = 10.0  # [s] that a rewind goes back
KEPT = 20.0  # [s] so that there is something left to go back to after a rewind


class Moment(NamedTuple):
    """A live scene between two steps."""

    time: float  # [s] simulated
    events: int  # that the service had by then
    live: LiveScene  # a copy, which no step changes


class History:
    """The moments of one run, and its events from the beginning."""

    def __init__(self, moments: Sequence[Moment] = (), events: Sequence[FractureEvent] = ()) -> None:
        self._moments = deque(moments)  # in order of time
        self._events = list(events)

    @property
    def events(self) -> list[FractureEvent]:
        """All events that the service has, in order."""
        return list(self._events)

    def add(self, events: Sequence[FractureEvent]) -> None:
        """Add those that the service gets; events that it has already do not count."""
        self._events += [event for event in events if event.sequence > len(self._events)]

    def keep(self, live: LiveScene) -> None:
        """Keep a copy, if it is time for one. Called between two steps."""
        time = live.simulation.time
        if self._moments and time < self._moments[-1].time + INTERVAL:
            return
        self._moments.append(Moment(time, len(self._events), live.copied()))
        while len(self._moments) > 1 and self._moments[1].time <= time - KEPT:
            self._moments.popleft()

    def moment(self, time: float) -> Moment | None:
        """The last moment until `time` [s], else the first one that is kept; None if there is none."""
        earlier = [moment for moment in self._moments if moment.time <= time]
        return earlier[-1] if earlier else next(iter(self._moments), None)

    def until(self, moment: Moment) -> History:
        """The history of a scene that goes on from this one of the moments."""
        return History([each for each in self._moments if each.time <= moment.time], self._events[: moment.events])
