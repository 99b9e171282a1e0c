"""sampling_gap of the closed forms: no point of a surface is farther than that from a sample."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import cKDTree

from fracture_collision.core.mesh.primitives import box_edge_points
from fracture_collision.records import BOX, SPHERE, CollisionBody, SolidPrimitive
from fracture_collision.world import CollisionWorld

FINE = 400  # points along each edge of a face


def published_gap(primitive: SolidPrimitive) -> float:
    world = CollisionWorld()
    world.add_body(CollisionBody(1, 1, primitive=primitive))
    return float(world.fragments().sampling_gaps[0])


def farthest_on_faces(half: np.ndarray) -> float:
    """[m] of a box's surface from its samples, over a fine grid of each face."""
    samples, farthest = cKDTree(box_edge_points(half)), 0.0
    for axis in range(3):
        others = [k for k in range(3) if k != axis]
        u, v = np.meshgrid(*(np.linspace(-half[k], half[k], FINE) for k in others))
        points = np.empty((u.size, 3))
        points[:, others[0]], points[:, others[1]], points[:, axis] = u.ravel(), v.ravel(), half[axis]
        farthest = max(farthest, samples.query(points)[0].max())
    return farthest


@pytest.mark.parametrize(
    "edges",
    [
        (0.02, 0.02, 4.0), (4.0, 0.02, 0.02), (0.02, 4.0, 0.3), (1.0, 1.0, 1.0), (2.0, 1.0, 0.5), (3.0, 3.0, 0.01),
        (1.0, 0.017, 0.9), (0.1, 0.031, 1.0),
    ],
)  # fmt: skip
def test_sampling_gap_of_a_box_equals_brute_force(edges: tuple[float, float, float]) -> None:
    gap, found = published_gap(SolidPrimitive(BOX, edges)), farthest_on_faces(np.array(edges) / 2.0)
    assert found <= gap <= 1.03 * found


def test_sampling_gap_of_a_sphere_is_zero() -> None:
    """A sphere's contacts are found anywhere on its surface: test_sphere_contacts.py compares points all over it."""
    assert published_gap(SolidPrimitive(SPHERE, (0.5,))) == 0.0
