"""Participants of a run: the scene's bodies, those thrown in, and the fragments that they consist of.

Fragments wait here, outside the engine, until the registry brings their masses. The traits of bodies in motion are
arrays: they are looked up when bodies come or go, not for every contact.
"""

from __future__ import annotations

from collections.abc import Container, Mapping, Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from fracture_collision.records import REMOVE, CollisionBody, ContactConstraintArray, FractureEvent, FragmentRegistry
from fracture_collision.simulation.breakable_body import BreakableBody
from fracture_collision.simulation.engine import BodyStates, FrameState, MassProperties, rows_of
from fracture_collision.simulation.scene.scene import SceneBody, collision_body
from fracture_collision.simulation.solver.touch_ahead import Forms

if TYPE_CHECKING:
    from fracture_collision.simulation.dynamics import Dynamics


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

    def move_waiting(self, fragment_ids: np.ndarray, frames: FrameState) -> None:
        """Let those of `fragment_ids` (m,) that wait enter in these frames, a FrameState of arrays."""
        for row, fragment_id in enumerate(fragment_ids.tolist()):
            if fragment_id in self.waiting:
                self.waiting[fragment_id] = FrameState(*(column[row] for column in frames))

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

    def take_out(self, body_id: int, engine: Dynamics) -> list[int]:
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

    def replace(self, event: FractureEvent, frame: FrameState, engine: Dynamics) -> None:
        """Replace a broken fragment by its pieces, which wait in its `frame`."""
        self._next_fragment_id += len(event.new_fragment_ids)
        engine.remove(event.fragment_id)
        body_id = self.body_id_of.pop(event.fragment_id)
        for new_id in event.new_fragment_ids.tolist():
            self.body_id_of[new_id] = body_id
            self.waiting[new_id] = frame

    def admit_waiting(self, registry: FragmentRegistry, engine: Dynamics) -> None:
        """Move the waiting fragments into the engine. ValueError if one is missing in the registry."""
        if not self.waiting:
            return
        rows = {fragment_id: row for row, fragment_id in enumerate(registry.fragment_ids.tolist())}
        for fragment_id in sorted(self.waiting):
            if fragment_id not in rows:
                sequence = registry.fracture_sequence
                raise ValueError(f"registry of fracture_sequence {sequence}: fragment {fragment_id} is missing")
            row = rows[fragment_id]
            xx, xy, xz, yy, yz, zz = registry.inertias[row].tolist()
            properties = MassProperties(
                mass=float(registry.masses[row]),
                center_of_mass=registry.centers_of_mass[row],
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


class Traits(NamedTuple):
    """Of n bodies in motion."""

    fragment_ids: np.ndarray  # (n,) uint32, in the engine's order
    body_ids: np.ndarray  # (n + 1,) int64; the last, -1, for what cannot move
    rolling_arms: np.ndarray  # (n + 1,) [m]; the last, 0, for what cannot move
    strengths: np.ndarray  # (n,) [N s]; inf for what does not break
    forms: Forms


def traits_of(
    states: BodyStates,
    bodies: Mapping[int, SceneBody],
    sizes: Mapping[int, float],
    body_ids: Mapping[int, int],
    breakable: Mapping[int, BreakableBody],
    held_together: Container[int],
) -> Traits:
    """Traits of the bodies in `states`.

    The other arguments are the simulation's own tables: `bodies`, their R `sizes` [m] and `breakable` by body id,
    `body_ids` by fragment id, `held_together`: fragments that do not break.
    """
    numbers = np.array([*(body_ids[fragment] for fragment in states.fragment_ids.tolist()), -1], dtype=np.int64)
    arms, strengths = np.zeros(len(states.masses) + 1), np.full(len(states.masses), np.inf)
    forms = Forms(np.zeros(len(arms), np.bool_), np.full(len(arms), np.inf))
    for i, (fragment_id, body_id) in enumerate(zip(states.fragment_ids.tolist(), numbers.tolist(), strict=False)):
        material, mesh = bodies[body_id].material, breakable.get(body_id)
        fracture, arms[i] = material.fracture, material.rolling_arm
        forms.is_round[i], forms.sizes[i] = bodies[body_id].shape.kind == "sphere", sizes[body_id]
        if (
            fracture is not None
            and mesh is not None
            and fragment_id not in held_together
            and states.masses[i] >= fracture.minimum_mass
            and mesh.node_count(fragment_id) >= 2 * fracture.pattern.minimum_nodes
        ):
            strengths[i] = fracture.strength
    return Traits(states.fragment_ids, numbers, arms, strengths, forms)


class SharedTraits(NamedTuple):
    """Of p pairs."""

    body_a: np.ndarray  # (p,) int64 rows of the bodies, n for what cannot move
    body_b: np.ndarray  # (p,) int64
    rolling_arm: np.ndarray  # (p,) [m] the larger one
    sizes: np.ndarray  # (p,) R [m], the smaller one
    is_one_body: np.ndarray  # (p,) bool: fragments of one body

    def of(self, pairs: np.ndarray) -> SharedTraits:
        """Those of some `pairs` (p,) bool."""
        return self if pairs.all() else SharedTraits._make(column[pairs] for column in self)


def shared_traits(contacts: ContactConstraintArray, traits: Traits, cast: Cast) -> SharedTraits:
    """Traits of the pairs of `contacts`. ValueError if a fragment is neither among the n of `traits` nor static."""
    immovable = len(traits.fragment_ids)

    def of(fragments: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        rows = rows_of(fragments, traits.fragment_ids)
        arms, sizes = traits.rolling_arms[rows], traits.forms.sizes[rows]
        for fragment in np.unique(fragments[rows == immovable]).tolist():
            if fragment not in cast.body_id_of or not cast.scene_body(fragment).is_static:
                raise ValueError(f"contacts of step {contacts.step}: fragment {fragment} is not in the states")
            arms[fragments == fragment] = cast.scene_body(fragment).material.rolling_arm
            sizes[fragments == fragment] = cast.sizes[fragment]
        return rows, arms, sizes

    (a, arms_a, sizes_a), (b, arms_b, sizes_b) = of(contacts.fragment_a), of(contacts.fragment_b)
    is_one_body = (traits.body_ids[a] == traits.body_ids[b]) & (a < immovable)
    return SharedTraits(a, b, np.maximum(arms_a, arms_b), np.minimum(sizes_a, sizes_b), is_one_body)
