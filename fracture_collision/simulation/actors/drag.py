"""A hand in a running simulation: it takes hold of fragments, pulls them, and keeps hold when they break."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from fracture_collision.portable_math import lengths
from fracture_collision.simulation.actors.hand import Grip, Hand, HandSettings, HandTrack, HeldBody, kick
from fracture_collision.simulation.breakable_body import BreakableBody
from fracture_collision.simulation.engine.engine import BodyStates
from fracture_collision.simulation.rotations import turned_back, turned_by
from fracture_collision.simulation.solver.contact_solver import kinetic_energy


class Drag:
    """A hand with its grip. A scene's recorded hand moves it; without one, `grab`, `move` and `release` do.

    `body_ids`: the body of each living fragment, `breakable`: bodies with a mesh; both are the simulation's own tables.
    """

    def __init__(
        self,
        hand: Hand | None,
        names: Mapping[int, str],
        body_ids: Mapping[int, int],
        breakable: Mapping[int, BreakableBody],
    ) -> None:
        self._settings = HandSettings() if hand is None else hand.settings
        self._track = None if hand is None else hand.track
        self._id_of = {name: body_id for body_id, name in names.items()}
        self._body_ids, self._breakable = body_ids, breakable
        self._grip: Grip | None = None
        self._holds = ""  # name of the body in the recorded hand
        self._position, self._velocity = np.zeros((2, 3))
        self._quickness = 1.0

    @property
    def held(self) -> int | None:
        """Id of the fragment in the hand."""
        return None if self._grip is None else self._grip.fragment_id

    def grab(self, name: str, position: np.ndarray, states: BodyStates) -> bool:
        """Take hold of the body `name`, or a fragment of it, by the node nearest to `position` (3,) [m], world.

        A box or a sphere is held by its centre. The hand stays at `position` until it is moved. False if no fragment of
        the body is among `states`; KeyError if no body has this name.
        """
        body_id, nearest, self._grip = self._id_of[name], np.inf, None
        for i, fragment_id in enumerate(states.fragment_ids.tolist()):
            if self._body_ids[fragment_id] != body_id:
                continue
            turn, origin = states.frame_orientations[i], states.frame_positions[i]
            at = turned_back(turn, position - origin)
            node, point = -1, turned_back(turn, states.centers[i] - origin)
            if body_id in self._breakable:
                node, point = self._breakable[body_id].nearest_node(fragment_id, at)
            distance = float(lengths(point - at))
            if distance < nearest:
                self._grip, nearest = Grip(fragment_id, point, node), distance
        self.move(position, np.zeros(3))
        return self._grip is not None

    def hold(self, fragment_id: int, point: np.ndarray, position: np.ndarray, states: BodyStates) -> bool:
        """Take hold of one fragment at `point` (3,) [m] of its body frame, by its nearest node if it has any.

        The hand is at `position` (3,) [m], world. False where the fragment is not among `states`.
        """
        self._grip = None
        if fragment_id in states.fragment_ids:
            node, body = -1, self._breakable.get(self._body_ids[fragment_id])
            if body is not None:
                node, point = body.nearest_node(fragment_id, np.asarray(point, np.float64))
            self._grip = Grip(fragment_id, np.asarray(point, np.float64), node)
        self.move(position, np.zeros(3))
        return self._grip is not None

    def move(self, position: np.ndarray, velocity: np.ndarray) -> None:
        """Set the hand's position (3,) [m] and velocity (3,) [m/s] for the next step; world."""
        self._position, self._velocity = np.asarray(position, np.float64), np.asarray(velocity, np.float64)

    def quicken(self, factor: float) -> None:
        """Follow the hand in 1/`factor` of the simulated time, from now on."""
        self._quickness = factor

    def release(self) -> None:
        """Release the held fragment, if any."""
        self._grip = None

    def keep_hold(self, body_id: int, fragment_id: int) -> None:
        """After the fragment has broken: if it was held, keep hold of the piece at the grip."""
        if self._grip is not None and self._grip.fragment_id == fragment_id:
            self._grip = self._grip._replace(fragment_id=self._breakable[body_id].owner(self._grip.node))

    def pull(
        self, states: BodyStates, time: float, time_step: float, gravity: np.ndarray
    ) -> tuple[np.ndarray, float]:
        """What the hand adds in the step at `time` [s]: to all velocities, (n, 6), and to the energy [J]."""
        if self._track is not None:
            self._follow(self._track, time, states)
        pushes = np.zeros((len(states.fragment_ids), 6))
        if self._grip is None:
            return pushes, 0.0
        i = int(np.searchsorted(states.fragment_ids, self._grip.fragment_id))
        if i == len(states.fragment_ids) or states.fragment_ids[i] != self._grip.fragment_id:
            return pushes, 0.0  # a new piece waits for the registry
        before = np.concatenate((states.linear[i], states.angular[i]))
        held_at = states.frame_positions[i] + turned_by(states.frame_orientations[i], self._grip.point)
        # The spring includes this step's weight, or what hangs from it would hang too low.
        falling = before + np.concatenate((time_step * gravity, np.zeros(3)))
        body = HeldBody(states.masses[i], states.inertias[i], states.centers[i], falling, held_at)
        settings = self._settings._replace(frequency=self._quickness * self._settings.frequency)
        pushes[i] = kick(settings, body, self._position, self._velocity, time_step)
        of_body = states.masses[i : i + 1], states.inertias[i : i + 1]
        gain = kinetic_energy(*of_body, (before + pushes[i])[None]) - kinetic_energy(*of_body, before[None])
        return pushes, gain

    def _follow(self, track: HandTrack, time: float, states: BodyStates) -> None:
        position, velocity, name = track.at(time)
        if name != self._holds:
            self.release()
            # A body that has not entered yet is grabbed when it comes.
            if not name or self.grab(name, position, states):
                self._holds = name
        self.move(position, velocity)
