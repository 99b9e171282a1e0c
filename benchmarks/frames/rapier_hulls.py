"""Rapier's collision pipeline over the states of a scene: convex hulls for fragments; boxes, balls, planes as is."""

from __future__ import annotations

from time import perf_counter

import numpy as np
import rapier3d

from benchmarks.frames.peer import GrowingPeer, Shape, is_fixed, normal_and_point, poses_of, shape_of
from benchmarks.peers.libraries.rapier import touching_contacts
from benchmarks.peers.method import Contacts
from benchmarks.peers.worlds import Frame
from fracture_collision.records import CollisionBody, FragmentStates

PREDICTION = 0.0025  # [m] by which the pipeline inflates bounding boxes in its broad phase


class RapierHulls(GrowingPeer):
    lists_contacts = True

    def __init__(self) -> None:
        super().__init__()
        self._bodies, self._colliders = rapier3d.RigidBodySet(), rapier3d.ColliderSet()
        self._islands, self._broad_phase = rapier3d.IslandManager(), rapier3d.BroadPhaseBvh()
        self._narrow_phase, self._pipeline = rapier3d.NarrowPhase(), rapier3d.CollisionPipeline()
        self._joints = rapier3d.ImpulseJointSet(), rapier3d.MultibodyJointSet()

    def step(self, states: FragmentStates) -> float:
        """Time [s] of the pipeline's step; setting the poses is not included."""
        for i, position, (x, y, z, w) in poses_of(states):
            turn = rapier3d.Rotation3.from_quaternion(w, x, y, z)
            self._bodies[self._handles[i]].position = rapier3d.Isometry3(position, turn)
        started = perf_counter()
        self._pipeline.step(
            PREDICTION, self._islands, self._broad_phase, self._narrow_phase, self._bodies, self._colliders
        )
        return perf_counter() - started

    def contacts(self, ids: np.ndarray, frame: Frame) -> Contacts:
        bodies = (self._bodies[self._handles[i]] for i in ids.tolist())
        number = {body.colliders[0]: k for k, body in enumerate(bodies)}
        return touching_contacts(self._narrow_phase, number, frame)

    def _add(self, whole: CollisionBody | None, points: np.ndarray) -> object:
        body = rapier3d.RigidBody.fixed() if is_fixed(whole) else rapier3d.RigidBody.dynamic()
        handle = self._bodies.insert(body)
        self._colliders.insert_with_parent(_collider(whole, points), handle, self._bodies)
        return handle

    def _remove(self, handle) -> None:
        self._bodies.remove(handle, self._islands, self._colliders, *self._joints)


def _collider(whole: CollisionBody | None, points: np.ndarray):
    match shape_of(whole):
        case Shape.BOX:
            return rapier3d.Collider.cuboid(*[0.5 * side for side in whole.primitive.dimensions])
        case Shape.BALL:
            return rapier3d.Collider.ball(whole.primitive.dimensions[0])
        case Shape.PLANE:
            normal, at = normal_and_point(whole)
            return rapier3d.Collider.halfspace(normal.tolist(), translation=at.tolist())
        case Shape.SURFACE:
            return rapier3d.Collider.trimesh(
                np.asarray(whole.vertices, np.float32).reshape(-1, 3),
                np.asarray(whole.triangles, np.uint32).reshape(-1, 3),
            )
    points = np.ascontiguousarray(points, np.float32)
    try:
        return rapier3d.Collider.convex_hull(points)
    except rapier3d.MeshConversionError:  # parry fails on one hull in a hundred; reordering the points helps
        return rapier3d.Collider.convex_hull(np.ascontiguousarray(points[::-1]))
