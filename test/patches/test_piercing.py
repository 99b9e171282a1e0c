"""Where surfaces pierce each other, against all pairs of triangles; the least translation, by its dual."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from oracles.pierced_triangles import all_pierced
from scipy.spatial.transform import Rotation

from benchmarks.peers.judging.least_translation import least_translation as slow_translation
from fracture_collision.core.patches.facing_points import Posed
from fracture_collision.core.patches.least_translation import least_translation
from fracture_collision.core.patches.piercing import do_listed_pierce, do_pierce, overlaps_of, pierced_pairs
from fracture_collision.core.patches.surface import make_surface

SHAPES = {
    "box": trimesh.creation.box((1.0, 0.7, 0.4)),
    "ball": trimesh.creation.icosphere(2, 0.5),
    "torus": trimesh.creation.torus(0.4, 0.1, major_sections=16, minor_sections=8),
    "spike": trimesh.creation.cone(0.1, 1.0, sections=9),
}
ALONG = np.array([0.0, 0.0, 1.0])


def posed(mesh: trimesh.Trimesh, turn: Rotation | None = None, offset=(0.0, 0.0, 0.0)) -> Posed:
    turn = Rotation.identity() if turn is None else turn
    surface = make_surface(np.ascontiguousarray(mesh.triangles.reshape(-1, 9)))
    return Posed(
        turn.apply(surface.corners) + offset, surface.triangles, turn.apply(surface.normals), surface.edges,
        surface.beside, surface.is_sharp,
    )  # fmt: skip


def corners_of(surface: Posed) -> np.ndarray:
    return surface.corners[surface.triangles]


SEEDS = pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (1, 2))])


@SEEDS
def test_pairs_that_pierce_each_other_are_all_found_once(seed: int) -> None:
    random, pierced = np.random.default_rng(seed), 0
    for _ in range(40):
        names = random.choice(list(SHAPES), 2)
        turns = Rotation.random(2, random_state=random)
        a, b = posed(SHAPES[names[0]], turns[0]), posed(SHAPES[names[1]], turns[1], random.normal(0.0, 0.3, 3))
        n = random.normal(size=3)
        found = [tuple(pair) for pair in pierced_pairs(a, b, n / np.linalg.norm(n)).tolist()]
        assert len(found) == len(set(found))
        assert set(found) == all_pierced(corners_of(a), corners_of(b))
        pierced += len(found) > 0
    assert pierced > 10


def test_the_area_of_an_overlap_is_that_of_what_is_inside() -> None:
    """A corner of a cube in another: three squares of 0.2 m."""
    cube = trimesh.creation.box((1.0, 1.0, 1.0))
    turned = posed(cube, Rotation.from_rotvec([1e-9, 2e-9, 3e-9]), (0.8, 0.8, 0.8))
    a = posed(cube)
    overlaps = overlaps_of(a, turned, pierced_pairs(a, turned, ALONG))
    np.testing.assert_allclose(overlaps.areas, [[0.04, 0.04, 0.04]], atol=1e-6)
    assert (overlaps.of_a >= 0).any() and (overlaps.of_b >= 0).any()


def test_overlaps_at_two_places_are_told_apart() -> None:
    """A bar through both walls of a box's corner regions: two balls of a dumbbell in a plate's rims."""
    plate = posed(trimesh.creation.box((2.0, 2.0, 0.1)))
    balls = trimesh.util.concatenate(
        [trimesh.creation.icosphere(2, 0.3).apply_translation((x, 0.1, 0.28)) for x in (-0.5, 0.53)]
    )
    two = posed(balls)
    overlaps = overlaps_of(plate, two, pierced_pairs(plate, two, ALONG))
    assert len(overlaps.areas) == 2
    up = overlaps.areas / np.linalg.norm(overlaps.areas, axis=1)[:, None]
    np.testing.assert_allclose(up, [[0.0, 0.0, 1.0]] * 2, atol=0.05)
    assert np.all(np.linalg.norm(overlaps.areas, axis=1) > 0.95 * overlaps.spreads)


def test_a_needle_through_a_plate_leaves_no_area() -> None:
    plate = posed(trimesh.creation.box((1.0, 0.8, 0.03)))
    needle = posed(trimesh.creation.cylinder(0.01, 1.2, sections=8), None, (0.2, 0.1, 0.05))
    overlaps = overlaps_of(plate, needle, pierced_pairs(plate, needle, ALONG))
    assert len(overlaps.areas) == 1 and np.linalg.norm(overlaps.areas[0]) < 0.05 * overlaps.spreads[0]


@pytest.mark.parametrize("seed", range(3))
def test_the_least_translation_is_that_of_least_squares(seed: int) -> None:
    random = np.random.default_rng(seed)
    for _ in range(200):
        n = int(random.integers(1, 12))
        toward = random.normal(size=3)
        normals = random.normal(size=(n, 3)) + 1.5 * toward
        normals /= np.linalg.norm(normals, axis=1)[:, None]
        normals[normals @ toward < 0.0] *= -1.0  # so that there is one
        needs = random.uniform(-0.5, 1.0, n)
        x, is_possible = least_translation(normals, needs)
        if needs.max() <= 0.0:
            np.testing.assert_array_equal(x, np.zeros(3))
            continue
        assert is_possible and (normals @ x - needs).min() > -1e-8
        np.testing.assert_allclose(np.linalg.norm(x), np.linalg.norm(slow_translation(normals, needs)), rtol=1e-6)


def test_opposite_needs_have_no_translation() -> None:
    normals = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]])
    assert not least_translation(normals, np.array([0.1, 0.1]))[1]
    x, is_possible = least_translation(normals, np.array([0.1, -0.2]))
    assert is_possible
    np.testing.assert_allclose(x, [0.0, 0.0, 0.1])


@SEEDS
def test_whether_anything_pierces_anything_is_what_all_pairs_say(seed: int) -> None:
    """Also where only the listed triangles are looked at, after a motion within the list's reach."""
    random, pierced, told = np.random.default_rng(seed), 0, 0
    meshes, reach = list(SHAPES.values()), 0.1
    surfaces = [make_surface(np.ascontiguousarray(mesh.triangles.reshape(-1, 9))) for mesh in meshes]
    for _ in range(150):
        i, j = random.choice(len(meshes), 2)
        turns, places = Rotation.random(2, random_state=random), random.normal(0.0, 0.3, (2, 3))
        n, listed = random.normal(size=3), None
        for moved in (np.zeros(3), reach * (1.0 - 1e-9) * n / np.linalg.norm(n)):
            placed = places[0], places[1] + moved
            poses = tuple((turn.as_matrix(), place) for turn, place in zip(turns, placed, strict=True))
            both = posed(meshes[i], turns[0], placed[0]), posed(meshes[j], turns[1], placed[1])
            truth = len(all_pierced(*map(corners_of, both))) > 0
            room = np.empty((4000, 2), np.int32)
            pierce, count = do_pierce(surfaces[i], surfaces[j], poses, n / np.linalg.norm(n), (room, reach))
            assert pierce == truth and (count < 0) == truth
            if moved.any() and listed is not None:
                assert do_listed_pierce(surfaces[i], surfaces[j], poses, listed) == truth
                told += truth
            listed = room[:count] if count >= 0 else None
            pierced += truth
    assert 60 < pierced < 240 and told > 0


def test_more_triangles_than_there_is_room_for_are_no_list() -> None:
    cube = make_surface(np.ascontiguousarray(trimesh.creation.box((1.0, 1.0, 1.0)).triangles.reshape(-1, 9)))
    poses = (np.eye(3), np.zeros(3)), (np.eye(3), np.array([1.0 + 1e-6, 0.0, 0.0]))
    assert do_pierce(cube, cube, poses, np.array([1.0, 0.0, 0.0]), (np.empty((3, 2), np.int32), 1e-3)) == (False, -1)


def test_triangles_out_of_reach_are_not_listed() -> None:
    """Two cubes, one edge across another: their faces are in each other's planes, however far these are apart."""
    cube = make_surface(np.ascontiguousarray(trimesh.creation.box((1.0, 1.0, 1.0)).triangles.reshape(-1, 9)))
    u, v, w = np.array([1.0, 1.0, 0.0]) / 2**0.5, np.array([-1.0, 1.0, 0.0]) / 2**0.5, np.array([0.0, 0.0, 1.0])
    turn, room = np.column_stack((u + w, 2**0.5 * v, w - u)) / 2**0.5, np.empty((200, 2), np.int32)
    for gap, is_listed in ((-0.01, False), (0.09, True), (0.11, False)):
        poses = (np.eye(3), np.zeros(3)), (turn, (2**0.5 + gap) * u)
        pierce, count = do_pierce(cube, cube, poses, w, (room, 0.1))
        assert pierce == (gap < 0.0) and (count > 0) == is_listed
