"""Inspection of a world against the slow oracles: spheres, the field on a plane, the errors of an answer."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest
from oracles.corner_samples import corner_samples
from truth.contact_truth import BORDER, COARSE_SHAPES, ContactTruth, Poses, check_all_pairs, pairs_of, piled
from worlds.fractured_worlds import SETTINGS, fractured_world, with_settings

from fracture_collision.records import BOX, SPHERE, CollisionBody, FragmentStates, SolidPrimitive
from fracture_collision.world import CollisionWorld, PaperSettings, Settings
from fracture_collision.world.inspection import (
    NOBODY,
    PLANE_AXES,
    asked_with,
    errors_of,
    every_contact,
    field_on_plane,
    reach_along,
    spheres_of_level,
)

TRUE = SETTINGS._replace(detection_tolerance=0.0)


@pytest.fixture(scope="module", params=["flat", "curved"])
def truth(request: pytest.FixtureRequest) -> ContactTruth:
    return ContactTruth(
        fractured_world(COARSE_SHAPES["l_block"](), seeds=5, generations=2, curved=request.param == "curved")
    )


def samples_of(truth: ContactTruth, fragment: int) -> np.ndarray:
    """(n, 3) [m] the oracle's samples: the fragment's mesh nodes, its cut edges' crossings, and where cracks meet."""
    oracle = truth.case.oracle
    points = list(oracle.vertices[oracle.labels == fragment])
    for ends, plane in oracle.planes.items():
        if fragment in oracle.labels[list(ends)]:
            a, b = oracle.vertices[list(ends)]
            points.append(a + (plane[3] - plane[:3] @ a) / (plane[:3] @ (b - a)) * (b - a))
    # a neighbour's later crack adds corners to this fragment's border; keep only those that the fragment samples
    paper = truth.case.geometry.paper
    assert paper is not None
    known = set(paper.sphere_tree(truth.case.row(fragment)).sample.tolist())
    return np.array([*points, *(point for k, point in corner_samples(oracle, fragment).items() if k in known)])


def within(points: np.ndarray, centres: np.ndarray, radii: np.ndarray) -> np.ndarray:
    distances = np.linalg.norm(points[:, None] - centres, axis=2)
    return (distances <= radii + 1e-9).any(axis=1)


def test_spheres_of_a_level_contain_all_samples_and_shrink_with_the_level(truth: ContactTruth) -> None:
    world = truth.case.world
    here = world.present(truth.case.states())
    samples = {f: samples_of(truth, f) for f in truth.fragment_ids}
    counts, last = [], None
    level = 0
    while last is None or level <= last.deepest:
        spheres = spheres_of_level(world, here, level)
        assert set(spheres.fragment_ids.tolist()) == set(truth.fragment_ids)
        for fragment in truth.fragment_ids:
            own = spheres.fragment_ids == fragment
            assert within(samples[fragment], spheres.centres[own], spheres.radii[own]).all()
            if last is not None:  # lower levels lie within
                above = last.fragment_ids == fragment
                assert within(spheres.centres[own], last.centres[above], last.radii[above]).all()
        counts.append(len(spheres.radii))
        last, level = spheres, level + 1
    assert counts[0] == len(truth.fragment_ids) and np.all(np.diff(counts) > 0)
    assert not last.radii.any()
    # the deepest level is the samples themselves
    for fragment in truth.fragment_ids:
        leaves = last.centres[last.fragment_ids == fragment]
        assert within(leaves, samples[fragment], np.zeros(len(samples[fragment]))).all()
    beyond = spheres_of_level(world, here, last.deepest + 5)
    assert np.array_equal(beyond.centres, last.centres)


@pytest.mark.parametrize("axis", range(3))
def test_the_field_on_a_plane_equals_the_oracles(truth: ContactTruth, axis: int) -> None:
    world, states = truth.case.world, piled(truth, 4 + axis, 0.4)
    poses, here = Poses(states), truth.case.world.present(states)
    low, high = reach_along(world, here, axis)
    place = 0.4 * low + 0.6 * high
    found = field_on_plane(world, here, axis, place, finest=40)
    assert (found.axis, found.place) == (axis, place) and max(found.owners.shape) == 40
    rows, columns = found.owners.shape
    across, up = PLANE_AXES[axis]
    # two extra cells on each side, which must be empty
    column, row = np.meshgrid(np.arange(-2, columns + 2) + 0.5, np.arange(-2, rows + 2) + 0.5)
    points = np.full((*row.shape, 3), place)
    points[..., across], points[..., up] = found.corner[0] + found.cell * column, found.corner[1] + found.cell * row
    depths, certain = [], np.ones(row.shape, dtype=bool)
    for fragment in truth.fragment_ids:
        one = truth.depths_of(fragment, poses.to_body(fragment, points.reshape(-1, 3)))
        depths.append(one.depth.reshape(row.shape))
        certain &= one.certain.reshape(row.shape)
    depths = np.array(depths)
    inside, deepest = (depths > 0.0).sum(axis=0), depths.max(axis=0)
    ring = np.ones(row.shape, dtype=bool)
    ring[2:-2, 2:-2] = False
    assert not inside[ring & certain].any()
    within, certain = (slice(2, -2),) * 2, certain[2:-2, 2:-2]
    expected = np.where(inside[within] > 0, np.array(truth.fragment_ids)[depths.argmax(axis=0)][within], NOBODY)
    assert certain.mean() > 0.95
    assert np.array_equal(found.owners[certain], expected[certain])
    assert np.abs(found.depths - np.maximum(deepest[within], 0.0))[certain].max() < BORDER
    assert np.array_equal(found.shared[certain], inside[within][certain] > 1)
    # guards against a vacuous comparison
    assert (expected != NOBODY).sum() > 50 and found.shared.any() and len(np.unique(expected)) > 3


def test_shapes_without_a_mesh_are_on_the_plane_and_the_ground_is_not() -> None:
    world = CollisionWorld(TRUE)
    world.add_body(CollisionBody(1, 1, plane=np.array([0.0, 0.0, 1.0, 5.0]), is_static=True))
    world.add_body(CollisionBody(2, 2, primitive=SolidPrimitive(BOX, (2.0, 2.0, 2.0)), is_static=True))
    nothing = world.present(FragmentStates(0, 0, np.zeros(0, int), np.zeros(0), np.zeros(0)))
    assert reach_along(world, nothing, 0) is None and field_on_plane(world, nothing, 0, 0.0) is None
    world.add_body(CollisionBody(3, 3, primitive=SolidPrimitive(SPHERE, (0.5,))))
    turned = np.array([0.0, 0.0, np.sqrt(0.5), np.sqrt(0.5)])
    here = world.present(FragmentStates(1, 0, np.array([3]), np.array([1.2, 0.1, 0.0]), turned))
    assert reach_along(world, here, 0) == pytest.approx((0.7, 1.7))
    found = field_on_plane(world, here, 2, 0.1, finest=30)
    x, y = (found.corner[k] + found.cell * (np.arange(30) + 0.5) for k in range(2))
    x, y = np.meshgrid(x, y)
    of_box = np.minimum(np.minimum(1.0 - np.abs(x), 1.0 - np.abs(y)), 0.9)
    of_ball = 0.5 - np.sqrt((x - 1.2) ** 2 + (y - 0.1) ** 2 + 0.1**2)
    expected = np.where(of_ball > of_box, 3, 2)
    expected[np.maximum(of_ball, of_box) <= 0.0] = NOBODY
    assert np.array_equal(found.owners, expected) and {NOBODY, 2, 3} == set(np.unique(expected).tolist())
    assert np.allclose(found.depths, np.maximum(np.maximum(of_ball, of_box), 0.0), atol=1e-12)
    assert np.array_equal(found.shared, (of_ball > 0.0) & (of_box > 0.0))
    assert field_on_plane(world, here, 2, 0.9) is None  # intersects only the box
    assert not len(spheres_of_level(world, here, 0).radii)  # the box is static, a ball has no tree
    world.add_body(CollisionBody(4, 4, primitive=SolidPrimitive(BOX, (2.0, 2.0, 1.0))))
    here = world.present(FragmentStates(2, 0, np.array([3, 4]), np.zeros(6), np.tile(turned, 2)))
    spheres = spheres_of_level(world, here, 0)
    assert spheres.fragment_ids.tolist() == [4]
    assert within(np.array([[x, y, 0.5] for x in (-1, 1) for y in (-1, 1)]), spheres.centres, spheres.radii).all()


@pytest.mark.parametrize(
    "settings",
    [
        SETTINGS, SETTINGS._replace(contacts_per_pair=1, penetration_tolerance=0.02),
        SETTINGS._replace(max_work=200), SETTINGS._replace(paper=PaperSettings()),
        SETTINGS._replace(contacts_per_pair=4, penetration_tolerance=0.0, detection_tolerance=0.0),
    ],
    ids=["defaults", "few", "limited", "averaged", "all that penetrate"],
)  # fmt: skip
def test_errors_of_an_answer_equal_those_by_brute_force(truth: ContactTruth, settings: Settings) -> None:
    states = piled(truth, 11, 0.3)
    asked = with_settings(truth.case, settings)
    answer, checks = asked.contacts(states), check_all_pairs(truth, states, asked)
    world = with_settings(truth.case, TRUE)
    every = every_contact(world, states)
    errors = errors_of(answer, every, world, world.present(states), settings.penetration_tolerance)
    assert errors.listed == sum(check.contacts for check in checks) > 0
    poses, inside, unlisted, listed = Poses(states), 0, 0.0, pairs_of(answer)
    for (a, b), check in zip(combinations(sorted(truth.fragment_ids), 2), checks, strict=True):
        inside += sum(np.count_nonzero(truth.depths(*pair, poses).depth >= 0.0) for pair in ((a, b), (b, a)))
        rows, _ = listed.get((a, b), (slice(0, 0), 0.0))
        if check.deepest_unlisted > (-answer.gaps[rows]).max(initial=0.0) + BORDER:
            unlisted = max(unlisted, check.deepest_unlisted)
    assert errors.colliding == inside > 50
    assert errors.unlisted == pytest.approx(unlisted, abs=BORDER)
    # the bound of a pair that the answer leaves out is epsilon
    bounds = [check.bound for check in checks if check.is_listed or check.deepest_unlisted > 0.0]
    assert errors.unlisted <= errors.promised == pytest.approx(max(bounds), abs=BORDER)
    if settings.max_work == 200:
        assert errors.unlisted > 1e-3  # [R]


def test_inspection_with_other_settings_keeps_those_of_the_world(truth: ContactTruth) -> None:
    states = piled(truth, 2, 0.3)
    world = with_settings(truth.case, TRUE)
    before = world.contacts(states)
    few = asked_with(world, states, contacts_per_pair=1, penetration_tolerance=0.05)
    assert len(few.gaps) < len(before.gaps) <= len(every_contact(world, states).gaps)
    other = with_settings(truth.case, TRUE._replace(contacts_per_pair=1, penetration_tolerance=0.05)).contacts(states)
    assert np.array_equal(few.contact_ids, other.contact_ids) and np.array_equal(few.gaps, other.gaps)
    assert world.settings == TRUE
    assert np.array_equal(world.contacts(states).contact_ids, before.contact_ids)
