"""Box3D's collision step over the states of a scene: convex hulls for fragments; boxes and balls as they are.

Uses robox3d's raw binding. A hull has at most 256 half-edges: a fragment with more gets a hull of fewer points. Box3D
has no half-space: a plane is the top of a large box. Box3D reuses the contacts of pairs that have hardly moved.
"""

from __future__ import annotations

from time import perf_counter

import numpy as np
from robox3d._ffi import ffi, lib
from scipy.spatial import ConvexHull

from benchmarks.frames.peer import GrowingPeer, Shape, is_fixed, normal_and_point, poses_of, shape_of, turn_onto
from fracture_collision.records import CollisionBody, FragmentStates

CORNERS = (44, 32)  # at most in a hull; more exceed the half-edge limit, and so does 44 sometimes
HALF_EXTENT = 50.0  # [m] of the box whose top is a plane


class Box3dHulls(GrowingPeer):
    def __init__(self) -> None:
        super().__init__()
        definition = lib.b3DefaultWorldDef()
        definition.gravity, definition.workerCount = (0.0, 0.0, 0.0), 1
        definition.enableSleep = definition.enableContinuous = False
        self._world = lib.b3CreateWorld(ffi.addressof(definition))

    def __del__(self) -> None:
        lib.b3DestroyWorld(self._world)

    def step(self, states: FragmentStates) -> float:
        """Time [s] of a world step of zero duration: new pairs and contacts of all pairs, but no solver.

        Setting the poses is not included; it moves the boxes in Box3D's tree.
        """
        for i, position, (x, y, z, w) in poses_of(states):
            lib.b3Body_SetTransform(self._handles[i], tuple(position), ((x, y, z), w))
        started = perf_counter()
        lib.b3World_Step(self._world, 0.0, 1)
        return perf_counter() - started

    def _add(self, whole: CollisionBody | None, points: np.ndarray) -> object:
        definition = lib.b3DefaultBodyDef()
        definition.type = lib.b3_staticBody if is_fixed(whole) else lib.b3_dynamicBody
        body = lib.b3CreateBody(self._world, ffi.addressof(definition))
        shape = lib.b3DefaultShapeDef()
        shape.density = 1000.0  # [kg/m3], irrelevant here
        match shape_of(whole):
            case Shape.BOX:
                box = ffi.new("b3BoxHull*", lib.b3MakeBoxHull(*[0.5 * side for side in whole.primitive.dimensions]))
                lib.b3CreateHullShape(body, ffi.addressof(shape), ffi.addressof(box.base))
            case Shape.BALL:
                ball = ffi.new("b3Sphere*", {"center": (0.0, 0.0, 0.0), "radius": whole.primitive.dimensions[0]})
                lib.b3CreateSphereShape(body, ffi.addressof(shape), ball)
            case Shape.PLANE:
                normal, at = normal_and_point(whole)
                x, y, z, w = turn_onto(normal, axis=2)
                middle = at - HALF_EXTENT * normal / np.linalg.norm(normal)
                transform = (tuple(middle.tolist()), ((x, y, z), w))
                box = ffi.new("b3BoxHull*", lib.b3MakeTransformedBoxHull(*3 * [HALF_EXTENT], transform))
                lib.b3CreateHullShape(body, ffi.addressof(shape), ffi.addressof(box.base))
            case Shape.SURFACE:
                raise ValueError(f"{whole.name}: surfaces are not given to Box3D")
            case Shape.HULL:
                hull = _hull(points)
                lib.b3CreateHullShape(body, ffi.addressof(shape), hull)
                lib.b3DestroyHull(hull)
        return body

    def _remove(self, handle) -> None:
        lib.b3DestroyBody(handle)


def _hull(points: np.ndarray):
    """A hull that the caller must destroy."""
    corners = np.ascontiguousarray(points[ConvexHull(points).vertices], np.float32)
    for most in CORNERS:
        hull = lib.b3CreateHull(ffi.cast("b3Vec3*", ffi.from_buffer(corners)), len(corners), most)
        if hull != ffi.NULL:
            return hull
    raise RuntimeError(f"Box3D builds no hull of {len(corners)} points")
