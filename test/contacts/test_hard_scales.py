"""Hard scales, positions and rotations: the same contacts, near or far, small or large, for any pose history."""

from __future__ import annotations

from fractions import Fraction
from itertools import combinations

import numpy as np
import pytest
from oracles.fracture_patterns import curved_event
from scipy.spatial.transform import Rotation
from truth.contact_truth import BORDER, ContactTruth, Poses, check_pair, pairs_of
from worlds.fractured_worlds import FracturedWorld
from worlds.hard_worlds import (
    EVERY_CONTACT,
    ROUNDING,
    SETTINGS,
    UPRIGHT,
    block,
    broken_world,
    by_labels,
    common_plane,
    tetrahedral_body,
)
from worlds.rigid_shapes import boundary_of

from fracture_collision.core.mesh.point_location import tetrahedron_at
from fracture_collision.geometry.generators import ball, brick, l_block
from fracture_collision.geometry.tetrahedra import face_neighbours
from fracture_collision.records import ContactConstraintArray, FragmentStates
from fracture_collision.world import CollisionWorld

FAR = np.array([10_000.0, -10_000.0, 10_000.0])  # [m]
LAST_BIT_FAR = 2.0**-39  # [m] 10 km and multiples of it add up without rounding


def rounded(values: np.ndarray) -> np.ndarray:
    """Rounded to coordinates that are unchanged by adding FAR."""
    return np.round(values / LAST_BIT_FAR) * LAST_BIT_FAR


def broken_ball(scale: float = 1.0, shift: np.ndarray | float = 0.0) -> FracturedWorld:
    """A ball of R = `scale` [m] broken along curved cracks; its planes, too, are those of the unit ball to rounding."""
    whole = ball(1.0, 0.4)
    unit = whole._replace(vertices=rounded(whole.vertices))
    seeds = np.random.default_rng(8).uniform(-0.6, 0.6, (5, 3))

    def broken(body, first, sequence):
        reference = type(body)(unit.vertices, unit.tetrahedra)
        event = curved_event(reference, 1, seeds, first, sequence)
        planes = event.cut_planes.reshape(-1, 4) * [1.0, 1.0, 1.0, scale]
        planes[:, 3] += planes[:, :3] @ np.broadcast_to(shift, 3)
        return event._replace(cut_planes=planes.ravel())

    return broken_world(unit._replace(vertices=scale * unit.vertices + shift), [broken])


def jittered(case: FracturedWorld, scale: float = 1.0) -> FragmentStates:
    """Fragments moved by 0.02 and turned by 1 degree at random, the positions then times `scale`."""
    random = np.random.default_rng(12)
    ids = np.array(case.oracle.fragment_ids)
    positions = scale * rounded(random.uniform(-0.02, 0.02, (len(ids), 3)))
    turns = Rotation.from_rotvec(random.uniform(-0.01, 0.01, (len(ids), 3)))
    return FragmentStates(1, case.generations, ids, positions.ravel(), turns.as_quat().ravel())


def assert_true_at_scale(case: FracturedWorld, states: FragmentStates, scale: float) -> int:
    """Brute force's contacts, all lengths in units of `scale` [m]; returns how many."""
    truth, poses = ContactTruth(case), Poses(states)
    answer = case.world.contacts(states)
    listed, found = pairs_of(answer), 0
    epsilon = SETTINGS.penetration_tolerance * scale
    for pair in combinations(case.oracle.fragment_ids, 2):
        check = check_pair(truth, poses, answer, pair, listed, epsilon)
        assert check.bound <= epsilon + BORDER * scale
        assert check.deepest_unlisted <= check.bound
        assert check.apart == 0
        assert max(check.misplaced, check.off_surface, np.abs(check.excess).max(initial=0.0)) <= BORDER * scale
        found += check.contacts
    return found


def assert_same(far: ContactConstraintArray, near: ContactConstraintArray, shift: np.ndarray, limit: float) -> None:
    """The same contacts in the same order; points and gaps within `limit` [m] after `shift` (3,)."""
    assert np.array_equal(far.contact_ids, near.contact_ids)
    assert np.array_equal(far.fragment_a, near.fragment_a) and np.array_equal(far.fragment_b, near.fragment_b)
    assert np.abs(far.gaps - near.gaps).max() <= limit
    for name in ("points_a", "points_b"):
        assert np.abs(getattr(far, name).reshape(-1, 3) - shift - getattr(near, name).reshape(-1, 3)).max() <= limit
    assert np.abs(far.missed_depth_bound - near.missed_depth_bound).max() <= limit


def test_a_body_of_a_millimetre() -> None:
    """All tolerances must be shares of R: contacts true to 1e-9 R; at 2^-10 m, no digit differs from those at 1 m."""
    case = broken_ball(1e-3)
    assert assert_true_at_scale(case, jittered(case, 1e-3), 1e-3) > 20
    scale = 2.0**-10
    small, large = broken_ball(scale), broken_ball()
    answers = small.world.contacts(jittered(small, scale)), large.world.contacts(jittered(large))
    assert len(answers[0].gaps) > 20
    for name in ("gaps", "points_a", "points_b", "missed_depth_bound"):
        assert np.array_equal(getattr(answers[0], name), scale * getattr(answers[1], name))
    for name in ("contact_ids", "normals", "pair_begin"):
        assert np.array_equal(getattr(answers[0], name), getattr(answers[1], name))


@pytest.mark.parametrize("scale", [1.0, 1e-3], ids=["metre", "millimetre"])
def test_a_body_carried_ten_kilometres_off(scale: float) -> None:
    """World coordinates have a last bit of 1.8e-12 m there: points and gaps are right to 1e-11 m, all else the same."""
    case = broken_ball(scale)
    states = jittered(case, scale)
    positions = rounded(states.positions)
    near = case.world.contacts(states._replace(positions=positions))
    far = case.world.contacts(states._replace(positions=positions + np.tile(FAR, len(states.fragment_ids))))
    assert len(near.gaps) > 20
    assert_same(far, near, FAR, 1e-11)
    assert np.array_equal(far.normals, near.normals)


def test_a_body_whose_own_frame_is_ten_kilometres_off() -> None:
    """Its vertices, planes and weights have lost four digits: no point falls between tetrahedra, contacts to 1e-9 R."""
    near, far = broken_ball(), broken_ball(shift=FAR)
    masses = near.world.fragments().masses, far.world.fragments().masses
    assert np.abs(masses[1] / masses[0] - 1.0).max() <= 1e-9
    states = jittered(near)
    # the same motion: turned about the ball's middle
    turns = Rotation.from_quat(states.orientations.reshape(-1, 4))
    back = (states.positions.reshape(-1, 3) - turns.apply(FAR)).ravel()
    for there in (states, states._replace(orientations=np.tile(UPRIGHT, len(states.fragment_ids)))):
        positions = back if there is states else states.positions - np.tile(FAR, len(states.fragment_ids))
        answers = near.world.contacts(there), far.world.contacts(there._replace(positions=positions))
        assert len(answers[0].gaps) > 20
        assert_same(answers[1], answers[0], np.zeros(3), 1e-9)
        assert np.abs(answers[1].normals - answers[0].normals).max() <= 1e-6


@pytest.mark.parametrize("scale", [1.0, 1e-3], ids=["metre", "millimetre"])
def test_no_point_falls_between_tetrahedra_ten_kilometres_off(scale: float) -> None:
    """Weights of a point on the face of two tetrahedra round to 1e-11 there, of a body of 1 mm to 1e-8.

    Each of a thousand points on inner faces, as crack samples are, must still be in one of the two.
    """
    ball_here = ball(1.0, 0.4)
    body = ball_here._replace(vertices=scale * rounded(ball_here.vertices) + FAR)
    world = CollisionWorld(SETTINGS)
    world.add_body(tetrahedral_body(body))
    world.contacts(FragmentStates(1, 0, np.array([1]), np.zeros(3), UPRIGHT))
    random, pools = np.random.default_rng(0), world._registry.geometry.pools
    at, faces = np.nonzero(face_neighbours(body.tetrahedra) >= 0)
    lost = 0
    for t, face in zip(np.tile(at, 2).tolist(), np.tile(faces, 2).tolist(), strict=True):
        point = random.dirichlet(np.ones(3)) @ body.vertices[np.delete(body.tetrahedra[t], face)]
        lost += tetrahedron_at(pools.mesh, 0, *point) < 0
    assert len(at) > 500 and lost == 0


# --- sizes of 1 : 1,000,000 -------------------------------------------------------------------------------------------

BIG, SMALL = 1000.0, 0.001  # [m] R


BIG_BLOCK = (2 * BIG, 2 * BIG, BIG)  # its top at z = 0 in the world


@pytest.mark.parametrize("place", ["inside a triangle", "on an edge of the mesh", "on a node"])
@pytest.mark.parametrize("kind", ["tetrahedra", "triangles", "box"])
def test_a_millimetre_on_a_kilometre(kind: str, place: str) -> None:
    """Coordinates of the big have a last bit of 1e-13 m and weights a tolerance of 1e-12 of its edges, 5e-10 m.

    So of the small one's R, 1 mm, depths are right to 1e-6, normals to 1e-12, and every sample that near is listed.
    """
    x, y = {"inside a triangle": (123.456, -371.9), "on an edge of the mesh": (250.0, 0.0), "on a node": (500.0, 0.0)}[
        place
    ]
    world = CollisionWorld(EVERY_CONTACT)
    world.add_body(block(kind, 1, BIG_BLOCK, 0.5 * BIG))
    pebble = ball(SMALL, 0.3 * SMALL)
    world.add_body(tetrahedral_body(pebble, 2))
    turn = Rotation.from_rotvec([0.4, -0.9, 0.3])
    depth = 0.15 * SMALL
    lowest = turn.apply(pebble.vertices)[:, 2].min()
    positions = np.array([0.0, 0.0, -0.5 * BIG, x, y, -lowest - depth])
    answer = world.contacts(
        FragmentStates(1, 0, np.array([1, 2]), positions, np.append(UPRIGHT, turn.as_quat()))
    )
    heights = (turn.apply(boundary_of(pebble).vertices) + positions[3:])[:, 2]
    if place == "on a node" and kind != "box":
        # a sample of the big within the small: as deep as it is far from the nearest of the small one's faces
        a, b, c = np.moveaxis(boundary_of(pebble).corners, 1, 0)
        normals = np.cross(b - a, c - a)
        normals /= np.linalg.norm(normals, axis=1)[:, None]
        node = turn.inv().apply(np.array([x, y, 0.0]) - positions[3:])
        heights = np.append(heights, ((node - a) * normals).sum(axis=1).max())
    expected = np.sort(heights[heights <= SETTINGS.detection_tolerance * SMALL])
    assert len(expected) >= 3
    assert len(answer.gaps) == len(expected)
    assert np.abs(np.sort(answer.gaps) - expected).max() <= 1e-6 * SMALL
    upwards = np.abs(answer.normals.reshape(-1, 3) - [0.0, 0.0, 1.0]).max(axis=1) <= ROUNDING
    assert np.count_nonzero(~upwards) <= (1 if place == "on a node" else 0)
    assert np.abs(answer.points_a.reshape(-1, 3)[:, 2]).max() <= 1e-6 * SMALL


def test_the_bound_of_a_millimetre_on_a_kilometre() -> None:
    """No unlisted sample is deeper than the bound, in exact arithmetic too, though depths round to 1e-13 m.

    A last bit of the big body's coordinates is 1e-10 of the small one's R: the bound leaves room for some of them.
    """
    world = CollisionWorld(SETTINGS._replace(contacts_per_pair=1, penetration_tolerance=0.3))
    world.add_body(block("box", 1, BIG_BLOCK))
    pebble = ball(SMALL, 0.3 * SMALL)
    world.add_body(tetrahedral_body(pebble, 2))
    heights = [Fraction(z) for z in boundary_of(pebble).vertices[:, 2].tolist()]
    for lift in np.linspace(0.5, 0.95, 200):
        positions = np.array([0.0, 0.0, -0.5 * BIG, 123.4, -371.9, lift * SMALL])
        answer = world.contacts(FragmentStates(1, 0, np.array([1, 2]), positions, np.tile(UPRIGHT, 2)))
        unlisted = [-(z + Fraction(float(positions[5]))) for z in heights]
        for gap in answer.gaps.tolist():
            unlisted.remove(min(unlisted, key=lambda depth, gap=gap: abs(float(depth) + gap)))
        assert max(unlisted) <= Fraction(float(answer.missed_depth_bound[0]))


def test_a_millimetre_in_the_inner_edge_of_a_kilometre() -> None:
    """A sample just inside the inner edge of an L has its witness on that edge: as deep as it is, to 1e-6 of small R.

    A face's normal in place of the way to the edge would make the gap 30 % too shallow.
    """
    corner = l_block((2.0, 2.0, 1.0), (1.0, 1.0), 0.5)
    world = CollisionWorld(EVERY_CONTACT)
    world.add_body(tetrahedral_body(corner._replace(vertices=BIG * corner.vertices)))
    pebble = ball(SMALL, 0.3 * SMALL)
    world.add_body(tetrahedral_body(pebble, 2))
    samples = boundary_of(pebble).vertices
    tip = samples[np.argmin(samples[:, 0] + samples[:, 1])]
    inside = np.array([-5e-7, -5e-7, 0.0])
    positions = np.append(np.zeros(3), inside - tip)
    answer = world.contacts(FragmentStates(1, 0, np.array([1, 2]), positions, np.tile(UPRIGHT, 2)))
    contact = np.argmin(np.linalg.norm(answer.points_b.reshape(-1, 3) - inside, axis=1))
    assert answer.gaps[contact] == pytest.approx(-np.linalg.norm(inside), abs=1e-6 * SMALL)


def test_a_millimetre_in_the_crack_of_a_kilometre() -> None:
    """A pebble wedged between two halves that stand 1.8 mm apart: depth in both to 1e-6 of the pebble's R."""
    body = brick((2 * BIG, 2 * BIG, BIG), 0.5 * BIG)
    offset = 100.0
    event = broken_world(body, [by_labels(body.vertices[:, 0] > offset, common_plane(np.array([1.0, 0, 0]), offset))])
    world = CollisionWorld(EVERY_CONTACT)
    world.add_body(event.messages[0][0])
    pebble = ball(SMALL, 0.3 * SMALL)
    world.add_body(tetrahedral_body(pebble, 100))
    world.add_fracture(event.messages[1][0])
    turn = Rotation.from_rotvec([0.4, -0.9, 0.3])
    half_gap = 0.9 * SMALL
    left = event.oracle.labels[np.argmin(body.vertices[:, 0])]
    ids = np.array([*event.oracle.fragment_ids, 100])
    positions = np.array([[-half_gap if f == left else half_gap, 0.0, 0.0] for f in ids[:2]] + [[offset, 77.7, 31.3]])
    orientations = np.vstack([np.tile(UPRIGHT, (2, 1)), turn.as_quat()])
    answer = world.contacts(FragmentStates(1, 1, ids, positions.ravel(), orientations.ravel()))
    x = turn.apply(boundary_of(pebble).vertices)[:, 0]
    for fragment, gaps in ((left, x + half_gap), (ids[:2][ids[:2] != left][0], half_gap - x)):
        expected = np.sort(gaps[gaps <= SETTINGS.detection_tolerance * SMALL])
        pair = np.flatnonzero((answer.fragment_a == fragment) & (answer.fragment_b == 100))[0]
        rows = slice(answer.pair_begin[pair], answer.pair_begin[pair + 1])
        assert len(expected) >= 3
        assert len(answer.gaps[rows]) == len(expected)
        assert np.abs(np.sort(answer.gaps[rows]) - expected).max() <= 1e-6 * SMALL


# --- turns of the scene -----------------------------------------------------------------------------------------------


def test_a_scene_that_is_turned() -> None:
    """The scene is rigid: gaps are those at rest, to 1e-12 R.

    The relative poses are those at rest but for the rounding of one product.
    """
    case = broken_ball()
    states = jittered(case)
    turn = Rotation.random(random_state=np.random.default_rng(5))
    own = Rotation.from_quat(states.orientations.reshape(-1, 4))
    there = states._replace(
        positions=turn.apply(states.positions.reshape(-1, 3)).ravel(), orientations=(turn * own).as_quat().ravel()
    )
    rest, moved = case.world.contacts(states), case.world.contacts(there)
    assert len(rest.gaps) > 20
    assert np.array_equal(moved.contact_ids, rest.contact_ids)
    assert np.abs(moved.gaps - rest.gaps).max() <= ROUNDING
    assert np.abs(turn.inv().apply(moved.points_a.reshape(-1, 3)) - rest.points_a.reshape(-1, 3)).max() <= ROUNDING
    assert np.abs(turn.inv().apply(moved.normals.reshape(-1, 3)) - rest.normals.reshape(-1, 3)).max() <= 1e-9
