"""The simulator in its own process: lock-step by topics, asking again, and a service that dies in between."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from fracture_collision.bag.reader import message_counts, topic_digest
from fracture_collision.records import FragmentStates
from fracture_collision.ros.node_process import NodeProcess, free_domain_id
from fracture_collision.ros.simulator_node import derived_run_id, with_static_fragments

STEPS = 60  # of the scene "pane"
RUN_LIMIT = 420.0  # [s] beyond it hangs; a run takes about 20 s on a quiet machine


class Stage:
    """Nodes of one domain, all ended at the end."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._domain_id = free_domain_id()
        self._nodes: list[NodeProcess] = []

    def start(self, module: str, **parameters) -> NodeProcess:
        log = self._folder / f"{module}_{len(self._nodes)}.log"
        self._nodes.append(NodeProcess(module, parameters, self._domain_id, log))
        return self._nodes[-1]

    def close(self) -> None:
        for node in reversed(self._nodes):
            node.stop()


@pytest.fixture
def stage(tmp_path: Path) -> Iterator[Stage]:
    stage = Stage(tmp_path)
    yield stage
    stage.close()


def record_run(stage: Stage, folder: Path, killed_after: int | None = None) -> Path:
    """Runs the scene to its end; the service is killed and started again once it has answered some steps."""
    recorder = stage.start("recorder_node", folder=str(folder))
    service = stage.start("collision_node", threads=1)
    simulator = stage.start("simulator_node", scene="pane", wait_for_subscribers=2, progress=True)
    if killed_after is not None:
        while f'"step": {killed_after}' not in simulator.log_text():
            assert simulator.exit_status() is None, simulator.log_text()
        service.stop(patience=0.0)
        service = stage.start("collision_node", threads=1)
    assert simulator.wait(RUN_LIMIT) == 0, simulator.log_text()
    assert recorder.stop() == 0, recorder.log_text()
    assert service.stop() == 0, service.log_text()
    if killed_after is not None:
        assert "asking again" in simulator.log_text()
    return folder


@pytest.mark.timeout(900)
def test_a_service_that_dies_in_mid_run_changes_nothing(tmp_path: Path) -> None:
    bags = []
    for name, killed_after in (("plain", None), ("interrupted", 1)):
        folder = tmp_path / name
        folder.mkdir()
        stage = Stage(folder)
        try:
            bags.append(record_run(stage, folder / "bag", killed_after))
        finally:
            stage.close()
    assert message_counts(bags[0])["/fragment_states"] == STEPS
    for topic in ("/bodies", "/fracture_events", "/fragment_states", "/contact_constraints"):
        assert topic_digest(bags[0], topic) == topic_digest(bags[1], topic), topic


def test_a_scene_that_is_not_there_is_an_error_in_words(stage: Stage) -> None:
    simulator = stage.start("simulator_node", scene="no_such_scene")
    assert simulator.wait(30.0) == 1
    assert "no_such_scene" in simulator.log_text() and "Traceback" not in simulator.log_text()


def test_static_fragments_are_named_once_and_where_they_are() -> None:
    states = FragmentStates(
        3, 0, np.array([2, 5], np.uint32), np.arange(6.0), np.tile([0.0, 0.0, 0.0, 1.0], 2), np.ones(6), np.ones(6)
    )
    named = with_static_fragments(states, [5, 1, 9])
    assert named.fragment_ids.tolist() == [1, 2, 5, 9] and named.fragment_ids.dtype == np.uint32
    assert named.positions.reshape(-1, 3)[1:3].ravel().tolist() == states.positions.tolist()
    assert named.positions.reshape(-1, 3)[[0, 3]].tolist() == [[0.0] * 3] * 2
    assert named.orientations.reshape(-1, 4).tolist() == [[0.0, 0.0, 0.0, 1.0]] * 4
    assert named.linear_velocities.reshape(-1, 3).sum(axis=1).tolist() == [0.0, 3.0, 3.0, 0.0]


def test_run_ids_differ_by_scene_and_seed() -> None:
    ids = {derived_run_id(scene, seed) for scene in ("plates", "pane") for seed in range(20)}
    assert len(ids) == 40 and all(0 < run_id < 2**62 for run_id in ids)
    assert derived_run_id("plates", 7) == derived_run_id("plates", 7)
