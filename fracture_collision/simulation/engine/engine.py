"""Interface of the physics engine: bodies in, velocities in, states out.

The engine holds the bodies and moves them; it neither finds nor solves contacts. The simulation passes it the contact
solver's velocities, and it integrates the poses. Two frames occur: the *body frame* of the records (that of the
original, unbroken body, carried along rigidly by each of its fragments) and the centre of mass, about which velocities
and inertias are given here.
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
    """Positions of `fragments` (m,) in ascending `ids` (n,): (m,) int64; n if not among them."""
    rows = np.searchsorted(ids, fragments)
    return np.where(np.append(ids, 0)[rows] == fragments, rows, len(ids)).astype(np.int64)


class ByFragment(NamedTuple):
    """Values of n fragments."""

    fragment_ids: np.ndarray  # (n,) uint32, ascending
    values: np.ndarray  # (n, ...)

    def of(self, fragment_ids: np.ndarray) -> np.ndarray:
        """(m, ...) the values of `fragment_ids` (m,), ascending; 0 for fragments that are not among these."""
        values = np.zeros((len(fragment_ids), *self.values.shape[1:]), self.values.dtype)
        _, own, these = np.intersect1d(fragment_ids, self.fragment_ids, assume_unique=True, return_indices=True)
        values[own] = self.values[these]
        return values


class Engine(Protocol):
    """A world of free rigid bodies without collision shapes."""

    def add(self, fragment_id: int, properties: MassProperties, frame: FrameState) -> None:
        """Add a body; ValueError if its id is taken or its mass is not positive."""

    def remove(self, fragment_id: int) -> None:
        """Remove a body; KeyError if there is none of this id."""

    def states(self) -> BodyStates:
        """Present states of all bodies."""

    def advance(
        self, linear: np.ndarray, angular: np.ndarray, drift_linear: np.ndarray, drift_angular: np.ndarray
    ) -> None:
        """One time step: bodies, in the order of `states`, move with `linear` + `drift_linear` (n, 3), keep `linear`.

        Likewise `angular`. The velocities already contain gravity and gyroscopic terms of this step; the drift
        velocities move poses only and do not outlast the step.
        """

    def close(self) -> None:
        """Release all resources; safe to call twice."""
