"""Rapier's collision pipeline over the states of a scene: hulls of fragments; boxes, balls and planes as they are."""

from __future__ import annotations

from time import perf_counter

import numpy as np
import rapier3d

from fracture_collision.records import BOX, SPHERE, CollisionBody, FragmentStates
from fracture_collision.world import CollisionWorld

TIME_STEP = 0.0025  # [s] of the pipeline; it moves nothing


class RapierHulls:
    """Who lives it learns from the service that answers the same states."""

    def __init__(self) -> None:
        self._bodies, self._colliders = rapier3d.RigidBodySet(), rapier3d.ColliderSet()
        self._islands, self._broad_phase = rapier3d.IslandManager(), rapier3d.BroadPhaseBvh()
        self._narrow_phase, self._pipeline = rapier3d.NarrowPhase(), rapier3d.CollisionPipeline()
        self._joints = rapier3d.ImpulseJointSet(), rapier3d.MultibodyJointSet()
        self._handles: dict[int, object] = {}
        self._whole: dict[int, CollisionBody] = {}  # bodies by the fragment that they are before they break

    def tell(self, bodies: list[CollisionBody]) -> None:
        self._whole |= {body.fragment_id: body for body in bodies}

    def follow(self, world: CollisionWorld, ids: list[int]) -> float:
        """Removes who broke and adds who came of it; returns the time [s] that hulls and sets took."""
        new = [i for i in ids if i not in self._handles]
        points = {i: world.fragment_mesh(i).vertices.reshape(-1, 3) for i in new}
        started = perf_counter()
        for i in self._handles.keys() - set(ids):
            self._bodies.remove(self._handles.pop(i), self._islands, self._colliders, *self._joints)
        for i in new:
            whole = self._whole.get(i)
            is_static = whole is not None and whole.is_static
            body = rapier3d.RigidBody.fixed() if is_static else rapier3d.RigidBody.dynamic()
            self._handles[i] = self._bodies.insert(body)
            collider = _collider(whole, points[i])
            self._colliders.insert_with_parent(collider, self._handles[i], self._bodies)
        return perf_counter() - started

    def step(self, states: FragmentStates) -> float:
        """[s] of the pipeline's step; setting the poses is not part of it."""
        poses = zip(
            states.fragment_ids.tolist(), states.positions.reshape(-1, 3).tolist(),
            states.orientations.reshape(-1, 4).tolist(), strict=True,
        )  # fmt: skip
        for i, position, (x, y, z, w) in poses:
            turn = rapier3d.Rotation3.from_quaternion(w, x, y, z)
            self._bodies[self._handles[i]].position = rapier3d.Isometry3(position, turn)
        started = perf_counter()
        self._pipeline.step(
            TIME_STEP, self._islands, self._broad_phase, self._narrow_phase, self._bodies, self._colliders
        )
        return perf_counter() - started


def _collider(whole: CollisionBody | None, points: np.ndarray):
    if whole is not None and whole.primitive.type == BOX:
        return rapier3d.Collider.cuboid(*[0.5 * side for side in whole.primitive.dimensions])
    if whole is not None and whole.primitive.type == SPHERE:
        return rapier3d.Collider.ball(whole.primitive.dimensions[0])
    if whole is not None and np.any(whole.plane):
        normal = np.asarray(whole.plane[:3], float)
        at = -whole.plane[3] * normal / (normal @ normal)
        return rapier3d.Collider.halfspace(normal.tolist(), translation=at.tolist())
    points = np.ascontiguousarray(points, np.float32)
    if whole is not None and len(whole.triangles) and not len(whole.tetrahedra):
        return rapier3d.Collider.trimesh(
            np.asarray(whole.vertices, np.float32).reshape(-1, 3), np.asarray(whole.triangles, np.uint32).reshape(-1, 3)
        )
    try:
        return rapier3d.Collider.convex_hull(points)
    except rapier3d.MeshConversionError:  # parry gives up on one in a hundred; the points in another order help
        return rapier3d.Collider.convex_hull(np.ascontiguousarray(points[::-1]))
