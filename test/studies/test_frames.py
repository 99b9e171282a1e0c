"""Whole recorded runs: the same answers, byte for byte, with and without memory between steps; and their errors."""

from __future__ import annotations

import hashlib

import numpy as np
import pytest

from benchmarks.frames.errors import errors_of
from benchmarks.frames.measure import is_busy, ours, tell
from benchmarks.frames.recording import Recording, record
from fracture_collision.world import CollisionWorld, Settings

TWO_THREADS, ONE_THREAD = Settings(threads=2), Settings(threads=1)


def digest_without_memory(recording: Recording) -> str:
    """As of `ours`, of a world that forgets each answer."""
    world, sha = CollisionWorld(ONE_THREAD), hashlib.sha256()
    for step in recording.steps:
        tell(world, step)
        world.forget()
        for field in world.contacts(step.states):
            sha.update(np.asarray(field).tobytes())
    return sha.hexdigest()


@pytest.mark.parametrize(
    "scene",
    [
        "pane", "pane@0.25",
        *[pytest.param(scene, marks=pytest.mark.slow) for scene in ("plates", "bricks@0.25", "drop_bunnies", "vase")],
    ],
)  # fmt: skip
def test_answers_of_a_whole_run(scene: str) -> None:
    recording = record(scene)
    remembered, once = ours(recording, TWO_THREADS, again=True), ours(recording, ONE_THREAD)
    assert remembered.digest == once.digest == digest_without_memory(recording)
    assert len(remembered.query) == len(recording.steps) and (remembered.query > 0.0).all()
    assert np.array_equal(remembered.update > 0.0, [bool(step.events) for step in recording.steps])
    assert not np.isnan(remembered.again).any() and np.isnan(once.again).all()
    assert is_busy(recording).any() or scene.startswith("pane")  # it falls apart slowly


def test_errors_at_steps_of_a_run() -> None:
    recording = record("piggy_bank@0.25")
    (own,) = errors_of(recording, TWO_THREADS, {}, count=2)
    assert (own.scene, own.method, own.steps) == ("piggy_bank@0.25", "ours", 2)
    assert own.pairs >= own.penetrating + own.apart and own.apart > 0
    assert own.missed <= own.penetrating and own.false == 0
    # the worst pair: an edge through a thin piece
    assert 0.0 <= own.remaining_mean <= own.remaining_worst and own.remaining_mean < 0.1
    assert 0.0 <= own.unnecessary_mean < 1.0
    assert own == errors_of(recording, ONE_THREAD, {}, count=2)[0]
