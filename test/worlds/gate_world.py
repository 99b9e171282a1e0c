"""A world with one body of each kind and a fracture, messages that fit it, and its observable state."""

from __future__ import annotations

import numpy as np
import pytest

from fracture_collision.geometry.generators import brick
from fracture_collision.geometry.tetrahedra import unique_edges
from fracture_collision.records import BOX, SPHERE, CollisionBody, FractureEvent, FragmentStates, SolidPrimitive
from fracture_collision.world import CollisionWorld, InvalidMessage, Settings
from worlds.rigid_shapes import RigidShape, cube

SETTINGS = Settings(threads=1)
BRICK = brick((1.0, 0.5, 0.5), 0.25)
X = BRICK.vertices[:, 0]
EDGES = unique_edges(BRICK.tetrahedra)


def tetrahedral(number: int, **fields) -> CollisionBody:
    return CollisionBody(number, number, vertices=BRICK.vertices.ravel(), tetrahedra=BRICK.tetrahedra.ravel())._replace(
        **fields
    )


def rigid(number: int, shape: RigidShape | None = None, **fields) -> CollisionBody:
    vertices, triangles = shape or cube()
    return CollisionBody(number, number, vertices=vertices.ravel(), triangles=triangles.ravel())._replace(**fields)


def sphere(number: int, **fields) -> CollisionBody:
    return CollisionBody(number, number, primitive=SolidPrimitive(SPHERE, (0.2,)))._replace(**fields)


def box(number: int, **fields) -> CollisionBody:
    return CollisionBody(number, number, primitive=SolidPrimitive(BOX, (1.0, 2.0, 3.0)))._replace(**fields)


def plane(number: int, **fields) -> CollisionBody:
    return CollisionBody(number, number, plane=np.array([0.0, 0.0, 2.0, 0.5]), is_static=True)._replace(**fields)


def crack(
    sequence: int, fragment_id: int, new_ids: tuple[int, int], at: float, above: float = -np.inf
) -> FractureEvent:
    """Splits the nodes with x > `above` by the plane x = at."""
    nodes = np.flatnonzero(above < X)
    inside = EDGES[(above < X[EDGES]).all(axis=1)]
    beyond = at < X
    cut = inside[beyond[inside[:, 0]] != beyond[inside[:, 1]]]
    towards = np.where(beyond[cut[:, 1]], 1.0, -1.0)
    planes = np.column_stack([towards, np.zeros((len(cut), 2)), towards * at])
    return FractureEvent(
        sequence, 1, fragment_id, np.array(new_ids), nodes, beyond[nodes].astype(np.int64), cut.ravel(), planes.ravel()
    )


FIRST = crack(1, 1, (10, 11), 0.1)
SECOND = crack(2, 11, (12, 13), 0.3, above=0.1)
REFERENCE = FragmentStates(
    7, 1, np.array([3, 4, 10, 11]),
    np.array([0.1, 0.0, 0.25, 0.0, 0.5, 0.3, 0.0, 0.0, 0.2, 0.01, 0.0, 0.2]), np.tile([0.0, 0.0, 0.0, 1.0], 4),
)  # fmt: skip
IDS, POSITIONS, TURNS = REFERENCE.fragment_ids, REFERENCE.positions, REFERENCE.orientations
EARLIER = FragmentStates(
    8, 0, np.array([1, 3]), np.array([0.0, 0.0, 0.2, 0.1, 0.0, 0.5]), np.tile([0.0, 0.0, 0.0, 1.0], 2)
)


TET, TRI = tetrahedral(20), rigid(20)  # new to the world below


def made_world(settings: Settings = SETTINGS) -> CollisionWorld:
    world = CollisionWorld(settings)
    for body in (tetrahedral(1), plane(2), sphere(3), rigid(4)):
        world.add_body(body)
    world.add_fracture(FIRST)
    assert len(world.contacts(REFERENCE).gaps) > 10
    return world


def record_bytes(record) -> bytes:
    return b"|".join(np.asarray(field).tobytes() for field in record)


def assert_same_bytes(own, other, *where) -> None:
    for name, a, b in zip(own._fields, own, other, strict=True):
        assert np.asarray(a).tobytes() == np.asarray(b).tobytes(), (*where, name)


def observed(world: CollisionWorld) -> tuple[bytes, bytes]:
    """The observable state: the current registry and the answer to a reference state."""
    return record_bytes(world.fragments()), record_bytes(world.contacts(REFERENCE))


def refused(world: CollisionWorld, deliver, kind: str, words: str, error: type = InvalidMessage) -> None:
    before = observed(world)
    with pytest.raises(InvalidMessage, match=words) as refusal:
        deliver()
    assert type(refusal.value) is error
    assert refusal.value.kind == kind
    assert observed(world) == before


def with_entry(values: np.ndarray, index: int, value) -> np.ndarray:
    changed = np.array(values, copy=True)
    changed[index] = value
    return changed
