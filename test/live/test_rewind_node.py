"""Rewinding a live scene over DDS: a new run with the same bodies, events, states and contacts."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from stages.live_player import PLATE, Player
from stages.ros_stage import StageWithClients

from fracture_collision.ros.wire import qos
from fracture_collision.ros.wire.conversion import to_record

LONG = 400  # steps, 1 s: more than the interval of moments to go back to


def course(messages: list[Any], run_id: int) -> dict[int, list[bytes]]:
    """Messages of a run as bytes, without header and run_id, by step."""
    return {
        message.step: [np.asarray(column).tobytes() for column in to_record(message)]
        for message in messages
        if message.run_id == run_id
    }


@pytest.mark.slow
def test_a_rewound_scene_has_the_same_states_and_contacts(stage: StageWithClients) -> None:
    player = Player(stage)
    player.hands.throw(PLATE - [0.0, 0.5, 0.0], [0.0, 7.0, 0.3])
    player.until(lambda: player.status.fragments > 10, "shards")
    player.steps_go_on(LONG)

    # to the beginning: no time of this scene is ten seconds ago
    first = player.status.run_id
    response = player.answer(player.hands.rewind())
    assert response.success and "back to 0.00 s" in response.message
    player.until(lambda: player.status.run_id != first and player.status.step == 1, "the first step of another run")
    assert player.status.paused and player.status.fragments == 4, "whole plates"
    count = len(player.told)
    player.until(lambda: len(player.told) > count + 3, "more news")
    assert player.status.step == 1, "it waits"

    # then ten seconds on, with a throw at another time, and back into the middle
    assert player.answer(player.hands.pause(False)).success
    player.answer(player.hands.set_parameters(rate=10.0))
    player.hands.throw(PLATE - [0.0, 0.5, 0.0], [0.0, 7.0, 0.3])
    player.until(lambda: player.status.fragments > 10, "shards")
    player.until(lambda: player.status.step * 0.0025 > 12.0, "twelve seconds")
    second = player.status.run_id
    response = player.answer(player.hands.rewind())
    assert response.success
    player.until(lambda: player.status.run_id != second, "another run")
    third, begin = player.status.run_id, player.status.step - 1
    assert 1.0 < begin * 0.0025 < 4.0 and player.status.paused

    joined = stage.client()  # a late joiner gets the run so far, and it only
    bodies: list[Any] = []
    events: list[Any] = []
    for topic, heard in ((qos.BODIES, bodies), (qos.FRACTURE_EVENTS, events)):
        joined.node.create_subscription(topic.message_class, topic.name, heard.append, topic.qos)
    player.until(lambda: any(message.run_id == third for message in player.states), "states of the run")
    sequence = next(message.fracture_sequence for message in player.states if message.run_id == third)
    assert sequence > 0
    joined.spin_until(lambda: len(bodies) >= 9 and len(events) >= sequence, "bodies and events of the run")
    assert [event.sequence for event in events] == list(range(1, sequence + 1))
    assert {message.run_id for message in (*bodies, *events)} == {third} and len(bodies) == 9

    assert player.answer(player.hands.pause(False)).success
    player.until(lambda: player.status.step > begin + LONG, "the course again")
    for messages in (player.states, player.ears.answers):
        before, after = course(messages, second), course(messages, third)
        shared = sorted(before.keys() & after.keys())
        assert len(shared) >= LONG and shared[0] == begin
        assert all(before[step] == after[step] for step in shared)
    assert player.service.exit_status() is None and player.simulator.exit_status() is None
