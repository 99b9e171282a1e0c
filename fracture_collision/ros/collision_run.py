"""One run as the service sees it: messages as the topics happen to deliver them, applied in the order they ask for.

DDS keeps order within a topic, not across topics. An event may arrive before its body, states before either: they are
held until they can be applied. Knows records, not ROS.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fracture_collision import world
from fracture_collision.records import ADD, CollisionBody, ContactConstraintArray, FractureEvent, FragmentStates
from fracture_collision.world.errors import InvalidMessage, StatesAhead
from fracture_collision.world.settings import Settings

# Events held for a body that has not come; beyond this the publisher of the bodies is certainly gone.
MAX_HELD_EVENTS = 10_000
MAX_HELD_BYTES = 256 * 1024 * 1024  # of their arrays


class Refusal(NamedTuple):
    topic: str
    kind: str
    reason: str


class CollisionRun:
    """A CollisionWorld and what waits to go into it."""

    def __init__(self, run_id: int, settings: Settings) -> None:
        self.run_id = run_id
        self.world = world.CollisionWorld(settings)  # which loads numba, not when this module is imported
        self.body_ids: set[int] = set()
        self._known_bodies: set[int] = set()  # removed ones too: an event of theirs may still be on its way
        self.event_count = 0
        self.removals = 0
        self._held_events: dict[int, FractureEvent] = {}  # by sequence
        self._held_bytes = 0

    @property
    def held_event_count(self) -> int:
        return len(self._held_events)

    def add_body(self, body: CollisionBody) -> list[Refusal]:
        """Takes a body, and the events that waited for it."""
        try:
            self.world.add_body(body)
        except InvalidMessage as error:
            return [Refusal("bodies", error.kind, str(error))]
        if body.operation == ADD:
            self.body_ids.add(body.body_id)
            self._known_bodies.add(body.body_id)
        else:
            self.body_ids.discard(body.body_id)
            self.removals += 1
        return self._apply_held_events()

    def add_fracture(self, event: FractureEvent) -> list[Refusal]:
        """Takes an event, or holds it where its body has not arrived, or behind one that is held. An event held is
        reported as one refused, for it may be that the body never comes; a later event of the same sequence takes its
        place.
        """
        if event.sequence <= self.event_count:
            return self._apply(event)
        self._release(event.sequence)
        size = _array_bytes(event)
        if len(self._held_events) >= MAX_HELD_EVENTS or self._held_bytes + size > MAX_HELD_BYTES:
            reason = f"{len(self._held_events)} events, {self._held_bytes} bytes, wait for their bodies already"
            return [Refusal("fracture_events", "limit_exceeded", reason)]
        self._held_events[event.sequence] = event
        self._held_bytes += size
        if event.body_id in self._known_bodies:
            refusals = self._apply_held_events()
            if event.sequence not in self._held_events:
                return refusals
            first = min(self._held_events)
            reason = (
                f"sequence: event {event.sequence} is held behind event {first}, until body"
                f" {self._held_events[first].body_id} comes"
            )
            return [*refusals, Refusal("fracture_events", "sequence_gap", reason)]
        reason = f"body_id: no body {event.body_id}; event {event.sequence} is held until it comes"
        return [Refusal("fracture_events", "unknown_id", reason)]

    def answer(self, states: FragmentStates) -> ContactConstraintArray | None:
        """Contacts, or None as long as events or bodies that the states speak of are missing. Raises InvalidMessage."""
        try:
            return self.world.contacts(states)
        except StatesAhead:
            return None

    def _apply(self, event: FractureEvent) -> list[Refusal]:
        try:
            self.world.add_fracture(event)
        except InvalidMessage as error:
            return [Refusal("fracture_events", error.kind, str(error))]
        self.event_count = max(self.event_count, event.sequence)
        return []

    def _apply_held_events(self) -> list[Refusal]:
        refusals: list[Refusal] = []
        while self._held_events:
            first = min(self._held_events)
            if self._held_events[first].body_id not in self._known_bodies:
                break
            refusals += self._apply(self._release(first))
        return refusals

    def _release(self, sequence: int) -> FractureEvent | None:
        event = self._held_events.pop(sequence, None)
        if event is not None:
            self._held_bytes -= _array_bytes(event)
        return event


def _array_bytes(event: FractureEvent) -> int:
    return sum(np.asarray(field).nbytes for field in event)
