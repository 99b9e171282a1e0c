"""The simulator in its own process: what it rejects, and its run ids."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from campaigns.kills.stage import Stage, stage
from fracture_collision.ros.nodes.simulator_node import derived_run_id


@pytest.fixture
def nodes(tmp_path: Path) -> Iterator[Stage]:
    with stage(tmp_path) as made:
        yield made


def test_a_missing_scene_is_reported_with_an_explanation(nodes: Stage) -> None:
    simulator = nodes.start("simulator_node", scene="no_such_scene")
    assert simulator.wait(30.0) == 1
    assert "no_such_scene" in simulator.log_text() and "Traceback" not in simulator.log_text()


def test_run_ids_differ_by_scene_and_seed() -> None:
    ids = {derived_run_id(scene, seed) for scene in ("plates", "pane") for seed in range(20)}
    assert len(ids) == 40 and all(0 < run_id < 2**62 for run_id in ids)
    assert derived_run_id("plates", 7) == derived_run_id("plates", 7)
