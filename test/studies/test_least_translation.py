"""The least translation that satisfies contacts, for known cases; needs no geometry library."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.peers.judging.least_translation import FARTHEST, least_translation

X, Y, Z = np.eye(3)
DEPTH = 0.01


def test_one_contact_moves_along_its_normal() -> None:
    np.testing.assert_allclose(least_translation(X[None], np.array([DEPTH])), DEPTH * X, atol=1e-15)


def test_nothing_reported_and_gaps_move_nothing() -> None:
    assert not least_translation(np.zeros((0, 3)), np.zeros(0)).any()
    assert not least_translation(np.array([X, -X]), np.array([-DEPTH, 0.0])).any()


def test_redundant_contacts_change_nothing() -> None:
    tilted = (X + 0.1 * Y) / np.linalg.norm(X + 0.1 * Y)
    normals, depths = np.array([X, X, X, tilted]), np.array([0.5 * DEPTH, DEPTH, 0.9 * DEPTH, 0.2 * DEPTH])
    np.testing.assert_allclose(least_translation(normals, depths), DEPTH * X, atol=1e-12)


@pytest.mark.parametrize("half_angle", [10.0, 45.0, 80.0])
def test_a_wedge_needs_both_normals(half_angle: float) -> None:
    angle = np.deg2rad(half_angle)
    normals = np.array([np.cos(angle) * X + np.sin(angle) * Y, np.cos(angle) * X - np.sin(angle) * Y])
    np.testing.assert_allclose(
        least_translation(normals, np.array([DEPTH, DEPTH])), DEPTH / np.cos(angle) * X, atol=1e-12
    )


def test_a_corner_needs_three() -> None:
    np.testing.assert_allclose(least_translation(np.eye(3), DEPTH * np.array([1, 2, 3])), DEPTH * np.array([1, 2, 3]))


def test_a_gap_limits_the_translation() -> None:
    # the second may move back by DEPTH only, so it slides sideways
    normals = np.array([(X + Y) / np.sqrt(2.0), -X])
    shift = least_translation(normals, np.array([4.0 * DEPTH, -DEPTH]))
    assert normals @ shift == pytest.approx([4.0 * DEPTH, -DEPTH], abs=1e-12)


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
