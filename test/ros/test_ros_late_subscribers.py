"""Killed, stopped and idle subscribers: what the service and the simulator wait for, and what a recorder reports."""

from __future__ import annotations

import math
import signal
from pathlib import Path

import pytest
from stages.ros_client import ServiceClient
from stages.ros_stage import StageWithClients
from test_ros_collision_run import FIRST, SECOND, STATES, breakable_body, ground
from worlds.scene_of_length import scene_of_length

from campaigns.kills.stage import await_end, await_recording, await_step, await_that, must_end, steps_told
from fracture_collision.bag.reader import message_counts
from fracture_collision.ros.wire import qos
from fracture_collision.ros.wire.step_publisher import PATIENCE, StepPublisher

RUN = 43
ANSWERS = "fracture_collision: answers"
OVERWRITTEN = "answers overwritten before all subscribers acknowledged them"
LATE = "a subscriber is late and may miss answers"


@pytest.mark.parametrize("victim", ["recorder", "service"])
def test_a_killed_subscriber_takes_nothing_from_the_others(
    stage: StageWithClients, tmp_path: Path, victim: str
) -> None:
    recorder = stage.start("recorder_node", folder=str(tmp_path / "living"), progress=True)
    other = stage.start("recorder_node", folder=str(tmp_path / "killed"), progress=True)
    service = stage.start("collision_node", threads=1)
    scene = scene_of_length("plates", 1.0, tmp_path)  # 400 steps; the first plate breaks at 0.7 s
    simulator = stage.start("simulator_node", scene=str(scene), wait_for_subscribers=3, progress=True)
    await_step(simulator, 50, recorder, other, service)
    killed = other if victim == "recorder" else service
    killed.stop(patience=0.0, orders=(signal.SIGKILL,))
    if victim == "service":
        service = stage.start("collision_node", threads=1)
    await_end(simulator, recorder, service)
    steps = steps_told(simulator)
    # what a service said last before it was killed may have reached the simulator only
    may_lack = int(victim == "service")
    await_recording(recorder, simulator, service, may_lack=may_lack)
    for node in (simulator, recorder, service):
        must_end(node)
    counts = message_counts(tmp_path / "living")
    assert counts["/fragment_states"] >= steps == 400 <= counts["/contact_constraints"] + may_lack


def test_a_stopped_subscriber_is_waited_for_once_and_reported(stage: StageWithClients, tmp_path: Path) -> None:
    client = service_with_bodies(stage)
    recorder = stage.start("recorder_node", folder=str(tmp_path / "bag"), progress=True)
    await_that(lambda: '"/diagnostics": 2' in recorder.log_text(), "what the service reports", recorder)
    recorder.send_signal(signal.SIGSTOP)
    for step in range(100, 100 + 3 * qos.STEP_DEPTH):
        client.ask(STATES._replace(step=step), RUN)
    client.spin_until(lambda: LATE in client.diagnostics[ANSWERS], "its word on a late subscriber")
    assert 1 <= int(client.details[ANSWERS][OVERWRITTEN]) <= 2 * qos.STEP_DEPTH + 1
    assert PATIENCE < worst_of(client, "conversion and publishing") < 10.0 * PATIENCE
    recorder.send_signal(signal.SIGCONT)
    step = iter(range(1000, 10_000))

    def is_quick_again() -> bool:
        client.ask(STATES._replace(step=next(step)), RUN)
        return client.diagnostics[ANSWERS] == "ready"

    client.spin_until(is_quick_again, "its word on nobody being late")


def test_a_recorder_that_missed_a_step_reports_it_and_fails(stage: StageWithClients, tmp_path: Path) -> None:
    client = service_with_bodies(stage)
    recorder = stage.start("recorder_node", folder=str(tmp_path / "bag"), progress=True)
    client.spin_until(lambda: client.node.count_subscribers("fragment_states") == 2, "a recorder of states")
    for step in (7, 8, 8, 7, 8, 9):  # repeated, and a replay that goes back
        client.ask(STATES._replace(step=step), RUN)
    for step in (12, 13, 20, 30):  # without 2, 6 and 9 steps
        client.ask(STATES._replace(step=step), RUN)
    await_that(lambda: "states of 17 steps were missed" in recorder.log_text(), "what is missing", recorder)
    assert recorder.stop() == 1
    assert "the bag lacks the states of 17 steps, the first is 10" in recorder.log_text()
    assert "Traceback" not in recorder.log_text()


def test_a_recorder_gets_the_answers_that_came_before_it(stage: StageWithClients, tmp_path: Path) -> None:
    """A restarted service may answer before it and a recorder have discovered each other."""
    client = service_with_bodies(stage)
    for step in range(100, 120):
        client.ask(STATES._replace(step=step), RUN)
    recorder = stage.start("recorder_node", folder=str(tmp_path / "bag"), progress=True)
    await_that(lambda: '"contact_constraints": 21' in recorder.log_text(), "earlier answers", recorder)
    assert recorder.stop() == 0, recorder.log_text()


class StandIn:
    """A publisher and its node, with one subscriber that acknowledges after a set time."""

    def __init__(self) -> None:
        self.acknowledges_after, self.waited, self.warnings, self.published = 0.0, 0.0, 0, 0

    def create_publisher(self, *_arguments):
        return self

    def publish(self, _message: bytes) -> None:
        self.published += 1

    def wait_for_all_acked(self, duration) -> bool:
        seconds = duration.nanoseconds / 1e9
        waited = min(seconds, self.acknowledges_after)
        self.waited += waited
        self.acknowledges_after -= waited
        return self.acknowledges_after <= 0.0

    def get_logger(self):
        return self

    def warning(self, *_words, **_options) -> None:
        self.warnings += 1


def test_acknowledgements_are_awaited_once_the_depth_is_used_up() -> None:
    stand_in = StandIn()
    publisher = StepPublisher(stand_in, qos.CONTACT_CONSTRAINTS)

    def waited(count: int = 1) -> float:
        """Time [s] that the next messages wait."""
        stand_in.waited = 0.0
        for _ in range(count):
            publisher.publish(b"")
        return stand_in.waited

    assert waited(1000) == 0.0  # a subscriber that keeps up
    stand_in.acknowledges_after = 0.3
    before = publisher._open
    assert waited(qos.STEP_DEPTH - before) == 0.0  # late by less than the depth
    assert waited() == pytest.approx(0.3) and publisher.overwritten == 0
    assert waited(qos.STEP_DEPTH - 1) == 0.0

    stand_in.acknowledges_after = math.inf
    assert waited(qos.STEP_DEPTH) == pytest.approx(PATIENCE) and publisher.has_late
    assert waited(50) == 0.0 and stand_in.warnings == 1, "only once"
    assert 50 <= publisher.overwritten <= 50 + qos.STEP_DEPTH
    overwritten = publisher.overwritten
    stand_in.acknowledges_after = 0.0
    assert waited(qos.STEP_DEPTH) == 0.0 and not publisher.has_late and publisher.overwritten == overwritten
    stand_in.acknowledges_after = 0.3  # it keeps up again, so publishes wait for it
    assert waited(qos.STEP_DEPTH) == pytest.approx(0.3)
    assert stand_in.published > 1000


def test_a_subscriber_that_never_spins_is_not_waited_for(stage: StageWithClients) -> None:
    """DDS acknowledges every sample it receives, even if the application never takes it."""
    client = service_with_bodies(stage)
    idle = stage.client()
    client.spin_until(lambda: client.node.count_subscribers("contact_constraints") == 2, "the other")
    for step in range(100, 100 + 3 * qos.STEP_DEPTH):
        client.ask(STATES._replace(step=step), RUN)
    client.details.clear()
    client.spin_until(lambda: ANSWERS in client.details, "its word on that")
    assert client.diagnostics[ANSWERS] == "ready" and client.details[ANSWERS][OVERWRITTEN] == "0"
    assert idle.answers == []


def service_with_bodies(stage: StageWithClients) -> ServiceClient:
    stage.start("collision_node", threads=1)
    client = stage.client()
    client.await_service()
    for body in (breakable_body(), ground()):
        client.publish("bodies", body, RUN)
    for event in (FIRST, SECOND):
        client.publish("fracture_events", event, RUN)
    client.ask(STATES, RUN)
    return client


def worst_of(client: ServiceClient, part: str) -> float:
    """[s] of the longest."""
    text = next(value for key, value in client.details[ANSWERS].items() if key.startswith(f"{part} (last"))
    return 1e-3 * float(text.split(", ")[1].split()[0])
