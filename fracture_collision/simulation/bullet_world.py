"""PyBullet as the engine: it holds masses, inertias and poses and integrates them; collision and contacts stay outside.

Bullet keeps each body in its *inertial frame*: origin in the centre of mass, axes along the principal axes. With c the
centre of mass and P the principal axes in the body frame, and (x, R) the body frame in the world, the inertial frame is
(x + R c, R P).
"""

from __future__ import annotations

from typing import NamedTuple, TypeVar

import numpy as np
import pybullet

from fracture_collision.simulation.engine import BodyStates, FrameState, MassProperties
from fracture_collision.simulation.rotations import (
    crossed,
    from_principal,
    quaternion_products,
    quaternions_of,
    rotation_matrices,
    through_matrices,
    turned,
    turned_along,
)

# Bullet clamps every velocity coordinate to 100 (m/s or rad/s) unless told otherwise; small shards spin faster.
VELOCITY_LIMIT = 1.0e6
INVERSE = np.array([-1.0, -1.0, -1.0, 1.0])  # of a unit quaternion, coordinate by coordinate


class _Bodies(NamedTuple):
    """What does not change while a body is there; ascending by fragment id."""

    handles: np.ndarray  # (n,) int64, Bullet's
    fragment_ids: np.ndarray  # (n,) uint32
    masses: np.ndarray  # (n,)
    centers_of_mass: np.ndarray  # (n, 3)
    body_to_inertial: np.ndarray  # (n, 4) quaternions; the inertial frame's axes are the principal ones
    moments: np.ndarray  # (n, 3) [kg m2], principal


NO_BODIES = _Bodies(
    np.zeros(0, np.int64), np.zeros(0, np.uint32), np.zeros(0), np.zeros((0, 3)), np.zeros((0, 4)), np.zeros((0, 3))
)


_Table = TypeVar("_Table", _Bodies, BodyStates)


class BulletWorld:
    """An `Engine` on a Bullet client of its own (DIRECT: no window, no threads, no clock)."""

    def __init__(self, gravity: np.ndarray, time_step: float) -> None:
        self._gravity = np.asarray(gravity, dtype=np.float64)
        self._time_step = float(time_step)
        self._client = pybullet.connect(pybullet.DIRECT)
        pybullet.setTimeStep(self._time_step, physicsClientId=self._client)
        pybullet.setGravity(*self._gravity, physicsClientId=self._client)
        self._newcomers: dict[int, tuple[MassProperties, FrameState]] = {}  # in Bullet when states are asked for
        # Of bodies that are gone, for the next that come: to make one takes twenty times as long as to move it
        # elsewhere. Meanwhile they fall, which nobody sees.
        self._spare: list[int] = []
        self._bodies = NO_BODIES
        # Of `_bodies`. Velocities are kept here: Bullet's have drift in them, and to ask for them costs as much as a
        # step.
        self._states = self._read(NO_BODIES, np.zeros((0, 3)), np.zeros((0, 3)))

    def add(self, fragment_id: int, properties: MassProperties, frame: FrameState) -> None:
        if fragment_id in self._newcomers or self._row_of(fragment_id) is not None:
            raise ValueError(f"fragment {fragment_id} is already in the world")
        if not properties.mass > 0.0:
            raise ValueError(f"fragment {fragment_id}: mass {properties.mass} kg: not positive")
        self._newcomers[fragment_id] = properties, frame

    def remove(self, fragment_id: int) -> None:
        if self._newcomers.pop(fragment_id, None) is not None:
            return
        row = self._row_of(fragment_id)
        if row is None:
            raise KeyError(fragment_id)
        self._spare.append(int(self._bodies.handles[row]))
        rest = np.delete(np.arange(len(self._bodies.handles)), row)
        self._bodies, self._states = _rows(self._bodies, rest), _rows(self._states, rest)

    def states(self) -> BodyStates:
        if self._newcomers:
            self._take_in()
        return self._states

    def advance(
        self, linear: np.ndarray, angular: np.ndarray, drift_linear: np.ndarray, drift_angular: np.ndarray
    ) -> None:
        before = self.states()
        linear, angular = np.array(linear), np.array(angular)
        spin = angular + drift_angular
        # Bullet adds gravity and, explicitly (which feeds energy to fast spins), the gyroscopic torque. Both are in
        # the given velocities already, so the one is subtracted and the other held by an opposite torque.
        velocity = linear + drift_linear - self._gravity * self._time_step
        torque = crossed(spin, turned(before.inertias, spin))
        client = self._client
        # Lists of floats: Bullet takes a numpy array apart number by number.
        for handle, v, w, t in zip(
            self._bodies.handles.tolist(), velocity.tolist(), spin.tolist(), torque.tolist(), strict=True
        ):
            pybullet.resetBaseVelocity(handle, v, w, physicsClientId=client)
            pybullet.applyExternalTorque(handle, -1, t, pybullet.WORLD_FRAME, physicsClientId=client)
        pybullet.stepSimulation(physicsClientId=client)
        moved = self._read(self._bodies, linear, angular)
        # Spins turn with the bodies, which keeps their energies.
        self._states = moved._replace(
            angular=turned_along(before.frame_orientations, moved.frame_orientations, angular)
        )

    def close(self) -> None:
        if self._client >= 0:
            pybullet.disconnect(physicsClientId=self._client)
            self._client = -1

    def _row_of(self, fragment_id: int) -> int | None:
        ids = self._bodies.fragment_ids
        row = int(np.searchsorted(ids, fragment_id))
        return row if row < len(ids) and ids[row] == fragment_id else None

    def _take_in(self) -> None:
        """All newcomers at once: a tenth of the time of one by one."""
        ids = np.array(list(self._newcomers), dtype=np.uint32)
        properties, frames = zip(*self._newcomers.values(), strict=True)
        masses, centers_of_mass, inertias = map(np.array, zip(*properties, strict=True))
        moments, body_to_inertial = _principal_axes(ids, inertias)
        self._newcomers.clear()
        positions, to_world, linear, angular = map(np.array, zip(*frames, strict=True))
        arms = turned(rotation_matrices(to_world), centers_of_mass)
        handles = self._created(
            masses, moments, positions + arms, quaternion_products(to_world, INVERSE * body_to_inertial)
        )
        bodies = _Bodies(handles, ids, masses, centers_of_mass, body_to_inertial, moments)
        states = self._read(bodies, linear + crossed(angular, arms), angular)
        order = np.argsort(np.concatenate((self._bodies.fragment_ids, ids)))
        self._bodies = _rows(_joined(self._bodies, bodies), order)
        self._states = _rows(_joined(self._states, states), order)

    def _created(
        self, masses: np.ndarray, moments: np.ndarray, positions: np.ndarray, orientations: np.ndarray
    ) -> np.ndarray:
        """Handles (n,) of new bodies with these inertial frames in the world."""
        client, places = self._client, positions.tolist()
        handles = [self._spare.pop() for _ in range(min(len(self._spare), len(places)))]
        if len(handles) < len(places):
            # Bullet reckons the handles of a batch from its last one's: right as long as none has ever been removed.
            handles += pybullet.createMultiBody(
                baseMass=1.0, basePosition=places[0], batchPositions=places[len(handles) :], physicsClientId=client
            )
        # Bullet takes an orientation through a matrix twice where a body is created with it, once where it is set. Once
        # more here: a run is the same to the bit as if each body had been created for itself.
        turns = through_matrices(orientations).tolist()
        for handle, mass, diagonal, place, turn in zip(
            handles, masses.tolist(), moments.tolist(), places, turns, strict=True
        ):
            pybullet.resetBasePositionAndOrientation(handle, place, turn, physicsClientId=client)
            # Energy is the contact solver's business: no damping, no sleeping, no clamp of Bullet's own.
            pybullet.changeDynamics(
                handle,
                -1,
                mass=mass,
                localInertiaDiagonal=diagonal,
                linearDamping=0.0,
                angularDamping=0.0,
                maxJointVelocity=VELOCITY_LIMIT,
                activationState=pybullet.ACTIVATION_STATE_DISABLE_SLEEPING,
                physicsClientId=client,
            )
        return np.array(handles)

    def _read(self, bodies: _Bodies, linear: np.ndarray, angular: np.ndarray) -> BodyStates:
        client = self._client
        poses = [
            pybullet.getBasePositionAndOrientation(handle, physicsClientId=client)
            for handle in bodies.handles.tolist()
        ]
        centers = np.array([pose[0] for pose in poses]).reshape(-1, 3)
        inertial_to_world = np.array([pose[1] for pose in poses]).reshape(-1, 4)
        body_to_world = quaternion_products(inertial_to_world, bodies.body_to_inertial)
        return BodyStates(
            fragment_ids=bodies.fragment_ids,
            masses=bodies.masses,
            inertias=from_principal(rotation_matrices(inertial_to_world), bodies.moments),
            centers=centers,
            linear=linear,
            angular=angular,
            frame_positions=centers - turned(rotation_matrices(body_to_world), bodies.centers_of_mass),
            frame_orientations=body_to_world,
        )


def _rows(table: _Table, rows: np.ndarray) -> _Table:
    return type(table)(*[column[rows] for column in table])


def _joined(first: _Table, second: _Table) -> _Table:
    return type(first)(*[np.concatenate(columns) for columns in zip(first, second, strict=True)])


def _principal_axes(ids: np.ndarray, inertias: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Of inertias (n, 3, 3): principal moments (n, 3), and the rotations (n, 4) from the body's axes to theirs."""
    moments, axes = np.linalg.eigh(inertias)
    for i in np.flatnonzero(~(moments[:, 0] > 0.0)):
        raise ValueError(f"fragment {ids[i]}: principal moments {moments[i]} kg m2: not positive")
    axes[np.linalg.det(axes) < 0.0, :, 2] *= -1.0
    return moments, quaternions_of(np.ascontiguousarray(axes.transpose(0, 2, 1)))
