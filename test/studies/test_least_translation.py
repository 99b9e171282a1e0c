"""The least translation that satisfies contacts, for known cases; needs no geometry library."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.peers.judging.least_translation import FARTHEST, least_translation

X, Y, Z = np.eye(3)
DEPTH = 0.01


def test_nothing_reported_and_gaps_move_nothing() -> None:
    assert not least_translation(np.zeros((0, 3)), np.zeros(0)).any()
    assert not least_translation(np.array([X, -X]), np.array([-DEPTH, 0.0])).any()


@pytest.mark.parametrize("tilt", [0.0, 0.1 / FARTHEST])
def test_opposing_contacts_are_satisfied_half_way(tilt: float) -> None:
    normals = np.array([X + tilt * Y, -X + tilt * Y]) / np.hypot(1.0, tilt)
    shift = least_translation(normals, np.array([3.0 * DEPTH, DEPTH]))
    assert shift @ X == pytest.approx(DEPTH, rel=0.01)


def test_the_translation_is_the_least_that_satisfies_all_contacts() -> None:
    random = np.random.default_rng(1)
    for _ in range(50):
        normals = random.normal(size=(60, 3)) + 8.0 * X
        normals /= np.linalg.norm(normals, axis=1)[:, None]
        depths = random.uniform(-DEPTH, DEPTH, 60)
        shift = least_translation(normals, depths)
        assert np.min(normals @ shift - depths) > -1e-9
        # Karush-Kuhn-Tucker: the shift is a sum of binding normals with positive weights
        binding = normals @ shift - depths < 1e-9
        weights, *_ = np.linalg.lstsq(normals[binding].T, shift, rcond=None)
        np.testing.assert_allclose(normals[binding].T @ weights, shift, atol=1e-9)
        assert weights.min() > -1e-9
