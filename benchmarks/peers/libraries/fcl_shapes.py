"""FCL through python-fcl: bounding volume hierarchies of triangles, and hulls."""

from __future__ import annotations

from time import perf_counter
from typing import NamedTuple

import fcl
import numpy as np
from scipy.spatial import ConvexHull

from benchmarks.peers.boxes import LocalBoxes, local_boxes, near_pairs
from benchmarks.peers.method import Contacts, Method, about_middle
from benchmarks.peers.worlds import Frame, Surface, World

CONTACTS = 100  # per pair


class _State(NamedTuple):
    objects: list
    boxes: LocalBoxes


class Fcl(Method):
    def __init__(self, name: str, is_hull: bool) -> None:
        self.name, self._is_hull = name, is_hull

    def _geometry(self, surface: Surface):
        if self._is_hull:
            return _hull(surface.vertices)
        model = fcl.BVHModel()
        model.beginModel(len(surface.vertices), len(surface.triangles))
        model.addSubModel(surface.vertices, surface.triangles)
        model.endModel()
        return model

    def update(self, world: World, before) -> _State:
        surfaces = [f.mesh for f in world.fragments]
        return _State([fcl.CollisionObject(self._geometry(s)) for s in surfaces], local_boxes(surfaces))

    def query(self, world: World, state: _State, frame: Frame) -> Contacts:
        for it, rotation, position in zip(state.objects, frame.rotations, frame.positions, strict=True):
            it.setTransform(fcl.Transform(rotation, position))
        native, first, second, middles, normals, depths = 0.0, [], [], [], [], []
        for a, b in near_pairs(state.boxes, frame):
            request = fcl.CollisionRequest(num_max_contacts=CONTACTS, enable_contact=True)
            result = fcl.CollisionResult()
            started = perf_counter()
            fcl.collide(state.objects[a], state.objects[b], request, result)
            native += perf_counter() - started
            for contact in result.contacts:
                first.append(a)
                second.append(b)
                middles.append(contact.pos)
                normals.append(contact.normal)
                depths.append(contact.penetration_depth)
        return about_middle(first, second, middles, normals, depths, native)


def _hull(points: np.ndarray):
    """Qhull's hull, with its triangles oriented outwards."""
    hull = ConvexHull(points)
    corners = hull.points[hull.simplices]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    inward = np.sum(normals * hull.equations[:, :3], axis=1) < 0.0
    triangles = np.where(inward[:, None], hull.simplices[:, ::-1], hull.simplices)
    number = np.zeros(len(points), dtype=np.int64)
    number[hull.vertices] = np.arange(len(hull.vertices))
    faces = np.column_stack([np.full(len(triangles), 3), number[triangles]]).ravel().astype(np.int32)
    return fcl.Convex(np.ascontiguousarray(points[hull.vertices]), len(triangles), faces)


def methods() -> list[Method]:
    return [Fcl("fcl mesh", is_hull=False), Fcl("fcl hull", is_hull=True)]
