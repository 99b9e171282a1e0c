"""Read-only and unaligned arrays are answered by the kernels that are there: none is compiled for them."""

from __future__ import annotations

import numpy as np
import pytest
from numba.core import event

from fracture_collision import fracture
from fracture_collision.geometry.generators import brick
from fracture_collision.records import FragmentStates
from fracture_collision.world import CollisionBody, CollisionWorld


def writeable(array: np.ndarray) -> np.ndarray:
    return np.array(array)


def read_only(array: np.ndarray) -> np.ndarray:
    """As from rosbags, jax, or a memory map."""
    copy = np.array(array)
    copy.setflags(write=False)
    return copy


def unaligned(array: np.ndarray) -> np.ndarray:
    """As from a message's bytes at any offset."""
    array = np.ascontiguousarray(array)
    return np.frombuffer(bytearray(b"x" + array.tobytes()), np.uint8)[1:].view(array.dtype).reshape(array.shape)


def answer(kind) -> list[np.ndarray]:
    mesh = brick((1.0, 1.0, 1.0), 0.5)
    body = CollisionBody(1, 1, vertices=kind(mesh.vertices), tetrahedra=kind(mesh.tetrahedra))
    faces = kind(np.array([[0, 1, 2], [0, 3, 1], [0, 2, 3], [1, 3, 2]], np.uint32))
    rigid = CollisionBody(2, 8, vertices=kind(mesh.vertices[[0, 1, 3, 9]]), triangles=faces)
    crack = fracture.planes(body, [(0.0, 0.0, 1.0)], [0.1])
    world = CollisionWorld()
    for each in (body, rigid, body._replace(body_id=3, fragment_id=9)):
        world.add_body(each)
    world.add_fracture(type(crack)(*(kind(field) if isinstance(field, np.ndarray) else field for field in crack)))
    states = FragmentStates(
        1, 1, kind(np.array([2, 3, 8, 9], np.uint32)), kind(np.linspace(0.0, 0.5, 12)),
        kind(np.tile([0.0, 0.0, 0.0, 1.0], 4)), kind(np.zeros(12)), kind(np.zeros(12)),
    )  # fmt: skip
    return [np.asarray(field) for field in world.contacts(states)]


@pytest.mark.parametrize("kind", [read_only, unaligned])
def test_such_arrays_compile_nothing(kind) -> None:
    expected = answer(writeable)
    with event.install_recorder("numba:compile") as compiled:
        given = answer(kind)
    assert not compiled.buffer
    for one, other in zip(given, expected, strict=True):
        assert one.tobytes() == other.tobytes()
