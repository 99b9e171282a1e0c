"""Whole recorded runs: the same answers, byte for byte, with and without memory between steps; and their errors."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.frames.errors import errors_of
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
    assert is_busy(recording).any() or scene.startswith("pane")  # it falls apart slowly


def test_errors_at_steps_of_a_run() -> None:
    recording = record("piggy_bank@0.25")
    (own,) = errors_of(recording, REMEMBERED, {}, count=2)
    assert (own.scene, own.method, own.steps) == ("piggy_bank@0.25", "ours", 2)
    assert own.pairs >= own.penetrating + own.apart and own.apart > 0
    assert own.missed <= own.penetrating and own.false == 0
    # the worst pair: an edge through a thin piece
    assert 0.0 <= own.remaining_mean <= own.remaining_worst and own.remaining_mean < 0.1
    assert 0.0 <= own.unnecessary_mean < 1.0
    assert own == errors_of(recording, SEARCHED, {}, count=2)[0]
