"""A scene's bodies as the records that the collision service reads."""

from __future__ import annotations

import numpy as np

from fracture_collision.records import BOX, SPHERE, CollisionBody, SolidPrimitive
from fracture_collision.simulation.scene.scene import SceneBody


def collision_body(body_id: int, body: SceneBody) -> CollisionBody:
    """`body` as CollisionBody; its one fragment has the same number as the body."""
    shape, material = body.shape, body.material
    record = CollisionBody(
        body_id=body_id,
        fragment_id=body_id,
        name=body.name,
        is_static=body.is_static,
        density=material.density,
        friction=material.friction,
        restitution=material.restitution,
    )
    if shape.kind == "plane":
        return record._replace(plane=np.array(shape.plane))
    if shape.kind == "box":
        return record._replace(primitive=SolidPrimitive(BOX, shape.size))
    if shape.kind == "sphere":
        return record._replace(primitive=SolidPrimitive(SPHERE, (shape.radius,)))
    assert shape.mesh is not None  # as in every shape of another kind
    return record._replace(
        vertices=shape.mesh.vertices.ravel(), tetrahedra=shape.mesh.tetrahedra.astype(np.uint32).ravel()
    )
