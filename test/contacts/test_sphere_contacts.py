"""Every contact of a sphere with another surface: against each triangle in turn.

The slow twin gets shared corners and edges from the triangles' indices: a nearest point counts if no triangle that
contains it is nearer to the centre.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import numpy as np
import pytest
from oracles.brute_force import distances_to_triangles
from truth.contact_truth import sample_ids
from worlds.fractured_worlds import fractured_world
from worlds.gate_world import rigid
from worlds.rigid_shapes import RigidShape, boundary_of, box_of_quads, hollow_box, noisy_ball, torus, true_distance

from fracture_collision.core.search import scratch
from fracture_collision.geometry.generators import TetGeometry, ball, bowl, l_block, shell
from fracture_collision.records import (
    BUDGET_EXHAUSTED,
    SPHERE,
    CollisionBody,
    ContactConstraintArray,
    FragmentStates,
    SolidPrimitive,
)
from fracture_collision.world import CollisionWorld, Settings

SETTINGS = Settings(threads=1)
BALL = 1000
ROUNDING = 1e-9
Solid = Callable[[np.ndarray], np.ndarray]  # points (n, 3) to bools: inside


def room() -> RigidShape:
    """Floor z = 0, walls x = 0 and y = 0, each 1 m thick and 4 m wide, in one body."""
    solid = np.ones((2, 2, 2), bool)
    solid[1, 1, 1] = False
    steps = np.array([-1.0, 0.0, 4.0])
    return box_of_quads(steps, steps, steps, solid)


def groove(half: float = 0.6) -> RigidShape:
    """A block with a groove along x: floor z = 0, sides y = -half and y = half."""
    solid = np.ones((1, 3, 2), bool)
    solid[0, 1, 1] = False
    return box_of_quads(np.array([-2.0, 2.0]), np.array([-2.0, -half, half, 2.0]), np.array([-1.0, 0.0, 1.0]), solid)


def world_of(shape: RigidShape, radius: float, tetrahedra: np.ndarray | None = None, **settings) -> CollisionWorld:
    mesh = {} if tetrahedra is None else {"triangles": np.zeros(0, np.uint32), "tetrahedra": tetrahedra.ravel()}
    return world_with(radius, rigid(1, shape, **mesh), **settings)


def world_with(radius: float, *bodies: CollisionBody, **settings) -> CollisionWorld:
    world = CollisionWorld(SETTINGS._replace(**settings))
    for body in (*bodies, CollisionBody(2, BALL, primitive=SolidPrimitive(SPHERE, (radius,)))):
        world.add_body(body)
    return world


def answer_at(world: CollisionWorld, center, step: int = 1) -> ContactConstraintArray:
    center = np.asarray(center, float)
    return world.contacts(
        FragmentStates(step, 0, np.array([1, BALL]), np.append(np.zeros(3), center), np.tile([0.0, 0.0, 0.0, 1.0], 2))
    )


@cache
def ids_on_ball(other: int) -> np.ndarray:
    """In order, what the contacts of the sphere's own point may be called."""
    return np.sort(sample_ids(BALL, other, np.arange(-1, 1_000_000)))


def places_of(answer: ContactConstraintArray, center: np.ndarray, radius: float, other: int = 1) -> np.ndarray:
    """Witnesses (n, 3) on the other body, for contacts whose own point is on the sphere, by id."""
    table = ids_on_ball(other)
    own = table[np.searchsorted(table, answer.contact_ids).clip(max=len(table) - 1)] == answer.contact_ids
    on_ball = answer.points_b.reshape(-1, 3)[own]
    assert np.allclose(np.linalg.norm(on_ball - center, axis=1), radius, atol=1e-12)
    return answer.points_a.reshape(-1, 3)[own]


def true_places(corners: np.ndarray, is_solid: Solid, center: np.ndarray, reach: float) -> np.ndarray:
    """Points (n, 3) of the surface of triangles (t, 3, 3) within `reach` [m] that are locally nearest to a centre.

    The centre is outside, and they face it.
    """
    distance, feet = distances_to_triangles(center, corners)
    lowest = []
    for t in np.flatnonzero(distance <= reach):
        nearer = corners[distance < distance[t] - ROUNDING]
        if not (distances_to_triangles(feet[t], nearer)[0] < ROUNDING).any():
            lowest.append(t)
    towards = (center - feet[lowest]) / distance[lowest, None]
    found: list[np.ndarray] = []
    for foot in feet[lowest][~is_solid(feet[lowest] + 1e-5 * towards)]:
        if not any(np.linalg.norm(foot - p) < 1e-4 for p in found):
            found.append(foot)
    return np.array(found).reshape(-1, 3)


def assert_same_places(found: np.ndarray, truth: np.ndarray) -> None:
    apart = np.linalg.norm(found[:, None] - truth[None], axis=2)
    assert len(found) == len(truth)
    assert (apart.min(axis=1, initial=np.inf) < 1e-6).all() and (apart.min(axis=0, initial=np.inf) < 1e-6).all()


@pytest.mark.parametrize(
    ("shape", "center", "gaps"),
    [
        (room(), (0.47, 2.0, 0.48), [-0.03, -0.02]),
        (room(), (0.47, 0.49, 0.48), [-0.03, -0.02, -0.01]),
        (room(), (2.0, 2.1, 0.48), [-0.02]),
        (groove(), (0.1, 0.0, 0.46), [-0.04]),
        (groove(0.48), (0.1, 0.01, 0.46), [-0.04, -0.03, -0.01]),
    ],
    ids=["corner", "three faces", "floor", "wide groove", "groove"],
)  # fmt: skip
def test_each_face_has_its_contact(shape: RigidShape, center, gaps) -> None:
    answer = answer_at(world_of(shape, 0.5), center)
    assert np.allclose(np.sort(answer.gaps), gaps, atol=1e-12)
    assert answer.missed_depth_bound[0] < 1e-9 and answer.status == 0
    assert len(places_of(answer, np.array(center), 0.5)) == len(gaps)


def assert_places_are_those_of_brute_force(
    world: CollisionWorld, shape: RigidShape, radius: float, centers: np.ndarray, least: int
) -> None:
    """At the `centers` near the surface; at `least` this many of them have several contacts."""
    several = 0
    for center in centers:
        distance = true_distance(shape, center[None])[0]
        if not 0.0 < distance < radius:
            continue
        found = places_of(answer_at(world, center), center, radius)
        truth = true_places(shape.corners, lambda x: true_distance(shape, x) < 0.0, center, radius * 1.002)
        assert_same_places(found, truth)
        several += len(truth) > 1
    assert several >= least


@pytest.mark.parametrize("as_tetrahedra", [False, True])
@pytest.mark.parametrize(
    ("body", "concave"),
    [
        (l_block((2.0, 1.6, 0.6), (1.2, 0.9), 0.25), 0), (bowl(2.0, 0.2, 0.35, 0.6), 1), (shell(1.0, 0.8, 0.5), 1),
        (ball(1.0, 0.4), 0),
    ],
    ids=["l", "bowl", "shell", "ball"],
)  # fmt: skip
def test_sphere_contacts_equal_those_of_brute_force(body: TetGeometry, concave: int, as_tetrahedra: bool) -> None:
    shape = boundary_of(body)
    whole = RigidShape(body.vertices, body.tetrahedra) if as_tetrahedra else shape
    world = world_of(whole, 0.35, body.tetrahedra if as_tetrahedra else None, contacts_per_pair=1000)
    centers = np.random.default_rng(2).uniform(-0.9, 0.9, (25, 3))
    assert_places_are_those_of_brute_force(world, shape, 0.35, centers, concave)


def test_sphere_contacts_on_a_jagged_surface() -> None:
    """Convex and concave edges and corners, many of them within reach at once."""
    shape, directions = noisy_ball(), np.random.default_rng(4).normal(size=(15, 3))
    centers = 1.25 * directions / np.linalg.norm(directions, axis=1)[:, None]
    assert_places_are_those_of_brute_force(world_of(shape, 0.4, contacts_per_pair=1000), shape, 0.4, centers, 3)


@pytest.mark.parametrize("curved", [False, True])
def test_sphere_contacts_on_fragments(curved: bool) -> None:
    """In the gap between separated fragments: contacts on both sides, on crack and old surface."""
    case = fractured_world(ball(1.0, 0.4), seeds=4, generations=2, curved=curved)
    world = world_with(0.3, *case.messages[0], contacts_per_pair=1000)
    for event in case.messages[1]:
        world.add_fracture(event)
    ids, touched = case.oracle.fragment_ids, 0
    for center in np.random.default_rng(7).uniform(-0.8, 0.8, (12, 3)):
        answer = world.contacts(
            FragmentStates(
                1, case.generations, np.append(ids, BALL), np.append(np.zeros(3 * len(ids)), center),
                np.tile([0.0, 0.0, 0.0, 1.0], len(ids) + 1),
            )
        )  # fmt: skip
        for fragment in ids:
            def is_solid(points: np.ndarray, fragment: int = fragment) -> np.ndarray:
                return case.oracle.owner(points) == fragment

            if is_solid(center[None])[0]:
                continue
            truth = true_places(case.oracle.surface_triangles(fragment), is_solid, center, 0.3 * 1.002)
            assert_same_places(places_of(answer, center, 0.3, fragment), truth)
            touched += len(truth)
    assert touched >= 10


def test_the_bound_covers_contacts_omitted_within_a_hollow_sphere() -> None:
    """Hundreds of facets within reach; the deeper ones are listed, and eight of the others, far apart."""
    shape = boundary_of(shell(1.0, 0.8, 0.25))
    reach = 0.79
    center = np.array([0.01, 0.02, -0.005])
    truth = true_places(shape.corners, lambda x: true_distance(shape, x) < 0.0, center, reach * 1.002)
    depth = reach - np.linalg.norm(truth - center, axis=1)
    assert len(truth) > 50
    answer = answer_at(world_of(shape, reach), center)
    all_of_them = places_of(answer, center, reach)
    is_deep = depth > 0.002 * reach
    assert is_deep.sum() > 16 == len(all_of_them)
    assert (np.linalg.norm(truth[:, None] - all_of_them, axis=2).min(axis=0) < 1e-6).all()
    few = answer_at(world_of(shape, reach, penetration_tolerance=0.1), center)
    chosen = places_of(few, center, reach)
    assert len(chosen) == 8
    bound = few.missed_depth_bound[few.fragment_b == BALL][0]
    listed = np.linalg.norm(truth[:, None] - chosen, axis=2).min(axis=1) < 1e-6
    # the samples of the shell count for the bound too
    assert listed.sum() == 8 and depth[~listed].max() <= bound <= 0.1 * reach + ROUNDING
    along = (chosen - center) / np.linalg.norm(chosen - center, axis=1)[:, None]
    assert (along @ along.T - 2.0 * np.eye(8)).max() < 0.7  # 45 degrees apart


@pytest.mark.parametrize("room", [2, 100, 200])
def test_the_bound_holds_if_few_triangles_are_tested(room: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(scratch, "MOST_WITHIN", room)
    shape, radius, center = boundary_of(shell(1.0, 0.8, 0.25)), 0.79, np.array([0.03, 0.05, -0.04])
    answer = answer_at(world_of(shape, radius), center)
    found = places_of(answer, center, radius)
    truth = true_places(shape.corners, lambda x: true_distance(shape, x) < 0.0, center, radius * 1.002)
    apart = np.linalg.norm(truth[:, None] - found, axis=2).min(axis=1)
    depth = radius - np.linalg.norm(truth - center, axis=1)
    assert answer.status == BUDGET_EXHAUSTED
    assert 1 <= len(found) < len(truth)
    assert apart[np.argmax(depth)] < 1e-6
    assert depth[apart > 1e-6].max() <= answer.missed_depth_bound[0]


def test_a_point_of_hundreds_of_triangles_is_one_contact_at_most() -> None:
    """A cone of 600 facets is convex: a sphere has one contact with it, wherever it is, with one id at the apex."""
    count = 600
    angle = np.arange(count) * 2.0 * np.pi / count
    ring = np.column_stack((np.cos(angle), np.sin(angle), np.zeros(count)))
    vertices = np.vstack((ring, [(0.0, 0.0, 1.0), (0.0, 0.0, 0.0)]))
    i, after = np.arange(count), (np.arange(count) + 1) % count
    sides = np.column_stack((i, after, np.full(count, count)))
    base = np.column_stack((after, i, np.full(count, count + 1)))
    world = world_of(RigidShape(vertices, np.vstack((sides, base))), 0.3)
    ids = sample_ids(BALL, 1, np.arange(-1, 2 * count))
    at_apex = set()
    for turn in (0.001, 0.7, 1.9, 2.8, 4.1, 5.6):
        around = np.array([np.cos(turn), np.sin(turn), 0.0])
        center = np.array([0.0, 0.0, 1.296]) + 0.03 * around
        answer = answer_at(world, center)
        assert len(places_of(answer, center, 0.3)) == 1
        at_apex |= set(answer.contact_ids[np.isin(answer.contact_ids, ids)].tolist())
        # beside the apex, which is within reach, too
        center = np.array([0.0, 0.0, 0.9995]) + 0.0005 * around + 0.299 / np.sqrt(2.0) * (around + [0.0, 0.0, 1.0])
        assert len(places_of(answer_at(world, center), center, 0.3)) == 1, turn
    assert len(at_apex) == 1


def test_contact_ids_stay_with_the_face() -> None:
    """Regardless of whether wall or floor is deeper, and of other contacts."""
    world, ids = world_of(room(), 0.5), []
    for center in ((0.47, 2.0, 0.48), (0.48, 2.01, 0.47), (0.47, 1.99, 0.6), (0.47, 0.49, 0.48)):
        answer = answer_at(world, center)
        wall = np.abs(answer.normals.reshape(-1, 3)[:, 0]) == 1.0
        ids.append(answer.contact_ids[wall])
        assert len(set(answer.contact_ids.tolist())) == len(answer.gaps)
    assert len(np.unique(np.concatenate(ids))) == 1


def test_contact_ids_do_not_depend_on_other_bodies() -> None:
    shape = boundary_of(ball(1.0, 0.4))
    answers = []
    for others in ((), (torus(), hollow_box())):
        world = world_with(0.5, *(rigid(i, other) for i, other in enumerate(others, 10)), rigid(1, shape))
        answers.append(answer_at(world, (0.3, 0.9, 1.0)))
    assert len(answers[0].gaps) >= 1
    assert answers[0].contact_ids.tolist() == answers[1].contact_ids.tolist()
