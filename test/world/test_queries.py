"""Rays, closest points, containment and contacts of chosen pairs, beside brute force over all triangles."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pytest
from oracles.brute_force import nearest_on_triangles
from scipy.spatial.transform import Rotation
from worlds.fractured_worlds import fractured_world
from worlds.gate_world import record_bytes
from worlds.rigid_shapes import boundary_of, cube, torus

from fracture_collision.geometry.generators import ball
from fracture_collision.records import SolidPrimitive
from fracture_collision.world import (
    BOX,
    SPHERE,
    CollisionBody,
    CollisionWorld,
    FragmentStates,
    InvalidMessage,
    Settings,
)

TORUS, BLOCK, MARBLE, GROUND = 50, 51, 52, 53
GROUND_AT = -2.0


class Placed(NamedTuple):
    """A world of all kinds of bodies: pieces of a ball broken twice along curved cracks, far apart and turned."""

    world: CollisionWorld
    states: FragmentStates
    triangles: dict[int, np.ndarray]  # (t, 3, 3) [m] world, of all but the marble and the ground
    oracle: object
    poses: dict[int, tuple[Rotation, np.ndarray]]

    def local(self, fragment: int, points: np.ndarray) -> np.ndarray:
        turn, place = self.poses[fragment]
        return turn.inv().apply(points - place)


@pytest.fixture(scope="module")
def placed() -> Placed:
    case = fractured_world(ball(0.5, 0.2), 5, 2, curved=True, settings=Settings(threads=1))
    world, hoop = case.world, torus()
    for number, body in (
        (TORUS, {"vertices": hoop.vertices, "triangles": hoop.triangles}),
        (BLOCK, {"primitive": SolidPrimitive(BOX, (0.4, 0.6, 0.2))}),
        (MARBLE, {"primitive": SolidPrimitive(SPHERE, (0.3,))}),
        (GROUND, {"plane": (0.0, 0.0, 1.0, -GROUND_AT), "is_static": True}),
    ):
        world.add_body(CollisionBody(number, number, density=1000.0, **body))
    ids = [*case.oracle.fragment_ids, TORUS, BLOCK, MARBLE]
    random = np.random.default_rng(1)
    turns, places = Rotation.random(len(ids), random_state=random), random.uniform(-1.2, 1.2, (len(ids), 3))
    middle, size = cube().vertices.mean(axis=0), np.ptp(cube().vertices, axis=0)
    block = (cube().corners - middle) * [0.4, 0.6, 0.2] / size
    shapes = {i: case.oracle.surface_triangles(i) for i in case.oracle.fragment_ids}
    shapes |= {TORUS: hoop.corners, BLOCK: block}
    poses = {i: (turns[k], places[k]) for k, i in enumerate(ids)}
    triangles = {
        i: (poses[i][0].apply(shape.reshape(-1, 3)) + poses[i][1]).reshape(-1, 3, 3) for i, shape in shapes.items()
    }
    states = FragmentStates(2, 2, np.array(ids), places, turns.as_quat())
    return Placed(world, states, triangles, case.oracle, poses)


def along(origins: np.ndarray, directions: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Distances (n,) to the first of triangles (t, 3, 3): Moeller, Trumbore 1997, over all of them."""
    p, u, v = triangles[:, 0], triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    out = np.empty(len(origins))
    for r, (o, d) in enumerate(zip(origins, directions, strict=True)):
        h = np.cross(d, v)
        with np.errstate(divide="ignore", invalid="ignore"):
            f = 1.0 / (u * h).sum(axis=1)
            s = f * ((o - p) * h).sum(axis=1)
            q = np.cross(o - p, u)
            t, w = f * (v * q).sum(axis=1), f * (q @ d)
            met = (s >= 0.0) & (w >= 0.0) & (s + w <= 1.0) & (t >= 0.0)
        out[r] = t[met].min(initial=np.inf)
    return out


def first_hits(placed: Placed, origins: np.ndarray, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Distances (n,) and fragments (n,) of the first hits, -1: none."""
    ids, found = list(placed.triangles), [along(origins, directions, each) for each in placed.triangles.values()]
    center = placed.poses[MARBLE][1]
    middle = ((center - origins) * directions).sum(axis=1)
    square = 0.3**2 - ((center - origins) ** 2).sum(axis=1) + middle**2
    half = np.sqrt(np.maximum(square, 0.0))
    entry = np.where(middle - half >= 0.0, middle - half, middle + half)
    found.append(np.where((square >= 0.0) & (entry >= 0.0), entry, np.inf))
    ground = (GROUND_AT - origins[:, 2]) / directions[:, 2]
    found.append(np.where(ground >= 0.0, ground, np.inf))
    table = np.array(found)
    nearest = table.min(axis=0)
    return nearest, np.where(np.isfinite(nearest), np.array([*ids, MARBLE, GROUND])[table.argmin(axis=0)], -1)


def test_rays_meet_what_brute_force_meets(placed: Placed) -> None:
    random = np.random.default_rng(2)
    origins = random.uniform(-1.8, 1.8, (2000, 3))
    directions = random.normal(size=(2000, 3))
    unit = directions / np.linalg.norm(directions, axis=1)[:, None]
    hits = placed.world.cast_rays(placed.states, origins, directions)
    distances, fragments = first_hits(placed, origins, unit)
    assert len(np.unique(fragments)) == len(placed.triangles) + 3  # all, and nothing
    np.testing.assert_array_equal(hits.fragment_ids, fragments)
    np.testing.assert_allclose(hits.distances, distances, rtol=0.0, atol=1e-9)
    met = fragments >= 0
    np.testing.assert_allclose(np.linalg.norm(hits.normals[met], axis=1), 1.0, rtol=1e-12)
    assert not hits.normals[~met].any()
    # outward: a step along the normal leaves the fragment
    for i in np.unique(fragments[met]):
        own = np.flatnonzero(fragments == i)
        points = origins[own] + distances[own, None] * unit[own]
        for side, inside in ((1e-6, False), (-1e-6, True)):
            at = placed.world.contains(placed.states, int(i), points + side * hits.normals[own])
            assert (at == inside).mean() > 0.99  # not at edges


def test_no_ray_slips_through_between_two_triangles() -> None:
    """Rays through corners and middles of sides to the middle of a ball, at any angle."""
    mesh = ball(0.5, 0.2)
    world, turns = CollisionWorld(Settings(threads=1)), Rotation.random(20, random_state=6)
    world.add_body(CollisionBody(1, 1, vertices=mesh.vertices, tetrahedra=mesh.tetrahedra, density=1000.0))
    triangles = boundary_of(mesh).corners
    points = np.vstack((triangles.reshape(-1, 3), 0.5 * (triangles + np.roll(triangles, 1, axis=1)).reshape(-1, 3)))
    for turn in turns:
        states, there = FragmentStates(1, 0, [1], np.zeros((1, 3)), turn.as_quat()[None]), turn.apply(points)
        hits = world.cast_rays(states, 3.0 * there, -there)
        assert (hits.fragment_ids == 1).all()
        np.testing.assert_allclose(hits.distances, 2.0 * np.linalg.norm(points, axis=1), rtol=0.0, atol=1e-9)


def test_closest_points_are_those_of_all_triangles(placed: Placed) -> None:
    points = np.random.default_rng(3).uniform(-2.0, 2.0, (700, 3))
    for i, triangles in placed.triangles.items():
        near = np.vstack((points, triangles.mean(axis=1) + 1e-3, triangles.mean(axis=(0, 1))[None]))
        found = placed.world.closest_points(placed.states, i, near)
        distances, nearest = nearest_on_triangles(near, triangles)
        np.testing.assert_allclose(np.abs(found.distances), distances, rtol=0.0, atol=1e-9)
        np.testing.assert_allclose(np.linalg.norm(near - found.points, axis=1), distances, rtol=0.0, atol=1e-9)
        np.testing.assert_allclose(
            found.points + found.distances[:, None] * found.normals, near, rtol=0.0, atol=1e-9
        )
        np.testing.assert_array_equal(found.distances < 0.0, placed.world.contains(placed.states, i, near))


def test_a_point_of_a_body_is_in_one_of_its_fragments(placed: Placed) -> None:
    """In place, the slow oracle says in which."""
    ids = np.array(placed.oracle.fragment_ids)
    states = FragmentStates(3, 2, ids, np.zeros((len(ids), 3)), np.tile([0.0, 0.0, 0.0, 1.0], (len(ids), 1)))
    points = np.random.default_rng(4).uniform(-0.5, 0.5, (3000, 3))
    owner = placed.oracle.owner(points)
    for i in ids:
        np.testing.assert_array_equal(placed.world.contains(states, int(i), points), owner == i)


def test_a_marble_and_the_ground_have_closed_forms(placed: Placed) -> None:
    points = np.random.default_rng(5).uniform(-3.0, 3.0, (50, 3))
    for i, distances in (
        (MARBLE, np.linalg.norm(points - placed.poses[MARBLE][1], axis=1) - 0.3), (GROUND, points[:, 2] - GROUND_AT),
    ):  # fmt: skip
        found = placed.world.closest_points(placed.states, i, points)
        np.testing.assert_allclose(found.distances, distances, atol=1e-12)
        np.testing.assert_array_equal(placed.world.contains(placed.states, i, points), distances <= 0.0)


def test_contacts_of_chosen_pairs_are_those_of_all(placed: Placed) -> None:
    ids = np.array(placed.oracle.fragment_ids)
    states = FragmentStates(4, 2, ids, np.zeros((len(ids), 3)), np.tile([0.0, 0.0, 0.0, 1.0], (len(ids), 1)))
    every = list(placed.world.contacts(states).pairs())
    assert len(every) > 4
    chosen = every[::2]
    asked = [(pair.b, pair.a) if k % 2 else (pair.a, pair.b) for k, pair in enumerate(chosen)]
    some = list(placed.world.contacts(states, pairs=asked).pairs())
    assert len(some) == len(chosen)
    for one, other in zip(chosen, some, strict=True):
        assert record_bytes(one) == record_bytes(other)
        np.testing.assert_allclose(((one.points_b - one.points_a) * one.normals).sum(axis=1), one.gaps, atol=1e-12)
    assert not placed.world.contacts(states, pairs=np.empty((0, 2), int))
    # what is remembered of all pairs is still there
    assert len(list(placed.world.contacts(states).pairs())) == len(every) and placed.world.last_visits == 0


@pytest.mark.parametrize(
    ("ask", "words"),
    [
        (lambda w, s: w.contains(s, 99, np.zeros((1, 3))), "fragment_id: 99 does not take part"),
        (lambda w, s: w.closest_points(s, TORUS, [[0.0, np.nan, 0.0]]), "points: entry 1 is nan"),
        (lambda w, s: w.cast_rays(s, np.zeros((2, 3)), np.eye(3)), "directions: 3 for 2 origins"),
        (lambda w, s: w.cast_rays(s, np.zeros((2, 3)), [[1.0, 0.0, 0.0], [0.0, 0.0, 0.0]]), "ray 1 has a direction of"),
        (lambda w, s: w.contacts(s, pairs=[[TORUS, 99]]), "pairs: fragment 99 does not take part"),
    ],
)
def test_nonsense_is_rejected_with_an_explanation(placed: Placed, ask, words: str) -> None:
    with pytest.raises(InvalidMessage, match=words):
        ask(placed.world, placed.states)


def test_a_fragment_touches_what_a_closer_look_says(placed: Placed) -> None:
    """Where it touches it is as near as it says, and before it is apart from all."""
    world, states = placed.world, placed.states
    random, touched = np.random.default_rng(7), 0
    movers = [i for i in placed.oracle.fragment_ids if free(world, states, i)]
    for i in movers * 4:
        way = random.normal(0.0, 2.0, 3)
        found = world.sweep(states, i, way)
        k, others = states.fragment_ids.tolist().index(i), [j for j in (*placed.triangles, MARBLE, GROUND) if j != i]
        for share in (1.0,) if found.share == np.inf else (found.share, 0.5 * found.share, 0.98 * found.share):
            moved = states._replace(positions=states.positions.copy())
            moved.positions[k] += share * way
            distances = world.distance(moved, [(i, j) for j in others]).distances
            if share == found.share:
                assert others[int(np.argmin(distances))] == found.fragment_id
                assert -1e-12 < distances.min() <= 1e-7
            else:
                assert distances.min() > 0.0
        touched += found.share < np.inf
    assert touched > 4


def free(world: CollisionWorld, states: FragmentStates, fragment: int) -> bool:
    others = [j for j in (*states.fragment_ids, GROUND) if j != fragment]
    return world.distance(states, [(fragment, j) for j in others]).distances.min() > 0.0


def test_a_box_that_is_swept_touches_where_arithmetic_says() -> None:
    world = CollisionWorld(Settings(threads=1))
    world.add_body(CollisionBody(1, 1, density=1.0, primitive=SolidPrimitive(BOX, (0.2, 0.2, 0.2))))
    world.add_body(CollisionBody(2, 2, density=1.0, primitive=SolidPrimitive(SPHERE, (0.1,))))
    world.add_body(CollisionBody(3, 3, plane=(0.0, 0.0, 1.0, 0.0), is_static=True))
    places, upright = np.array([[0.0, 0.0, 0.6], [1.0, 0.0, 0.6]]), np.tile([0.0, 0.0, 0.0, 1.0], (2, 1))
    states = FragmentStates(1, 0, [1, 2], places, upright)
    for mover, way, share, other, normal in (
        (1, [0.0, 0.0, -2.0], 0.25, 3, [0.0, 0.0, 1.0]), (1, [3.0, 0.0, 0.0], 0.8 / 3.0, 2, [-1.0, 0.0, 0.0]),
        (2, [-1.0, 0.0, -0.1], 0.8, 1, [1.0, 0.0, 0.0]), (1, [0.0, 0.0, -0.4], np.inf, -1, [0.0, 0.0, 0.0]),
        (1, [0.0, 3.0, 0.0], np.inf, -1, [0.0, 0.0, 0.0]),
    ):  # fmt: skip
        found = world.sweep(states, mover, way)
        assert found.share == pytest.approx(share, abs=1e-6) and found.fragment_id == other
        np.testing.assert_allclose(found.normal, normal, atol=1e-3)
    inside = states._replace(positions=[[0.0, 0.0, 0.6], [0.1, 0.0, 0.6]])
    assert world.sweep(inside, 1, [1.0, 0.0, 0.0]).share == 0.0
    for fragment, way, words in ((1, [0.0, 0.0, 0.0], "way: needs one"), (3, [1.0, 0.0, 0.0], "3 is an unbounded")):
        with pytest.raises(InvalidMessage, match=words):
            world.sweep(states, fragment, way)


def test_boxes_overlap_what_is_cut_off_by_their_sides(placed: Placed) -> None:
    """The slow twin cuts each triangle off at the six sides of a box; small boxes lie inside fragments, too."""
    random = np.random.default_rng(8)
    inner = [triangles.mean(axis=(0, 1)) for triangles in placed.triangles.values()]
    middles = np.vstack((random.uniform(-1.5, 1.5, (150, 3)), inner))
    halves = random.uniform(0.005, 0.2, (len(middles), 3))
    boxes = np.hstack((middles - halves, middles + halves))
    found = placed.world.overlaps(placed.states, boxes)
    assert np.array_equal(np.lexsort((found.fragment_ids, found.boxes)), np.arange(len(found.boxes)))
    pairs = set(zip(found.boxes.tolist(), found.fragment_ids.tolist(), strict=True))
    expected = set()
    for b, (low, high) in enumerate(zip(boxes[:, :3], boxes[:, 3:], strict=True)):
        for i, triangles in placed.triangles.items():
            near = ((triangles.min(axis=1) <= high) & (triangles.max(axis=1) >= low)).all(axis=1)
            is_in = placed.world.contains(placed.states, i, middles[b][None])[0]
            if is_in or any(is_left(triangle, low, high) for triangle in triangles[near]):
                expected.add((b, i))
        if np.linalg.norm(np.clip(placed.poses[MARBLE][1], low, high) - placed.poses[MARBLE][1]) <= 0.3:
            expected.add((b, MARBLE))
        if low[2] <= GROUND_AT:
            expected.add((b, GROUND))
    assert pairs == expected and len(expected) > 40 and {i for _, i in expected} >= set(placed.triangles)
    everything = placed.world.overlaps(placed.states, [[-9.0, -9.0, -9.0, 9.0, 9.0, 9.0]])
    assert set(everything.fragment_ids.tolist()) == {*placed.triangles, MARBLE, GROUND}
    with pytest.raises(InvalidMessage, match="box 0 has its lower corner"):
        placed.world.overlaps(placed.states, [[1.0, 0.0, 0.0, 0.0, 1.0, 1.0]])


def is_left(triangle: np.ndarray, low: np.ndarray, high: np.ndarray) -> bool:
    """Whether anything is left of a triangle that is cut off at the sides of a box: Sutherland, Hodgman 1974."""
    polygon = list(triangle)
    for axis in range(3):
        for sign, limit in ((1.0, high[axis]), (-1.0, -low[axis])):
            kept = []
            for p, q in zip(polygon, polygon[1:] + polygon[:1], strict=True):
                d, e = limit - sign * p[axis], limit - sign * q[axis]
                if d >= 0.0:
                    kept.append(p)
                if (d >= 0.0) != (e >= 0.0):
                    kept.append(p + d / (d - e) * (q - p))
            polygon = kept
            if not polygon:
                return False
    return True


def test_nothing_is_an_answer(placed: Placed) -> None:
    world, none = placed.world, np.empty((0, 3))
    assert len(world.cast_rays(placed.states, none, none).distances) == 0
    assert len(world.closest_points(placed.states, TORUS, none).distances) == 0
    empty = CollisionWorld(Settings(threads=1))
    hits = empty.cast_rays(FragmentStates(1, 0, [], none, np.empty((0, 4))), np.zeros((1, 3)), [[1.0, 0.0, 0.0]])
    assert hits.fragment_ids.tolist() == [-1] and hits.distances[0] == np.inf


def test_distances_are_those_of_all_triangles(placed: Placed) -> None:
    pairs = [(a, b) for a in placed.triangles for b in placed.triangles if a != b]
    found = placed.world.distance(placed.states, pairs)
    table = dict(zip(pairs, found.distances.tolist(), strict=True))
    for (a, b), d, p, q in zip(pairs, *found, strict=True):
        one, other = placed.triangles[a], placed.triangles[b]
        on_one, on_other = nearest_on_triangles(p[None], one)[0], nearest_on_triangles(q[None], other)[0]
        assert on_one[0] < 1e-9 and on_other[0] < 1e-9
        assert d == pytest.approx(table[b, a], abs=1e-9)
        if d > 0.0:
            assert d == pytest.approx(np.linalg.norm(p - q), abs=1e-12)
            assert a > b or d == pytest.approx(slow_distance(one, other), abs=1e-9)
    assert 10 < (found.distances > 0.0).sum() < len(pairs)


def slow_distance(one: np.ndarray, other: np.ndarray) -> float:
    """Of surfaces of triangles (t, 3, 3): between corners and faces, and between the insides of sides."""
    to_other = nearest_on_triangles(one.reshape(-1, 3), other)[0].min()
    to_one = nearest_on_triangles(other.reshape(-1, 3), one)[0].min()
    p, q = (np.unique(sides_of(t), axis=0) for t in (one, other))
    u, v = (p[:, 1] - p[:, 0])[:, None], (q[:, 1] - q[:, 0])[None]
    w = p[:, None, 0] - q[None, :, 0]
    a, b, e = (u * u).sum(axis=2), (u * v).sum(axis=2), (v * v).sum(axis=2)
    c, f = (u * w).sum(axis=2), (v * w).sum(axis=2)
    with np.errstate(divide="ignore", invalid="ignore"):
        s, t = (b * f - c * e) / (a * e - b * b), (a * f - b * c) / (a * e - b * b)
        inside = (s >= 0.0) & (s <= 1.0) & (t >= 0.0) & (t <= 1.0)
    away = np.linalg.norm((w + s[..., None] * u - t[..., None] * v)[inside], axis=1)
    return float(min(to_other, to_one, away.min(initial=np.inf)))


def sides_of(triangles: np.ndarray) -> np.ndarray:
    """Sides (s, 2, 3) of triangles (t, 3, 3), each once, from its lexicographically smaller end."""
    ends = np.stack((triangles, np.roll(triangles, -1, axis=1)), axis=2).reshape(-1, 2, 3)
    is_turned = [tuple(first) > tuple(second) for first, second in ends.tolist()]
    ends[is_turned] = ends[is_turned][:, ::-1]
    return ends


def test_distances_of_two_boxes_balls_and_the_ground() -> None:
    world = CollisionWorld(Settings(threads=1))
    half = (0.2, 0.2, 0.2)
    for number, body in (
        (1, {"primitive": SolidPrimitive(BOX, half)}), (2, {"primitive": SolidPrimitive(BOX, half)}),
        (3, {"primitive": SolidPrimitive(SPHERE, (0.1,))}), (4, {"primitive": SolidPrimitive(SPHERE, (0.1,))}),
        (5, {"plane": (0.0, 0.0, 1.0, 0.0), "is_static": True}),
        (6, {"plane": (0.0, 0.0, 1.0, 1.0), "is_static": True}),
    ):  # fmt: skip
        world.add_body(CollisionBody(number, number, density=1000.0, **body))
    places = [[0.0, 0.0, 0.1], [0.5, 0.05, 0.15], [0.0, 0.0, 0.5], [0.0, 0.05, 0.5]]
    states = FragmentStates(1, 0, [1, 2, 3, 4], places, np.tile([0.0, 0.0, 0.0, 1.0], (4, 1)))
    pairs = [(1, 2), (1, 3), (3, 2), (3, 4), (1, 5), (5, 3), (2, 5)]
    found = world.distance(states, pairs)
    corner = np.linalg.norm([0.4, 0.0, 0.25]) - 0.1
    np.testing.assert_allclose(found.distances, [0.3, 0.2, corner, -0.15, 0.0, 0.4, 0.05], atol=1e-12)
    np.testing.assert_allclose(found.points_a[5], [0.0, 0.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(found.points_b[5], [0.0, 0.0, 0.4], atol=1e-12)
    with pytest.raises(InvalidMessage, match="5 and 6 are unbounded planes"):
        world.distance(states, [(5, 6)])


def test_a_fragment_inside_another_overlaps_it() -> None:
    world = CollisionWorld(Settings(threads=1))
    for number, size in ((1, 1.0), (2, 0.1)):
        world.add_body(CollisionBody(number, number, density=1000.0, primitive=SolidPrimitive(BOX, (size, size, size))))
    states = FragmentStates(1, 0, [1, 2], np.zeros((2, 3)), np.tile([0.0, 0.0, 0.0, 1.0], (2, 1)))
    assert world.distance(states, [(1, 2), (2, 1)]).distances.max() < -0.4
