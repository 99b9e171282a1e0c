"""Recordings on request: which nodes are recorded, and the errors of one that is impossible or lacks answers."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from stages.ros_stage import StageWithClients

from campaigns.kills.stage import PATIENCE, await_that
from fracture_collision.records import FragmentStates
from fracture_collision.ros.nodes.recorder_node import FEW
from fracture_collision.ros.nodes.recordings import RecordingFailed, Recordings, _new_folder
from fracture_collision.ros.wire import qos
from fracture_collision.ros.wire.conversion import header_of, heading


def test_nodes_of_a_namespace_are_recorded(
    stage: StageWithClients, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", str(stage.domain_id))
    recordings = Recordings(tmp_path / "play", "/cell")
    try:
        assert recordings.end() is None
        ears = stage.client()
        bag = recordings.begin()
        topic = qos.CONTACT_CONSTRAINTS
        ears.node.create_publisher(topic.message_class, f"/cell/{topic.name}", topic.qos)  # in place of a service
        ears.spin_until(lambda: ears.node.count_subscribers("/cell/fragment_states") == 1, "a recorder")
        assert recordings.end() == bag == tmp_path / "play" / "bag_1" and (bag / "metadata.yaml").exists()
        assert recordings.end() is None
    finally:
        recordings.end()


def test_a_new_recording_does_not_reuse_the_name_of_an_earlier_log(tmp_path: Path) -> None:
    (tmp_path / "bag_1").mkdir()
    (tmp_path / "bag_2.log").write_text("no bag came of it")
    assert _new_folder(tmp_path) == tmp_path / "bag_3"


def test_a_recording_without_a_folder_is_reported(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(RecordingFailed, match="cannot start a recording: .*file"):
        Recordings(tmp_path / "file" / "play", "/").begin()


class Lonely:
    """A recorder, and in place of simulator and service a client."""

    def __init__(self, stage: StageWithClients, folder: Path) -> None:
        self.ears = stage.client()
        self.recorder = stage.start("recorder_node", folder=str(folder / "bag"), progress=True)
        self._time = 0.0

    def subscribers(self, topic: qos.Topic) -> int:
        """Without the client itself."""
        return self.ears.node.count_subscribers(topic.name) - (topic is qos.CONTACT_CONSTRAINTS)

    def begin(self) -> None:
        """Becomes a service, and waits for the recorder to subscribe to states and answers."""
        topic = qos.CONTACT_CONSTRAINTS
        self.answers = self.ears.node.create_publisher(topic.message_class, topic.name, topic.qos)
        self.ears.spin_until(lambda: self.subscribers(qos.FRAGMENT_STATES) == 1, "a recorder of states")
        self.ears.spin_until(lambda: self.answers.get_subscription_count() == 2, "both subscribers")

    def ask(self, count: int) -> None:
        """Publishes states of `count` steps; each is in the recorder before the next."""
        for _ in range(count):
            self._time += 0.01
            self.ears.publish("fragment_states", FragmentStates(1, 0, *(np.zeros(0),) * 3), 7, self._time)
            recorded = f'"fragment_states": {round(100 * self._time)},'
            await_that(lambda recorded=recorded: recorded in self.recorder.log_text(), recorded)

    def answer(self, count: int, ahead: float = 0.0) -> None:
        """Publishes the `count`-th answer, to the last states or those `ahead` [s]."""
        self.answers.publish(qos.CONTACT_CONSTRAINTS.message_class(header=header_of(heading(self._time + ahead))))
        await_that(lambda: f'"contact_constraints": {count},' in self.recorder.log_text(), "an answer on record")


@pytest.fixture
def lonely(stage: StageWithClients, tmp_path: Path) -> Lonely:
    return Lonely(stage, tmp_path)


def test_states_are_recorded_once_answers_can_arrive_and_without_any_it_fails(lonely: Lonely) -> None:
    """So a simulator that waits for the recorder waits until that receives answers, too."""
    lonely.ears.spin_until(lambda: lonely.subscribers(qos.CONTACT_CONSTRAINTS) == 1, "a recorder")
    assert lonely.subscribers(qos.FRAGMENT_STATES) == 0
    lonely.begin()
    lonely.ask(FEW)
    assert lonely.recorder.stop() == 1
    assert f"{FEW} recorded steps lack their answers, the first at 0.01 s: they have" in lonely.recorder.log_text()


def test_answers_missing_in_the_middle_are_reported_at_the_end(lonely: Lonely) -> None:
    """Those before the first answer are not missing: they may be on their way when a recording begins."""
    lonely.begin()
    lonely.ask(FEW)
    lonely.answer(1)
    lonely.ask(FEW + 1)
    lonely.answer(2)
    assert lonely.recorder.stop() == 1
    assert f"{FEW} recorded steps lack their answers, the first at 0.04 s: they have" in lonely.recorder.log_text()


def test_answers_that_are_taken_before_their_states_are_not_missing(lonely: Lonely) -> None:
    lonely.begin()
    for count in range(1, FEW + 1):
        lonely.answer(count, ahead=0.01)
        lonely.ask(1)
    lonely.ask(FEW - 1)  # so few may be on their way
    assert lonely.recorder.stop() == 0


def test_a_recorder_that_loses_the_service_while_the_run_goes_on_ends(lonely: Lonely) -> None:
    lonely.begin()
    lonely.answer(1)
    lonely.ask(FEW)
    lonely.ears.node.destroy_publisher(lonely.answers)
    assert lonely.recorder.wait(PATIENCE) == 1
    assert f"{FEW} recorded steps lack their answers, the first at 0.01 s: the service" in lonely.recorder.log_text()
