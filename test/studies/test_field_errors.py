"""Both fields against libigl's distance from independently built surfaces: a sample of benchmarks/field_errors.py."""

from __future__ import annotations

import numpy as np
import pytest
from truth.field_truth import INWARD, NEAR, Said, Truth, ask, igl_closest, make_truth
from worlds.fractured_worlds import FracturedWorld, fractured_world

from fracture_collision.geometry.generators import ball
from fracture_collision.world import Settings

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
