"""What fractures leave behind is reclaimed: trees of fragments that broke, polygons that were replaced."""

from __future__ import annotations

import numpy as np
import pytest
from worlds.gate_world import record_bytes

from fracture_collision import fracture
from fracture_collision.core.bodies import collision_geometry
from fracture_collision.core.bodies.body_validator import validate_body
from fracture_collision.geometry.generators import ball
from fracture_collision.records import CollisionBody, FractureEvent, FragmentStates
from fracture_collision.world import CollisionWorld, Settings

BALL = ball(0.5, 0.12)
BODY = CollisionBody(1, 1, vertices=BALL.vertices, tetrahedra=BALL.tetrahedra)
FIELDS = {"exact": Settings(threads=1), "averaged": Settings(threads=1, method="glondu2014")}


def chips() -> list[FractureEvent]:
    """Again and again, the largest piece loses a chip."""
    events: list[FractureEvent] = []
    largest, next_id = 1, 2
    for normal in np.random.default_rng(4).normal(size=(60, 3)):
        try:
            event = fracture.planes(BODY, normal, 0.34, fragment_id=largest, after=events, first_new_id=next_id)
        except ValueError:  # nothing is left there
            continue
        events.append(event)
        sizes = np.bincount(event.node_fragments)
        largest, next_id = int(event.new_fragment_ids[np.argmax(sizes)]), next_id + len(sizes)
    return events


def scattered(events: list[FractureEvent]) -> FragmentStates:
    living = {1}
    for event in events:
        living = living - {event.fragment_id} | set(event.new_fragment_ids.tolist())
    ids = np.array(sorted(living))
    places = np.random.default_rng(len(events)).uniform(-0.01, 0.01, (len(ids), 3))
    return FragmentStates(len(events), len(events), ids, places, np.tile([0.0, 0.0, 0.0, 1.0], (len(ids), 1)))


@pytest.mark.parametrize("field", FIELDS)
def test_answers_are_the_same_and_memory_is_bounded(field: str, monkeypatch: pytest.MonkeyPatch) -> None:
    answers, sizes, events = {}, {}, chips()
    for least in (1 << 60, 0):
        monkeypatch.setattr(collision_geometry, "LEAST_GARBAGE", least)
        world = CollisionWorld(FIELDS[field])
        world.add_body(BODY)
        answers[least], sizes[least] = [], []
        for count, event in enumerate(events, 1):
            world.add_fracture(event)
            states = scattered(events[:count])
            answers[least].append(record_bytes(world.contacts(states)) + record_bytes(world.fragments()))
            sizes[least].append(world.geometry._tables.bytes_used)
        validate_body(world.geometry, [world._registry.row_of(each) for each in states.fragment_ids.tolist()])
        assert world._registry.renumbered > 1 if least == 0 else world._registry.renumbered == 0
    assert answers[0] == answers[1 << 60]
    assert sizes[0][-1] < 0.7 * sizes[1 << 60][-1]
