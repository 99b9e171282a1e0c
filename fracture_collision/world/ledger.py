"""The log of one run, checked at the gate: bodies, events, and who owns which node after the last event.

What is in the ledger is true and applies cleanly; the registry (registry.py) replays any prefix of it.
"""

from __future__ import annotations

import numpy as np

from fracture_collision.records import ADD, REMOVE, CollisionBody, FractureEvent
from fracture_collision.world.body_gate import CheckedBody, MeshStore, check_body
from fracture_collision.world.checks import identifier, refuse
from fracture_collision.world.errors import InvalidMessage
from fracture_collision.world.fracture_gate import CheckedFracture, check_fracture
from fracture_collision.world.settings import Settings


class Ledger:
    def __init__(self, settings: Settings) -> None:
        self._settings = settings
        self._store = MeshStore()
        self._nodes = 0
        self._labels: dict[int, np.ndarray] = {}  # body id -> fragment id of each node, for tetrahedral bodies
        self._owner: dict[int, int] = {}  # fragment id -> body id, for every fragment ever made
        self._alive: set[int] = set()
        self.bodies: dict[int, CheckedBody] = {}
        self.events: list[CheckedFracture] = []
        self.removals = 0

    def add_body(self, body: CollisionBody) -> None:
        operation = identifier("operation", body.operation)
        if operation == REMOVE:
            self._remove(identifier("body_id", body.body_id))
            return
        if operation != ADD:
            refuse("out_of_range", f"operation: {operation} is neither ADD (0) nor REMOVE (1)")
        known = self.bodies.get(body.body_id) if isinstance(body.body_id, int | np.integer) else None
        if len(self.bodies) >= self._settings.max_bodies and known is None:
            refuse("limit_exceeded", f"body_id: the limit of {self._settings.max_bodies} bodies is reached")
        checked = check_body(body, self._store, self._settings.max_nodes - self._nodes)
        if known is not None:
            # a latched topic delivers a body again after a reconnection: the same content changes nothing
            if known.digest == checked.digest:
                return
            refuse("doubled", f"body_id: body {checked.body_id} exists already with another content")
        self._new_fragment("fragment_id", checked.fragment_id)
        self.bodies[checked.body_id] = checked
        self._owner[checked.fragment_id] = checked.body_id
        self._alive.add(checked.fragment_id)
        if checked.mesh is not None:
            nodes = len(checked.mesh.mesh.nodes)
            self._nodes += nodes
            self._labels[checked.body_id] = np.full(nodes, checked.fragment_id, dtype=np.int64)

    def add_fracture(self, event: FractureEvent) -> None:
        sequence = identifier("sequence", event.sequence, 2**64 - 1)
        if sequence != len(self.events) + 1:
            if 1 <= sequence <= len(self.events):
                self._repeated(event, sequence)
                return
            refuse("sequence_gap", f"sequence: {sequence} follows {len(self.events)}")
        body = self.bodies.get(identifier("body_id", event.body_id))
        if body is None:
            refuse("unknown_id", f"body_id: no body {event.body_id}")
        fragment_id = identifier("fragment_id", event.fragment_id)
        if self._owner.get(fragment_id) != body.body_id:
            refuse("unknown_id", f"fragment_id: body {body.body_id} has no fragment {fragment_id}")
        if fragment_id not in self._alive:
            refuse("retired_id", f"fragment_id: fragment {fragment_id} broke already")
        if body.mesh is None:
            refuse("rigid_body", f"body_id: body {body.body_id} has no tetrahedra and cannot break")
        labels = self._labels[body.body_id]
        checked = check_fracture(event, body.mesh.mesh, labels)
        if len(self._owner) + len(checked.new_fragment_ids) > self._settings.max_fragments:
            refuse("limit_exceeded", f"new_fragment_ids: the limit of {self._settings.max_fragments} fragments is reached")
        for new_id in checked.new_fragment_ids:
            self._new_fragment("new_fragment_ids", int(new_id))
        self.events.append(checked)
        labels[checked.nodes] = checked.new_fragment_ids[checked.parts]
        self._alive.discard(fragment_id)
        for new_id in checked.new_fragment_ids.tolist():
            self._owner[new_id] = body.body_id
            self._alive.add(new_id)

    def was_made(self, fragment_id: int) -> bool:
        """Whether a fragment of this id exists or existed at any time of the run."""
        return fragment_id in self._owner

    def _new_fragment(self, name: str, fragment_id: int) -> None:
        if fragment_id in self._owner:
            refuse("doubled", f"{name}: fragment {fragment_id} exists or existed already; ids are never reused")

    def _repeated(self, event: FractureEvent, sequence: int) -> None:
        """An old event delivered again by the latched topic is ignored if it is the same one."""
        old = self.events[sequence - 1]
        new_ids = np.asarray(event.new_fragment_ids)
        same = (event.body_id, event.fragment_id) == (old.body_id, old.fragment_id)
        if not same or not np.array_equal(new_ids, old.new_fragment_ids):
            raise InvalidMessage("sequence_repeat", f"sequence: {sequence} was another event")

    def _remove(self, body_id: int) -> None:
        if body_id not in self.bodies:
            refuse("unknown_id", f"body_id: no body {body_id} to remove")
        body = self.bodies.pop(body_id)
        if body.mesh is not None:
            self._nodes -= len(self._labels.pop(body_id))
        self._alive -= {f for f, b in self._owner.items() if b == body_id}
        self.removals += 1
