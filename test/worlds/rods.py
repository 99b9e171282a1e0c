"""Two crossing rods, edge over edge, far from all of their samples, for every kind of body."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from fracture_collision.geometry.generators import brick
from fracture_collision.records import BOX, CollisionBody, ContactConstraintArray, FragmentStates, SolidPrimitive
from fracture_collision.world import CollisionWorld, Settings
from worlds.hard_worlds import tetrahedral_body
from worlds.rigid_shapes import boundary_of

# Half edges [m] of a rod; turned by 45 degrees about its length, its upper edge is at EDGE.
ROD = np.array([1.0, 0.05, 0.05])
EDGE = 0.05 * np.sqrt(2.0)
OVERLAP = 0.01  # [m] five times epsilon



def rod_of(kind: str, body_id: int) -> CollisionBody:
    if kind == "box":
        return CollisionBody(body_id, body_id, primitive=SolidPrimitive(BOX, tuple(2.0 * ROD)), density=1000.0)
    body = brick(tuple(2.0 * ROD), 0.35)
    if kind == "tetrahedra":
        return tetrahedral_body(body, body_id)
    shape = boundary_of(body)
    return CollisionBody(
        body_id, body_id, vertices=shape.vertices.ravel(), triangles=shape.triangles.ravel(), density=1000.0
    )  # fmt: skip


def crossed(apart: float, beside: float) -> FragmentStates:
    """Rod 1 along x, rod 2 along y above it, edge over edge, `apart` [m], crossing `beside` [m] both middles."""
    along_x = Rotation.from_euler("x", 45.0, degrees=True)
    along_y = Rotation.from_euler("z", 90.0, degrees=True) * along_x
    positions = np.array([[0.0, 0.0, 0.0], [beside, -beside, 2.0 * EDGE + apart]])
    turns = np.array([along_x.as_quat(), along_y.as_quat()])
    return FragmentStates(1, 0, np.array([1, 2]), positions.ravel(), turns.ravel())


def answer_of_rods(
    kind: str, settings: Settings, states: FragmentStates, made: type[CollisionWorld] = CollisionWorld
) -> ContactConstraintArray:
    world = made(settings)
    for body_id in (1, 2):
        world.add_body(rod_of(kind, body_id))
    return world.contacts(states)
