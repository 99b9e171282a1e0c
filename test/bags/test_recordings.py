"""Recordings on request: which nodes are recorded, and the error if recording is impossible."""

from __future__ import annotations

from pathlib import Path

import pytest
from stages.ros_stage import StageWithClients

from fracture_collision.ros.nodes.recordings import RecordingFailed, Recordings, _new_folder


def test_nodes_of_a_namespace_are_recorded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    stage = StageWithClients(tmp_path / "stage")
    monkeypatch.setenv("ROS_DOMAIN_ID", str(stage.domain_id))
    recordings = Recordings(tmp_path / "play", "/cell")
    try:
        assert recordings.end() is None
        ears = stage.client()
        bag = recordings.begin()
        ears.spin_until(lambda: ears.node.count_subscribers("/cell/fragment_states") == 1, "a recorder")
        assert recordings.end() == bag == tmp_path / "play" / "bag_1" and (bag / "metadata.yaml").exists()
        assert recordings.end() is None
    finally:
        recordings.end()
        stage.close()


def test_a_new_recording_does_not_reuse_the_name_of_an_earlier_log(tmp_path: Path) -> None:
    (tmp_path / "bag_1").mkdir()
    (tmp_path / "bag_2.log").write_text("no bag came of it")
    assert _new_folder(tmp_path) == tmp_path / "bag_3"


def test_a_recording_without_a_folder_is_reported(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(RecordingFailed, match="cannot start a recording: .*file"):
        Recordings(tmp_path / "file" / "play", "/").begin()
