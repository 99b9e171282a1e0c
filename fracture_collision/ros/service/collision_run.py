"""One run of the service: takes messages in the order of arrival and applies them in the order that they require.

DDS keeps order within a topic, not across topics. An event may arrive before its body, states before either: they are
held until they can be applied. If an event is rejected, states that need it are rejected with the reason, and later
events are held until a corrected one arrives, however late. Uses records, not ROS.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fracture_collision import world
from fracture_collision.records import ADD, CollisionBody, ContactConstraintArray, FractureEvent, FragmentStates
from fracture_collision.world.body_sequence import OVERTAKEN
from fracture_collision.world.gates.errors import InvalidMessage, StatesAhead
from fracture_collision.world.settings import Settings

# Events held for a missing body or an earlier event. Those beyond the limit are requested again (`wants_log`).
MAX_HELD_EVENTS = 10_000
MAX_HELD_BYTES = 256 * 1024 * 1024  # of their arrays


class Refusal(NamedTuple):
    """A message that was rejected, or held for one that may never arrive."""

    topic: str
    kind: str  # as in InvalidMessage
    reason: str


class CollisionRun:
    """A CollisionWorld and the messages that wait to be applied to it."""

    def __init__(self, run_id: int, settings: Settings) -> None:
        self.run_id = run_id
        self.world = world.CollisionWorld(settings)  # loads numba only now, not when this module is imported
        self.body_ids: set[int] = set()
        self._known_bodies: set[int] = set()  # removed ones too: an event of theirs may still be on its way
        self.event_count = 0
        self.removals = 0
        self.lacks_body_sequence = False  # whether states came that do not say which bodies precede them
        self._held_events: dict[int, FractureEvent] = {}  # by sequence
        self._held_bytes = 0
        self._unreadable: dict[int, str] = {}  # sequences of events that could not be read, with the reason
        self._first_dropped: int | None = None  # the lowest sequence of events dropped for lack of room
        self._rejected_bodies: dict[int, tuple[int, str]] = {}  # body id -> fragment id, reason
        self._ahead: tuple[FragmentStates, StatesAhead] | None = None  # the last states that had to be held

    @property
    def held_event_count(self) -> int:
        """Number of events that wait for a body or an earlier event."""
        return len(self._held_events)

    @property
    def rejected_event(self) -> str:
        """Which event was rejected, why, and that a corrected one is awaited; "" if none blocks the others."""
        return str(self.world.rejected_event or "")

    def add_body(self, body: CollisionBody) -> list[Refusal]:
        """Applies a body, and the events that waited for it."""
        try:
            self.world.add_body(body)
        except InvalidMessage as error:
            if body.body_id not in self._known_bodies and len(self._rejected_bodies) < MAX_HELD_EVENTS:
                self._rejected_bodies[body.body_id] = body.fragment_id, str(error)
            return [Refusal("bodies", error.kind, str(error))]
        self._rejected_bodies.pop(body.body_id, None)
        if body.operation == ADD:
            self.body_ids.add(body.body_id)
            self._known_bodies.add(body.body_id)
        else:
            self.body_ids.discard(body.body_id)
            self.removals += 1
        return self._apply_held_events()

    def add_fracture(self, event: FractureEvent) -> list[Refusal]:
        """Applies an event, or holds it until its body has arrived and all events before it are applied.

        A held event is reported as a rejected one, since what it waits for may never arrive; a later event of the same
        sequence replaces it.
        """
        if event.sequence <= self.event_count:
            return self._apply(event)
        self._release(event.sequence)
        size = _array_bytes(event)
        # events that are due first stay, so that the log can always advance
        while not self._has_room_for(size) and max(self._held_events, default=0) > event.sequence:
            self._drop(max(self._held_events))
        if not self._has_room_for(size):
            self._drop(event.sequence)
            reason = (
                f"{len(self._held_events)} events, {self._held_bytes} bytes, are held already; the service will request"
                f" event {event.sequence} again when it is due"
            )
            return [Refusal("fracture_events", "limit_exceeded", reason)]
        self._unreadable.pop(event.sequence, None)
        self._held_events[event.sequence] = event
        self._held_bytes += size
        refusals = self._apply_held_events()
        if event.sequence not in self._held_events:
            return refusals
        if event.body_id in self._known_bodies:
            kind, what = "sequence_gap", "sequence:"
        else:
            kind, what = "unknown_id", f"body_id: no body {event.body_id};"
        reason = f"{what} event {event.sequence} is held: {self._what_events_wait_for()}"
        return [*refusals, Refusal("fracture_events", kind, reason)]

    def reject_fracture(self, sequence: int, reason: str) -> None:
        """Event `sequence` has arrived but cannot be read."""
        if sequence > self.event_count and len(self._unreadable) < MAX_HELD_EVENTS:
            self._release(sequence)
            self._unreadable[sequence] = reason
            self._apply_held_events()

    def wants_log(self) -> bool:
        """Whether all events must be sent again: the one due now was dropped for lack of room. True once."""
        due = self.event_count + 1
        if self._first_dropped is None or self._first_dropped > due or due in self._held_events:
            return False
        self._first_dropped = None
        return True

    def answer(self, states: FragmentStates) -> ContactConstraintArray | None:
        """Contacts, or None while events or bodies that the states need are missing.

        The same states are tried again only when these have arrived. Raises InvalidMessage, also if an event that they
        need was rejected.
        """
        if self._ahead is not None and self._ahead[0] is states and self.world.lacks(self._ahead[1]):
            return None
        self._ahead = None
        try:
            return self.world.contacts(states)
        except StatesAhead as error:
            self._ahead = states, error
            return None

    def what_states_wait_for(self) -> str:
        """Explains why the last answer was None."""
        if self._ahead is None:
            return "they have not been tried yet"
        ahead = self._ahead[1]
        if ahead.body_sequence:
            return str(ahead)
        if ahead.fracture_sequence > self.event_count:
            return f"{ahead}; {self._what_events_wait_for()}"
        for fragment_id in ahead.fragment_ids:
            for body_id, (own, reason) in self._rejected_bodies.items():
                if own == fragment_id:
                    return f"no fragment {fragment_id} is known, as body {body_id} was rejected: {reason}"
        return f"no body or event has arrived that makes fragment {next(iter(ahead.fragment_ids), '')}"

    def _what_events_wait_for(self) -> str:
        due = self.event_count + 1
        if self.rejected_event:
            return self.rejected_event
        if due not in self._held_events:
            return f"event {due} has not arrived" + OVERTAKEN * any(later > due for later in self._held_events)
        body_id = self._held_events[due].body_id
        if body_id in self._rejected_bodies:
            return f"event {due} waits for body {body_id}, which was rejected: {self._rejected_bodies[body_id][1]}"
        return f"event {due} waits for body {body_id}, which has not arrived"

    def _apply(self, event: FractureEvent) -> list[Refusal]:
        try:
            self.world.add_fracture(event)
        except InvalidMessage as error:
            return [Refusal("fracture_events", error.kind, str(error))]
        self.event_count = max(self.event_count, event.sequence)
        return []

    def _apply_held_events(self) -> list[Refusal]:
        """Applies the events that are due, one after the other, up to a rejected one."""
        refusals: list[Refusal] = []
        while (due := self.event_count + 1) in self._held_events and not refusals:
            event = self._held_events[due]
            if event.body_id not in self._known_bodies:
                break
            self._release(due)
            refusals += self._apply(event)
        if (reason := self._unreadable.get(due)) is not None:
            self.world.reject_fracture(due, reason)
        return refusals

    def _has_room_for(self, size: int) -> bool:
        return len(self._held_events) < MAX_HELD_EVENTS and self._held_bytes + size <= MAX_HELD_BYTES

    def _drop(self, sequence: int) -> None:
        self._release(sequence)
        self._first_dropped = min(self._first_dropped or sequence, sequence)

    def _release(self, sequence: int) -> None:
        event = self._held_events.pop(sequence, None)
        if event is not None:
            self._held_bytes -= _array_bytes(event)


def _array_bytes(event: FractureEvent) -> int:
    return sum(np.asarray(field).nbytes for field in event)
