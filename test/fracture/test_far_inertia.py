"""Masses, centres and inertias far from the frame's origin are those near it, before and after fractures."""

from __future__ import annotations

import numpy as np
import pytest
from worlds.fractured_worlds import fractured_world

from fracture_collision.fracture import labels
from fracture_collision.geometry.generators import TetGeometry, ball, l_block
from fracture_collision.geometry.tetrahedra import boundary_triangles
from fracture_collision.records import CollisionBody, FragmentRegistry, FragmentStates
from fracture_collision.world import CollisionWorld

BODIES = {"ball": ball(0.5, 0.2), "l_block": l_block((1.0, 1.0, 0.3), (0.5, 0.5), 0.2)}
# (place [m], relative error of inertias): rounding of coordinates alone costs 1e-16 of the place, in a body of 1 m
PLACES = [((2e4, 0.0, 0.0), 1e-10), ((1e5, -1e5, 0.0), 1e-9), ((4e5, 4e6, 0.0), 3e-8)]


def registry_of(world: CollisionWorld, events: int) -> FragmentRegistry:
    world.contacts(FragmentStates(9, events, [], [], []))
    return world.fragments()


def assert_equal(far: FragmentRegistry, near: FragmentRegistry, place: np.ndarray, error: float) -> None:
    assert far.masses == pytest.approx(near.masses, rel=error)
    moved = far.centers_of_mass.reshape(-1, 3) - place
    assert np.abs(moved - near.centers_of_mass.reshape(-1, 3)).max() < error + 2e-16 * np.abs(place).max()
    ours, wanted = far.inertias.reshape(-1, 6), near.inertias.reshape(-1, 6)
    assert (np.abs(ours - wanted).max(axis=1) < error * wanted.max(axis=1)).all()


@pytest.mark.parametrize(("place", "error"), PLACES)
@pytest.mark.parametrize("shape", BODIES)
def test_bodies_and_fragments_far_away(shape: str, place: tuple[float, float, float], error: float) -> None:
    body = BODIES[shape]
    moved = TetGeometry(body.vertices + place, body.tetrahedra)
    whole, again = (registry_of(fractured_world(each, 5, generations=0).world, 0) for each in (moved, body))
    assert_equal(whole, again, np.array(place), error)
    # the labels of a pattern near the origin, and cuts in the middle of edges
    label = (body.vertices[:, 0] > 0.05) + 2 * (body.vertices[:, 1] > 0.05)
    broken = []
    for each in (moved, body):
        own = CollisionBody(1, 1, vertices=each.vertices, tetrahedra=each.tetrahedra, density=1000.0)
        world = CollisionWorld()
        world.add_body(own)
        world.add_fracture(labels(own, label, first_new_id=2))
        broken.append(registry_of(world, 1))
    assert len(broken[0].masses) >= 3
    assert_equal(*broken, np.array(place), error)


@pytest.mark.parametrize(("place", "error"), PLACES)
def test_rigid_surfaces_far_away(place: tuple[float, float, float], error: float) -> None:
    body, found = BODIES["l_block"], []
    surface = boundary_triangles(body.tetrahedra)
    used, triangles = np.unique(surface, return_inverse=True)
    for offset in (np.array(place), np.zeros(3)):
        vertices, world = body.vertices[used] + offset, CollisionWorld()
        world.add_body(CollisionBody(1, 1, vertices=vertices, triangles=triangles.reshape(-1, 3), density=1000.0))
        found.append(registry_of(world, 0))
    assert_equal(*found, np.array(place), error)
