"""Sequences of messages: limits, removal, repetition, earlier registries, and fragments without volume."""

from __future__ import annotations

import numpy as np
import pytest
from oracles.fragmented_body import FragmentedBody
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
    crack,
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
from worlds.hard_worlds import by_labels, lattice_planes

from fracture_collision.geometry.generators import brick
from fracture_collision.records import REMOVE, CollisionBody, FractureEvent, FragmentStates
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


def moved(event: FractureEvent, at: float) -> FractureEvent:
    """The same event with its cut planes moved to x = at."""
    planes = event.cut_planes.reshape(-1, 4).copy()
    planes[:, 3] = planes[:, 0] * at
    return event._replace(cut_planes=planes.ravel())


def masses(world: CollisionWorld, sequence: int, ids: list[int]) -> dict[int, float]:
    still = np.tile([0.0, 0.0, 0.0, 1.0], len(ids))
    world.contacts(FragmentStates(1, sequence, np.array(ids), np.zeros(3 * len(ids)), still))
    told = world.fragments()
    return dict(zip(told.fragment_ids.tolist(), told.masses.tolist(), strict=True))


OUTERMOST = crack(2, 11, (12, 13), 0.4, above=0.1)  # the layer of nodes at x = 0.5
INNER = crack(2, 11, (12, 13), 0.3, above=0.1)  # that at x = 0.25; fragment 11 begins at x = 0.1


def test_a_layer_of_nodes_that_all_planes_pass_through() -> None:
    world = made_world()
    event = moved(OUTERMOST, 0.5)
    refused(world, lambda: world.add_fracture(event), "no_volume", "cut_planes: fragment 13 has no volume")
    world.add_fracture(OUTERMOST)


def test_planes_through_all_nodes_of_a_fragment_that_has_volume_beyond_an_older_crack() -> None:
    world = made_world()
    world.add_fracture(moved(INNER, 0.25))
    found = masses(world, 2, [3, 10, 12, 13])
    assert found[12] == pytest.approx(1000.0 * 0.15 * 0.25)
    assert found[13] == pytest.approx(1000.0 * 0.25 * 0.25)


def test_a_layer_between_an_older_crack_and_a_new_one_through_the_same_nodes() -> None:
    world = CollisionWorld(SETTINGS)
    world.add_body(tetrahedral(1))
    world.add_fracture(moved(crack(1, 1, (10, 11), 0.1), 0.25))
    with pytest.raises(InvalidMessage, match="fragment 12 has no volume"):
        world.add_fracture(moved(INNER, 0.25))
    world.add_fracture(INNER)
    assert masses(world, 2, [10, 12, 13])[12] == pytest.approx(1000.0 * 0.05 * 0.25)


def test_fragments_without_volume_by_the_oracle_are_rejected() -> None:
    body, refusals = brick((2.0, 1.0, 1.0), 0.5), 0
    for seed in range(16):
        cells = (2, 3, 6)[seed % 3]
        labels = np.random.default_rng(seed).integers(0, cells, len(body.vertices))
        oracle = FragmentedBody(body.vertices, body.tetrahedra)
        event = by_labels(labels, lattice_planes(body.vertices, cells))(oracle, 2, 1)
        oracle.apply(event)
        volumes = [oracle.volume(f) for f in oracle.fragment_ids]
        world = CollisionWorld(SETTINGS)
        world.add_body(CollisionBody(1, 1, vertices=body.vertices.ravel(), tetrahedra=body.tetrahedra.ravel()))
        if min(volumes) > 1e-12:
            world.add_fracture(event)
        else:
            with pytest.raises(InvalidMessage, match="has no volume"):
                world.add_fracture(event)
            refusals += 1
    assert 0 < refusals < 16
