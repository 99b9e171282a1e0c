"""Rapier (parry) through its Python binding: convex hulls, triangle meshes, its own convex decomposition."""

from __future__ import annotations

from time import perf_counter
from typing import NamedTuple

import numpy as np
import rapier3d

from benchmarks.peers.method import Contacts, Method, contacts_of
from benchmarks.peers.worlds import Frame, Surface, World

TIME_STEP = 0.002  # [s] of the pipeline; nothing moves


class _State(NamedTuple):
    bodies: rapier3d.RigidBodySet
    colliders: rapier3d.ColliderSet
    islands: rapier3d.IslandManager
    broad_phase: rapier3d.BroadPhaseBvh
    narrow_phase: rapier3d.NarrowPhase
    pipeline: rapier3d.CollisionPipeline
    handles: list
    number: dict  # collider to fragment


class Rapier(Method):
    def __init__(self, shape: str, is_quick: bool) -> None:
        self.name = f"rapier {shape}"
        self.is_quick = is_quick
        self._shape = shape

    def _collider(self, surface: Surface):
        vertices, triangles = surface.vertices.astype(np.float32), surface.triangles.astype(np.uint32)
        if self._shape == "hull":
            try:
                return rapier3d.Collider.convex_hull(vertices)
            except rapier3d.MeshConversionError:  # parry fails on one hull in a hundred; reordering the points helps
                return rapier3d.Collider.convex_hull(np.ascontiguousarray(vertices[::-1]))
        if self._shape == "mesh":
            return rapier3d.Collider.trimesh(vertices, triangles, flags=rapier3d.TriMeshFlags.FIX_INTERNAL_EDGES)
        return rapier3d.Collider.convex_decomposition(vertices, triangles)

    def update(self, world: World, before) -> _State:
        state = _State(
            rapier3d.RigidBodySet(), rapier3d.ColliderSet(), rapier3d.IslandManager(), rapier3d.BroadPhaseBvh(),
            rapier3d.NarrowPhase(), rapier3d.CollisionPipeline(), [], {},
        )  # fmt: skip
        for i, fragment in enumerate(world.fragments):
            body = state.bodies.insert(rapier3d.RigidBody.dynamic())
            collider = state.colliders.insert_with_parent(self._collider(fragment.mesh), body, state.bodies)
            state.handles.append(body)
            state.number[collider] = i
        return state

    def query(self, world: World, state: _State, frame: Frame) -> Contacts:
        poses = zip(state.handles, frame.positions.tolist(), frame.quaternions.tolist(), strict=True)
        for handle, position, (x, y, z, w) in poses:
            turn = rapier3d.Rotation3.from_quaternion(w, x, y, z)
            state.bodies[handle].position = rapier3d.Isometry3(position, turn)
        started = perf_counter()
        state.pipeline.step(
            TIME_STEP, state.islands, state.broad_phase, state.narrow_phase, state.bodies, state.colliders
        )  # fmt: skip
        native = perf_counter() - started
        return touching_contacts(state.narrow_phase, state.number, frame, native)


def touching_contacts(
    narrow_phase: rapier3d.NarrowPhase, number: dict, frame: Frame, native: float = np.nan
) -> Contacts:  # fmt: skip
    """Contacts without gaps. `number`: collider to fragment."""
    first, second, own, other, normals, depths = [], [], [], [], [], []
    for pair in narrow_phase.contact_pairs():
        a, b = number[pair.collider1], number[pair.collider2]
        for manifold in pair.manifolds:
            points = manifold.points
            normal = manifold.data.normal if points else None
            for point in points:
                if point.dist <= 0.0:
                    first.append(a)
                    second.append(b)
                    own.append((point.local_p1.x, point.local_p1.y, point.local_p1.z))
                    other.append((point.local_p2.x, point.local_p2.y, point.local_p2.z))
                    normals.append((normal.x, normal.y, normal.z))
                    depths.append(-point.dist)
    return contacts_of(
        first, second, _to_world(frame, first, own), _to_world(frame, second, other), normals, depths, native
    )  # fmt: skip


def _to_world(frame: Frame, fragments: list[int], points: list[tuple]) -> np.ndarray:
    if not fragments:
        return np.zeros((0, 3))
    return np.einsum("nij,nj->ni", frame.rotations[fragments], np.array(points)) + frame.positions[fragments]


def methods() -> list[Method]:
    return [Rapier("hull", True), Rapier("mesh", False), Rapier("decomposition", False)]
