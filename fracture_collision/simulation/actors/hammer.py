"""A heavy ball on a strong arm that follows a velocity command, for smashing interactively.

The arm is a spring like a hand's (hand.py), of limited force: a hammer that is driven against a wall stops there, and
its momentum breaks what it meets as any body's would. It does not turn.
"""

from __future__ import annotations

import numpy as np

from fracture_collision.portable_math import lengths
from fracture_collision.simulation.actors.hand import HandSettings, HeldBody, kick
from fracture_collision.simulation.engine.engine import BodyStates
from fracture_collision.simulation.solver.contact_solver import kinetic_energy

ARM = HandSettings(frequency=8.0, damping_ratio=1.0, force_limit=600.0)
LEAD = 0.15  # [m] most that the commanded place leads the hammer, which so stops soon after the command does


class Hammer:
    """Drives one body of a simulation; a pushes.Pusher."""

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
        pushes[i] = kick(ARM, body, self._position, self._velocity, time_step)
        # The arm always bears the ball's weight and stops its spin.
        pushes[i, :3] -= time_step * gravity
        pushes[i, 3:] = -before[3:]
        of_body = states.masses[i : i + 1], states.inertias[i : i + 1]
        gain = kinetic_energy(*of_body, (before + pushes[i])[None]) - kinetic_energy(*of_body, before[None])
        return pushes, gain
