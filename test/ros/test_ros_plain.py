"""Nodes with the extras of ros/fastdds/ switched off: the same run, through public interfaces only."""

from __future__ import annotations

import signal
from pathlib import Path

import pytest
import rclpy
from rclpy.executors import SingleThreadedExecutor
from stages.ros_stage import StageWithClients
from test_ros_collision_run import FIRST, SECOND, STATES, breakable_body, ground

from campaigns.kills.trials import undisturbed
from fracture_collision.ros.fastdds import extras
from fracture_collision.ros.fastdds.extras import SWITCH, UNKNOWN, Origin
from fracture_collision.ros.fastdds.prompt_executor import PromptExecutor
from fracture_collision.ros.processes.node_process import free_domain_id
from fracture_collision.ros.processes.own_context import own_context

RUN = 47
pytestmark = pytest.mark.timeout(300)


def test_a_run_without_the_extras_has_the_same_bytes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    reference = undisturbed(tmp_path / "with", "pane")
    monkeypatch.setenv(SWITCH, "1")
    assert undisturbed(tmp_path / "without", "pane") == reference


def test_a_plain_service_answers_two_runs_and_restarts(
    stage: StageWithClients, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It cannot distinguish publishers, so it accepts a second run at once; after a kill it gets the log again."""
    monkeypatch.setenv(SWITCH, "1")
    service = stage.start("collision_node", threads=1)
    client = stage.client()
    client.await_service()
    for run in (RUN, RUN + 1):
        for body in (breakable_body(), ground()):
            client.publish("bodies", body, run)
        for event in (FIRST, SECOND):
            client.publish("fracture_events", event, run)
        client.ask(STATES, run)
    service.stop(patience=0.0, orders=(signal.SIGKILL,))
    service = stage.start("collision_node", threads=1)
    later = STATES._replace(step=STATES.step + 1)

    def is_answered() -> bool:
        client.publish("fragment_states", later, RUN + 1)
        client.spin_once(0.5)
        return any(answer.step == later.step and answer.run_id == RUN + 1 for answer in client.answers)

    client.spin_until(is_answered, "an answer of the next service")
    assert service.stop() == 0 and "Traceback" not in service.log_text()


@pytest.mark.parametrize("value", ["", "0", "1"])
def test_the_switch_selects_the_executor_and_the_checks(value: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(SWITCH, value)
    is_plain = value == "1"
    used: list[str] = []
    monkeypatch.setattr(extras, "remove_left_behind", lambda: used.append("files"))
    monkeypatch.setattr(extras, "orphaned_ports_held", lambda _: used.append("ports"))
    monkeypatch.setattr(extras, "fault_of_own_ports", lambda _: used.append("fault") or "lost")
    monkeypatch.setattr(extras, "has_known_transports", lambda _: True)
    extras.remove_unused_files()
    extras.ports_for_new_node(1)
    assert extras.fault_of_ports(1) == ("" if is_plain else "lost")
    assert used == ([] if is_plain else ["files", "ports", "fault"])
    context = own_context(free_domain_id())
    try:
        node = rclpy.create_node("plain", context=context)
        executor = extras.make_executor(context)
        assert type(executor) is (SingleThreadedExecutor if is_plain else PromptExecutor)
        executor.shutdown()
        neighbours = extras.make_neighbours(node)
        assert neighbours.await_all()
        neighbours.look()
        assert neighbours.dead == set() and neighbours.name(UNKNOWN) == "a node"
    finally:
        context.try_shutdown()


def test_the_publisher_of_a_message_is_unknown_to_rclpy() -> None:
    known = Origin(bytes(16), 3)
    assert extras.origin_of(known) is known
    assert extras.origin_of({"publication_sequence_number": 5}) == Origin(UNKNOWN, 5)
