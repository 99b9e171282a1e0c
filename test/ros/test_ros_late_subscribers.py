"""Killed and stopped subscribers delay nobody, and a recorder reports what it missed."""

from __future__ import annotations

import re
import signal
from itertools import count
from pathlib import Path

from stages.ros_client import ServiceClient
from stages.ros_stage import StageWithClients
from worlds.broken_bar import STATES, tell_all

from campaigns.kills.stage import await_that
from fracture_collision.ros.wire import qos

RUN = 43
ANSWERS = "fracture_collision: answers"
LONGEST = 1.0  # [s] on a loaded machine; a wait for a stopped process would have no end


def test_a_recorder_fails_for_missed_steps_and_a_stopped_one_delays_no_answer(
    stage: StageWithClients, tmp_path: Path
) -> None:
    client = service_with_bodies(stage)
    recorder = stage.start("recorder_node", folder=str(tmp_path / "bag"), progress=True)
    client.spin_until(lambda: client.node.count_subscribers("fragment_states") == 2, "a recorder of states")
    for step in (7, 8, 8, 7, 8, 9):  # repeated, and a replay that goes back
        client.ask(STATES._replace(step=step), RUN)
    for step in (12, 13, 20, 30):  # without 2, 6 and 9 steps
        client.ask(STATES._replace(step=step), RUN)
    await_that(lambda: "states of 17 steps were missed" in recorder.log_text(), "what is missing", recorder)

    reports = recorder.log_text().count("were missed")
    recorder.send_signal(signal.SIGSTOP)
    steps = count(31)
    for _ in range(20 * qos.STEP_DEPTH):  # also more than fits into its queue in shared memory
        client.ask(STATES._replace(step=next(steps)), RUN)
    client.details.clear()
    client.spin_until(lambda: ANSWERS in client.details, "its word on that")
    assert client.diagnostics[ANSWERS] == "ready" and worst_of(client, "conversion and publishing") < LONGEST
    recorder.send_signal(signal.SIGCONT)

    def has_noticed() -> bool:
        client.ask(STATES._replace(step=next(steps)), RUN)
        return recorder.log_text().count("were missed") > reports

    client.spin_until(has_noticed, "what else is missing")
    assert recorder.stop() == 1
    assert re.search(r"the bag lacks the states of \d{2,} steps, the first is 10", recorder.log_text())
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
