"""Records behave as their readers expect of Python objects."""

from __future__ import annotations

import copy
import pickle
import signal
import threading
import time
from functools import partial

import numpy as np
import pytest
from worlds.gate_world import EARLIER, REFERENCE, SECOND, made_world

from fracture_collision.core.memory.crew import Crew
from fracture_collision.records import CollisionBody, ContactConstraintArray, FractureEvent, FragmentStates


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
