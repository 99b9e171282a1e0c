"""PyBullet: hulls, queried pair by pair or as a world, and concave meshes."""

from __future__ import annotations

from time import perf_counter
from typing import NamedTuple

import pybullet

from benchmarks.peers.boxes import LocalBoxes, local_boxes, near_pairs
from benchmarks.peers.method import Contacts, Method, contacts_of
from benchmarks.peers.worlds import Frame, World


class _State(NamedTuple):
    client: int
    bodies: list[int]
    boxes: LocalBoxes


class Bullet(Method):
    def __init__(self, name: str, is_concave: bool = False, by_pairs: bool = False) -> None:
        self.name, self._is_concave, self._by_pairs = name, is_concave, by_pairs

    def prepare(self, world: World) -> int:
        return pybullet.connect(pybullet.DIRECT)

    def update(self, world: World, before: int) -> _State:
        bodies = []
        for fragment in world.fragments:
            shape = {"vertices": fragment.mesh.vertices.tolist(), "physicsClientId": before}
            if self._is_concave:
                # Bullet has no narrow phase between two such meshes: it returns no contacts, without an error
                shape["indices"] = fragment.mesh.triangles.ravel().tolist()
                shape["flags"] = pybullet.GEOM_FORCE_CONCAVE_TRIMESH
            made = pybullet.createCollisionShape(pybullet.GEOM_MESH, **shape)
            place = fragment.centre.tolist()
            bodies.append(pybullet.createMultiBody(1.0, made, basePosition=place, physicsClientId=before))
        boxes = local_boxes([f.mesh for f in world.fragments]) if self._by_pairs else None
        return _State(before, bodies, boxes)

    def query(self, world: World, state: _State, frame: Frame) -> Contacts:
        client, bodies, boxes = state
        poses = zip(bodies, frame.positions.tolist(), frame.quaternions.tolist(), strict=True)
        for body, position, quaternion in poses:
            pybullet.resetBasePositionAndOrientation(body, position, quaternion, physicsClientId=client)
        pairs = near_pairs(boxes, frame) if self._by_pairs else []
        started = perf_counter()
        if self._by_pairs:
            found = []
            for a, b in pairs:
                found += pybullet.getClosestPoints(bodies[a], bodies[b], 0.0, physicsClientId=client) or ()
        else:
            pybullet.performCollisionDetection(physicsClientId=client)
            found = pybullet.getContactPoints(physicsClientId=client) or ()
        native = perf_counter() - started
        number = {body: i for i, body in enumerate(bodies)}
        # Bullet's normal points from b to a
        return contacts_of(
            [number[c[1]] for c in found], [number[c[2]] for c in found], [c[5] for c in found], [c[6] for c in found],
            [(-c[7][0], -c[7][1], -c[7][2]) for c in found], [-c[8] for c in found], native,
        )  # fmt: skip

    def release(self, state: _State) -> None:
        pybullet.disconnect(physicsClientId=state.client)


def methods() -> list[Method]:
    return [
        Bullet("pybullet hull"),
        Bullet("pybullet hull, by pairs", by_pairs=True),
        Bullet("pybullet concave", is_concave=True),
    ]
