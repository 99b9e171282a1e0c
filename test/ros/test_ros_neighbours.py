"""Killed and stopped subscribers: which ones the service and the simulator wait for, and how they report it."""

from __future__ import annotations

import math
import os
import signal
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest
import rclpy
from stages.ros_client import ServiceClient
from stages.ros_stage import StageWithClients
from test_ros_collision_run import FIRST, SECOND, STATES, breakable_body, ground
from worlds.scene_of_length import scene_of_length

from campaigns.kills.stage import await_end, await_recording, await_step, await_that, must_end, steps_told
from fracture_collision.bag.reader import message_counts
from fracture_collision.ros.fastdds import acknowledged_publisher
from fracture_collision.ros.fastdds.acknowledged_publisher import (
    LOOK_INTERVAL,
    PATIENCE,
    PATIENCE_WITH_THE_SLOW,
    AcknowledgedPublisher,
)
from fracture_collision.ros.fastdds.farewell import farewell, participants_here
from fracture_collision.ros.fastdds.message_origin import participant_of
from fracture_collision.ros.fastdds.neighbours import EVERYBODYS_TOPICS, Neighbours
from fracture_collision.ros.fastdds.participant_process import (
    Process,
    age_of,
    is_dead,
    is_of_this_process,
    is_stopped,
    process_of,
)
from fracture_collision.ros.processes.node_process import free_domain_id
from fracture_collision.ros.processes.own_context import own_context
from fracture_collision.ros.wire import qos

RUN = 43
ANSWERS = "fracture_collision: answers"
OVERTAKEN = "messages overtaken before all had them"
SLOW = "slow subscribers"
FORGOTTEN = "has died; its participant is removed"


@pytest.mark.parametrize("victim", ["recorder", "service"])
def test_a_killed_subscriber_delays_no_step(stage: StageWithClients, tmp_path: Path, victim: str) -> None:
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
    await_recording(recorder, simulator, service)
    for node in (simulator, recorder, service):
        must_end(node)
        assert "did not acknowledge" not in node.log_text()
    for node in (simulator, service) if victim == "recorder" else (simulator,):
        lines = [line for line in node.log_text().splitlines() if FORGOTTEN in line]
        assert len(lines) == 1 and f"/{killed.name} [" in lines[0], node.log_text()
    counts = message_counts(tmp_path / "living")
    assert counts["/fragment_states"] >= steps == 400 <= counts["/contact_constraints"]


def test_a_stopped_subscriber_is_waited_for_once_and_named(stage: StageWithClients, tmp_path: Path) -> None:
    client = service_with_bodies(stage)
    recorder = stage.start("recorder_node", folder=str(tmp_path / "bag"), progress=True)
    await_that(lambda: '"/diagnostics": 2' in recorder.log_text(), "what the service says", recorder)
    client.ask(STATES, RUN)
    client.diagnostics.clear()
    client.spin_until(lambda: client.diagnostics.get(ANSWERS) == "ready", "its word on that")
    assert client.details[ANSWERS][SLOW] == "none" and client.details[ANSWERS][OVERTAKEN] == "0"

    recorder.send_signal(signal.SIGSTOP)
    for step in range(100, 140):
        client.ask(STATES._replace(step=step), RUN)
    client.spin_until(lambda: "some subscribers are slow" in client.diagnostics[ANSWERS], "its word on who is slow")
    said = client.details[ANSWERS][SLOW]
    assert said.startswith("contact_constraints: ") and "/recorder_node [" in said and "], stopped" in said
    before = int(client.details[ANSWERS][OVERTAKEN])
    assert 1 <= before <= 40
    # A stopped subscriber is not given the PATIENCE that a merely slow one gets.
    assert worst_of(client, "conversion and publishing") < PATIENCE

    recorder.send_signal(signal.SIGCONT)
    step = iter(range(200, 10_000))

    def is_quick_again() -> bool:
        client.ask(STATES._replace(step=next(step)), RUN)
        return client.diagnostics[ANSWERS] == "ready"

    client.spin_until(is_quick_again, "its word on nobody being slow")
    assert client.details[ANSWERS][SLOW] == "none"


class Clock:
    """A clock that advances without real waiting."""

    def __init__(self) -> None:
        self.now = 100.0

    def monotonic(self) -> float:
        return self.now


class StandIn:
    """A publisher, its node and its neighbours, with one subscriber that acknowledges after a set time."""

    slow: dict[str, frozenset[bytes]]

    def __init__(self, clock: Clock) -> None:
        self.clock, self.slow, self.waits, self.warnings = clock, {}, [], 0
        self.acknowledges_after, self.is_stopped = 0.0, False
        self.topic_name = qos.CONTACT_CONSTRAINTS.name

    def create_publisher(self, *_arguments):
        return self

    def get_subscription_count(self) -> int:
        return 1

    def get_subscriptions_info_by_topic(self, _name: str) -> list[SimpleNamespace]:
        return [SimpleNamespace(node_name="recorder_node", endpoint_gid=bytes(24), qos_profile=qos.FRAGMENTS.qos)]

    def publish(self, _message: bytes) -> None:
        """Publishing takes no time."""

    def wait_for_all_acked(self, duration) -> bool:
        seconds = duration.nanoseconds / 1e9
        waited = min(seconds, self.acknowledges_after)
        self.acknowledges_after -= waited
        self.waits.append(waited)
        self.clock.now += waited + 1e-9  # the check itself takes time too
        return self.acknowledges_after <= 0.0

    def look(self, *_infos) -> None:
        """No participant joins or leaves."""

    def are_some_stopped(self, _participants) -> bool:
        return self.is_stopped

    def names(self, _participants) -> str:
        return "recorder_node"

    def get_logger(self):
        return self

    def warning(self, *_words, **_options) -> None:
        self.warnings += 1


@pytest.mark.parametrize("is_stopped", [True, False])
def test_a_subscriber_that_does_not_acknowledge_is_left_out_until_it_does(
    is_stopped: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    clock = Clock()
    monkeypatch.setattr(acknowledged_publisher, "time", clock)
    stand_in = StandIn(clock)
    publisher = AcknowledgedPublisher(stand_in, qos.CONTACT_CONSTRAINTS, neighbours=stand_in)

    def waited(since_the_last: float) -> float:
        """Time [s] the next publish waits."""
        clock.now += since_the_last
        stand_in.waits.clear()
        publisher.publish(b"")
        return sum(stand_in.waits)

    stand_in.acknowledges_after = 0.005
    assert waited(0.001) == pytest.approx(0.005) and publisher.overtaken == 0
    stand_in.acknowledges_after, stand_in.is_stopped = math.inf, is_stopped
    first = waited(0.001)
    assert first <= (LOOK_INTERVAL if is_stopped else PATIENCE) + 1e-6
    # it waits neither 2 s again, nor 10 ms if the step has taken that long already
    assert [waited(0.02) for _ in range(50)] == [0.0] * 50
    assert waited(0.004) == pytest.approx(PATIENCE_WITH_THE_SLOW - 0.004, abs=1e-6)
    assert publisher.overtaken == 52 and stand_in.warnings == 1 and stand_in.slow
    stand_in.acknowledges_after, stand_in.is_stopped = 0.0, False
    assert waited(0.001) == 0.0 and not stand_in.slow
    stand_in.acknowledges_after = 0.3  # it keeps up again, so publishes wait for it
    assert waited(0.001) == pytest.approx(0.3, abs=1e-6) and publisher.overtaken == 52


def test_a_subscriber_that_never_spins_is_not_waited_for(stage: StageWithClients) -> None:
    """DDS acknowledges every sample it receives, even if the application never takes it."""
    client = service_with_bodies(stage)
    idle = stage.client()
    client.spin_until(lambda: client.node.count_subscribers("contact_constraints") == 2, "the other")
    for step in range(100, 160):
        client.ask(STATES._replace(step=step), RUN)
    client.details.clear()
    client.spin_until(lambda: ANSWERS in client.details, "its word on that")
    assert client.details[ANSWERS][SLOW] == "none" and client.details[ANSWERS][OVERTAKEN] == "0"
    assert idle.answers == []


def test_a_participant_identifies_its_process() -> None:
    domain_id = free_domain_id()
    contexts = [own_context(domain_id) for _ in range(2)]
    try:
        nodes = [rclpy.create_node(f"node_{i}", context=context) for i, context in enumerate(contexts)]
        assert [Neighbours(node).await_all() for node in nodes] == [True, True]
        assert participants_here(domain_id) == 2
        infos = nodes[0].get_publishers_info_by_topic(EVERYBODYS_TOPICS[1])
        found = {participant_of(bytes(info.endpoint_gid)) for info in infos}
        assert found and all(is_of_this_process(each) for each in found)
        (process,) = {process_of(each) for each in found}
        assert process.pid == os.getpid() and not is_dead(process) and not is_stopped(process)
        assert is_dead(process._replace(started=process.started + 1))  # its pid was reused by another process
        stranger = min(found)
        assert process_of(stranger[:4] + b"\xff\xff" + stranger[6:]) is None
        assert not is_of_this_process(b"\x01\x10" + stranger[2:])  # other vendors encode GUIDs differently
    finally:
        for context in contexts:
            context.try_shutdown()


def test_dead_stopped_and_zombie_processes() -> None:
    child = subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE)
    started = int(Path(f"/proc/{child.pid}/stat").read_text().rpartition(")")[2].split()[19])
    process = Process(child.pid, started)
    assert not is_dead(process) and not is_stopped(process)
    assert 0.0 <= age_of(child.pid) < age_of(os.getpid())
    child.send_signal(signal.SIGSTOP)
    await_that(lambda: is_stopped(process), "a stopped process")
    assert not is_dead(process)
    child.kill()
    await_that(lambda: is_dead(process), "a dead one, though nobody has asked for its status")
    assert Path(f"/proc/{child.pid}").exists() and not is_stopped(process)
    child.communicate()
    assert is_dead(process)
    with pytest.raises(ProcessLookupError):
        age_of(child.pid)


def test_the_message_for_a_dead_participant_is_an_rtps_disposal() -> None:
    prefix = bytes(range(12))
    message = farewell(prefix)
    assert message[:4] == b"RTPS" and message[8:20] == prefix
    length = int.from_bytes(message[22:24], "little")
    assert message[20] == 0x15 and len(message) == 24 + length
    assert prefix + bytes.fromhex("000001c1") in message and message.endswith(b"\0\0\0\x03\x01\0\0\0")


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
    return _times(client, part)[1]


def _times(client: ServiceClient, part: str) -> list[float]:
    text = next(value for key, value in client.details[ANSWERS].items() if key.startswith(f"{part} (last"))
    return [1e-3 * float(words.split()[0]) for words in text.split(", ")]
