"""Bags that were recorded with earlier definitions of the messages."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from stages.bag_of_records import write_bag

from fracture_collision.bag.cdr import deserialize_record
from fracture_collision.bag.errors import BagError
from fracture_collision.bag.exchanges import read_runs
from fracture_collision.bag.reader import SETTINGS
from fracture_collision.bag.writer import BagWriter
from fracture_collision.records import SPHERE, CollisionBody, FragmentStates, SolidPrimitive
from fracture_collision.replay import settings_of


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
