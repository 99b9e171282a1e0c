"""States wait for the bodies that precede them, and only those take part, whatever order topics are delivered in."""

from __future__ import annotations

from itertools import permutations

import numpy as np
import pytest
from worlds.gate_world import box, record_bytes

from fracture_collision.records import REMOVE, CollisionBody, FragmentStates
from fracture_collision.ros.service.collision_run import CollisionRun
from fracture_collision.world import CollisionWorld, InvalidMessage, Settings, StatesAhead

SETTINGS = Settings(threads=1)
FLOOR = CollisionBody(1, 1, plane=np.array([0.0, 0.0, 1.0, 0.0]), is_static=True, sequence=1)
BODY = box(2, sequence=2)
WALL = CollisionBody(3, 3, plane=np.array([1.0, 0.0, 0.0, -0.5]), is_static=True, sequence=3)
TURN = np.array([0.0, 0.0, 0.0, 1.0])


def states(body_sequence: int, step: int = 1) -> FragmentStates:
    """The box, 10 mm deep in the floor and across the wall; static bodies are left out."""
    return FragmentStates(step, 0, np.array([2]), np.array([0.0, 0.0, 1.49]), TURN, body_sequence=body_sequence)


def touched(contacts) -> list[int]:
    """The fragments that touch the box."""
    return sorted({*contacts.fragment_a.tolist(), *contacts.fragment_b.tolist()} - {2})


@pytest.mark.parametrize("order", [*permutations((FLOOR, BODY, WALL))])
def test_states_are_answered_with_all_bodies_before_them_or_not_at_all(order: tuple[CollisionBody, ...]) -> None:
    run = CollisionRun(1, SETTINGS)
    asked = states(3)
    for body in order:
        assert run.answer(asked) is None
        assert "body_sequence: 3, but body message" in run.what_states_wait_for()
        assert not run.add_body(body)
    assert touched(run.answer(asked)) == [1, 3]


def test_static_bodies_of_later_messages_take_no_part() -> None:
    """So a body that is delivered before states which precede it changes nothing."""
    world = CollisionWorld(SETTINGS)
    world.add_body(FLOOR)
    world.add_body(BODY)
    before = record_bytes(world.contacts(states(2)))
    world.add_body(WALL)
    assert record_bytes(world.contacts(states(2))) == before
    assert touched(world.contacts(states(3))) == [1, 3]
    assert touched(world.contacts(states(0))) == [1, 3], "0: all that have arrived"
    assert record_bytes(world.contacts(states(2))) == before, "nor after another question"
    assert [touched(world.contacts(states(3, step))) for step in (4, 5)] == [[1, 3]] * 2


def test_states_before_the_removal_of_a_static_body_are_rejected_after_it() -> None:
    world = CollisionWorld(SETTINGS)
    for body in (FLOOR, BODY, WALL):
        world.add_body(body)
    world.add_body(WALL._replace(operation=REMOVE, sequence=4))
    with pytest.raises(InvalidMessage, match="body message 4 has removed static body 3") as caught:
        world.contacts(states(3))
    assert caught.value.kind == "retired_id"
    assert touched(world.contacts(states(2))) == touched(world.contacts(states(4))) == [1]


def test_states_after_a_rejected_body_are_rejected_until_it_is_corrected() -> None:
    run = CollisionRun(1, SETTINGS)
    assert not run.add_body(BODY)
    (refusal,) = run.add_body(FLOOR._replace(friction=-1.0))
    assert refusal.kind == "out_of_range"
    with pytest.raises(InvalidMessage, match="body message 1 was rejected: friction") as caught:
        run.answer(states(2))
    assert caught.value.kind == "body_rejected" and not isinstance(caught.value, StatesAhead)
    assert not run.add_body(FLOOR)
    assert touched(run.answer(states(2))) == [1]


def test_held_states_are_rejected_once_the_missing_body_turns_out_to_be_unreadable() -> None:
    run = CollisionRun(1, SETTINGS)
    run.add_body(BODY)
    asked = states(2)
    assert run.answer(asked) is None
    run.world.reject_body(1, "600 bytes, more than the parameter max_message_bytes, 500")
    with pytest.raises(InvalidMessage, match="max_message_bytes"):
        run.answer(asked)


def test_a_repeated_delivery_changes_nothing_and_another_body_cannot_take_its_number() -> None:
    world = CollisionWorld(SETTINGS)
    for body in (FLOOR, BODY, FLOOR, BODY):
        world.add_body(body)
    with pytest.raises(InvalidMessage, match="sequence: body message 2 already exists and names body 2"):
        world.add_body(WALL._replace(sequence=2))
    assert touched(world.contacts(states(2))) == [1]


def test_a_log_whose_beginning_is_gone_is_reported_as_such() -> None:
    """A restarted service gets what the publisher still keeps; it must not wait without a word."""
    run = CollisionRun(1, SETTINGS)
    run.add_body(BODY)
    run.add_body(WALL)
    assert run.answer(states(3)) is None
    assert "body message 1 has not arrived, but later ones have" in run.what_states_wait_for()
    assert "start a new run" in run.what_states_wait_for()


def test_bodies_without_numbers_are_named_where_states_wait_for_numbered_ones() -> None:
    world = CollisionWorld(SETTINGS)
    for body in (FLOOR, BODY):
        world.add_body(body._replace(sequence=0))
    with pytest.raises(StatesAhead, match="2 arrived without a sequence: number them 1, 2, 3"):
        world.contacts(states(2))
    assert touched(world.contacts(states(0))) == [1]
