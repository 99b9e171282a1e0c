"""The validated event log of one run: bodies, events, and which fragment owns each node after the last event.

Everything in the ledger is valid and applies without error; the registry (registry.py) replays any prefix of it. The
ledger also keeps the reason if the next event was rejected: no later one can be applied before a corrected one arrives.
"""

from __future__ import annotations

import numpy as np

from fracture_collision.core.bodies.collision_geometry import CollisionGeometry, PreparedMesh
from fracture_collision.records import ADD, REMOVE, CollisionBody, FractureEvent
from fracture_collision.world.body_sequence import BodySequence
from fracture_collision.world.gates.body_gate import CheckedBody, MeshStore, check_body, read_body
from fracture_collision.world.gates.checks import UINT64_MAX, identifier, refuse
from fracture_collision.world.gates.errors import InvalidMessage, Rejection, StatesAhead
from fracture_collision.world.gates.fracture_gate import (
    CheckedFracture,
    apply_fracture,
    check_fracture,
    fracture_of_removed_body,
    read_fracture,
    refuse_without_volume,
    without_content,
)
from fracture_collision.world.settings import Settings

# Share of the smallest tetrahedron's volume: a fragment with planes through all its nodes and no more is rounding.
LEAST_VOLUME = 1e-9


class Ledger:
    """Bodies and events of one run. Methods that take a message raise InvalidMessage, and then change nothing."""

    def __init__(self, settings: Settings) -> None:
        self._settings = settings
        self._store = MeshStore()
        self._room_for_nodes = settings.max_nodes
        self._nodes: dict[int, int] = {}  # body id -> its nodes or vertices
        self._labels: dict[int, np.ndarray] = {}  # body id -> fragment id of each node, for tetrahedral bodies
        self._pinched: dict[int, np.ndarray] = {}  # body id -> nodes that crack planes pass through, likewise
        self._removed: dict[int, bytes] = {}  # body id -> digest of the removed body
        self._owner: dict[int, int] = {}  # fragment id -> body id, for every fragment ever made
        self._born: dict[int, int] = {}  # fragment id -> sequence of the event that made it, 0: with its body
        self._broke: dict[int, int] = {}  # fragment id -> sequence of the event that retired it
        self.bodies: dict[int, CheckedBody] = {}
        self.events: list[CheckedFracture] = []
        self._events_of: dict[int, list[int]] = {}  # body id -> indices of its events
        self.rejected: Rejection | None = None  # why the next event was rejected, until it is accepted
        self._body_messages = BodySequence()
        self._added: dict[int, CheckedBody] = {}  # bodies added since the last `take_changes`
        self._gone: list[int] = []  # ids of bodies that were present then and removed since

    def change_limits(self, settings: Settings) -> None:
        """Limits of later messages; existing content stays."""
        self._room_for_nodes += settings.max_nodes - self._settings.max_nodes
        self._settings = settings

    def add_body(self, body: CollisionBody) -> None:
        """Validate and store a body, or remove one (REMOVE); keep the reason if it is rejected."""
        try:
            sequence = identifier("sequence", body.sequence, UINT64_MAX)
            operation = identifier("operation", body.operation)
            body_id = identifier("body_id", body.body_id)
            self._body_messages.check(sequence, operation, body_id)
            if operation == REMOVE:
                self._remove(body_id, sequence)
            elif operation == ADD:
                self._add(body)
            else:
                refuse("out_of_range", f"operation: {operation} is neither ADD (0) nor REMOVE (1)")
        except InvalidMessage as error:
            if isinstance(body.sequence, int | np.integer):
                self.reject_body(int(body.sequence), str(error))
            raise
        self._body_messages.accept(sequence, operation, body_id)

    def reject_body(self, sequence: int, reason: str) -> None:
        """Record that body message `sequence` arrived and is not acceptable. States that follow it are rejected."""
        self._body_messages.reject(sequence, reason)

    def _add(self, body: CollisionBody) -> None:
        fields = read_body(body)
        known = self.bodies.get(fields.body_id)
        if fields.digest == (known.digest if known else self._removed.get(fields.body_id)):
            return  # a latched topic repeats its messages after a reconnection: the same content changes nothing
        if known:
            refuse("doubled", f"body_id: body {fields.body_id} already exists with different content")
        if fields.body_id in self._removed:
            refuse("retired_id", f"body_id: body {fields.body_id} was removed; ids are never reused")
        if len(self.bodies) >= self._settings.max_bodies:
            refuse("limit_exceeded", f"body_id: the limit of {self._settings.max_bodies} bodies is reached")
        self._check_new_fragments("fragment_id", [fields.fragment_id])
        checked = check_body(fields, self._store, self._room_for_nodes)
        self.bodies[checked.body_id] = self._added[checked.body_id] = checked
        self._owner[checked.fragment_id] = checked.body_id
        self._born[checked.fragment_id] = 0
        self._nodes[checked.body_id] = len(fields.vertices)
        self._room_for_nodes -= len(fields.vertices)
        if checked.mesh is not None:
            self._labels[checked.body_id] = np.full(len(fields.vertices), checked.fragment_id, dtype=np.int64)
            self._pinched[checked.body_id] = np.zeros(len(fields.vertices), np.uint8)

    def take_changes(self) -> tuple[list[int], list[CheckedBody]]:
        """Ids of bodies removed since the last call, and bodies added since, in order of arrival."""
        gone, added = self._gone, list(self._added.values())
        self._gone, self._added = [], {}
        return gone, added

    def add_fracture(self, event: FractureEvent) -> None:
        """Validate an event and append it to the log; keep the reason if the next one is rejected."""
        try:
            self._add_fracture(event)
        except InvalidMessage as error:
            if isinstance(event.sequence, int | np.integer):
                self.reject(int(event.sequence), str(error))
            raise

    def reject(self, sequence: int, reason: str) -> None:
        """Record that event `sequence` arrived and is not acceptable. No effect unless it is the next event."""
        if sequence == len(self.events) + 1:
            self.rejected = Rejection(sequence, reason)

    def _add_fracture(self, event: FractureEvent) -> None:
        fields = read_fracture(event)
        sequence, fragment_id = fields.sequence, fields.fragment_id
        if 1 <= sequence <= len(self.events):
            if fields.digest != self.events[sequence - 1].digest:
                refuse("sequence_repeat", f"sequence: event {sequence} already exists with different content")
            return  # delivered again by the latched topic
        if sequence != len(self.events) + 1:
            refuse("sequence_gap", f"sequence: event {sequence} does not follow event {len(self.events)}")
        body = self.bodies.get(fields.body_id)
        if body is None and fields.body_id not in self._removed:
            refuse("unknown_id", f"body_id: unknown body {fields.body_id}")
        if self._owner.get(fragment_id) != fields.body_id:
            refuse("unknown_id", f"fragment_id: body {fields.body_id} has no fragment {fragment_id} and never had")
        if fragment_id in self._broke:
            refuse("retired_id", f"fragment_id: fragment {fragment_id} has already broken")
        new_ids = fields.new_fragment_ids.tolist()
        self._check_new_fragments("new_fragment_ids", new_ids)
        if body is None:
            # body and event topics have no mutual order: the sequence must not stop at this event
            checked = fracture_of_removed_body(fields)
        else:
            if body.mesh is None:
                refuse("rigid_body", f"body_id: body {fields.body_id} has no tetrahedra and cannot break")
            labels = self._labels[body.body_id]
            checked, pinched, doubtful = check_fracture(fields, body.mesh.mesh, labels, self._pinched[body.body_id])
            if len(doubtful):
                self._have_volume(body, body.mesh, checked, doubtful)
            labels[checked.nodes] = checked.new_fragment_ids[checked.parts]
            self._pinched[body.body_id] = pinched
        self.rejected = None
        self._events_of.setdefault(fields.body_id, []).append(len(self.events))
        self.events.append(checked)
        self._broke[fragment_id] = sequence
        for new_id in new_ids:
            self._owner[new_id] = fields.body_id
            self._born[new_id] = sequence

    def _have_volume(
        self, body: CheckedBody, mesh: PreparedMesh, checked: CheckedFracture, doubtful: np.ndarray
    ) -> None:
        """Reject the fracture if a `doubtful` new fragment has no volume, measured in a separate geometry."""
        geometry = CollisionGeometry()
        row = {body.fragment_id: geometry.add_tetrahedra(mesh)}
        earlier = [self.events[i] for i in self._events_of.get(body.body_id, ())]
        for event in [*earlier, checked]:
            first = apply_fracture(geometry, row[event.fragment_id], event)
            row.update((new_id, first + i) for i, new_id in enumerate(event.new_fragment_ids.tolist()))
        least = LEAST_VOLUME * mesh.mesh.moments[:, 0].min()
        for new_id in checked.new_fragment_ids[doubtful].tolist():
            if not geometry.volume(row[new_id]) > least:
                refuse_without_volume(new_id)

    def require_bodies(self, sequence: int) -> None:
        """Raise unless the bodies after `sequence` messages are known, as BodySequence.require."""
        self._body_messages.require(sequence)

    def require_events(self, sequence: int) -> None:
        """Raise unless `sequence` events are known: InvalidMessage if the next was rejected, else StatesAhead."""
        known = len(self.events)
        if sequence <= known:
            return
        if self.rejected is not None:
            refuse("event_rejected", f"fracture_sequence: {sequence}, but {self.rejected}")
        raise StatesAhead(
            "sequence_gap", f"fracture_sequence: {sequence}, but only {known} events are known",
            fracture_sequence=sequence,
        )  # fmt: skip

    def require_living(self, fragment_ids: np.ndarray, sequence: int) -> None:
        """Raise unless all live after `sequence` events: InvalidMessage if one never will, else StatesAhead."""
        unknown = []
        for fragment_id in fragment_ids.tolist():
            if fragment_id not in self._owner:
                unknown.append(fragment_id)
                continue
            if self._owner[fragment_id] not in self.bodies:
                refuse("retired_id", f"fragment_ids: the body of fragment {fragment_id} was removed")
            if not self._born[fragment_id] <= sequence < self._broke.get(fragment_id, sequence + 1):
                refuse("retired_id", f"fragment_ids: fragment {fragment_id} does not live after {sequence} events")
        if unknown:
            raise StatesAhead(
                "unknown_id", f"fragment_ids: no fragment {unknown[0]} is known yet",
                fracture_sequence=sequence, fragment_ids=sorted(unknown),
            )  # fmt: skip

    def lacks(self, ahead: StatesAhead) -> bool:
        """Whether something that the states of `ahead` need is still missing. Amortized O(1) per missing fragment."""
        if ahead.body_sequence:
            return self._body_messages.lacks(ahead.body_sequence)
        if ahead.fracture_sequence > len(self.events):
            return self.rejected is None
        while ahead.fragment_ids and ahead.fragment_ids[-1] in self._owner:
            ahead.fragment_ids.pop()
        return bool(ahead.fragment_ids)

    def _check_new_fragments(self, name: str, fragment_ids: list[int]) -> None:
        if len(self._owner) + len(fragment_ids) > self._settings.max_fragments:
            refuse("limit_exceeded", f"{name}: the limit of {self._settings.max_fragments} fragments is reached")
        for fragment_id in fragment_ids:
            if fragment_id in self._owner:
                refuse(
                    "doubled",
                    f"{name}: fragment {fragment_id} already exists or existed; ids are never reused, those above "
                    f"{max(self._owner)} are free",
                )

    def _remove(self, body_id: int, sequence: int) -> None:
        if body_id in self._removed:
            return
        if body_id not in self.bodies:
            refuse("unknown_id", f"body_id: unknown body {body_id} cannot be removed")
        body = self.bodies.pop(body_id)
        self._removed[body_id] = body.digest
        if body.is_static:
            self._body_messages.remove_static(body_id, body.sequence, sequence)
        self._labels.pop(body_id, None)
        self._pinched.pop(body_id, None)
        self._room_for_nodes += self._nodes.pop(body_id)
        self._store.release(body.mesh or body.surface)
        for i in self._events_of.pop(body_id, ()):
            self.events[i] = without_content(self.events[i])
        if self._added.pop(body_id, None) is None:
            self._gone.append(body_id)
