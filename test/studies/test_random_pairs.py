"""Random pairs and drops: none is unlisted, missed or false, contacts of rigid bodies part them, and boxes rest."""

from __future__ import annotations

from itertools import islice

import numpy as np
import pytest

from benchmarks.elementary.ours import run
from benchmarks.elementary.scenes import Setting, scene_of
from benchmarks.random_drops import drops, elementary
from benchmarks.random_pairs import EPSILON, Pair, campaign

PAIR = Pair(0.01, 0.02, 0.01, 4, True, 0.0, 1, "box box")


@pytest.mark.parametrize(
    "family", ["triangles", *(pytest.param(name, marks=pytest.mark.slow) for name in ("boxes", "flat fragments"))]
)
def test_pairs_are_listed_parted_and_not_invented(family: str) -> None:
    found = list(campaign(family, 60, 5))
    deep = [pair for pair in found if pair.depth > EPSILON]
    assert len(found) == 60 and len(deep) > 15
    faults = [fault for pair in found for fault in pair.faults]
    # the bound of a shallow pair of fragments speaks of its samples
    allowed = {"beyond"} if family == "flat fragments" else set()
    assert set(faults) <= allowed, [pair for pair in found if pair.faults]


def test_each_fault_is_told_from_the_others() -> None:
    assert PAIR.faults == []
    assert PAIR._replace(is_listed=False, contacts=0).faults == ["unlisted", "missed"]
    assert PAIR._replace(depth=0.03).faults == ["beyond"]
    assert PAIR._replace(depth=0.0).faults == ["false"]
    assert PAIR._replace(left=2.0 * EPSILON).faults == ["not parted"]


def test_boxes_dropped_at_random_rest_on_top_or_beside() -> None:
    made = drops(np.random.default_rng(7))
    for _ in range(4):
        drop = next(made)
        what = elementary(drop)
        assert not list(what.faults(run(scene_of("drop", what, Setting(step=drop.step))))), drop


def test_a_heavy_box_stays_on_a_light_one() -> None:
    """17 kg on 0.6 kg, off centre at 4.3 m/s, at steps of 10 ms."""
    drop = next(islice(drops(np.random.default_rng(1)), 166, None))
    assert drop.step == 0.01 and drop.upper.prod() > 25.0 * drop.lower.prod()
    what = elementary(drop)
    assert not list(what.faults(run(scene_of("drop", what, Setting(step=drop.step)))))


def test_a_campaign_is_repeatable() -> None:
    first, second = (list(campaign("boxes", 5, 3)) for _ in range(2))
    np.testing.assert_equal(first, second)
