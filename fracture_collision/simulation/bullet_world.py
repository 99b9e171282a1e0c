"""PyBullet as the engine: it holds masses, inertias and poses and integrates them; collision and contacts stay outside.

Bullet keeps each body in its *inertial frame*: origin in the centre of mass, axes along the principal axes. With c the
centre of mass and P the principal axes in the body frame, and (x, R) the body frame in the world, the inertial frame is
(x + R c, R P).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pybullet

from fracture_collision.simulation.engine import BodyStates, FrameState, MassProperties
from fracture_collision.simulation.rotations import (
    from_principal,
    quaternion_of,
    quaternion_products,
    rotation_matrices,
    turned,
    turned_along,
)

# Bullet clamps every velocity coordinate to 100 (m/s or rad/s) unless told otherwise; small shards spin faster.
VELOCITY_LIMIT = 1.0e6
INVERSE = np.array([-1.0, -1.0, -1.0, 1.0])  # of a unit quaternion, coordinate by coordinate


class _Inertial(NamedTuple):
    mass: float
    center_of_mass: np.ndarray  # (3,) body frame
    body_to_inertial: np.ndarray  # (4,) quaternion; the inertial frame's axes are the principal ones
    moments: np.ndarray  # (3,) [kg m2], principal


class _Bodies(NamedTuple):
    """What does not change while no body comes or goes; ascending by fragment id."""

    handles: list[int]  # Bullet's
    fragment_ids: np.ndarray  # (n,) uint32
    masses: np.ndarray  # (n,)
    centers_of_mass: np.ndarray  # (n, 3)
    body_to_inertial: np.ndarray  # (n, 4)
    moments: np.ndarray  # (n, 3)


class _Motion(NamedTuple):
    linear: np.ndarray  # (3,) [m/s], of the centre of mass
    angular: np.ndarray  # (3,) [rad/s]


class BulletWorld:
    """An `Engine` on a Bullet client of its own (DIRECT: no window, no threads, no clock)."""

    def __init__(self, gravity: np.ndarray, time_step: float) -> None:
        self._gravity = np.asarray(gravity, dtype=np.float64)
        self._time_step = float(time_step)
        self._client = pybullet.connect(pybullet.DIRECT)
        pybullet.setTimeStep(self._time_step, physicsClientId=self._client)
        pybullet.setGravity(*self._gravity, physicsClientId=self._client)
        self._handles: dict[int, int] = {}
        self._inertials: dict[int, _Inertial] = {}
        # Velocities are kept here: Bullet's have drift in them, and to ask for them costs as much as a step.
        self._motions: dict[int, _Motion] = {}  # of all bodies, as long as there are no states
        self._bodies: _Bodies | None = None
        self._states: BodyStates | None = None

    def add(self, fragment_id: int, properties: MassProperties, frame: FrameState) -> None:
        if fragment_id in self._handles:
            raise ValueError(f"fragment {fragment_id} is already in the world")
        inertial = _inertial_frame(fragment_id, properties)
        to_world = frame.orientation.reshape(1, 4)
        arm = turned(rotation_matrices(to_world), inertial.center_of_mass[None])[0]
        handle = pybullet.createMultiBody(
            baseMass=inertial.mass,
            basePosition=(frame.position + arm).tolist(),
            baseOrientation=quaternion_products(to_world, INVERSE * inertial.body_to_inertial[None])[0].tolist(),
            physicsClientId=self._client,
        )
        # Energy is the contact solver's business: no damping, no sleeping, no clamp of Bullet's own.
        pybullet.changeDynamics(
            handle,
            -1,
            localInertiaDiagonal=inertial.moments.tolist(),
            linearDamping=0.0,
            angularDamping=0.0,
            maxJointVelocity=VELOCITY_LIMIT,
            activationState=pybullet.ACTIVATION_STATE_DISABLE_SLEEPING,
            physicsClientId=self._client,
        )
        self._before_change()
        self._handles[fragment_id] = handle
        self._inertials[fragment_id] = inertial
        velocity = frame.linear_velocity + np.cross(frame.angular_velocity, arm)
        self._motions[fragment_id] = _Motion(velocity, frame.angular_velocity)

    def remove(self, fragment_id: int) -> None:
        pybullet.removeBody(self._handles[fragment_id], physicsClientId=self._client)
        self._before_change()
        for of_all in (self._handles, self._inertials, self._motions):
            del of_all[fragment_id]

    def states(self) -> BodyStates:
        if self._states is None:
            self._bodies = self._gather()
            motions = [self._motions[fragment_id] for fragment_id in self._bodies.fragment_ids.tolist()]
            linear, angular = (np.array([motion[k] for motion in motions]).reshape(-1, 3) for k in range(2))
            self._states = self._read(linear, angular)
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
        torque = np.cross(spin, turned(before.inertias, spin))
        client = self._client
        # Lists of floats: Bullet takes a numpy array apart number by number.
        for handle, v, w, t in zip(
            self._bodies.handles, velocity.tolist(), spin.tolist(), torque.tolist(), strict=True
        ):
            pybullet.resetBaseVelocity(handle, v, w, physicsClientId=client)
            pybullet.applyExternalTorque(handle, -1, t, pybullet.WORLD_FRAME, physicsClientId=client)
        pybullet.stepSimulation(physicsClientId=client)
        moved = self._read(linear, angular)
        # Spins turn with the bodies, which keeps their energies.
        self._states = moved._replace(
            angular=turned_along(before.frame_orientations, moved.frame_orientations, angular)
        )

    def close(self) -> None:
        if self._client >= 0:
            pybullet.disconnect(physicsClientId=self._client)
            self._client = -1

    def _before_change(self) -> None:
        """Bodies come or go: states and table are of the past, the velocities stay."""
        if self._states is not None:
            states = self._states
            for fragment_id, linear, angular in zip(
                states.fragment_ids.tolist(), states.linear, states.angular, strict=True
            ):
                self._motions[fragment_id] = _Motion(linear, angular)
            self._states = None

    def _gather(self) -> _Bodies:
        fragment_ids = sorted(self._handles)
        inertials = [self._inertials[fragment_id] for fragment_id in fragment_ids]
        return _Bodies(
            [self._handles[fragment_id] for fragment_id in fragment_ids],
            np.array(fragment_ids, dtype=np.uint32),
            np.array([inertial.mass for inertial in inertials]),
            np.array([inertial.center_of_mass for inertial in inertials]).reshape(-1, 3),
            np.array([inertial.body_to_inertial for inertial in inertials]).reshape(-1, 4),
            np.array([inertial.moments for inertial in inertials]).reshape(-1, 3),
        )

    def _read(self, linear: np.ndarray, angular: np.ndarray) -> BodyStates:
        bodies, client = self._bodies, self._client
        poses = [pybullet.getBasePositionAndOrientation(handle, physicsClientId=client) for handle in bodies.handles]
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


def _inertial_frame(fragment_id: int, properties: MassProperties) -> _Inertial:
    moments, axes = np.linalg.eigh(properties.inertia)
    if not (properties.mass > 0.0 and moments[0] > 0.0):
        raise ValueError(
            f"fragment {fragment_id}: mass {properties.mass} kg, principal moments {moments} kg m2: not positive"
        )
    if np.linalg.det(axes) < 0.0:
        axes[:, 2] = -axes[:, 2]
    return _Inertial(
        float(properties.mass),
        np.asarray(properties.center_of_mass, dtype=np.float64),
        quaternion_of(axes.T),
        moments,
    )
