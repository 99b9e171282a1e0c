"""PhysX's step on the CPU over the states of a scene: convex hulls for fragments; boxes, balls and planes as they are.

Uses sapien, which has no separate collision step: the time includes the solver, with one iteration.
"""

from __future__ import annotations

from time import perf_counter

import numpy as np
import sapien
from sapien import physx

from benchmarks.frames.peer import GrowingPeer, Shape, is_fixed, normal_and_point, poses_of, shape_of, turn_onto
from fracture_collision.records import CollisionBody, FragmentStates

TIME_STEP = 1e-6  # [s]; nothing moves noticeably, and 0 is rejected
CONTACT_OFFSET = 1e-4  # [m] of each shape; contacts are made within the sum of both offsets: about our tolerance
STILL = np.zeros(3, np.float32)


class PhysxHulls(GrowingPeer):
    def __init__(self) -> None:
        super().__init__()
        physx.set_scene_config(gravity=STILL, enable_pcm=True, enable_ccd=False)
        physx.set_body_config(solver_position_iterations=1, solver_velocity_iterations=0, sleep_threshold=0.0)
        self._system, self._material = physx.PhysxCpuSystem(), physx.PhysxMaterial(0.5, 0.5, 0.0)
        self._system.timestep = TIME_STEP
        self._scene = sapien.Scene([self._system])

    def step(self, states: FragmentStates) -> float:
        """Time [s] of the step including the solver; setting poses and velocities is not included."""
        for i, position, turn in poses_of(states):
            entity, body = self._handles[i]
            entity.pose = _pose(position, turn)
            if isinstance(body, physx.PhysxRigidDynamicComponent):
                body.linear_velocity = body.angular_velocity = STILL
        started = perf_counter()
        self._system.step()
        return perf_counter() - started

    def _add(self, whole: CollisionBody | None, points: np.ndarray) -> object:
        body = physx.PhysxRigidStaticComponent() if is_fixed(whole) else physx.PhysxRigidDynamicComponent()
        shape = self._shape(whole, points)
        shape.contact_offset, shape.rest_offset = CONTACT_OFFSET, 0.0
        body.attach(shape)
        entity = sapien.Entity()
        entity.add_component(body)
        self._scene.add_entity(entity)
        return entity, body

    def _remove(self, handle) -> None:
        self._scene.remove_entity(handle[0])

    def _shape(self, whole: CollisionBody | None, points: np.ndarray):
        match shape_of(whole):
            case Shape.BOX:
                half_sides = 0.5 * np.array(whole.primitive.dimensions, np.float32)
                return physx.PhysxCollisionShapeBox(half_sides, self._material)
            case Shape.BALL:
                return physx.PhysxCollisionShapeSphere(whole.primitive.dimensions[0], self._material)
            case Shape.PLANE:
                normal, at = normal_and_point(whole)
                plane = physx.PhysxCollisionShapePlane(self._material)
                plane.local_pose = _pose(at, turn_onto(normal, axis=0))
                return plane
            case Shape.SURFACE:
                raise ValueError(f"{whole.name}: surfaces are not given to PhysX")
        return physx.PhysxCollisionShapeConvexMesh(
            np.ascontiguousarray(points, np.float32), np.ones(3, np.float32), self._material
        )


def _pose(position, turn: list[float]) -> sapien.Pose:
    """`turn`: quaternion (4) x y z w."""
    x, y, z, w = turn
    return sapien.Pose(np.array(position, np.float32), np.array([w, x, y, z], np.float32))
