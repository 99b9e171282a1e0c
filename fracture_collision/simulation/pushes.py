"""What pushes the bodies of a simulation, beside gravity and contacts: hands, hammers, arms; asked once a step."""

from __future__ import annotations

from typing import NamedTuple, Protocol

import numpy as np

from fracture_collision.simulation.engine import BodyStates


class Pusher(Protocol):
    """Something outside the scene that acts on what moves in it."""

    def pull(
        self, states: BodyStates, time: float, time_step: float, gravity: np.ndarray
    ) -> tuple[np.ndarray, float]:
        """What it adds in the step at `time` [s]: to all velocities, (n, 6) [m/s, rad/s], and to the energy [J]."""


class Pushes(NamedTuple):
    velocities: np.ndarray  # (n, 6) [m/s, rad/s] that all of them add
    energy: float  # [J] likewise


class Planned(NamedTuple):
    """Pushes that were asked for when the step began, of the bodies that moved then."""

    fragment_ids: np.ndarray  # (n,) uint32, ascending
    pushes: Pushes

    def of(self, fragment_ids: np.ndarray) -> Pushes:
        """Those of the bodies that move now (m,); who has come since is not pushed in this step."""
        velocities = np.zeros((len(fragment_ids), 6))
        _, now, then = np.intersect1d(fragment_ids, self.fragment_ids, assume_unique=True, return_indices=True)
        velocities[now] = self.pushes.velocities[then]
        return Pushes(velocities, self.pushes.energy)


def pushes_of(
    pushers: list[Pusher], states: BodyStates, time: float, time_step: float, gravity: np.ndarray
) -> Pushes:
    """What all of them add in the step at `time` [s]."""
    velocities, energy = np.zeros((len(states.fragment_ids), 6)), 0.0
    for pusher in pushers:
        more, gain = pusher.pull(states, time, time_step, gravity)
        velocities, energy = velocities + more, energy + gain
    return Pushes(velocities, energy)
