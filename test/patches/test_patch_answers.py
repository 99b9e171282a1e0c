"""Answers for convex bodies: contacts along one direction, and a bound that holds."""

from __future__ import annotations

import igl
import numpy as np
import pytest
import trimesh
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from fracture_collision.records import BOX, CollisionBody, FragmentStates, SolidPrimitive
from fracture_collision.world import CollisionWorld, Settings

SETTINGS = Settings(threads=1, lookahead=0.01)


def stone(random: np.random.Generator) -> trimesh.Trimesh:
    """A convex hull of a few points, or of a cylinder with corners at its ends alone."""
    if random.random() < 0.3:
        return trimesh.creation.cylinder(0.3, random.uniform(0.2, 2.0), sections=int(random.integers(5, 130)))
    points = random.normal(size=(int(random.integers(5, 30)), 3)) * random.uniform(0.2, 0.6, 3)
    return trimesh.convex.convex_hull(points)


def body(number: int, mesh: trimesh.Trimesh) -> CollisionBody:
    return CollisionBody(number, number, vertices=mesh.vertices.view(np.ndarray), triangles=mesh.faces, density=1000.0)


def states(step: int, places: np.ndarray, turns: Rotation, linear: np.ndarray, angular: np.ndarray) -> FragmentStates:
    return FragmentStates(
        step, 0, np.arange(1, len(places) + 1, dtype=np.uint32), places.ravel(), turns.as_quat().ravel(),
        linear_velocities=linear.ravel(), angular_velocities=angular.ravel(),
    )  # fmt: skip


def apart_along(meshes: list[trimesh.Trimesh], places: np.ndarray, turns: Rotation, n: np.ndarray) -> float:
    a, b = (turn.apply(mesh.vertices) + place for mesh, place, turn in zip(meshes, places, turns, strict=True))
    return float((b @ n).min() - (a @ n).max())


def least_overlap(meshes: list[trimesh.Trimesh], places: np.ndarray, turns: Rotation) -> float:
    """How far two convex bodies must be moved apart, 0 if they are: by the hull of all differences of their corners."""
    a, b = (turn.apply(mesh.vertices) + place for mesh, place, turn in zip(meshes, places, turns, strict=True))
    return float(-min(ConvexHull((b[None] - a[:, None]).reshape(-1, 3)).equations[:, 3].max(), 0.0))


def test_the_least_translation_by_the_contacts_separates_two_convex_bodies() -> None:
    random, touching = np.random.default_rng(11), 0
    for _ in range(150):
        meshes = [stone(random), stone(random)]
        world = CollisionWorld(SETTINGS._replace(lookahead=0.0))
        for k, mesh in enumerate(meshes):
            world.add_body(body(k + 1, mesh))
        turns, places = Rotation.random(2, random_state=random), random.uniform(-0.4, 0.4, (2, 3))
        answer = world.contacts(states(1, places, turns, np.zeros((2, 3)), np.zeros((2, 3))))
        overlap = least_overlap(meshes, places, turns)
        size = min(np.ptp(mesh.vertices, axis=0).max() for mesh in meshes)
        if not len(answer.gaps):
            assert overlap < 1e-9
            continue
        touching += 1
        normals = answer.normals.reshape(-1, 3)
        assert np.abs(normals - normals[0]).max() == 0.0 and len(answer.gaps) <= SETTINGS.contacts_per_pair
        assert -apart_along(meshes, places, turns, normals[0]) <= overlap + 0.003 * size
        assert answer.missed_depth_bound[0] >= overlap - 1e-9
        assert answer.missed_depth_bound[0] >= -answer.gaps.min() - 1e-9
        points = answer.points_a.reshape(-1, 3), answer.points_b.reshape(-1, 3)
        assert np.allclose(((points[1] - points[0]) * normals).sum(axis=1), answer.gaps, atol=1e-12)
        for mesh, place, turn, own in zip(meshes, places, turns, points, strict=True):
            corners, faces = turn.apply(mesh.vertices) + place, mesh.faces.astype(np.int64)
            squared = igl.point_mesh_squared_distance(np.ascontiguousarray(own), corners, faces)[0]
            assert np.sqrt(squared.max()) < 1e-7 * size
    assert touching > 60


@pytest.mark.parametrize("spin", [0.0, -40.0, 300.0])
def test_a_thin_spinning_bar_does_not_pass_a_thin_wall(spin: float) -> None:
    """It meets the wall with its end, in the middle of the step."""
    world = CollisionWorld(SETTINGS)
    for number, sides in ((1, (0.02, 2.0, 2.0)), (2, (1.0, 0.05, 0.05))):
        solid = SolidPrimitive(BOX, sides)
        world.add_body(CollisionBody(number, number, primitive=solid, density=1000.0, is_static=number == 1))
    turns = Rotation.from_rotvec([[0.0, 0.0, 0.0], [0.0, 0.0, 1.2]])
    places = np.array([[0.0, 0.0, 0.0], [-0.25, 0.0, 0.0]])
    linear, angular = np.array([[0.0, 0.0, 0.0], [10.0, 0.0, 0.0]]), np.array([[0.0, 0.0, 0.0], [0.0, 0.0, spin]])
    asked = states(1, places, turns, linear, angular)
    answer = world.contacts(asked)
    assert len(answer.gaps) and answer.gaps.min() > 0.0
    assert np.abs(answer.normals.reshape(-1, 3)[:, 0]).min() > 0.99
