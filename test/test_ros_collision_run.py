"""Messages in the order the topics happen to deliver them: the answers are those of the right order."""

from __future__ import annotations

import numpy as np

from fracture_collision.geometry.generators import brick
from fracture_collision.geometry.tetrahedra import unique_edges
from fracture_collision.records import CollisionBody, ContactConstraintArray, FractureEvent, FragmentStates
from fracture_collision.ros import collision_run
from fracture_collision.ros.collision_run import CollisionRun
from fracture_collision.world import CollisionWorld, Settings

SETTINGS = Settings(threads=1)


def breakable_body() -> CollisionBody:
    mesh = brick((1.0, 0.5, 0.5), 0.25)
    return CollisionBody(1, 1, vertices=mesh.vertices.ravel(), tetrahedra=mesh.tetrahedra.ravel())


def ground() -> CollisionBody:
    return CollisionBody(2, 2, plane=np.array([0.0, 0.0, 1.0, 0.0]), is_static=True)


def cut(sequence: int, fragment_id: int, new_ids: tuple[int, int], offset: float, above: float) -> FractureEvent:
    """The nodes of a fragment that spans x > `above`, parted by the plane x = offset."""
    mesh = brick((1.0, 0.5, 0.5), 0.25)
    x = mesh.vertices[:, 0]
    nodes = np.flatnonzero(x > above)
    edges = unique_edges(mesh.tetrahedra)
    edges = edges[(x[edges] > above).all(axis=1)]
    beyond = x > offset
    edges = edges[beyond[edges[:, 0]] != beyond[edges[:, 1]]]
    towards = np.where(beyond[edges[:, 1]], 1.0, -1.0)
    planes = np.column_stack([towards, np.zeros((len(edges), 2)), towards * offset])
    parts = beyond[nodes].astype(np.int64)
    return FractureEvent(sequence, 1, fragment_id, np.array(new_ids), nodes, parts, edges.ravel(), planes.ravel())


FIRST, SECOND = cut(1, 1, (10, 11), 0.1, above=-np.inf), cut(2, 11, (12, 13), 0.3, above=0.1)
STATES = FragmentStates(
    5, 2, np.array([2, 10, 12, 13]), np.tile([0.0, 0.0, 0.24], 4) * np.repeat([0.0, 1.0, 1.0, 1.0], 3),
    np.tile([0.0, 0.0, 0.0, 1.0], 4),
)  # fmt: skip


def expected_contacts() -> ContactConstraintArray:
    world = CollisionWorld(SETTINGS)
    world.add_body(breakable_body())
    world.add_body(ground())
    world.add_fracture(FIRST)
    world.add_fracture(SECOND)
    contacts = world.contacts(STATES)
    assert len(contacts.gaps) > 0
    return contacts


def field_bytes(record: ContactConstraintArray) -> list[bytes]:
    return [np.asarray(value).tobytes() for value in record]


def test_events_before_their_body_and_states_before_all() -> None:
    run = CollisionRun(1, SETTINGS)
    assert run.answer(STATES) is None
    for event in (FIRST, SECOND):
        (refusal,) = run.add_fracture(event)
        assert refusal.kind == "unknown_id" and "body_id" in refusal.reason
    assert run.held_event_count == 2
    assert run.answer(STATES) is None
    assert run.add_body(ground()) == []
    assert run.answer(STATES) is None
    assert run.add_body(breakable_body()) == []
    assert (run.held_event_count, run.event_count) == (0, 2)
    assert field_bytes(run.answer(STATES)) == field_bytes(expected_contacts())


def test_an_event_of_an_unknown_body_blocks_nothing() -> None:
    run = CollisionRun(1, SETTINGS)
    run.add_body(breakable_body())
    run.add_body(ground())
    assert run.add_fracture(FIRST._replace(body_id=77))
    assert run.add_fracture(FIRST) == []
    assert run.add_fracture(SECOND) == []
    assert (run.held_event_count, run.event_count) == (0, 2)
    assert field_bytes(run.answer(STATES)) == field_bytes(expected_contacts())
    # Nor does one that speaks of a sequence long applied.
    (refusal,) = run.add_fracture(SECOND._replace(sequence=1, body_id=77))
    assert refusal.kind == "sequence_repeat" and run.held_event_count == 0


def test_events_behind_one_whose_body_is_missing_are_held_in_words() -> None:
    run = CollisionRun(1, SETTINGS)
    run.add_body(breakable_body())
    run.add_fracture(FIRST._replace(body_id=77))
    (refusal,) = run.add_fracture(SECOND)
    assert refusal.kind == "sequence_gap" and "behind event 1, until body 77 comes" in refusal.reason
    assert (run.held_event_count, run.event_count) == (2, 0)
    assert run.add_fracture(FIRST) == []
    assert (run.held_event_count, run.event_count) == (0, 2)


def test_what_is_held_has_a_limit(monkeypatch) -> None:
    monkeypatch.setattr(collision_run, "MAX_HELD_EVENTS", 2)
    run = CollisionRun(1, SETTINGS)
    kinds = [run.add_fracture(FIRST._replace(sequence=k))[0].kind for k in (1, 2, 3)]
    assert kinds == ["unknown_id", "unknown_id", "limit_exceeded"]
    assert run.held_event_count == 2


def test_what_is_held_has_a_limit_in_bytes(monkeypatch) -> None:
    size = sum(np.asarray(field).nbytes for field in FIRST)
    monkeypatch.setattr(collision_run, "MAX_HELD_BYTES", 2 * size + size // 2)
    run = CollisionRun(1, SETTINGS)
    kinds = [run.add_fracture(FIRST._replace(sequence=k))[0].kind for k in (1, 2, 2, 3)]
    assert kinds == ["unknown_id", "unknown_id", "unknown_id", "limit_exceeded"]
    assert run.held_event_count == 2
    run.add_body(breakable_body())  # what waited is applied, and makes room
    assert run.held_event_count == 0
    assert run.add_fracture(FIRST._replace(sequence=9, body_id=77))[0].kind == "unknown_id"
