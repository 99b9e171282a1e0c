"""Bags that were recorded with earlier definitions of the messages."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from stages.bag_of_records import write_bag

from fracture_collision.bag.exchanges import deserialize_record, read_runs, registry_settings
from fracture_collision.bag.mcap_file import BagError
from fracture_collision.bag.reader import SETTINGS, read_messages
from fracture_collision.bag.writer import BagWriter
from fracture_collision.records import SPHERE, CollisionBody, ContactConstraintArray, FragmentStates, SolidPrimitive
from fracture_collision.replay import InProcess, Replay, Report, settings_of
from fracture_collision.world import CollisionWorld, Settings
from fracture_collision.world.settings import settings_text


def test_bags_recorded_before_a_field_existed_are_read_with_its_default(tmp_path: Path) -> None:
    body = CollisionBody(7, 7, primitive=SolidPrimitive(SPHERE, (0.5,)), is_static=True, friction=0.25)
    states = FragmentStates(3, 0, np.array([7], np.uint32), np.arange(3.0), np.array([0.0, 0.0, 0.0, 1.0]))
    write_bag(tmp_path / "old", [(0.5, body), (1.0, states)], lacking=frozenset({"sequence", "body_sequence"}))
    write_bag(tmp_path / "new", [(0.5, body), (1.0, states)])
    (old,), (new,) = read_runs(tmp_path / "old"), read_runs(tmp_path / "new")
    assert [message.received.record.friction for message in old.bodies] == [0.25]
    assert old.bodies[0].received.record.sequence == 0
    assert [(q.states, q.time) for q in old.questions] == [(q.states, q.time) for q in new.questions]
    assert deserialize_record(old.questions[0].states, FragmentStates).record.body_sequence == 0
    write_bag(tmp_path / "other", [(0.5, body), (1.0, states)], lacking=frozenset({"positions"}))
    with pytest.raises(BagError, match="another definition of FragmentStates: positions"):
        read_runs(tmp_path / "other")


def test_bags_recorded_before_a_setting_existed_are_replayed_as_the_service_was_then(tmp_path: Path) -> None:
    """Crossings of edges were not searched; today they are by default."""
    with BagWriter(tmp_path / "old", []) as bag:
        bag.note(SETTINGS, json.dumps({"contacts_per_pair": 5}))
    found = settings_of(tmp_path / "old", {}).settings
    assert (found.contacts_per_pair, found.surfaces) == (5, "sampled")
    assert settings_of(tmp_path / "old", {"surfaces": "edges"}).settings.surfaces == "edges"


BALL = CollisionBody(7, 7, primitive=SolidPrimitive(SPHERE, (0.5,)))
BALLS = (BALL._replace(is_static=True), BALL._replace(body_id=8, fragment_id=8))
# The second ball falls, 4 cm above the first: a contact comes within the lookahead.
FALLING = FragmentStates(
    3, 0, np.array([8], np.uint32), np.array([0.0, 0.0, 1.04]), np.array([0.0, 0.0, 0.0, 1.0]),
    np.array([0.0, 0.0, -9.0]),
)  # fmt: skip
AHEAD = Settings(threads=1, lookahead=0.01)


def write_answered(folder: Path, lacking: frozenset[str], changed: bool = False) -> None:
    """A bag of a world with AHEAD; `changed`: the answer is another one."""
    world = CollisionWorld(AHEAD)
    for body in BALLS:
        world.add_body(body)
    answer = world.contacts(FALLING)
    assert len(answer) == 1 and answer.lookahead == 0.01
    if changed:
        answer = answer._replace(gaps=answer.gaps + 1.0)
    write_bag(folder, [(0.5, each) for each in (*BALLS, FALLING, world.fragments(), answer)], lacking=lacking)


def replayed(bag: Path) -> Report:
    replay = Replay(read_runs(bag), InProcess(AHEAD))
    assert list(replay) == [1]
    return replay.report()


def test_answers_recorded_before_they_had_a_lookahead_are_compared_without_it(tmp_path: Path) -> None:
    write_answered(tmp_path / "new", frozenset())
    write_answered(tmp_path / "old", frozenset({"lookahead"}))
    old, new = replayed(tmp_path / "old"), replayed(tmp_path / "new")
    assert old.exact and old.compared == 1 and new.exact and old.digest == old.recorded_digest != new.digest
    recorded = [message.data for message in read_messages(tmp_path / "old", ["/contact_constraints"])]
    (run,) = read_runs(tmp_path / "old")
    (answer,) = run.questions[0].answers
    assert run.as_recorded(answer) == recorded[0] and len(answer) == len(recorded[0]) + 8
    assert deserialize_record(answer, ContactConstraintArray).record.lookahead == 0.0
    write_answered(tmp_path / "changed", frozenset({"lookahead"}), changed=True)
    found = replayed(tmp_path / "changed")
    assert found.differing == 1 and found.difference.field == "gaps"


def test_registries_recorded_before_they_had_settings_name_none(tmp_path: Path) -> None:
    write_answered(tmp_path / "new", frozenset())
    write_answered(tmp_path / "old", frozenset({"settings"}))
    assert registry_settings(tmp_path / "old") == []
    assert registry_settings(tmp_path / "new") == [json.loads(settings_text(AHEAD))]
    lacking = "the bag lacks the settings of the service; the replay uses the defaults"
    assert settings_of(tmp_path / "old", {"contacts_per_pair": 5}).words == [lacking]
