"""Replay over DDS; the recorder node writes the bytes of the library's own recording, and the settings."""

from __future__ import annotations

import json
import signal
import time
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
import rclpy
import yaml
from rcl_interfaces.srv import GetParameters
from rclpy.executors import SingleThreadedExecutor
from rclpy.parameter import Parameter
from rosbags.highlevel import AnyReader
from rosbags.interfaces import QosDurability
from stages.ros_stage import StageWithClients
from stages.typed_command import begun, call
from test_replay import CONTACTS, EVENTS, STATES
from worlds.recorded_pane import STEPS, record_pane, replayed
from worlds.scene_of_length import scene_of_length

from campaigns.kills.stage import await_that
from fracture_collision.bag.exchanges import read_runs, registry_settings, serialize_record
from fracture_collision.bag.mcap_file import McapFile
from fracture_collision.bag.reader import (
    message_counts,
    missing_words,
    read_messages,
    recorded_settings,
    without_run_id,
)
from fracture_collision.bag.writer import mend_bag
from fracture_collision.cdr import Heading
from fracture_collision.records import FractureEvent
from fracture_collision.replay import Order, Replay, settings_of
from fracture_collision.ros.nodes import repeated_request
from fracture_collision.ros.nodes.settings_watcher import ServiceSettings
from fracture_collision.ros.processes.node_process import free_domain_id
from fracture_collision.ros.processes.own_context import own_context
from fracture_collision.ros.runs.replay_run import OverDds
from fracture_collision.ros.runs.scene_recording import TOPICS, record_scene
from fracture_collision.ros.wire import qos
from fracture_collision.simulation.scene.scene import load_scene
from fracture_collision.world import Settings
from fracture_collision.world.settings import settings_text, values_of

PATIENCE = 60.0  # [s] on a loaded machine


def test_a_replay_over_dds_gives_the_answers_of_one_in_process(tmp_path: Path) -> None:
    settings = Settings(contacts_per_pair=5, threads=2)
    runs = read_runs(record_pane(tmp_path / "one", settings))
    runs += read_runs(record_pane(tmp_path / "two", settings, seed=5))
    order = Order(first=5, end=STEPS - 5, backwards=True, loops=2)
    with OverDds(settings, tmp_path / "service.log") as service:
        over_dds = Replay(runs, service, order)
        assert list(over_dds) == list(range(1, 4 * (STEPS - 10) + 1))
    report = over_dds.report()
    assert report.exact and report.steps == 2 * (STEPS - 10)
    assert report.digest == replayed(runs, order, contacts_per_pair=5).digest


class Recording:
    """Service, simulator and recorder as processes."""

    def __init__(self, stage: StageWithClients, bag: Path, scene: str | Path, service: dict[str, object]) -> None:
        self.bag = bag
        self.service = stage.start("collision_node", **service)
        self.recorder = stage.start("recorder_node", folder=str(bag))
        self.simulator = stage.start("simulator_node", scene=str(scene), wait_for_subscribers=2)

    def stop(self) -> list[int]:
        return [process.stop() for process in (self.simulator, self.recorder, self.service)]


def test_nodes_record_the_same_as_the_library(stage: StageWithClients, tmp_path: Path) -> None:
    """Bodies, events, states and contacts byte for byte, but for run ids, and the settings given to the service."""
    settings = Settings(contacts_per_pair=6, penetration_tolerance=0.003, threads=1, lookahead=0.0025)
    given = {"contacts_per_pair": 6, "penetration_tolerance": 0.003, "threads": 1, "lookahead": 0.0025}
    recording = Recording(stage, tmp_path / "bag", "pane", given)
    assert recording.simulator.wait(PATIENCE) == 0
    await_that(lambda: recorded_settings(recording.bag) is not None, "the settings")
    assert recording.stop()[1:] == [0, 0]
    assert missing_words(recording.bag) == []
    library = tmp_path / "library"
    for _ in record_scene(load_scene("pane"), settings, None, library):
        pass
    for topic in TOPICS:
        one, other = (
            [each._replace(data=without_run_id(each.data)) for each in read_messages(bag, [f"/{topic.name}"])]
            for bag in (recording.bag, library)
        )
        assert len(one) > 0 and one == other
    found, words = settings_of(recording.bag, {"threads": 1})
    assert (found, words) == (settings, [])
    assert registry_settings(recording.bag) == [json.loads(settings_text(settings))]
    assert replayed(read_runs(recording.bag), **found._asdict()).exact


@pytest.mark.slow
def test_a_killed_recorder_leaves_a_readable_bag(stage: StageWithClients, tmp_path: Path) -> None:
    long_scene = scene_of_length("pane", 600.0, tmp_path)
    recording = Recording(stage, tmp_path / "bag", long_scene, {"threads": 1})
    file = recording.bag / "bag_0.mcap"
    await_that(lambda: (recording.bag / "metadata.yaml").is_file(), "metadata from the start")
    await_that(lambda: message_counts(recording.bag).get(CONTACTS, 0) > 30, "some of the run on disk")
    recording.recorder.send_signal(signal.SIGKILL)
    assert recording.recorder.wait(10.0) == -signal.SIGKILL
    recording.stop()

    bag = recording.bag
    told = " ".join(missing_words(bag))
    assert "is truncated" in told and not McapFile(file).is_whole
    counts = message_counts(bag)
    assert counts[STATES] > 30 and abs(counts[STATES] - counts[CONTACTS]) <= 1
    metadata = yaml.safe_load((bag / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
    assert 0 < metadata["message_count"] <= sum(counts.values())
    assert json.loads(metadata["custom_data"]["collision_settings"])["threads"] == 1
    settings = settings_of(bag, {"threads": 1}).settings
    assert settings.lookahead == 0.0025
    steps = replayed(read_runs(bag), Order(end=60), **settings._asdict())
    assert steps.exact and steps.steps > 30

    for done in (call("replay", bag, "--steps", "0:20"), call("digest", bag)):
        assert done.status == 0 and "is truncated" in done.text

    before = list(read_messages(bag))
    mended = mend_bag(bag)
    assert mended.damaged == [] and mended.messages == len(before) and mended.lost_bytes == 0
    assert missing_words(bag) == [] and list(read_messages(bag)) == before
    with AnyReader([bag]) as reader:
        assert reader.message_count == len(before)
        assert [(c.topic, t, bytes(d)) for c, t, d in reader.messages()] == [tuple(m) for m in before]
        by_name = {connection.topic: connection for connection in reader.connections}
        (latched,) = by_name["/bodies"].ext.offered_qos_profiles
        assert latched.durability == QosDurability.TRANSIENT_LOCAL
        assert by_name[CONTACTS].digest.startswith("RIHS01_")
    assert settings_of(bag, {"threads": 1}).words == []
    assert sorted(path.name for path in bag.iterdir()) == ["bag_0.mcap", "metadata.yaml"]


class Asking:
    """A node whose parameters may change, a recorder that asks it for its settings, and what it was told."""

    def __init__(self) -> None:
        self._context = own_context(free_domain_id())
        named = {"context": self._context, "namespace": "/arm"}
        self.service = rclpy.create_node("service", **named, start_parameter_services=False)
        self._recorder = rclpy.create_node("recorder", **named)
        self._executor = SingleThreadedExecutor(context=self._context)
        self.told: list[dict[str, object]] = []
        self._asked = ServiceSettings(self._recorder, "contact_constraints", self.told.append)
        for node in (self.service, self._recorder):
            self._executor.add_node(node)
        self._asked.look()  # no service yet

    def announce(self) -> None:
        """The service publishes contacts from now on."""
        topic = qos.CONTACT_CONSTRAINTS
        self.service.create_publisher(topic.message_class, topic.name, topic.qos)

    def spin_until(self, count: int) -> None:
        deadline = time.monotonic() + PATIENCE
        while len(self.told) < count and time.monotonic() < deadline:
            self._asked.look()
            self._executor.spin_once(timeout_sec=0.05)
        assert len(self.told) == count

    def close(self) -> None:
        self._executor.shutdown()
        for node in (self.service, self._recorder):
            node.destroy_node()
        self._context.try_shutdown()


def test_settings_are_requested_until_they_come_and_followed_when_they_change(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(repeated_request, "ASK_AGAIN", 0.2)
    lost: list[GetParameters.Response] = []

    def answer(request: GetParameters.Request, response: GetParameters.Response) -> GetParameters.Response:
        found = asking.service.get_parameters(request.names)
        response.values = [parameter.get_parameter_value() for parameter in found]
        return response

    def lose_two(response: GetParameters.Response, header: object) -> None:
        if len(lost) < 2:
            lost.append(response)
        else:
            send(response, header)

    with closing(Asking()) as asking:
        for name, value in values_of(Settings()).items():
            asking.service.declare_parameter(name, value)
        parameters = asking.service.create_service(GetParameters, "service/get_parameters", answer)
        send = parameters.send_response
        parameters.send_response = lose_two
        asking.announce()
        asking.spin_until(1)
        assert asking.told == [values_of(Settings())] and len(lost) == 2
        asking.service.set_parameters([Parameter("contacts_per_pair", value=5)])
        asking.spin_until(2)
        assert asking.told[1] == values_of(Settings(contacts_per_pair=5))


def test_a_recorder_survives_undecodable_messages(stage: StageWithClients, tmp_path: Path) -> None:
    recorder = stage.start("recorder_node", folder=str(tmp_path / "bag"))
    client = stage.client()
    client.spin_until(lambda: client.node.count_subscribers("fracture_events") == 1, "the recorder")
    good = [serialize_record(example_event(i), Heading(i - 1, 0, "world"), 7) for i in range(3)]
    for data in (b"\x00\x01\x00\x00", b"\x07\x07" + good[0][2:], good[0][:-5], *good):
        client.publish_bytes("fracture_events", data)
    await_that(lambda: message_counts(tmp_path / "bag").get(EVENTS, 0) == 3, "the good ones, on disk")
    assert recorder.stop() == 0
    found = [(message.nanoseconds, message.data) for message in read_messages(tmp_path / "bag", [EVENTS])]
    assert found == [(0, good[0]), (0, good[1]), (10**9, good[2])]
    assert "not recorded: no serialized FractureEvent" in recorder.log_text()


def example_event(sequence: int) -> FractureEvent:
    ids = np.arange(2, dtype=np.uint32)
    return FractureEvent(sequence, 1, 1, ids + 2, ids, ids, ids, np.ones(4))


def test_an_interrupted_replay_over_dds_reports_and_leaves_no_process(tmp_path: Path, recorded: Path) -> None:
    with begun(tmp_path, "replay", recorded, "--ros", "--loop", "100000") as process:
        process.until(lambda: bool(children(process.pid)))
        (service,) = children(process.pid)
        process.until(lambda: busy(service))
        process.stop(signal.SIGINT)
    assert "stopped" in process.text
    assert not Path(f"/proc/{service}").exists()


def children(pid: int) -> list[int]:
    try:
        return [int(child) for child in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]
    except OSError:
        return []


def busy(pid: int) -> bool:
    """Whether it has used more than three seconds of processor time, so has loaded its kernels and answered."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return int(fields[11]) + int(fields[12]) > 300
