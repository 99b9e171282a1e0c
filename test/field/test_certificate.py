"""missed_depth_bound: no unlisted sample of either fragment lies deeper in the other, without exception."""

from __future__ import annotations

import numpy as np
import pytest
from oracles.fracture_patterns import voronoi_event
from truth.certificate_campaign import Part, campaign
from truth.contact_truth import COARSE_SHAPES, ContactTruth, Poses, check_pair, pairs_of
from worlds.hard_worlds import broken_world
from worlds.sampled_worlds import SampledWorld

from fracture_collision.geometry.generators import brick
from fracture_collision.world import Settings

QUICK = {name: COARSE_SHAPES[name] for name in ("torus", "l_block", "shell")}


def assert_holds(parts: list[Part], pairs: int) -> None:
    assert sum(p.full.pairs + p.budgeted.pairs for p in parts) >= pairs
    assert not [violation for part in parts for violation in part.violations]
    assert sum(p.full.touching for p in parts) > 0 and sum(p.budgeted.touching for p in parts) > 0
    # a budget costs accuracy, which the bound shows
    full, budgeted = (np.concatenate([getattr(p, kind).looseness for p in parts]) for kind in ("full", "budgeted"))
    assert np.median(full) < np.median(budgeted)


def test_the_bound_holds_for_some_pairs() -> None:
    assert_holds(list(campaign(500, 2, QUICK, generations=1)), 500)


@pytest.mark.slow
@pytest.mark.timeout(3600)
def test_the_bound_holds_for_a_hundred_thousand_pairs() -> None:
    assert_holds(list(campaign(100_000, 1)), 100_000)


def test_crack_samples_close_around_an_interior_node_are_not_missed() -> None:
    """A crack 0.0005 R beside a layer of interior nodes: their crack samples lie within epsilon of them."""
    seeds = np.array([[0.0, 0.0, 0.0], [1.001, 0.0, 0.0]])
    makers = [lambda body, first, sequence: voronoi_event(body, 1, seeds, first, sequence)]
    case = broken_world(brick((2.0, 2.0, 2.0), 0.5), makers, Settings(threads=1), SampledWorld)
    states = case.states()._replace(positions=np.array([0.15, 0.0, 0.0, 0.0, 0.0, 0.0]))
    answer, truth = case.world.contacts(states), ContactTruth(case)
    check = check_pair(truth, Poses(states), answer, (2, 3), pairs_of(answer), 0.002)
    assert check.contacts > 0
    assert check.deepest_unlisted <= check.bound
