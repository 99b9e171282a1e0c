"""Killed and stopped subscribers delay nobody, and a recorder reports what it missed."""

from __future__ import annotations

import signal
from pathlib import Path

import pytest
from stages.ros_client import ServiceClient
from stages.ros_stage import StageWithClients
from worlds.broken_bar import STATES, tell_all
from worlds.scene_of_length import scene_of_length

from campaigns.kills.stage import await_end, await_recording, await_step, await_that, must_end, steps_told
from fracture_collision.bag.reader import message_counts
from fracture_collision.ros.wire import qos

RUN = 43
ANSWERS = "fracture_collision: answers"
LONGEST = 1.0  # [s] on a loaded machine; a wait for a stopped process would have no end


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


def test_a_stopped_recorder_delays_no_answer_and_fails_for_what_it_missed(
    stage: StageWithClients, tmp_path: Path
) -> None:
    client = service_with_bodies(stage)
    recorder = stage.start("recorder_node", folder=str(tmp_path / "bag"), progress=True)
    client.spin_until(lambda: client.node.count_subscribers("fragment_states") == 2, "a recorder of states")
    client.ask(STATES._replace(step=99), RUN)
    await_that(lambda: '"fragment_states": 1' in recorder.log_text(), "the first states", recorder)
    recorder.send_signal(signal.SIGSTOP)
    for step in range(100, 100 + 20 * qos.STEP_DEPTH):  # also more than fits into its queue in shared memory
        client.ask(STATES._replace(step=step), RUN)
    client.details.clear()
    client.spin_until(lambda: ANSWERS in client.details, "its word on that")
    assert client.diagnostics[ANSWERS] == "ready" and worst_of(client, "conversion and publishing") < LONGEST
    recorder.send_signal(signal.SIGCONT)
    step = iter(range(100 + 20 * qos.STEP_DEPTH, 100_000))

    def has_noticed() -> bool:
        client.ask(STATES._replace(step=next(step)), RUN)
        return "were missed" in recorder.log_text()

    client.spin_until(has_noticed, "what is missing")
    assert recorder.stop() == 1
    assert "the bag lacks the states of" in recorder.log_text() and "Traceback" not in recorder.log_text()


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


def service_with_bodies(stage: StageWithClients) -> ServiceClient:
    _, client = stage.served()
    tell_all(client, RUN)
    client.ask(STATES, RUN)
    return client


def worst_of(client: ServiceClient, part: str) -> float:
    """[s] of the longest."""
    text = next(value for key, value in client.details[ANSWERS].items() if key.startswith(f"{part} (last"))
    return 1e-3 * float(text.split(", ")[1].split()[0])
