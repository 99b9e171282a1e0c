"""Every rule of the protocol broken once: the message is rejected, naming the field, and nothing changes."""

from __future__ import annotations

import numpy as np
import pytest
from worlds.broken_rules import AHEAD, BODIES, EVENTS, HOLLOW, STATES
from worlds.gate_world import EARLIER, FIRST, REFERENCE, SECOND, TET, box, made_world, plane, refused, rigid, sphere

from fracture_collision.world import CollisionWorld, InvalidMessage, StatesAhead


@pytest.fixture
def world() -> CollisionWorld:
    return made_world()


@pytest.mark.parametrize("rule", BODIES)
def test_bodies_that_break_a_rule_are_rejected(world: CollisionWorld, rule: str) -> None:
    body, kind, words = BODIES[rule]
    refused(world, lambda: world.add_body(body), kind, words)
    for good in (TET, rigid(21), rigid(22, HOLLOW), sphere(23), box(24), plane(25)):
        world.add_body(good)
    assert world.fragments().fragment_ids.tolist() == [2, 3, 4, 10, 11, 20, 21, 22, 23, 24, 25]
    assert np.isfinite(world.fragments().masses).all()


@pytest.mark.parametrize("rule", EVENTS)
def test_events_that_break_a_rule_are_rejected(world: CollisionWorld, rule: str) -> None:
    event, kind, words = EVENTS[rule]
    refused(world, lambda: world.add_fracture(event), kind, words)
    world.add_fracture(FIRST)  # delivered again: ignored
    world.add_fracture(SECOND)
    states = REFERENCE._replace(fracture_sequence=2, fragment_ids=np.array([3, 10, 12, 13]))
    assert len(world.contacts(states).gaps) > 0
    assert world.fragments().fragment_ids.tolist() == [2, 3, 4, 10, 12, 13]


@pytest.mark.parametrize("rule", STATES)
def test_states_that_break_a_rule_are_rejected(world: CollisionWorld, rule: str) -> None:
    states, kind, words = STATES[rule]
    refused(world, lambda: world.contacts(states), kind, words, StatesAhead if rule in AHEAD else InvalidMessage)
    assert world.contacts(EARLIER).fracture_sequence == 0
    assert len(world.contacts(REFERENCE._replace(linear_velocities=np.ones(12), angular_velocities=np.ones(12))).gaps)


@pytest.mark.parametrize("wrong", [[1], None, "1", 1.0, True, {}, -1, 2**32])
def test_meshes_of_invalid_ids_are_rejected(world: CollisionWorld, wrong: object) -> None:
    with pytest.raises(InvalidMessage, match="^fragment_id: ") as caught:
        world.fragment_mesh(wrong)
    assert caught.value.kind == ("out_of_range" if isinstance(wrong, int) and wrong is not True else "wrong_type")
    assert world.fragment_mesh(np.uint32(2)).fragment_id == 2
