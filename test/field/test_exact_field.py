"""The `exact` field equals brute force to 1e-9 R, at a sample of points, and in the slow campaign at a million.

So do masses.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pytest
from oracles.brute_force import Partition, distances, owners, partition_of
from oracles.fragmented_body import uniform_points
from truth.contact_truth import COARSE_SHAPES, SHAPES
from worlds.fractured_worlds import DENSITY, FracturedWorld, after_each_fracture, fractured_world

from fracture_collision.core.field.elementary_queries import INSIDE, NEAR, probe
from fracture_collision.core.search.scratch import make_scratch
from fracture_collision.geometry.tetrahedra import tetrahedron_volumes

TOLERANCE = 1e-9  # of R = 1 m
NEAR_OUTSIDE = 0.05  # [m] distances outside a fragment are compared up to this
CAMPAIGN_POINTS, CAMPAIGN_GENERATIONS = 1_050_000, 5
CASES = [(shape, cracks) for shape in SHAPES for cracks in ("flat", "curved")]


class Compared(NamedTuple):
    inside: int  # points whose depth in their owner was compared
    outside: int  # points whose distance to another fragment was compared
    wrong_owner: int
    worst: float  # [m] largest error of either


def compare(case: FracturedWorld, count: int, seed: int) -> Compared:
    """Compares the field at `count` random points of the body, half of them close to cracks and old surface."""
    random = np.random.default_rng(seed)
    oracle = case.oracle
    partition = partition_of(oracle)
    near = _near_surfaces(case, partition, count // 2, random)
    points = np.concatenate((uniform_points(oracle.vertices, oracle.tetrahedra, count - count // 2, random), near))
    owner, certain = owners(partition, points)
    # on a face whose two tetrahedra give the point different owners, either is right
    points, owner = points[certain], owner[certain]
    assert len(points) > 0.998 * count
    stranger = random.choice(oracle.fragment_ids, len(points))
    scratch, pools = make_scratch(len(oracle.tetrahedra), 8), case.geometry.pools
    inside = outside = wrong = 0
    worst = 0.0
    for fragment in oracle.fragment_ids:
        row, surface = case.row(fragment), oracle.surface_triangles(fragment)
        own = points[owner == fragment]
        answers = [probe(pools, row, tuple(p), 0.0, np.inf, scratch)[:2] for p in own.tolist()]
        wrong += sum(status != INSIDE for status, _ in answers)
        depth = -np.array([distance for _, distance in answers])
        worst = max(worst, np.abs(depth - distances(own, surface)).max(initial=0.0))
        inside += len(own)
        others = points[(stranger == fragment) & (owner != fragment)]
        answers = [probe(pools, row, tuple(p), NEAR_OUTSIDE, np.inf, scratch)[:2] for p in others.tolist()]
        wrong += sum(status == INSIDE for status, _ in answers)
        distance, true = np.array([d for _, d in answers]), distances(others, surface)
        is_near = np.array([status == NEAR for status, _ in answers], dtype=bool)
        assert np.array_equal(is_near, true <= NEAR_OUTSIDE)
        worst = max(worst, np.abs(distance - true)[is_near].max(initial=0.0))
        outside += int(is_near.sum())
    return Compared(inside, outside, wrong, worst)


def _near_surfaces(
    case: FracturedWorld, partition: Partition, count: int, random: np.random.Generator
) -> np.ndarray:
    """Points of the body 1e-6 to 0.1 m from a polygon of some fragment."""
    triangles = np.concatenate([case.oracle.surface_triangles(f) for f in case.oracle.fragment_ids])
    area = np.linalg.norm(np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]), axis=1)
    found = np.zeros((0, 3))
    while len(found) < count:
        chosen = triangles[random.choice(len(triangles), 2 * count, p=area / area.sum())]
        on_them = np.einsum("nij,ni->nj", chosen, random.dirichlet(np.ones(3), 2 * count))
        away = random.normal(size=(2 * count, 3))
        away *= 10.0 ** random.uniform(-6, -1, (2 * count, 1)) / np.linalg.norm(away, axis=1)[:, None]
        points = on_them + away
        found = np.concatenate((found, points[owners(partition, points)[0] > 0]))
    return found[:count]


def assert_equal(done: Compared) -> None:
    assert done.wrong_owner == 0 and done.worst <= TOLERANCE, done
    assert done.inside > 0 and done.outside > 0


@pytest.fixture(scope="module", params=[c for c in CASES if c[0] in COARSE_SHAPES], ids="-".join)
def case(request) -> FracturedWorld:
    shape, cracks = request.param
    return fractured_world(COARSE_SHAPES[shape](), seeds=3, generations=2, curved=cracks == "curved", seed=8)


def test_the_exact_field_is_exact_at_a_sample_of_points(case: FracturedWorld) -> None:
    assert_equal(compare(case, 1700, seed=1))


def test_masses_equal_the_oracles_and_add_up(case: FracturedWorld) -> None:
    registry = case.world.fragments()
    volume = tetrahedron_volumes(case.oracle.vertices, case.oracle.tetrahedra).sum()
    assert registry.masses.sum() == pytest.approx(DENSITY * volume, rel=1e-12)
    radius = 0.5 * np.ptp(case.oracle.vertices, axis=0).max()
    for i, fragment in enumerate(registry.fragment_ids.tolist()):
        mass, center, inertia = case.oracle.mass_properties(fragment, DENSITY)
        assert registry.masses[i] == pytest.approx(mass, rel=1e-9)
        assert np.allclose(registry.centers_of_mass[i], center, atol=1e-9 * radius)
        xx, xy, xz, yy, yz, zz = registry.inertias[i]
        own = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        assert np.allclose(own, inertia, atol=1e-9 * mass * radius**2)


@pytest.mark.slow
@pytest.mark.timeout(1800)
@pytest.mark.parametrize(("shape", "cracks"), CASES)
def test_the_exact_field_is_exact_at_a_million_points(shape: str, cracks: str) -> None:
    case = fractured_world(SHAPES[shape](), seeds=6, generations=CAMPAIGN_GENERATIONS, curved=cracks == "curved")
    points = CAMPAIGN_POINTS // (len(CASES) * CAMPAIGN_GENERATIONS)
    done = [compare(stage, points, seed=stage.generations) for stage in after_each_fracture(case)]
    print(shape, cracks, *done, sep="\n")
    assert sum(d.inside for d in done) * len(CASES) >= 1_000_000
    for part in done:
        assert_equal(part)
