"""A hand that takes hold of bodies and drags them by an implicit spring with a damper, live or recorded.

The spring pulls the held point, x = c + r, to the hand, x_h. It is implicit in the velocity after the step, so that it
is stable at any stiffness and time step h. The impulse J at x obeys

    J = -h (k (x + h v' - x_h) + d (v' - v_h)),   v' = v + K J,   K = 1/m - [r] I^-1 [r]
    (1 + (h d + h^2 k) K) J = -h (k (x + h v - x_h) + d (v - v_h))

with k = m (2 pi f)^2 and d = 2 zeta m (2 pi f), m the mass of the held fragment: light and heavy ones follow alike.

A hammer hangs on such a spring, of limited force: one that is driven against a wall stops there, and its momentum
breaks what it meets as any body's would. It does not turn.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np

from fracture_collision.portable_math import images, inverses, lengths, products, solutions
from fracture_collision.records import documented
from fracture_collision.simulation.breakable_body import BreakableBody
from fracture_collision.simulation.config.scene_fields import (
    Fields,
    SceneError,
    quoted,
)
from fracture_collision.simulation.engine import BodyStates
from fracture_collision.simulation.rotations import turned_back, turned_by
from fracture_collision.simulation.solver.contact_solver import kinetic_energy

COLUMNS = ["time", "x", "y", "z", "holds"]


@documented
class HandSettings(NamedTuple):
    """The spring between the hand and the fragment that it holds.

    Fields:
      frequency: [Hz] f, natural frequency of the held fragment about the hand
      damping_ratio: zeta of the spring; 1: critical
      force_limit: [N] largest pull of the hand
    """

    frequency: float = 4.0
    damping_ratio: float = 1.0
    force_limit: float = 200.0


class HandTrack(NamedTuple):
    """Recorded positions of a hand, and the body it held; between two times it moves at constant velocity."""

    times: np.ndarray  # (k,) [s], ascending
    positions: np.ndarray  # (k, 3) [m], world
    holds: tuple[str, ...]  # (k,) name of the body held from this time on; "": none

    def at(self, time: float) -> tuple[np.ndarray, np.ndarray, str]:
        """Position [m], velocity [m/s] and body held at `time` [s]; outside the track's times the hand rests, empty."""
        i = int(np.searchsorted(self.times, time, side="right")) - 1
        if i < 0 or i + 1 >= len(self.times):
            return self.positions[min(max(i, 0), len(self.times) - 1)], np.zeros(3), ""
        span = self.times[i + 1] - self.times[i]
        velocity = (self.positions[i + 1] - self.positions[i]) / span
        return self.positions[i] + (time - self.times[i]) * velocity, velocity, self.holds[i]


class Hand(NamedTuple):
    """A hand in a scene."""

    settings: HandSettings
    track: HandTrack


class Grip(NamedTuple):
    """What a hand holds, and where."""

    fragment_id: int
    point: np.ndarray  # (3,) [m], body frame
    node: int  # of the body's mesh, at that point: after a fracture the hand keeps the piece that owns it; -1: no mesh


def parse_hand(fields: Fields, folder: Path | None, names: list[str]) -> Hand:
    """`track` is a CSV file beside the scene, or a list of its rows; `names`: the bodies that the hand may hold."""
    settings = HandSettings(**fields.numbers(HandSettings, above=("frequency", "force_limit")))
    words = "rows of time [s], x, y, z [m] of the hand, and the name of the body that it holds from then on, or nothing"
    rows, holds = fields.timed_rows("track", words, COLUMNS, folder, texts=1)
    fields.finish()
    path = fields.name("track")
    if len(rows) < 2:
        raise SceneError(f"{path}: needs at least two rows")
    for i, (name,) in enumerate(holds):
        if name and name not in names:
            raise SceneError(f"{path}[{i}]: no body {quoted(name)} that can move")
    return Hand(settings, HandTrack(rows[:, 0].copy(), rows[:, 1:].copy(), tuple(name for (name,) in holds)))


class HeldBody(NamedTuple):
    """A body that a hand pulls, and where; world frame."""

    mass: float  # [kg]
    inertia: np.ndarray  # (3, 3) [kg m2] about its centre of mass
    center: np.ndarray  # (3,) [m]
    velocity: np.ndarray  # (6,) v [m/s], w [rad/s]
    point: np.ndarray  # (3,) [m] where it is held


def kick(
    settings: HandSettings, body: HeldBody, hand_position: np.ndarray, hand_velocity: np.ndarray, time_step: float
) -> np.ndarray:
    """Change (6,) of v [m/s] and w [rad/s] of a body that a hand pulls for one `time_step` [s].

    hand_position (3,) [m], hand_velocity (3,) [m/s]; world frame.
    """
    mass, inertia, center, velocity, point = body
    x, y, z = point - center
    arm = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    inverse = inverses(inertia)
    mobility = np.eye(3) / mass - products(arm, products(inverse, arm))
    swing = 2.0 * math.pi * settings.frequency
    stiffness, damping = mass * swing * swing, 2.0 * settings.damping_ratio * mass * swing
    at_point = velocity[:3] - images(arm, velocity[3:])
    pull = stiffness * (point + time_step * at_point - hand_position) + damping * (at_point - hand_velocity)
    softness = time_step * (damping + time_step * stiffness)
    impulse = -time_step * solutions(np.eye(3) + softness * mobility, pull)
    size = float(lengths(impulse))
    impulse *= min(1.0, settings.force_limit * time_step / size) if size > 0.0 else 1.0
    return np.concatenate((impulse / mass, images(inverse, images(arm, impulse))))


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


HAMMER_ARM = HandSettings(frequency=8.0, damping_ratio=1.0, force_limit=600.0)
LEAD = 0.15  # [m] most that the commanded place leads the hammer, which so stops soon after the command does


class Hammer:
    """A heavy ball on a strong arm that follows a velocity command, for smashing interactively; an engine.Pusher."""

    def __init__(self, fragment_id: int, position: np.ndarray) -> None:
        """`position` (3,) [m]: where it hangs until the first command, world."""
        self.fragment_id = fragment_id
        self._position, self._velocity = np.array(position, np.float64), np.zeros(3)

    def steer(self, velocity: np.ndarray) -> None:
        """Move with `velocity` (3,) [m/s], world axes, until the next command."""
        self._velocity = np.array(velocity, np.float64)

    def pull(
        self, states: BodyStates, time: float, time_step: float, gravity: np.ndarray
    ) -> tuple[np.ndarray, float]:
        """Additions in the step at `time` [s]: to all velocities, (n, 6) [m/s, rad/s], and to the energy [J]."""
        pushes = np.zeros((len(states.fragment_ids), 6))
        i = int(np.searchsorted(states.fragment_ids, self.fragment_id))
        if i == len(states.fragment_ids) or states.fragment_ids[i] != self.fragment_id:
            return pushes, 0.0
        center = states.centers[i]
        ahead = self._position + time_step * self._velocity - center
        distance = float(lengths(ahead))
        self._position = center + ahead * min(1.0, LEAD / distance if distance > 0.0 else 1.0)
        before = np.concatenate((states.linear[i], states.angular[i]))
        falling = before + np.concatenate((time_step * gravity, np.zeros(3)))
        body = HeldBody(states.masses[i], states.inertias[i], center, falling, center)
        pushes[i] = kick(HAMMER_ARM, body, self._position, self._velocity, time_step)
        # The arm always bears the ball's weight and stops its spin.
        pushes[i, :3] -= time_step * gravity
        pushes[i, 3:] = -before[3:]
        of_body = states.masses[i : i + 1], states.inertias[i : i + 1]
        gain = kinetic_energy(*of_body, (before + pushes[i])[None]) - kinetic_energy(*of_body, before[None])
        return pushes, gain
