"""Whole recorded runs: the same answers, byte for byte, whatever is remembered from step to step."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.frames.measure import is_busy, ours
from benchmarks.frames.recording import record
from fracture_collision.world import Settings

REMEMBERED, SEARCHED = Settings(threads=2), Settings(threads=1, neighbour_lists=False)


@pytest.mark.parametrize(
    "scene",
    [
        "pane", "pane@0.25",
        *[pytest.param(scene, marks=pytest.mark.slow) for scene in ("plates", "bricks@0.25", "drop_bunnies", "vase")],
    ],
)  # fmt: skip
def test_answers_of_a_whole_run(scene: str) -> None:
    recording = record(scene)
    remembered, searched = ours(recording, REMEMBERED, again=True), ours(recording, SEARCHED)
    assert remembered.digest == searched.digest
    assert len(remembered.query) == len(recording.steps) and (remembered.query > 0.0).all()
    assert np.array_equal(remembered.update > 0.0, [bool(step.events) for step in recording.steps])
    assert not np.isnan(remembered.again).any() and np.isnan(searched.again).all()
    assert is_busy(recording).any() or scene == "pane"  # which falls apart slowly
