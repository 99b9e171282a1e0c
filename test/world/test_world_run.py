"""Sequences of messages: limits, removal, repetition, earlier registries, and conservation of mass in fractures."""

from __future__ import annotations

import numpy as np
import pytest
from worlds.gate_world import (
    EARLIER,
    FIRST,
    IDS,
    POSITIONS,
    REFERENCE,
    SECOND,
    SETTINGS,
    TET,
    TRI,
    TURNS,
    X,
    made_world,
    observed,
    plane,
    record_bytes,
    refused,
    rigid,
    sphere,
    tetrahedral,
    with_entry,
)

from fracture_collision.records import REMOVE, CollisionBody
from fracture_collision.world import CollisionWorld, InvalidMessage


@pytest.fixture
def world() -> CollisionWorld:
    return made_world()


def test_rejected_states_do_not_move_the_registry(world: CollisionWorld) -> None:
    """After states of an earlier registry, rejected states of a later one must not activate the later registry."""
    world.contacts(EARLIER)
    before = record_bytes(world.fragments())
    unknown = REFERENCE._replace(fragment_ids=with_entry(IDS, 0, 50))
    for states in (unknown, REFERENCE._replace(positions=POSITIONS[3:])):
        with pytest.raises(InvalidMessage):
            world.contacts(states)
        assert record_bytes(world.fragments()) == before


@pytest.mark.parametrize(
    ("limits", "message", "words"),
    [
        ({"max_bodies": 4}, TET, "body_id"),
        ({"max_nodes": len(X) + 8 + 5}, TET, "vertices"),
        ({"max_nodes": len(X) + 8 + 5}, TRI, "vertices"),
        ({"max_fragments": 6}, sphere(20), "fragment_id"),
        ({"max_fragments": 7}, SECOND, "new_fragment_ids"),
    ],
    ids=["bodies", "nodes", "surface vertices", "fragments of bodies", "fragments of events"],
)
def test_messages_beyond_a_limit_are_rejected(limits: dict, message, words: str) -> None:
    world = made_world(SETTINGS._replace(**limits))
    deliver = world.add_body if isinstance(message, CollisionBody) else world.add_fracture
    refused(world, lambda: deliver(message), "limit_exceeded", words)
    room = made_world(SETTINGS._replace(**{name: value + 100 for name, value in limits.items()}))
    (room.add_body if isinstance(message, CollisionBody) else room.add_fracture)(message)


def test_removing_a_body_frees_its_share_of_the_limits() -> None:
    world = made_world(SETTINGS._replace(max_bodies=4, max_nodes=len(X) + 8))
    with pytest.raises(InvalidMessage, match="limit"):
        world.add_body(TRI)
    world.add_body(CollisionBody(4, 0, operation=REMOVE))
    world.add_body(TRI)
    assert world.fragments().fragment_ids.tolist() == [2, 3, 10, 11, 20]


def test_states_of_a_removed_body_are_rejected(world: CollisionWorld) -> None:
    remaining = REFERENCE._replace(fragment_ids=IDS[:2], positions=POSITIONS[:6], orientations=TURNS[:8])
    expected = record_bytes(world.contacts(remaining))
    world.add_body(CollisionBody(1, 1, operation=REMOVE))
    for states, words in ((REFERENCE, "fragment 10"), (EARLIER, "fragment 1")):
        with pytest.raises(InvalidMessage, match=f"fragment_ids: the body of {words} was removed") as refusal:
            world.contacts(states)
        assert refusal.value.kind == "retired_id"
    assert record_bytes(world.contacts(remaining)) == expected
    assert world.fragments().fragment_ids.tolist() == [2, 3, 4]
    digest = world.fragments().digest
    # a latched topic that redelivers everything changes nothing
    world.add_body(tetrahedral(1))
    world.add_body(CollisionBody(1, 1, operation=REMOVE))
    world.add_fracture(FIRST)
    assert world.fragments().digest == digest
    with pytest.raises(InvalidMessage, match="body_id: body 1 was removed") as refusal:
        world.add_body(tetrahedral(1, fragment_id=60))
    assert refusal.value.kind == "retired_id"
    with pytest.raises(InvalidMessage, match="fragment_id: fragment 10 already exists or existed"):
        world.add_body(tetrahedral(30, fragment_id=10))
    world.add_body(tetrahedral(30))
    assert world.fragments().fragment_ids.tolist() == [2, 3, 4, 30]


def test_events_of_a_removed_body_keep_their_place_in_the_sequence(world: CollisionWorld) -> None:
    """A service started late may get REMOVE before the events, as there is no order across topics."""
    world.add_fracture(SECOND)
    world.add_body(tetrahedral(30))
    third = FIRST._replace(sequence=3, body_id=30, fragment_id=30, new_fragment_ids=np.array([31, 32]))
    world.add_fracture(third)
    world.add_body(CollisionBody(1, 1, operation=REMOVE))
    late = CollisionWorld(SETTINGS)
    for body in (tetrahedral(1), plane(2), sphere(3), rigid(4), CollisionBody(1, 1, operation=REMOVE), tetrahedral(30)):
        late.add_body(body)
    with pytest.raises(InvalidMessage, match="fragment_id: body 1 has no fragment 11"):
        late.add_fracture(SECOND._replace(sequence=1))
    for event in (FIRST, SECOND, third):
        late.add_fracture(event)
    with pytest.raises(InvalidMessage, match="new_fragment_ids: fragment 12 already exists"):
        late.add_fracture(third._replace(sequence=4, fragment_id=31, new_fragment_ids=np.array([12, 40])))
    states = REFERENCE._replace(fracture_sequence=3, fragment_ids=np.array([3, 4, 31, 32]))
    assert record_bytes(late.contacts(states)) == record_bytes(world.contacts(states))
    assert record_bytes(late.fragments()) == record_bytes(world.fragments())


def test_bodies_delivered_again_change_nothing(world: CollisionWorld) -> None:
    before = observed(world)
    for body in (tetrahedral(1), plane(2), sphere(3), rigid(4)):
        world.add_body(body)
    world.add_fracture(FIRST)
    assert observed(world) == before


def test_states_of_earlier_registries_are_answered(world: CollisionWorld) -> None:
    young = CollisionWorld(SETTINGS)
    for body in (tetrahedral(1), plane(2), sphere(3), rigid(4)):
        young.add_body(body)
    expected = record_bytes(young.contacts(EARLIER))
    world.add_fracture(SECOND)
    later = REFERENCE._replace(fracture_sequence=2, fragment_ids=np.array([3, 10, 12, 13]))
    first = record_bytes(world.contacts(later))
    assert record_bytes(world.contacts(EARLIER)) == expected
    assert record_bytes(world.contacts(later)) == first
