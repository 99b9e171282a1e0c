"""Masses, centres and inertias far from the frame's origin are those near it, before and after fractures."""

from __future__ import annotations

import numpy as np
import pytest

from fracture_collision.fracture import labels
from fracture_collision.geometry.generators import ball, l_block
from fracture_collision.geometry.tetrahedra import boundary_triangles
from fracture_collision.records import CollisionBody, FractureEvent, FragmentRegistry
from fracture_collision.world import CollisionWorld

BODIES = {"ball": ball(0.5, 0.2), "l_block": l_block((1.0, 1.0, 0.3), (0.5, 0.5), 0.2)}
# (place [m], relative error of inertias): rounding of coordinates alone costs 1e-16 of the place, in a body of 1 m
PLACES = [((2e4, 0.0, 0.0), 1e-10), ((1e5, -1e5, 0.0), 1e-9), ((4e5, 4e6, 0.0), 3e-8)]


def registry_of(body: CollisionBody, *events: FractureEvent) -> FragmentRegistry:
    world = CollisionWorld()
    world.add_body(body)
    for event in events:
        world.add_fracture(event)
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
    mesh = BODIES[shape]
    near = CollisionBody(1, 1, vertices=mesh.vertices, tetrahedra=mesh.tetrahedra, density=1000.0)
    used, triangles = np.unique(boundary_triangles(mesh.tetrahedra), return_inverse=True)
    surface = CollisionBody(
        1, 1, vertices=mesh.vertices[used], triangles=triangles.reshape(-1, 3).astype(np.uint32), density=1000.0
    )
    for body in (near, surface):
        far = body._replace(vertices=body.vertices + place)
        assert_equal(registry_of(far), registry_of(body), np.array(place), error)
    # the labels of a pattern near the origin, and cuts in the middle of edges
    label = (mesh.vertices[:, 0] > 0.05) + 2 * (mesh.vertices[:, 1] > 0.05)
    moved = near._replace(vertices=near.vertices + place)
    broken = [registry_of(each, labels(each, label, first_new_id=2)) for each in (moved, near)]
    assert len(broken[0].masses) >= 3
    assert_equal(*broken, np.array(place), error)
