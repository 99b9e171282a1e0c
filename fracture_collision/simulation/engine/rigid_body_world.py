"""The engine: holds masses, inertias and poses of rigid bodies and integrates them.

One step of length h moves a body with centre of mass c and orientation q by the given velocities v, w,

    c += h v,   q = exp(h w / 2) q,

the second of which is exact for a constant w (semi-implicit Euler; the velocities already contain gravity and
gyroscopic terms). Bullet integrates by the same formulas (btTransformUtil::integrateTransform), but takes sin and cos
from glibc, which rounds them differently from processor to processor, and turns no body by more than pi/4 a step.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fracture_collision import portable_math
from fracture_collision.simulation.engine.engine import BodyStates, FrameState, MassProperties
from fracture_collision.simulation.rotations import (
    crossed,
    quaternion_products,
    rotation_matrices,
    turned,
    turned_along,
    turned_matrices,
    turns_of,
)


class _Bodies(NamedTuple):
    """Ascending by fragment id; mass properties in body frames, poses in the world."""

    fragment_ids: np.ndarray  # (n,) uint32
    masses: np.ndarray  # (n,) [kg]
    centers_of_mass: np.ndarray  # (n, 3) [m]
    inertias: np.ndarray  # (n, 3, 3) [kg m2], about the centre of mass
    centers: np.ndarray  # (n, 3) [m]
    orientations: np.ndarray  # (n, 4) unit quaternions x y z w
    linear: np.ndarray  # (n, 3) [m/s]
    angular: np.ndarray  # (n, 3) [rad/s]


_NONE = _Bodies(
    np.zeros(0, np.uint32), np.zeros(0), np.zeros((0, 3)), np.zeros((0, 3, 3)), np.zeros((0, 3)), np.zeros((0, 4)),
    np.zeros((0, 3)), np.zeros((0, 3)),
)  # fmt: skip


class RigidBodyWorld:
    """An `Engine`."""

    def __init__(self, time_step: float) -> None:
        self._time_step = float(time_step)
        self._bodies = _NONE
        self._newcomers: dict[int, tuple[MassProperties, FrameState]] = {}  # joined to `_bodies` when states are read
        self._states: BodyStates | None = None  # of `_bodies`, None after a change

    def add(self, fragment_id: int, properties: MassProperties, frame: FrameState) -> None:
        """Add a body; ValueError if its id is taken, or its mass or inertia is not positive."""
        if fragment_id in self._newcomers or self._row_of(fragment_id) is not None:
            raise ValueError(f"fragment {fragment_id} is already in the world")
        if not properties.mass > 0.0:
            raise ValueError(f"fragment {fragment_id}: mass {properties.mass} kg is not positive")
        minors = _leading_minors(properties.inertia)
        if not all(minor > 0.0 for minor in minors):
            tensor = properties.inertia.tolist()
            raise ValueError(f"fragment {fragment_id}: inertia {tensor} kg m2 is not positive definite")
        self._newcomers[fragment_id] = properties, frame

    def remove(self, fragment_id: int) -> None:
        """Remove a body; KeyError if there is none of this id."""
        if self._newcomers.pop(fragment_id, None) is not None:
            return
        row = self._row_of(fragment_id)
        if row is None:
            raise KeyError(fragment_id)
        self._bodies = _Bodies(*[np.delete(column, row, axis=0) for column in self._bodies])
        self._states = None

    def states(self) -> BodyStates:
        """Present states of all bodies, ascending by id."""
        if self._newcomers:
            self._take_in()
        if self._states is None:
            self._states = _states_of(self._bodies)
        return self._states

    def advance(
        self, linear: np.ndarray, angular: np.ndarray, drift_linear: np.ndarray, drift_angular: np.ndarray
    ) -> None:
        """One time step: see Engine."""
        before = self.states()
        turns = turns_of(angular + drift_angular, self._time_step)
        after = quaternion_products(turns, before.frame_orientations)
        self._bodies = self._bodies._replace(
            centers=before.centers + self._time_step * (linear + drift_linear),
            orientations=after,
            linear=np.array(linear),
            # Spins turn with the bodies, which conserves their energies.
            angular=turned_along(before.frame_orientations, after, np.array(angular)),
        )
        self._states = None

    def close(self) -> None:
        """No resources to release."""

    def _row_of(self, fragment_id: int) -> int | None:
        ids = self._bodies.fragment_ids
        row = int(np.searchsorted(ids, fragment_id))
        return row if row < len(ids) and ids[row] == fragment_id else None

    def _take_in(self) -> None:
        ids = np.array(list(self._newcomers), dtype=np.uint32)
        properties, frames = zip(*self._newcomers.values(), strict=True)
        self._newcomers.clear()
        masses, centers_of_mass, inertias = map(np.array, zip(*properties, strict=True))
        positions, orientations, linear, angular = map(np.array, zip(*frames, strict=True))
        arms = turned(rotation_matrices(orientations), centers_of_mass)
        come = _Bodies(
            ids, masses, centers_of_mass, inertias, positions + arms, orientations, linear + crossed(angular, arms),
            angular,
        )  # fmt: skip
        order = np.argsort(np.concatenate((self._bodies.fragment_ids, ids)), kind="stable")
        self._bodies = _Bodies(*[np.concatenate(columns)[order] for columns in zip(self._bodies, come, strict=True)])
        self._states = None


def _states_of(bodies: _Bodies) -> BodyStates:
    rotations = rotation_matrices(bodies.orientations)
    return BodyStates(
        fragment_ids=bodies.fragment_ids,
        masses=bodies.masses,
        inertias=turned_matrices(rotations, bodies.inertias),
        centers=bodies.centers,
        linear=bodies.linear,
        angular=bodies.angular,
        frame_positions=bodies.centers - turned(rotations, bodies.centers_of_mass),
        frame_orientations=bodies.orientations,
    )


def _leading_minors(matrix: np.ndarray) -> tuple[float, float, float]:
    """All positive if and only if a symmetric (3, 3) matrix is positive definite (Sylvester)."""
    two = matrix[0, 0] * matrix[1, 1] - matrix[0, 1] * matrix[1, 0]
    return float(matrix[0, 0]), float(two), float(portable_math.determinants(matrix))
