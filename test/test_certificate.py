"""missed_depth_bound: no sample of either fragment lies deeper in the other without being listed. Not once."""

from __future__ import annotations

import numpy as np
import pytest
from certificate_campaign import Part, campaign
from contact_truth import COARSE_SHAPES

QUICK = {name: COARSE_SHAPES[name] for name in ("torus", "l_block", "shell")}


def assert_holds(parts: list[Part], pairs: int) -> None:
    assert sum(p.full.pairs + p.budgeted.pairs for p in parts) >= pairs
    assert not [violation for part in parts for violation in part.violations]
    assert sum(p.full.touching for p in parts) > 0 and sum(p.budgeted.touching for p in parts) > 0
    # a budget has its price, and the bound says so
    full, budgeted = (np.concatenate([getattr(p, kind).looseness for p in parts]) for kind in ("full", "budgeted"))
    assert np.median(full) < np.median(budgeted)


def test_the_bound_holds_for_some_pairs() -> None:
    assert_holds(list(campaign(500, 2, QUICK, generations=1)), 500)


@pytest.mark.slow
@pytest.mark.timeout(3600)
def test_the_bound_holds_for_a_hundred_thousand_pairs() -> None:
    assert_holds(list(campaign(100_000, 1)), 100_000)
