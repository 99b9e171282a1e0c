"""The simulator in its own process: what it rejects, what it does not expect, and its run ids."""

from __future__ import annotations

from pathlib import Path

import pytest
from stages.ros_stage import StageWithClients
from worlds.scene_of_length import scene_of_length

from fracture_collision.ros.nodes.simulator_node import random_run_id


def test_a_missing_scene_is_reported_with_an_explanation(stage: StageWithClients) -> None:
    simulator = stage.start("simulator_node", scene="no_such_scene")
    assert simulator.wait(30.0) == 1
    assert "no_such_scene" in simulator.log_text() and "Traceback" not in simulator.log_text()


@pytest.mark.parametrize("module", ["simulator_node", "live_simulator_node"])
def test_settings_that_a_simulator_does_not_expect_are_logged_once_per_change(
    module: str, stage: StageWithClients, tmp_path: Path
) -> None:
    """It sets the lookahead itself; here another node changes it during the run."""
    _, client = stage.served()
    simulator = stage.start(module, scene=str(scene_of_length("pane", 600.0, tmp_path)))

    def await_answers(lookahead: float, count: int) -> None:
        client.answers.clear()
        client.spin_until(
            lambda: sum(answer.lookahead == lookahead for answer in client.answers) > count, f"{count} answers"
        )

    await_answers(0.0025, 3)
    for lookahead in (0.0, 0.0025, 0.02, 0.0):
        assert client.set_parameters(lookahead=lookahead) == [""]
        await_answers(lookahead, 20)
    assert client.set_parameters(method="glondu2014") == [""]
    client.spin_until(lambda: "has method:=glondu2014" in simulator.log_text(), "a warning")
    await_answers(0.0, 20)
    log = simulator.log_text()
    words = "have a lookahead of {} s, but this simulation counts on its time step, 0.0025 s"
    assert log.count(words.format("0")) == 2 and log.count(words.format("0.02")) == 1
    assert log.count("a lookahead of") == 3 and log.count("has method:=") == 1
    assert "fast bodies may pass through others. Set the service's parameter lookahead:=0.0025" in log
    assert "but this simulator expects exact: contacts are at samples alone, so bodies whose edges cross may" in log


def test_run_ids_are_random() -> None:
    ids = {random_run_id() for _ in range(40)}
    assert len(ids) == 40 and all(0 < run_id < 2**62 for run_id in ids)
