"""Coal (once hpp-fcl): bounding volume hierarchies of triangles, and hulls."""

from __future__ import annotations

from time import perf_counter
from typing import NamedTuple

import coal
import numpy as np

from benchmarks.peers.boxes import LocalBoxes, local_boxes, near_pairs
from benchmarks.peers.method import Contacts, Method, contacts_of
from benchmarks.peers.worlds import Frame, Surface, World


class _State(NamedTuple):
    geometries: list
    owners: list  # models that own the hulls and must outlive them
    boxes: LocalBoxes


class Coal(Method):
    def __init__(self, name: str, contacts: int, is_hull: bool = False, is_quick: bool = True) -> None:
        self.name, self.is_quick = name, is_quick
        self._contacts, self._is_hull = contacts, is_hull

    def _geometry(self, surface: Surface):
        model = coal.BVHModelOBBRSS()
        model.beginModel(len(surface.triangles), len(surface.vertices))
        model.addVertices(surface.vertices)
        model.addTriangles(surface.triangles.astype(np.int32))
        model.endModel()
        geometry = model
        if self._is_hull:
            model.buildConvexHull(True, "Qt")
            geometry = model.convex
        geometry.computeLocalAABB()
        return geometry, model

    def update(self, world: World, before) -> _State:
        surfaces = [f.mesh for f in world.fragments]
        geometries, owners = zip(*map(self._geometry, surfaces), strict=True)
        return _State(list(geometries), list(owners), local_boxes(surfaces))

    def query(self, world: World, state: _State, frame: Frame) -> Contacts:
        poses = [coal.Transform3s(r.copy(), p.copy()) for r, p in zip(frame.rotations, frame.positions, strict=True)]
        request = coal.CollisionRequest()
        request.num_max_contacts, request.enable_contact = self._contacts, True
        native, first, second, own, other, normals, depths = 0.0, [], [], [], [], [], []
        for a, b in near_pairs(state.boxes, frame):
            result = coal.CollisionResult()
            started = perf_counter()
            coal.collide(state.geometries[a], poses[a], state.geometries[b], poses[b], request, result)
            native += perf_counter() - started
            for contact in result.getContacts():
                first.append(a)
                second.append(b)
                own.append(contact.getNearestPoint1())
                other.append(contact.getNearestPoint2())
                normals.append(contact.normal)
                depths.append(-contact.penetration_depth)
        return contacts_of(first, second, own, other, normals, depths, native)


def methods() -> list[Method]:
    return [
        Coal("coal mesh, 100 contacts", 100),
        Coal("coal mesh, all contacts", 10_000, is_quick=False),
        Coal("coal hull", 1, is_hull=True),
    ]
