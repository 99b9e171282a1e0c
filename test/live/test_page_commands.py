"""Commands of a page that the simulator has not discovered yet, or whose responses are lost."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from rclpy.task import Future
from stages.ros_stage import StageWithClients

from fracture_collision.ros.nodes import repeated_request
from fracture_collision.ros.nodes.page_commands import PageCommands
from fracture_collision.ros.nodes.repeated_request import RepeatedRequest
from fracture_collision.ros.wire.interfaces import LIVE_STATUS
from fracture_collision.viewer.page.page_events import Ball, Ray, ServiceSliders


@pytest.fixture
def stage(tmp_path: Path) -> Iterator[StageWithClients]:
    stage = StageWithClients(tmp_path)
    yield stage
    stage.close()


def test_a_scene_and_a_pause_chosen_before_the_simulator_is_there_are_not_lost(
    stage: StageWithClients, tmp_path: Path
) -> None:
    ears, notices, told = stage.client(), [], []
    commands = PageCommands(ears.node, tmp_path, lambda _: None, notices.append, lambda _: None)
    ears.node.create_subscription(LIVE_STATUS.message_class, LIVE_STATUS.name, told.append, LIVE_STATUS.qos)
    ears.node.create_timer(0.05, commands.look)
    commands.handlers().scene_chosen("bunnies")
    commands.handlers().scene_chosen("pane")
    commands.handlers().paused(True)
    ears.spin_once(0.2)
    stage.start("collision_node")
    stage.start("live_simulator_node", scene="plates", seed=7)
    ears.spin_until(lambda: bool(told) and told[-1].scene == "pane" and told[-1].paused, "the paused scene")
    assert not notices
    commands.close()


def test_a_command_that_fails_leaves_the_page_running(stage: StageWithClients, tmp_path: Path) -> None:
    """A ball without speed never arrives, and no parameter takes an integer of more than 64 bits."""
    ears, notices = stage.client(), []
    commands = PageCommands(ears.node, tmp_path, lambda _: None, notices.append, lambda _: None)
    commands._hands.is_there = lambda: True  # type: ignore[method-assign]
    ray = Ray(np.zeros(3), np.array([1.0, 0.0, 0.0]))
    commands.handlers().clicked(ray, Ball(speed=0.0, radius=0.04))
    commands.handlers().service_set(ServiceSliders(contacts_per_pair=10**30))
    ears.spin_until(lambda: len(notices) == 2, "two notices")
    assert all(notice.startswith("a command failed: ") for notice in notices)
    commands.close()


@pytest.fixture
def sent(monkeypatch: pytest.MonkeyPatch) -> list[Future]:
    monkeypatch.setattr(repeated_request, "ASK_AGAIN", 0.0)
    return []


def sends(sent: list[Future]) -> Future:
    sent.append(Future())
    return sent[-1]


def test_a_request_is_sent_once_the_service_is_there_and_until_it_has_a_response(sent: list[Future]) -> None:
    ready, responses = [], []
    request = RepeatedRequest(lambda: bool(ready))
    request.begin(lambda: sends(sent), lambda done: responses.append(done.result()))
    request.look()
    assert not sent
    ready.append(True)
    request.look()
    request.look()
    assert len(sent) == 2 and not responses
    sent[0].set_result("late")
    sent[1].set_result("second")
    request.look()
    assert len(sent) == 2 and responses == ["late"], "the first response counts, and ends it"


def test_a_newer_request_replaces_one_without_a_response(sent: list[Future]) -> None:
    responses = []
    request = RepeatedRequest(lambda: True)
    for _ in range(2):
        request.begin(lambda: sends(sent), lambda done: responses.append(done.result()))
    sent[0].set_result("of the first")
    assert not responses
    sent[1].set_result("of the second")
    assert responses == ["of the second"]
    request.begin(lambda: sends(sent), lambda done: responses.append(done.result()))
    request.drop()
    sent[2].set_result("of a dropped one")
    request.look()
    assert len(sent) == 3 and len(responses) == 1
