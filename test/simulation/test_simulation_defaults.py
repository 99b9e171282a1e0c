"""Scenes that everybody tries first, at the defaults of what simulates."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from fracture_collision.bag.reader import recorded_settings
from fracture_collision.cli.bags import record
from fracture_collision.lockstep import Lockstep
from fracture_collision.simulation.scene.scene import Scene, parse_scene

BAR = {"brick": {"size_xyz": [0.2, 0.02, 0.02], "edge_length": 0.2}}  # one cell
ACROSS = {"brick": {"size_xyz": [0.02, 0.2, 0.02], "edge_length": 0.2}}


def scene_of(bodies: list[dict], duration: float) -> Scene:
    wood = {"density": 700.0, "friction": 0.5}
    content = {"time_step": 0.0025, "duration": duration, "materials": {"wood": wood}}
    return parse_scene(content | {"bodies": [{"material": "wood", **body} for body in bodies]}, "first")


def crossed_bars() -> Scene:
    """A bar falls across another that is fixed."""
    return scene_of(
        [
            {"name": "fixed", "static": True, "shape": BAR, "position": [0.0, 0.0, 0.0]},
            {"name": "across", "shape": ACROSS, "position": [0.0, 0.0, 0.05]},
        ], duration=0.5,
    )  # fmt: skip


def test_crossed_bars_of_one_cell_do_not_pass_through_each_other() -> None:
    with Lockstep(crossed_bars()) as run:
        heights = [exchange.states.positions.reshape(-1, 3)[exchange.states.fragment_ids == 2, 2] for exchange in run]
    assert min(np.concatenate(heights)) > 0.0198
    assert abs(heights[-1][0] - 0.02) < 1e-4, "it rests"


@pytest.mark.parametrize("speed", [50.0, 200.0])
def test_a_fast_ball_does_not_pass_through_a_pane(speed: float) -> None:
    pane = {"name": "pane", "static": True, "shape": {"box": {"size": [0.5, 0.5, 0.004]}}}
    ball = {"name": "ball", "shape": {"sphere": {"radius": 0.01}}, "position": [0.013, 0.0, 0.3]}
    with Lockstep(scene_of([pane, ball | {"linear_velocity": [0.0, 0.0, -speed]}], duration=0.05)) as run:
        heights = [exchange.states.positions.reshape(-1, 3)[-1, 2] for exchange in run]
    assert min(heights) > 0.0


def test_record_looks_ahead_by_a_step_of_the_scene(tmp_path: Path) -> None:
    done = CliRunner().invoke(record, ["pane", "--steps", "12", "--out", str(tmp_path / "bag")])
    assert done.exit_code == 0, done.output
    assert recorded_settings(tmp_path / "bag").values["lookahead"] == 0.0025
