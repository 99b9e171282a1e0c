"""Small samples of the studies of errors: both fields against libigl's distance, and whole recorded runs."""

from __future__ import annotations

import hashlib

import numpy as np
import pytest
from truth.field_truth import INWARD, NEAR, Said, Truth, ask, igl_closest, make_truth
from worlds.fractured_worlds import FracturedWorld, fractured_world

from benchmarks.frames.errors import errors_of
from benchmarks.frames.measure import is_busy, ours, tell
from benchmarks.frames.recording import Recording, record
from fracture_collision.geometry.generators import ball
from fracture_collision.world import CollisionWorld, Settings

RADIUS, POINTS = 1.0, 3000
TOLERANCE = 1e-9  # of R
# The averaged field guarantees no error. To detect changes, twice its results on this mesh and these fractures:
# mean error [R] at uniform points; the same at points less than 2 % R from the surface; share of steps inwards,
# ending before the middle, on which the depth falls.
LIMITS = {"flat": (0.026, 0.0025, 0.11), "curved": (0.025, 0.0031, 0.13)}


class Sample:
    def __init__(self, cracks: str) -> None:
        settings = Settings(threads=1, method="glondu2014")
        self.case: FracturedWorld = fractured_world(ball(1.0, 0.4), 3, 2, cracks == "curved", settings)
        self.cracks = cracks
        self.truth: Truth = make_truth(self.case, POINTS, RADIUS, seed=5)
        self.exact: Said = ask(self.case, self.truth, "exact", RADIUS)
        self.averaged: Said = ask(self.case, self.truth, "averaged", RADIUS)


@pytest.fixture(scope="module", params=["flat", "curved"])
def sample(request: pytest.FixtureRequest) -> Sample:
    made = Sample(request.param)
    assert len(made.truth.points) > 0.8 * POINTS and made.truth.is_uniform.sum() > 0.4 * POINTS
    return made


def test_the_surfaces_of_the_truth_close_around_their_points(sample: Sample) -> None:
    assert sample.truth.open_by <= 1e-9


def test_the_exact_field_equals_the_distance_of_libigl(sample: Sample) -> None:
    assert np.abs(sample.exact.depth - sample.truth.depth).max() <= TOLERANCE
    witnesses = sample.truth.points + RADIUS * sample.exact.depth[:, None] * sample.exact.outward
    for fragment in np.unique(sample.truth.fragments).tolist():
        own = sample.truth.fragments == fragment
        surface = sample.case.oracle.surface_triangles(fragment)
        assert igl_closest(witnesses[own], surface)[0].max() <= TOLERANCE * RADIUS


def test_the_exact_field_has_a_slope_of_at_most_one(sample: Sample) -> None:
    for rise in (sample.exact.rise, sample.exact.true_rise):
        assert np.nanmax(np.abs(rise)) <= INWARD + TOLERANCE
    # straight away from the surface depth grows by the step length, up to the middle, which is far from most points
    assert np.isclose(sample.exact.true_rise, INWARD, rtol=0.0, atol=TOLERANCE).mean() > 0.7


def test_errors_of_the_averaged_field_stay_within_the_measured_ones(sample: Sample) -> None:
    truth, said = sample.truth, sample.averaged
    most, most_near, most_falls = LIMITS[sample.cracks]
    error = np.abs(said.depth - truth.depth)
    assert 0.001 < error[truth.is_uniform].mean() <= most  # it differs from the exact field
    assert error[truth.depth < NEAR].mean() <= most_near
    before_middle = truth.is_uniform & (sample.exact.true_rise > 0.5 * INWARD)
    assert (said.true_rise < 0.0)[before_middle].mean() <= most_falls


def test_the_certain_depth_of_the_averaged_field_never_exceeds_the_true_depth(sample: Sample) -> None:
    assert (sample.averaged.most - sample.truth.depth).min() >= -1e-12


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


@pytest.mark.slow
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
