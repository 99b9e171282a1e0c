"""Maximum-distance order: the fast search against the definition, to the last bit, ties included."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from oracles.max_distance_order import order_by_definition

from fracture_collision.core.glondu2014.max_distance_order import max_distance_order

LATTICE = st.tuples(*[st.integers(-3, 3)] * 3)
FLOAT = st.floats(-1e3, 1e3, allow_subnormal=False)


def _sphere(count: int) -> np.ndarray:
    points = np.random.default_rng(2).normal(size=(count, 3))
    return points / np.linalg.norm(points, axis=1)[:, None]


def _lattice(*counts: int) -> np.ndarray:
    """A shuffled lattice, so that neither hierarchy nor ties follow the indices; no spacing is a binary fraction."""
    axes = np.meshgrid(*[0.1 * np.arange(c) for c in counts], indexing="ij")
    return np.random.default_rng(3).permutation(np.stack(axes, axis=-1).reshape(-1, 3))


CLOUDS = {
    "ball": lambda: _sphere(3000) * np.random.default_rng(4).uniform(0.0, 1.0, (3000, 1)) ** (1 / 3),
    "sphere": lambda: _sphere(3000),
    "symmetric sphere": lambda: np.vstack([_sphere(1000), -_sphere(1000)]),
    "grid": lambda: _lattice(14, 14, 14),
    "coplanar grid": lambda: _lattice(50, 50, 1),
    "collinear": lambda: np.random.default_rng(5).permutation(np.linspace(0.0, 1.0, 2000))[:, None] * [1.0, 2.0, 3.0],
    "duplicates": lambda: _sphere(30)[np.random.default_rng(6).integers(0, 30, 2000)],
    "all one point": lambda: np.ones((2000, 3)),
    "two heaps": lambda: np.eye(3)[np.random.default_rng(7).integers(0, 2, 1800)],
    "bicone": lambda: np.vstack([_sphere(900) * [1, 1, 0], 1e-3 * _sphere(300) + [0, 0, 3], [[0, 0, -3.0]]]),
    "far away": lambda: _sphere(2000) + 1e7,
}  # fmt: skip


def _check(points: np.ndarray) -> None:
    for fast, slow in zip(max_distance_order(points), order_by_definition(points), strict=True):
        assert fast.tolist() == slow.tolist()


@pytest.mark.parametrize("name", CLOUDS)
def test_the_order_of_thousands_of_points_follows_the_definition(name: str) -> None:
    _check(CLOUDS[name]())


@settings(max_examples=150, deadline=None)
@given(st.lists(LATTICE, min_size=1, max_size=120), st.sampled_from([(1, 1, 1), (1, 1, 0), (0, 1, 0)]))
def test_duplicate_collinear_and_coplanar_points(points: list, axes: tuple) -> None:
    _check(np.array(points) * 0.1 * axes)


@settings(max_examples=100, deadline=None)
@given(st.lists(st.tuples(FLOAT, FLOAT, FLOAT), min_size=1, max_size=60))
def test_points_of_any_scale(points: list) -> None:
    _check(np.array(points))


def test_the_order_of_no_points_is_empty() -> None:
    assert [len(column) for column in max_distance_order(np.zeros((0, 3)))] == [0, 0, 0]
