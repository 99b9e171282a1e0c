"""Maximum-distance order: the fast search against the definition, to the last bit, ties included."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from oracles.max_distance_order import order_by_definition, two_furthest

from fracture_collision.core.glondu2014.max_distance_order import max_distance_order
from fracture_collision.core.glondu2014.point_hierarchy import build_point_hierarchy

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


@settings(max_examples=100, deadline=None)
@given(st.integers(2, 400), st.integers(0, 10_000), st.booleans())
def test_ranks_and_parents_follow_the_paper(count: int, seed: int, on_lattice: bool) -> None:
    """Levels by rank; a parent is the nearest of the level above; the furthest two come first."""
    points = np.random.default_rng(seed).uniform(-1, 1, (count, 3))
    if on_lattice:
        points = np.round(points * 3) / 3
    ranks = max_distance_order(points)
    assert tuple(ranks.order[:2]) == two_furthest(points)
    for rank in range(1, count):
        level = int(np.ceil(np.log2(rank + 1)))
        assert ranks.level[rank] == level
        above = points[ranks.order[: 2 ** (level - 1)]]
        nearest = ((above - points[ranks.order[rank]]) ** 2).sum(axis=1)
        assert nearest[ranks.parent[rank]] == nearest.min()


def test_the_order_of_no_points_is_empty() -> None:
    assert [len(column) for column in max_distance_order(np.zeros((0, 3)))] == [0, 0, 0]


@pytest.mark.parametrize("count", [1, 7, 8, 15, 16, 17, 1000])
def test_the_hierarchy_holds_every_point_once(count: int) -> None:
    points = _sphere(count)
    hierarchy = build_point_hierarchy(points)
    assert np.array_equal(np.sort(hierarchy.index), np.arange(count))
    assert np.array_equal(hierarchy.points, points[hierarchy.index])
    for node, (begin, end) in enumerate(zip(hierarchy.begin, hierarchy.end, strict=True)):
        below = hierarchy.points[begin:end]
        assert np.array_equal(hierarchy.box[node], np.concatenate([below.min(axis=0), below.max(axis=0)]))
        assert hierarchy.lowest[node] == hierarchy.index[begin:end].min()
        if 2 * node + 1 < len(hierarchy.begin):
            left, right = 2 * node + 1, 2 * node + 2
            assert (begin, hierarchy.end[left], end) == (
                hierarchy.begin[left], hierarchy.begin[right], hierarchy.end[right],
            )  # fmt: skip
        else:
            assert end - begin <= 16
            assert (np.diff(hierarchy.index[begin:end]) > 0).all()
