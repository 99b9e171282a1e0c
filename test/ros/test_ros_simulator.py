"""The simulator in its own process: what it rejects, and the states it publishes."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from campaigns.kills.stage import Stage, stage
from fracture_collision.records import FragmentStates
from fracture_collision.ros.nodes.simulator_node import derived_run_id, with_static_fragments


@pytest.fixture
def nodes(tmp_path: Path) -> Iterator[Stage]:
    with stage(tmp_path) as made:
        yield made


def test_a_missing_scene_is_reported_with_an_explanation(nodes: Stage) -> None:
    simulator = nodes.start("simulator_node", scene="no_such_scene")
    assert simulator.wait(30.0) == 1
    assert "no_such_scene" in simulator.log_text() and "Traceback" not in simulator.log_text()


def test_static_fragments_are_published_once_with_their_poses() -> None:
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
