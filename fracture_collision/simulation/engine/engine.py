"""What the simulation asks of a physics engine: bodies in, velocities in, states out.

The engine holds the bodies and moves them; it finds no contacts and solves none. The simulation gives it the velocities
that the contact solver found, and it integrates the poses. Two frames occur: the *body frame* of the records (that of
the original, unbroken body, carried along rigidly by each of its fragments) and the centre of mass, about which
velocities and inertias are given here.
"""

from __future__ import annotations

from typing import NamedTuple, Protocol

import numpy as np


class MassProperties(NamedTuple):
    """Of one fragment, in its body frame."""

    mass: float  # [kg]
    center_of_mass: np.ndarray  # (3,) [m]
    inertia: np.ndarray  # (3, 3) [kg m2], about the centre of mass


class FrameState(NamedTuple):
    """Motion of one body frame in the world."""

    position: np.ndarray  # (3,) [m], its origin
    orientation: np.ndarray  # (4,) unit quaternion x y z w, body frame to world
    linear_velocity: np.ndarray  # (3,) [m/s], of its origin
    angular_velocity: np.ndarray  # (3,) [rad/s], world axes


class BodyStates(NamedTuple):
    """All bodies of an engine, ascending by fragment id; world frame."""

    fragment_ids: np.ndarray  # (n,) uint32
    masses: np.ndarray  # (n,) [kg]
    inertias: np.ndarray  # (n, 3, 3) [kg m2], about the centre of mass, world axes
    centers: np.ndarray  # (n, 3) [m], centres of mass
    linear: np.ndarray  # (n, 3) [m/s], of the centre of mass
    angular: np.ndarray  # (n, 3) [rad/s]
    frame_positions: np.ndarray  # (n, 3) [m], body frames' origins
    frame_orientations: np.ndarray  # (n, 4) unit quaternions x y z w, body frame to world

    def frame_velocities(self) -> np.ndarray:
        """Of the body frames' origins: v + w x (origin - c), (n, 3) [m/s]."""
        return self.linear + np.cross(self.angular, self.frame_positions - self.centers)

    def frame(self, i: int) -> FrameState:
        """Motion of the body frame of the i-th body."""
        return FrameState(
            self.frame_positions[i], self.frame_orientations[i], self.frame_velocities()[i], self.angular[i]
        )


def rows_of(fragments: np.ndarray, ids: np.ndarray) -> np.ndarray:
    """Where `fragments` (m,) stand in ascending `ids` (n,): (m,) int64; n: not among them."""
    rows = np.searchsorted(ids, fragments)
    return np.where(np.append(ids, 0)[rows] == fragments, rows, len(ids)).astype(np.int64)


class Engine(Protocol):
    """A world of free rigid bodies without collision shapes."""

    def add(self, fragment_id: int, properties: MassProperties, frame: FrameState) -> None:
        """Take in a body; ValueError where its id is taken or its mass is not positive."""

    def remove(self, fragment_id: int) -> None:
        """Forget a body; KeyError where there is none of this id."""

    def states(self) -> BodyStates:
        """Of all bodies, now."""

    def advance(
        self, linear: np.ndarray, angular: np.ndarray, drift_linear: np.ndarray, drift_angular: np.ndarray
    ) -> None:
        """One time step: bodies, in the order of `states`, move with `linear` + `drift_linear` (n, 3), keep `linear`.

        Likewise `angular`. The velocities already contain gravity and gyroscopic terms of this step; the drift
        velocities move poses only, they are gone after the step.
        """

    def close(self) -> None:
        """Give everything back; safe to call twice."""
