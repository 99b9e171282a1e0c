"""Pushes on the bodies of a simulation, beside gravity and contacts: hands, hammers and arms, evaluated once a step."""

from __future__ import annotations

from typing import NamedTuple, Protocol

import numpy as np

from fracture_collision.portable_math import lengths
from fracture_collision.simulation.engine.engine import BodyStates, ByFragment


class Pusher(Protocol):
    """An actor outside the scene that pushes bodies in it."""

    def pull(
        self, states: BodyStates, time: float, time_step: float, gravity: np.ndarray
    ) -> tuple[np.ndarray, float]:
        """Its additions in the step at `time` [s]: to all velocities, (n, 6) [m/s, rad/s], and to the energy [J]."""


class Pushes(NamedTuple):
    """What all pushers together add in a step."""

    velocities: np.ndarray  # (n, 6) [m/s, rad/s] that all of them add
    energy: float  # [J] likewise


NO_CHANGES = ByFragment(np.zeros(0, np.uint32), np.zeros((0, 6)))


class Planned(NamedTuple):
    """Pushes planned when the step began, on the bodies in motion then; newer bodies are not pushed in this step."""

    pushes: ByFragment  # (n, 6) [m/s, rad/s]
    energy: float  # [J] that they add
    expected: ByFragment  # (n, 6) estimate of what contacts leave of the pushes


def planned(fragment_ids: np.ndarray, pushes: Pushes, taken: ByFragment) -> Planned:
    """The pushes of a step, and the velocities expected after them.

    taken: (m, 6) by contacts in the last step. They are expected again, as for a hammer that presses against a wall,
    but no larger than the push: the blow of a hammer that has just hit the wall does not repeat.
    """
    by_contacts = taken.of(fragment_ids)
    for part in (slice(0, 3), slice(3, 6)):
        pushed, lost = lengths(pushes.velocities[:, part]), lengths(by_contacts[:, part])
        by_contacts[:, part] *= np.minimum(1.0, pushed / np.where(lost > 0.0, lost, 1.0))[:, None]
    left = ByFragment(fragment_ids, pushes.velocities + by_contacts)
    return Planned(ByFragment(fragment_ids, pushes.velocities), pushes.energy, left)


def pushes_of(
    pushers: list[Pusher], states: BodyStates, time: float, time_step: float, gravity: np.ndarray
) -> Pushes:
    """Sum over all pushers in the step at `time` [s]."""
    velocities, energy = np.zeros((len(states.fragment_ids), 6)), 0.0
    for pusher in pushers:
        more, gain = pusher.pull(states, time, time_step, gravity)
        velocities, energy = velocities + more, energy + gain
    return Pushes(velocities, energy)
