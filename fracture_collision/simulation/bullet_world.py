"""PyBullet as the engine: it holds masses, inertias and poses and integrates them; collision and contacts stay outside.

Bullet keeps each body in its *inertial frame*: origin in the centre of mass, axes along the principal axes. With c the
centre of mass and P the principal axes in the body frame, and (x, R) the body frame in the world, the inertial frame is
(x + R c, R P).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pybullet
from scipy.spatial.transform import Rotation

from fracture_collision.simulation.engine import BodyStates, FrameState, MassProperties
from fracture_collision.simulation.rotations import quaternion_products, rotation_matrices

# Bullet clamps every velocity coordinate to 100 (m/s or rad/s) unless told otherwise; small shards spin faster.
VELOCITY_LIMIT = 1.0e6


class _Inertial(NamedTuple):
    mass: float
    center_of_mass: np.ndarray  # (3,) body frame
    body_to_inertial: np.ndarray  # (4,) quaternion; the inertial frame's axes are the principal ones
    moments: np.ndarray  # (3,) [kg m2], principal


class BulletWorld:
    """An `Engine` on a Bullet client of its own (DIRECT: no window, no threads, no clock)."""

    def __init__(self, gravity: np.ndarray, time_step: float) -> None:
        self._gravity = np.asarray(gravity, dtype=np.float64)
        self._time_step = float(time_step)
        self._client = pybullet.connect(pybullet.DIRECT)
        pybullet.setTimeStep(self._time_step, physicsClientId=self._client)
        pybullet.setGravity(*self._gravity, physicsClientId=self._client)
        self._handles: dict[int, int] = {}  # kept in ascending order of fragment ids
        self._inertials: dict[int, _Inertial] = {}
        self._states: BodyStates | None = None
        self._velocities_differ = False  # Bullet's from those of the states: drift is in them

    def add(self, fragment_id: int, properties: MassProperties, frame: FrameState) -> None:
        if fragment_id in self._handles:
            raise ValueError(f"fragment {fragment_id} is already in the world")
        inertial = _inertial_frame(fragment_id, properties)
        to_world = Rotation.from_quat(frame.orientation)
        arm = to_world.apply(inertial.center_of_mass)
        handle = pybullet.createMultiBody(
            baseMass=inertial.mass,
            basePosition=frame.position + arm,
            baseOrientation=(to_world * Rotation.from_quat(inertial.body_to_inertial).inv()).as_quat(),
            physicsClientId=self._client,
        )
        # Energy is the contact solver's business: no damping, no sleeping, no clamp of Bullet's own.
        pybullet.changeDynamics(
            handle,
            -1,
            localInertiaDiagonal=inertial.moments,
            linearDamping=0.0,
            angularDamping=0.0,
            maxJointVelocity=VELOCITY_LIMIT,
            activationState=pybullet.ACTIVATION_STATE_DISABLE_SLEEPING,
            physicsClientId=self._client,
        )
        velocity = frame.linear_velocity + np.cross(frame.angular_velocity, arm)
        pybullet.resetBaseVelocity(handle, velocity, frame.angular_velocity, physicsClientId=self._client)
        self._settle_velocities()
        self._handles = dict(sorted([*self._handles.items(), (fragment_id, handle)]))
        self._inertials = dict(sorted([*self._inertials.items(), (fragment_id, inertial)]))
        self._states = None

    def remove(self, fragment_id: int) -> None:
        self._settle_velocities()
        pybullet.removeBody(self._handles.pop(fragment_id), physicsClientId=self._client)
        del self._inertials[fragment_id]
        self._states = None

    def states(self) -> BodyStates:
        if self._states is None:
            self._states = self._read()
        return self._states

    def advance(
        self, linear: np.ndarray, angular: np.ndarray, drift_linear: np.ndarray, drift_angular: np.ndarray
    ) -> None:
        before = self.states()
        if before.fragment_ids.size:
            spin = angular + drift_angular
            # Bullet adds gravity and, explicitly (which feeds energy to fast spins), the gyroscopic torque. Both are in
            # the given velocities already, so the one is subtracted and the other held by an opposite torque.
            velocity = linear + drift_linear - self._gravity * self._time_step
            torque = np.cross(spin, np.einsum("nij,nj->ni", before.inertias, spin))
            for i, handle in enumerate(self._handles.values()):
                pybullet.resetBaseVelocity(handle, velocity[i], spin[i], physicsClientId=self._client)
                pybullet.applyExternalTorque(
                    handle, -1, torque[i], pybullet.WORLD_FRAME, physicsClientId=self._client
                )
        pybullet.stepSimulation(physicsClientId=self._client)
        moved = self._read()
        if before.fragment_ids.size:
            # Take the drift out again, and turn the spins with the bodies, which keeps their energies.
            was = rotation_matrices(before.frame_orientations)
            now = rotation_matrices(moved.frame_orientations)
            spin = moved.angular - drift_angular
            angular = np.einsum("nij,nkj,nk->ni", now, was, spin)
            moved = moved._replace(linear=moved.linear - drift_linear, angular=angular)
            self._velocities_differ = True
        self._states = moved

    def _settle_velocities(self) -> None:
        """Give Bullet the velocities of the states, before the bodies are read anew."""
        if self._velocities_differ:
            for i, handle in enumerate(self._handles.values()):
                linear, angular = self._states.linear[i], self._states.angular[i]
                pybullet.resetBaseVelocity(handle, linear, angular, physicsClientId=self._client)
            self._velocities_differ = False

    def close(self) -> None:
        if self._client >= 0:
            pybullet.disconnect(physicsClientId=self._client)
            self._client = -1

    def _read(self) -> BodyStates:
        if not self._handles:
            empty = np.zeros((0, 3))
            return BodyStates(
                np.zeros(0, np.uint32), np.zeros(0), np.zeros((0, 3, 3)), *[empty] * 4, np.zeros((0, 4))
            )
        handles, inertials = self._handles.values(), self._inertials.values()
        poses = [pybullet.getBasePositionAndOrientation(h, physicsClientId=self._client) for h in handles]
        velocities = [pybullet.getBaseVelocity(h, physicsClientId=self._client) for h in handles]
        centers = np.array([pose[0] for pose in poses])
        inertial_to_world = np.array([pose[1] for pose in poses])
        body_to_inertial = np.array([inertial.body_to_inertial for inertial in inertials])
        body_to_world = quaternion_products(inertial_to_world, body_to_inertial)
        axes = rotation_matrices(inertial_to_world)
        moments = np.array([inertial.moments for inertial in inertials])
        arms = np.array([inertial.center_of_mass for inertial in inertials])
        return BodyStates(
            fragment_ids=np.array(list(self._handles), dtype=np.uint32),
            masses=np.array([inertial.mass for inertial in inertials]),
            inertias=np.einsum("nij,nj,nkj->nik", axes, moments, axes),
            centers=centers,
            linear=np.array([velocity[0] for velocity in velocities]),
            angular=np.array([velocity[1] for velocity in velocities]),
            frame_positions=centers - np.einsum("nij,nj->ni", rotation_matrices(body_to_world), arms),
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
        Rotation.from_matrix(axes.T).as_quat(),
        moments,
    )
