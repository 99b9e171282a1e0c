"""Participants of a run: the scene's bodies, those thrown in, and the fragments that they consist of.

Fragments wait here, outside the engine, until the registry brings their masses.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fracture_collision.records import REMOVE, CollisionBody, FractureEvent, FragmentRegistry
from fracture_collision.simulation.breakable_body import BreakableBody
from fracture_collision.simulation.engine.engine import Engine, FrameState, MassProperties
from fracture_collision.simulation.scene.scene import SceneBody
from fracture_collision.simulation.scene.scene_records import collision_body


class Cast:
    """A body's id is that of its first fragment: 1, 2 ... in the order of the scene, then in order of arrival."""

    def __init__(self, bodies: Sequence[SceneBody]) -> None:
        self.body_of: dict[int, SceneBody] = dict(enumerate(bodies, start=1))
        self.breakable = {
            i: BreakableBody(i, i, body.shape.mesh) for i, body in self.body_of.items() if body.shape.mesh is not None
        }
        self.body_id_of = {i: i for i in self.body_of}  # of each living fragment
        self.sizes = {i: body.shape.half_length() for i, body in self.body_of.items()}  # R [m], by body id
        # A static body in the world frame is left out of the states.
        still = np.zeros(3)
        self.static_frames = {
            i: FrameState(body.position, body.orientation, still, still)
            for i, body in self.body_of.items()
            if body.is_static and (body.position.any() or body.orientation[3] != 1.0)
        }
        # Listed in the states, but not in the engine until the registry brings their masses.
        self.waiting: dict[int, FrameState] = {}
        self._unthrown = sorted((body.start_time, i) for i, body in self.body_of.items() if not body.is_static)
        self._next_fragment_id = len(bodies) + 1
        self.body_sequence = 0  # number of bodies announced, or about to be: those that came and those that went
        self._news = self._announcements()  # bodies not yet announced

    @property
    def next_fragment_id(self) -> int:
        """The lowest id never used."""
        return self._next_fragment_id

    def scene_body(self, fragment_id: int) -> SceneBody:
        """The body that a living fragment belongs to; KeyError if there is no such fragment."""
        return self.body_of[self.body_id_of[fragment_id]]

    def announce(self) -> list[CollisionBody]:
        """All present bodies, numbered from 1; clears the news."""
        self._news.clear()
        return self._announcements()

    def take_news(self) -> list[CollisionBody]:
        """Bodies that came or went since the last call."""
        news, self._news = self._news, []
        return news

    def enter_until(self, time: float) -> None:
        """Let bodies of the scene enter if their `start_time` [s] has come."""
        while self._unthrown and self._unthrown[0][0] <= time:
            self._enter(self._unthrown.pop(0)[1])

    def throw(self, body: SceneBody) -> int:
        """Add a body with the next step, whatever its `start_time`. Returns its id. ValueError for a static body."""
        if body.is_static:
            raise ValueError(f"{body.name!r} is static: only movable bodies can be thrown")
        number = self._next_fragment_id
        self._next_fragment_id += 1
        self.body_of[number], self.body_id_of[number] = body, number
        self.sizes[number] = body.shape.half_length()
        if body.shape.mesh is not None:
            self.breakable[number] = BreakableBody(number, number, body.shape.mesh)
        self._news.append(self._numbered(collision_body(number, body)))
        self._enter(number)
        return number

    def take_out(self, body_id: int, engine: Engine) -> list[int]:
        """Remove a body with all its fragments; returns these. KeyError if no movable body has this id."""
        body = self.body_of[body_id]
        if body.is_static:
            raise KeyError(body_id)
        gone = [i for i, of in self.body_id_of.items() if of == body_id]
        for fragment_id in gone:
            if self.waiting.pop(fragment_id, None) is None:
                engine.remove(fragment_id)
            del self.body_id_of[fragment_id]
        self._unthrown = [each for each in self._unthrown if each[1] != body_id]
        del self.body_of[body_id], self.sizes[body_id]
        self._news.append(self._numbered(collision_body(body_id, body)._replace(operation=REMOVE)))
        return gone

    def replace(self, event: FractureEvent, frame: FrameState, engine: Engine) -> None:
        """Replace a broken fragment by its pieces, which wait in its `frame`."""
        self._next_fragment_id += len(event.new_fragment_ids)
        engine.remove(event.fragment_id)
        body_id = self.body_id_of.pop(event.fragment_id)
        for new_id in event.new_fragment_ids.tolist():
            self.body_id_of[new_id] = body_id
            self.waiting[new_id] = frame

    def admit_waiting(self, registry: FragmentRegistry, engine: Engine) -> None:
        """Move the waiting fragments into the engine. ValueError if one is missing in the registry."""
        if not self.waiting:
            return
        rows = {fragment_id: row for row, fragment_id in enumerate(registry.fragment_ids.tolist())}
        for fragment_id in sorted(self.waiting):
            if fragment_id not in rows:
                sequence = registry.fracture_sequence
                raise ValueError(f"registry of fracture_sequence {sequence}: fragment {fragment_id} is missing")
            row = rows[fragment_id]
            xx, xy, xz, yy, yz, zz = registry.inertias[6 * row : 6 * row + 6].tolist()
            properties = MassProperties(
                mass=float(registry.masses[row]),
                center_of_mass=registry.centers_of_mass[3 * row : 3 * row + 3],
                inertia=np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]),
            )
            engine.add(fragment_id, properties, self.waiting[fragment_id])
        self.waiting.clear()

    def _announcements(self) -> list[CollisionBody]:
        self.body_sequence = 0
        return [self._numbered(collision_body(i, body)) for i, body in self.body_of.items()]

    def _numbered(self, body: CollisionBody) -> CollisionBody:
        self.body_sequence += 1
        return body._replace(sequence=self.body_sequence)

    def _enter(self, body_id: int) -> None:
        body = self.body_of[body_id]
        self.waiting[body_id] = FrameState(
            body.position, body.orientation, body.linear_velocity, body.angular_velocity
        )
