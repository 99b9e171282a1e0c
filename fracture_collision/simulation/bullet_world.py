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

# Bullet clamps every velocity coordinate to 100 (m/s or rad/s) unless told otherwise; small shards spin faster.
VELOCITY_LIMIT = 1.0e6


class _Inertial(NamedTuple):
    mass: float
    center_of_mass: np.ndarray  # (3,) body frame
    principal_axes: np.ndarray  # (4,) quaternion, inertial frame to body frame
    principal_inertia: np.ndarray  # (3,)


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
        self._states: BodyStates | None = None

    def add(self, fragment_id: int, properties: MassProperties, frame: FrameState) -> None:
        if fragment_id in self._handles:
            raise ValueError(f"fragment {fragment_id} is already in the world")
        inertial = _inertial_frame(fragment_id, properties)
        to_world = Rotation.from_quat(frame.orientation)
        arm = to_world.apply(inertial.center_of_mass)
        handle = pybullet.createMultiBody(
            baseMass=inertial.mass,
            basePosition=frame.position + arm,
            baseOrientation=(to_world * Rotation.from_quat(inertial.principal_axes)).as_quat(),
            physicsClientId=self._client,
        )
        # Energy is the contact solver's business: no damping, no sleeping, no clamp of Bullet's own.
        pybullet.changeDynamics(
            handle,
            -1,
            localInertiaDiagonal=inertial.principal_inertia,
            linearDamping=0.0,
            angularDamping=0.0,
            maxJointVelocity=VELOCITY_LIMIT,
            activationState=pybullet.ACTIVATION_STATE_DISABLE_SLEEPING,
            physicsClientId=self._client,
        )
        velocity = frame.linear_velocity + np.cross(frame.angular_velocity, arm)
        pybullet.resetBaseVelocity(handle, velocity, frame.angular_velocity, physicsClientId=self._client)
        self._handles[fragment_id] = handle
        self._inertials[fragment_id] = inertial
        self._states = None

    def remove(self, fragment_id: int) -> None:
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
            for i, handle in enumerate(self._sorted_handles()):
                pybullet.resetBaseVelocity(handle, velocity[i], spin[i], physicsClientId=self._client)
                pybullet.applyExternalTorque(
                    handle, -1, torque[i], pybullet.WORLD_FRAME, physicsClientId=self._client
                )
        pybullet.stepSimulation(physicsClientId=self._client)
        self._states = None
        if before.fragment_ids.size:
            self._shed_drift(before, drift_linear, drift_angular)

    def _shed_drift(self, before: BodyStates, drift_linear: np.ndarray, drift_angular: np.ndarray) -> None:
        """Take the drift velocities out again, and turn the spins with the bodies, which keeps their energies."""
        moved = self._read()
        turn = Rotation.from_quat(moved.frame_orientations) * Rotation.from_quat(before.frame_orientations).inv()
        linear = moved.linear - drift_linear
        angular = turn.apply(moved.angular - drift_angular)
        for i, handle in enumerate(self._sorted_handles()):
            pybullet.resetBaseVelocity(handle, linear[i], angular[i], physicsClientId=self._client)
        self._states = moved._replace(linear=linear, angular=angular)

    def close(self) -> None:
        if self._client >= 0:
            pybullet.disconnect(physicsClientId=self._client)
            self._client = -1

    def _sorted_handles(self) -> list[int]:
        return [self._handles[fragment_id] for fragment_id in sorted(self._handles)]

    def _read(self) -> BodyStates:
        ids = sorted(self._handles)
        if not ids:
            empty = np.zeros((0, 3))
            return BodyStates(
                np.zeros(0, np.uint32), np.zeros(0), np.zeros((0, 3, 3)), *[empty] * 4, np.zeros((0, 4))
            )
        handles = self._sorted_handles()
        inertials = [self._inertials[i] for i in ids]
        poses = [pybullet.getBasePositionAndOrientation(h, physicsClientId=self._client) for h in handles]
        velocities = [pybullet.getBaseVelocity(h, physicsClientId=self._client) for h in handles]
        centers = np.array([pose[0] for pose in poses])
        inertial_to_world = Rotation.from_quat([pose[1] for pose in poses])
        axes = inertial_to_world.as_matrix()
        principal = np.array([inertial.principal_inertia for inertial in inertials])
        inertial_to_body = Rotation.from_quat([inertial.principal_axes for inertial in inertials])
        body_to_world = inertial_to_world * inertial_to_body.inv()
        return BodyStates(
            fragment_ids=np.array(ids, dtype=np.uint32),
            masses=np.array([inertial.mass for inertial in inertials]),
            inertias=np.einsum("nij,nj,nkj->nik", axes, principal, axes),
            centers=centers,
            linear=np.array([velocity[0] for velocity in velocities]),
            angular=np.array([velocity[1] for velocity in velocities]),
            frame_positions=centers - body_to_world.apply([inertial.center_of_mass for inertial in inertials]),
            frame_orientations=body_to_world.as_quat(),
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
        Rotation.from_matrix(axes).as_quat(),
        moments,
    )
