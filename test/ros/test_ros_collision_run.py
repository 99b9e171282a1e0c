"""Messages in any order of delivery across topics give the same answers as in the right order."""

from __future__ import annotations

import numpy as np
import pytest
from fracture_collision.msg import CollisionBody as CollisionBodyMessage
from fracture_collision.msg import FractureEvent as FractureEventMessage
from worlds.broken_bar import BAR, GROUND, STATES, expected_contacts
from worlds.gate_world import FIRST, SECOND, SETTINGS, record_bytes

from fracture_collision.records import SPHERE, CollisionBody, FragmentStates, SolidPrimitive
from fracture_collision.ros.service import collision_run
from fracture_collision.ros.service.collision_run import CollisionRun
from fracture_collision.ros.wire.cdr_records import place_in_log, serialize_record
from fracture_collision.ros.wire.conversion import heading
from fracture_collision.world import CollisionWorld, InvalidMessage, StatesAhead


def ready_run() -> CollisionRun:
    run = CollisionRun(1, SETTINGS)
    assert run.add_body(BAR) == [] and run.add_body(GROUND) == []
    return run


def test_an_event_of_an_unknown_body_blocks_nothing() -> None:
    run = ready_run()
    (refusal,) = run.add_fracture(FIRST._replace(body_id=77))
    assert refusal.kind == "unknown_id"
    (refusal,) = run.add_fracture(SECOND)
    assert refusal.kind == "sequence_gap"
    assert refusal.reason == "sequence: event 2 is held: event 1 waits for body 77, which has not arrived"
    assert (run.held_event_count, run.event_count) == (2, 0)
    assert run.add_fracture(FIRST) == []
    assert (run.held_event_count, run.event_count) == (0, 2)
    assert record_bytes(run.answer(STATES)) == record_bytes(expected_contacts())
    # Nor does an event with a sequence number that was applied before.
    (refusal,) = run.add_fracture(SECOND._replace(sequence=1, body_id=77))
    assert refusal.kind == "sequence_repeat" and run.held_event_count == 0


def test_held_messages_are_limited_in_bytes(monkeypatch) -> None:
    size = sum(np.asarray(field).nbytes for field in FIRST)
    monkeypatch.setattr(collision_run, "MAX_HELD_BYTES", 2 * size + size // 2)
    run = CollisionRun(1, SETTINGS)
    kinds = [run.add_fracture(FIRST._replace(sequence=k))[0].kind for k in (1, 2, 2, 3)]
    assert kinds == ["unknown_id", "unknown_id", "unknown_id", "limit_exceeded"]
    assert run.held_event_count == 2
    run.add_body(BAR)  # the held events are applied, which frees their bytes
    assert run.held_event_count == 0
    assert run.add_fracture(FIRST._replace(sequence=9, body_id=77))[0].kind == "unknown_id"


BAD = FIRST._replace(nodes=FIRST.nodes[1:])


def rejection(run: CollisionRun) -> str:
    with pytest.raises(InvalidMessage) as refusal:
        run.answer(STATES)
    assert refusal.value.kind == "event_rejected" and not isinstance(refusal.value, StatesAhead)
    return str(refusal.value)


def test_states_that_need_a_rejected_event_are_rejected_until_it_is_corrected() -> None:
    run = ready_run()
    assert run.answer(STATES) is None
    (refusal,) = run.add_fracture(BAD)
    assert refusal.kind == "size_mismatch"
    words = f"event 1 was rejected: {refusal.reason}; a corrected event with sequence 1 is awaited"
    assert rejection(run) == f"fracture_sequence: 2, but {words}" and run.rejected_event == words
    # the topic delivers the later event only once, possibly long before the corrected one
    (held,) = run.add_fracture(SECOND)
    assert held.kind == "sequence_gap" and words in held.reason
    assert words in rejection(run)
    (again,) = run.add_fracture(BAD)
    assert again.kind == "size_mismatch" and words in rejection(run)
    assert run.add_fracture(FIRST) == []
    assert (run.held_event_count, run.event_count, run.rejected_event) == (0, 2, "")
    assert record_bytes(run.answer(STATES)) == record_bytes(expected_contacts())
    (repeat,) = run.add_fracture(BAD)  # the latched topic still holds it
    assert repeat.kind == "size_mismatch" and run.rejected_event == ""
    assert record_bytes(run.answer(STATES)) == record_bytes(expected_contacts())


def test_states_before_a_rejected_event_are_answered() -> None:
    run = ready_run()
    run.add_fracture(BAD)
    before = STATES._replace(
        fracture_sequence=0, fragment_ids=np.array([1, 2]), positions=np.array([0.0, 0.0, 0.24, 0.0, 0.0, 0.0]),
        orientations=STATES.orientations[:8],
    )  # fmt: skip
    assert len(run.answer(before).gaps) > 0


def test_events_after_one_that_is_rejected_late_are_kept() -> None:
    """An event waits for its body and is rejected when the body arrives; the later events stay held."""
    run = CollisionRun(1, SETTINGS)
    run.add_body(GROUND)
    run.add_fracture(BAD)
    run.add_fracture(SECOND)
    assert "event 1 waits for body 1" in run.add_fracture(SECOND)[0].reason
    (refusal,) = run.add_body(BAR)
    assert refusal.kind == "size_mismatch" and run.held_event_count == 1
    assert "event 1 was rejected" in rejection(run)
    assert run.add_fracture(FIRST) == [] and run.event_count == 2


def test_an_undecodable_event_is_known_by_its_sequence() -> None:
    data = bytearray(serialize_record(SECOND, heading(1.5), 7))
    for damaged in (data[:-40], data[:400], data):
        place = place_in_log(bytes(damaged), FractureEventMessage)
        assert (place.run_id, place.record.sequence) == (7, 2)
    assert place_in_log(bytes(data[:20]), FractureEventMessage) is None
    body = serialize_record(GROUND._replace(sequence=9), heading(1.5), 7)
    place = place_in_log(body[:200], CollisionBodyMessage)
    assert (place.run_id, place.record.sequence) == (7, 9)
    assert place_in_log(b"not plain CDR at all", CollisionBodyMessage) is None
    run = ready_run()
    run.reject_fracture(2, "too long")
    assert run.rejected_event == "" and run.answer(STATES) is None  # event 1 may still arrive
    assert run.add_fracture(FIRST) == []
    assert "event 2 was rejected: too long" in rejection(run)
    assert run.add_fracture(SECOND) == []
    assert record_bytes(run.answer(STATES)) == record_bytes(expected_contacts())


def test_events_beyond_the_limit_are_requested_again_when_due(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(collision_run, "MAX_HELD_EVENTS", 1)
    run = ready_run()
    third = SECOND._replace(sequence=3)
    assert run.add_fracture(third)[0].kind == "sequence_gap"
    assert run.add_fracture(SECOND)[0].kind == "sequence_gap"  # replaces the later event
    assert run.held_event_count == 1 and not run.wants_log()
    assert run.add_fracture(FIRST) == []  # replaces event 2
    assert run.event_count == 1 and run.wants_log() and not run.wants_log()
    assert run.add_fracture(FIRST) == [] and run.add_fracture(SECOND) == []
    assert run.event_count == 2
    (refusal,) = run.add_fracture(third)
    assert refusal.kind == "retired_id" and "event 3 was rejected" in run.rejected_event


def test_held_states_are_tried_again_only_when_their_events_have_arrived(monkeypatch: pytest.MonkeyPatch) -> None:
    run = CollisionRun(1, SETTINGS)
    balls = [CollisionBody(n, n, primitive=SolidPrimitive(SPHERE, (0.1,))) for n in range(1, 41)]
    ids = np.arange(1, 41)
    states = FragmentStates(1, 0, ids, np.zeros(120), np.tile([0.0, 0.0, 0.0, 1.0], 40))
    tried = []
    real = CollisionWorld.contacts
    monkeypatch.setattr(CollisionWorld, "contacts", lambda *a: tried.append(1) or real(*a))
    for ball in balls[::2] + balls[:0:-2]:
        assert run.answer(states) is None
        run.add_body(ball)
    assert len(tried) == 1
    assert run.answer(states) is not None and len(tried) == 2
    # different states are tried immediately
    assert run.answer(states._replace(step=2)) is not None and len(tried) == 3


def test_the_reason_for_held_states_is_reported() -> None:
    run = CollisionRun(1, SETTINGS)
    assert run.answer(STATES) is None
    assert "event 1 has not arrived" in run.what_states_wait_for()
    run.add_fracture(FIRST)
    assert "event 1 waits for body 1, which has not arrived" in run.what_states_wait_for()
    assert run.add_body(BAR._replace(density=-1.0))
    assert "event 1 waits for body 1, which was rejected: density" in run.what_states_wait_for()
    run.add_body(BAR)
    run.add_fracture(SECOND)
    assert run.answer(STATES) is None
    assert run.what_states_wait_for() == "no body or event has arrived that makes fragment 2"
    run.add_body(GROUND._replace(friction=-1.0))
    assert run.what_states_wait_for().startswith("no fragment 2 is known, as body 2 was rejected: friction")
