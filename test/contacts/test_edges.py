"""Crossing edges of two fragments between samples make a contact, with the normal across both."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from truth.contact_truth import COARSE_SHAPES, Poses, pairs_of, sample_ids, surface_samples
from worlds.fractured_worlds import FracturedWorld, fractured_world, with_settings
from worlds.hard_worlds import UPRIGHT, block, tetrahedral_body
from worlds.sampled_worlds import SampledWorld

from fracture_collision.core.bodies.collision_geometry import CollisionGeometry
from fracture_collision.core.edges.ridge_contacts import DEEPEST, RIDGES_EACH
from fracture_collision.core.edges.ridge_crossing import BEYOND_FACE, LEAST_SINE, MATTERS
from fracture_collision.core.edges.ridges import LEAST_LENGTH, LEAST_TURN, LENGTH, OUTWARD, TURN
from fracture_collision.core.memory.pools import LEAF
from fracture_collision.core.mesh.sample_numbers import FIRST_OF_RIDGES
from fracture_collision.core.mesh.surface_triangles import surface_triangles
from fracture_collision.geometry.generators import brick
from fracture_collision.records import ContactConstraintArray, FragmentStates
from fracture_collision.world import CollisionWorld, Settings

EDGES = Settings(threads=1)
KINDS = ["box", "tetrahedra", "triangles"]
# Two rods, edge over edge, far from all of their samples. Turned by 45 degrees about its length, a rod's upper edge is
# at EDGE.
ROD = (2.0, 0.1, 0.1)  # [m] edges
EDGE = 0.05 * np.sqrt(2.0)
OVERLAP = 0.01  # [m] five times epsilon


def normals_of(triangles: np.ndarray) -> np.ndarray:
    normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    return normals / np.linalg.norm(normals, axis=1)[:, None]


def ridges_by_hand(triangles: np.ndarray, radius: float) -> dict[frozenset, float]:
    """Convex edges of a surface (t, 3, 3), by their ends, and the chord of the angle between their faces' normals."""
    normals, known, ridges = normals_of(triangles), {}, {}
    for corners, normal in zip(triangles.tolist(), normals, strict=True):
        for k in range(3):
            p, q, apex = tuple(corners[k]), tuple(corners[(k + 1) % 3]), np.array(corners[(k + 2) % 3])
            if (q, p) not in known:
                known[p, q] = normal
                continue
            other = known.pop((q, p))
            turn, falls = np.linalg.norm(normal - other), other @ (apex - np.array(p))
            if falls < 0.0 and turn >= LEAST_TURN and np.linalg.norm(np.subtract(p, q)) >= LEAST_LENGTH * radius:
                ridges[frozenset((p, q))] = turn
    return ridges


@pytest.fixture(scope="module", params=[("torus", True), ("brick", False), ("l_block", True)], ids=lambda p: p[0])
def case(request) -> FracturedWorld:
    shape, curved = request.param
    return fractured_world(COARSE_SHAPES[shape](), 6, 2, curved=curved, settings=EDGES)


def rows_of(geometry: CollisionGeometry, row: int) -> np.ndarray:
    ridges = geometry.searched.edges
    return ridges.rows[LEAF * ridges.first[row] : LEAF * ridges.first[row] + ridges.count[row]]


def test_ridges_are_the_convex_edges_of_a_surface(case: FracturedWorld) -> None:
    last = max(case.oracle.fragment_ids)  # no neighbour broke since
    triangles, _ = surface_triangles(case.geometry.pools, case.row(last), case.geometry.tet_range(case.row(last)))
    rows, truth = rows_of(case.geometry, case.row(last)), ridges_by_hand(triangles, 1.0)
    found = {frozenset((tuple(r[:3]), tuple(r[3:6]))): r[TURN] for r in rows.tolist()}
    assert len(found) == len(rows) > 10
    assert found.keys() == truth.keys()
    for ends, turn in found.items():
        assert turn == pytest.approx(truth[ends], abs=1e-6)
    np.testing.assert_allclose(np.linalg.norm(rows[:, 3:6] - rows[:, :3], axis=1), rows[:, LENGTH])
    np.testing.assert_allclose(np.linalg.norm(rows[:, OUTWARD : OUTWARD + 3], axis=1), 1.0)


def crossings_by_hand(case, a: int, b: int, states: FragmentStates, near: float) -> dict[int, float]:
    """Every ridge of a against every ridge of b: number and gap of the crossings, regardless of anything else.

    near: the greatest gap [R].
    """
    poses, found = Poses(states), {}
    radius = min(case.geometry.pools.fragment.radius[case.row(f)] for f in (a, b))
    least, near, deepest = MATTERS * EDGES.penetration_tolerance * radius, near * radius, DEEPEST * radius
    of_a, of_b = (rows_of(case.geometry, case.row(f)) for f in (a, b))

    def world(f: int, rows: np.ndarray) -> tuple[np.ndarray, ...]:
        ends = [poses.to_world(f, rows[:, k : k + 3]) for k in (0, 3)]
        return (*ends, *[rows[:, k : k + 3] @ poses.rotation[f].T for k in (6, 9, 12)])

    p, q, p_into, p_into_other, p_out = world(a, of_a)
    r, s, r_into, r_into_other, r_out = world(b, of_b)
    for i in range(len(of_a)):
        matters = np.minimum(of_a[i, LENGTH] * of_b[:, TURN], of_b[:, LENGTH] * of_a[i, TURN]) >= least
        u, v = q[i] - p[i], s - r
        n = np.cross(u, v)
        size = np.linalg.norm(n, axis=1)
        sine = size / (np.linalg.norm(u) * np.linalg.norm(v, axis=1))
        n /= np.where(size > 0.0, size, 1.0)[:, None]
        n *= np.where((n * (p_out[i] - r_out)).sum(axis=1) < 0.0, -1.0, 1.0)[:, None]  # from a to b
        gap = (n * (r - p[i])).sum(axis=1)
        out = (n @ p_into[i] <= BEYOND_FACE) & (n @ p_into_other[i] <= BEYOND_FACE)
        out &= ((n * r_into).sum(axis=1) >= -BEYOND_FACE) & ((n * r_into_other).sum(axis=1) >= -BEYOND_FACE)
        for j in np.flatnonzero(matters & (sine >= LEAST_SINE) & out & (gap <= near) & (gap >= -deepest)):
            k, l, _ = np.linalg.solve(np.column_stack([u, -v[j], -n[j]]), r[j] - p[i])  # noqa: E741
            if 0.0 <= k <= 1.0 and 0.0 <= l <= 1.0:
                found[FIRST_OF_RIDGES + RIDGES_EACH * i + j] = gap[j]
    return found


@pytest.mark.parametrize("jitter", [0.003, 0.02])
def test_listed_crossings_are_those_of_brute_force(case: FracturedWorld, jitter: float) -> None:
    """All crossings with a gap are listed, and no others; overlapping ones may be left out. Gaps are correct."""
    near = 0.01
    world = with_settings(case, EDGES._replace(detection_tolerance=near, contacts_per_pair=1000))
    states = case.states(jitter, 4)
    answer, apart, overlap = world.contacts(states), 0, 0
    listed = pairs_of(answer)
    for a, b in combinations(sorted(states.fragment_ids.tolist()), 2):
        rows, _ = listed.pop((a, b), (slice(0, 0), 0.0))
        gaps = dict(zip(answer.contact_ids[rows].tolist(), answer.gaps[rows].tolist(), strict=True))
        truth = crossings_by_hand(case, a, b, states, near)
        ids = sample_ids(a, b, np.array(list(truth), np.int64)).tolist()
        of_samples = (sample_ids(own, other, surface_samples(case, own)[1]) for own, other in ((a, b), (b, a)))
        assert gaps.keys() <= set(ids).union(*(each.tolist() for each in of_samples))
        for gap, own in zip(truth.values(), ids, strict=True):
            if gap > 0.0:
                apart += 1
                assert own in gaps
            if own in gaps:
                overlap += gap < 0.0
                assert gaps[own] == pytest.approx(gap, abs=1e-9)
    assert not listed and apart > 20 and overlap > 20


def crossed(apart: float, beside: float) -> FragmentStates:
    """Rod 1 along x, rod 2 along y above it, edge over edge, `apart` [m], crossing `beside` [m] both middles."""
    along_x = Rotation.from_euler("x", 45.0, degrees=True)
    along_y = Rotation.from_euler("z", 90.0, degrees=True) * along_x
    positions = [(0.0, 0.0, 0.0), (beside, -beside, 2.0 * EDGE + apart)]
    return FragmentStates(1, 0, [1, 2], positions, [along_x.as_quat(), along_y.as_quat()])


def answer_of_rods(
    kind: str, settings: Settings, states: FragmentStates, made: type[CollisionWorld] = CollisionWorld
) -> ContactConstraintArray:
    world = made(settings)
    for body_id in (1, 2):
        world.add_body(block(kind, body_id, ROD, 0.35))
    return world.contacts(states)


@pytest.mark.parametrize("kind", KINDS)
def test_crossed_rods_have_a_contact_normal_to_both_edges(kind: str) -> None:
    answer = answer_of_rods(kind, EDGES, crossed(-OVERLAP, 0.011))
    (k,) = np.flatnonzero(answer.gaps < 0.0)
    np.testing.assert_allclose(answer.normals[k], [0.0, 0.0, 1.0], atol=1e-12)
    assert answer.gaps[k] == pytest.approx(-OVERLAP, abs=1e-12)
    np.testing.assert_allclose(answer.points_a[k], [0.011, 0.0, EDGE], atol=1e-12)
    np.testing.assert_allclose(answer.points_b[k], [0.011, 0.0, EDGE - OVERLAP], atol=1e-12)


@pytest.mark.parametrize("kind", KINDS)
def test_rods_that_are_about_to_touch_have_a_contact(kind: str) -> None:
    answer = answer_of_rods(kind, EDGES, crossed(0.001, 0.011))
    assert answer.gaps.tolist() == [pytest.approx(0.001, abs=1e-12)]
    assert len(answer_of_rods(kind, EDGES, crossed(0.003, 0.011)).gaps) == 0


@pytest.mark.parametrize("kind", KINDS)
def test_rods_that_will_touch_within_a_step_have_a_contact(kind: str) -> None:
    states = crossed(0.2, 0.011)._replace(
        linear_velocities=np.array([0.0, 0.0, 0.0, 0.0, 0.0, -30.0]), angular_velocities=np.zeros(6)
    )
    answer = answer_of_rods(kind, EDGES._replace(lookahead=0.01), states)
    # the sides of the rods may meet later in the step
    assert answer.gaps.min() == pytest.approx(0.2, abs=1e-9) and (np.sort(answer.gaps)[1:] > 0.25).all()
    np.testing.assert_allclose(answer.normals.reshape(-1, 3), [[0.0, 0.0, 1.0]] * len(answer.gaps), atol=1e-9)
    # samples find nothing until one is inside, and then from the side
    sampled = answer_of_rods(kind, EDGES._replace(lookahead=0.01), states, SampledWorld)
    assert not (np.abs(sampled.normals.reshape(-1, 3)[:, 2]) > 0.9).any()


def test_a_contact_keeps_its_id_while_rods_move() -> None:
    answers = [answer_of_rods("box", EDGES, crossed(-OVERLAP, beside)) for beside in (0.010, 0.011, 0.012)]
    assert len({int(it.contact_ids[np.argmin(it.gaps)]) for it in answers}) == 1


def test_planks_that_cross_flat_hold_each_other_at_their_four_crossings() -> None:
    """There need not be a sample where both outlines cross."""
    world = CollisionWorld(EDGES._replace(contacts_per_pair=100))
    for body_id in (1, 2):
        world.add_body(block("box", body_id, (2.0, 0.18, 0.06)))
    turns = [UPRIGHT, (0.0, 0.0, np.sqrt(0.5), np.sqrt(0.5))]
    answer = world.contacts(FragmentStates(1, 0, [1, 2], [(0.0, 0.0, 0.0), (0.03, 0.02, 0.0599)], turns))
    points = answer.points_a.reshape(-1, 3)
    for x in (-0.06, 0.12):
        for y in (-0.09, 0.09):
            assert np.abs(points - [x, y, 0.03]).max(axis=1).min() < 1e-9
    np.testing.assert_allclose(answer.gaps, -0.0001, atol=1e-12)
    np.testing.assert_allclose(answer.normals.reshape(-1, 3), np.tile([0.0, 0.0, 1.0], (len(points), 1)), atol=1e-12)


def test_ridges_survive_the_removal_of_earlier_bodies() -> None:
    world = CollisionWorld(EDGES)
    for body_id, size in ((1, 0.25), (2, 0.5), (3, 0.25)):
        world.add_body(tetrahedral_body(brick((1.0, 1.0, 0.5), size), body_id))
    world.contacts(FragmentStates(1, 0, [1, 2, 3], np.arange(9.0), [UPRIGHT] * 3))
    geometry = world._registry.geometry
    before = rows_of(geometry, 1).copy(), rows_of(geometry, 2).copy()
    assert len(before[0]) != len(before[1])
    assert geometry.keep_only(np.array([1, 2])).of(np.array([1, 2])).tolist() == [0, 1]
    for row in (0, 1):
        np.testing.assert_array_equal(rows_of(geometry, row), before[row])
