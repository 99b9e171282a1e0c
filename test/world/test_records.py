"""Records behave as their readers expect of Python objects, and take any array that has the numbers."""

from __future__ import annotations

import copy
import pickle
import signal
import threading
import time
from functools import partial

import numpy as np
import pytest
from numba.core import event
from worlds.gate_world import EARLIER, REFERENCE, SECOND, made_world, record_bytes

from fracture_collision import fracture
from fracture_collision.core.memory.crew import Crew
from fracture_collision.geometry.generators import brick
from fracture_collision.records import CollisionBody, ContactConstraintArray, FractureEvent, FragmentStates
from fracture_collision.world import CollisionWorld


def test_the_length_of_an_answer_is_the_number_of_its_contacts() -> None:
    answer = made_world().contacts(REFERENCE)
    assert len(answer) == len(answer.gaps) > 0 and answer
    none = answer._replace(gaps=np.zeros(0))
    assert len(none) == 0 and not none
    for same in (
        answer._replace(step=answer.step), ContactConstraintArray._make(answer), copy.deepcopy(answer),
        pickle.loads(pickle.dumps(answer)),
    ):  # fmt: skip
        assert type(same) is ContactConstraintArray and len(same) == len(answer)
        assert len(tuple(same)) == len(ContactConstraintArray._fields) == len(list(same))


@pytest.mark.parametrize("record", [CollisionBody, FractureEvent, FragmentStates])
def test_default_arrays_cannot_be_written_to(record: type) -> None:
    """All bodies share them: body.plane[2] = 1 made a plane of every other body."""
    arrays = [value for value in record._field_defaults.values() if isinstance(value, np.ndarray)]
    assert all(not array.flags.writeable for array in arrays)
    with pytest.raises(ValueError, match="read-only"):
        CollisionBody(1, 1).plane[2] = 1.0


def test_new_fragments_are_there_right_after_their_event() -> None:
    world = made_world()
    world.add_fracture(SECOND)
    assert world.fragments().fragment_ids.tolist() == [2, 3, 4, 10, 12, 13]
    assert len(world.fragment_mesh(12).vertices) > 0
    world = made_world()
    world.add_fracture(SECOND)
    assert len(world.fragment_mesh(11).vertices) > 0, "it lives at the last states, until something newer is wanted"
    assert len(world.fragment_mesh(12).vertices) > 0
    world.contacts(EARLIER)
    assert world.fragments().fragment_ids.tolist() == [1, 2, 3, 4], "those of the states, once there were any"


def test_workers_have_ended_when_an_interrupt_reaches_the_caller(request: pytest.FixtureRequest) -> None:
    """They write to memory that the next call uses."""
    # an rclpy context of another test in this process would handle the signal itself
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    request.addfinalizer(partial(signal.signal, signal.SIGINT, before))
    running = threading.Semaphore(0)
    ended: list[int] = []

    def kernel(_own: None, share: tuple[int, int]) -> None:
        if share[0] == 0:
            running.acquire()
            signal.raise_signal(signal.SIGINT)
        else:
            running.release()
            deadline = time.monotonic() + 0.3
            while time.monotonic() < deadline:
                pass
            ended.append(share[0])

    crew = Crew(2)
    for _ in range(2):
        ended.clear()
        with pytest.raises(KeyboardInterrupt):
            crew.share(kernel, own=(None, None))
        assert ended == [1]


MESH = brick((0.2, 0.1, 0.06), 0.05)
V, T = MESH.vertices, MESH.tetrahedra
BODY = CollisionBody(1, 1, vertices=V.ravel(), tetrahedra=T.astype(np.uint32).ravel())
EVENT = fracture.planes(BODY, (1.0, 0.0, 0.0), 0.01)
POSES = [[0.0, 0.0, 0.0], [0.0005, 0.0, 0.0]], [[0.0, 0.0, 0.0, 1.0]] * 2
FLOOR = CollisionBody(9, 90, plane=[0.0, 0.0, 1.0, 0.03], is_static=True)


def answer_and_digest(body: CollisionBody, event: FractureEvent, states: FragmentStates):
    world = CollisionWorld()
    for each in (body, FLOOR):
        world.add_body(each)
    world.add_fracture(event)
    answer = world.contacts(states)
    return record_bytes(answer), world.fragments().digest


def test_rows_lists_and_other_types_are_the_same_messages() -> None:
    positions, orientations = map(np.array, POSES)
    flat = answer_and_digest(
        BODY, EVENT, FragmentStates(1, 1, np.array([2, 3], np.uint32), positions.ravel(), orientations.ravel())
    )
    in_rows = EVENT._replace(cut_edges=EVENT.cut_edges.reshape(-1, 2), cut_planes=EVENT.cut_planes.reshape(-1, 4))
    as_lists = FractureEvent._make(v.tolist() if isinstance(v, np.ndarray) else v for v in in_rows)
    rows = BODY._replace(vertices=V, tetrahedra=T)
    lists = BODY._replace(vertices=V.tolist(), tetrahedra=T.tolist())
    fortran = BODY._replace(vertices=np.asfortranarray(V), tetrahedra=np.asfortranarray(T.astype(np.int64)))
    for body in (rows, lists, fortran):
        for fields in (in_rows, as_lists):
            assert answer_and_digest(body, fields, FragmentStates(1, 1, [2, 3], *POSES)) == flat
    single = BODY._replace(vertices=V.astype(np.float32).astype(np.float64))
    in_single = rows._replace(vertices=V.astype(np.float32))
    states = FragmentStates(1, 1, [2, 3], *POSES)
    assert answer_and_digest(in_single, EVENT, states) == answer_and_digest(single, EVENT, states)
    assert flat[0] and len(flat[1]) == 64


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
