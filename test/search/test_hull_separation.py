"""The separating plane of two fragments' hulls: its bounds are valid, and it is found if one exists."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pytest
from scipy.optimize import linprog
from scipy.spatial.transform import Rotation
from worlds.fractured_worlds import FracturedWorld, fractured_world

from fracture_collision.core.mesh.surface_triangles import surface_triangles
from fracture_collision.core.separation.hull_separation import Hull, parting_plane
from fracture_collision.geometry.generators import ball, shell, torus

TRIES = 60
FAR_ENOUGH = 1e-3  # [m] bodies are of R = 1


@pytest.fixture(scope="module", params=["ball", "ball, curved, thrice", "shell, curved, twice", "torus, twice"])
def case(request) -> FracturedWorld:
    if request.param == "ball":
        return fractured_world(ball(1.0, 0.2), 7)
    if request.param == "torus, twice":
        return fractured_world(torus(0.7, 0.3, 0.2), 6, generations=2)
    if request.param == "shell, curved, twice":
        return fractured_world(shell(1.0, 0.8, 0.25), 7, generations=2, curved=True)
    return fractured_world(ball(1.0, 0.25), 6, generations=3, curved=True)


class Placed(NamedTuple):
    """Two fragments in b's frame: all vertices of their surfaces, and the arguments of parting_plane."""

    a: np.ndarray
    b: np.ndarray
    hulls: tuple[Hull, Hull]
    way: tuple[float, float, float]
    rotation: np.ndarray
    translation: np.ndarray


def placed(case: FracturedWorld, random: np.random.Generator) -> Placed:
    """Two random fragments, their boxes' centres apart by 0.2 to 1.6 times the sum of their mean half sizes."""
    pools = case.geometry.pools
    first, second = (case.row(int(i)) for i in random.choice(case.oracle.fragment_ids, 2, replace=False))
    vertices, hulls, middles = [], [], []
    for row in (first, second):
        corners, _ = surface_triangles(pools, row, case.geometry.tet_range(row))
        vertices.append(corners.reshape(-1, 3))
        tree = slice(pools.fragment.tree_begin[row], pools.fragment.tree_end[row])
        hulls.append(Hull(pools.tree.spheres[tree], pools.tree.entries[tree]))
        middles.append(0.5 * (pools.fragment.box[row, :3] + pools.fragment.box[row, 3:]))
    turn = Rotation.random(random_state=random).as_matrix()
    half = [0.5 * np.ptp(v, axis=0).mean() for v in vertices]
    towards = random.normal(size=3)
    apart = random.uniform(0.2, 1.6) * sum(half) * towards / np.linalg.norm(towards)
    shift = middles[1] + apart - turn @ middles[0]
    rotation, translation = np.array([turn, turn.T]), np.array([shift, -turn.T @ shift])
    return Placed(vertices[0] @ turn.T + shift, vertices[1], (hulls[0], hulls[1]), tuple(apart), rotation, translation)


def found_plane(pair: Placed) -> tuple[np.ndarray, float, float]:
    *normal, low, high = parting_plane(*pair.hulls, pair.way, pair.rotation, pair.translation, FAR_ENOUGH)
    return np.array(normal), low, high


def widest_gap(a: np.ndarray, b: np.ndarray) -> float:
    """Lower bound of the widest gap [m] of all planes between two sets of points; 0 if there is none."""
    n_a, n_b = np.ones((len(a), 1)), np.ones((len(b), 1))
    # n.x >= d + g / 2 for all of a, n.x <= d - g / 2 for all of b, |n| <= 1 by coordinates, g as large as may be
    rows = np.vstack([np.hstack([-a, n_a, 0.5 * n_a]), np.hstack([b, -n_b, 0.5 * n_b])])
    limits = [(-1.0, 1.0)] * 3 + [(None, None), (0.0, None)]
    best = linprog([0.0, 0.0, 0.0, 0.0, -1.0], A_ub=rows, b_ub=np.zeros(len(rows)), bounds=limits)
    length = np.linalg.norm(best.x[:3])
    return float(best.x[4] / length) if length > 0.0 else 0.0


def test_all_points_are_within_the_bounds_of_the_plane(case):
    random = np.random.default_rng(1)
    for _ in range(TRIES):
        pair = placed(case, random)
        normal, low, high = found_plane(pair)
        assert abs(np.linalg.norm(normal) - 1.0) < 1e-12
        assert (pair.a @ normal).min() >= low - 1e-12
        assert (pair.b @ normal).max() <= high + 1e-12
        # and the bounds are tight
        assert (pair.a @ normal).min() <= low + 1e-9
        assert (pair.b @ normal).max() >= high - 1e-9


def test_a_separating_plane_is_found_if_there_is_one(case):
    random = np.random.default_rng(2)
    found, there, none = 0, 0, 0
    for _ in range(TRIES):
        pair = placed(case, random)
        _, low, high = found_plane(pair)
        gap = widest_gap(pair.a, pair.b)
        there += gap > 2.0 * FAR_ENOUGH
        none += gap == 0.0
        if low - high > FAR_ENOUGH:
            found += 1
            assert gap > 0.0
    assert there > 10 and none > 5
    assert found >= 0.95 * there


def test_hulls_with_a_common_centre_have_no_separating_plane(case):
    pools = case.geometry.pools
    row = case.row(int(case.oracle.fragment_ids[0]))
    tree = slice(pools.fragment.tree_begin[row], pools.fragment.tree_end[row])
    hull = Hull(pools.tree.spheres[tree], pools.tree.entries[tree])
    still = np.array([np.eye(3), np.eye(3)]), np.zeros((2, 3))
    for way in ((0.0, 0.0, 0.0), (1e-300, 0.0, 0.0), (0.1, 0.2, 0.3)):
        *_, low, high = parting_plane(hull, hull, way, *still, 0.0)
        assert low <= high
