"""Guarantees of a fragment's surface, also after its neighbours break.

A sample is within sampling_gap, nothing outside its box, no cell of its grid left out, and with flat cracks no sample
inside a neighbour.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pytest
from oracles.brute_force import distances, owners, partition_of
from oracles.fragmented_body import ALL_KINDS
from scipy.spatial import cKDTree
from truth.contact_truth import COARSE_SHAPES, SHAPES, surface_samples
from worlds.fractured_worlds import FracturedWorld, after_each_fracture, fractured_world

from fracture_collision.core.mesh.occupancy import sphere_may_touch
from fracture_collision.core.mesh.primitives import box_edge_points
from fracture_collision.geometry.generators import ball
from fracture_collision.records import BOX, SPHERE, CollisionBody, SolidPrimitive
from fracture_collision.world import CollisionWorld

# R = 1 m for all shapes.
ROUNDING = 1e-12
# Points where planes meet solve normal equations; truth and service solve them differently.
SOLVED = 1e-11
# Planes disagree most in a ball this coarse.
COARSEST = COARSE_SHAPES | {"ball": lambda: ball(1.0, 0.5)}
POINTS_A_TRIANGLE = 4


class FragmentCheck(NamedTuple):
    fragment: int
    generation: int  # fractures of the body so far
    gap: float  # [m] sampling_gap of the registry
    farthest: float  # [m] from a sample, of random points and corners of the surface
    outside_box: float  # [m] how far the surface reaches beyond the stored box
    cells_missed: int  # corners of surface polygons in cells marked empty
    samples_astray: float  # [m] depth of the fragment's own deepest sample in another fragment, in place


def check_fragments(stage: FracturedWorld, seed: int) -> list[FragmentCheck]:
    random = np.random.default_rng(seed)
    registry, pools = stage.world.fragments(), stage.geometry.pools
    partition = partition_of(stage.oracle)
    checks = []
    for fragment, gap in zip(registry.fragment_ids.tolist(), registry.sampling_gaps.tolist(), strict=True):
        row, (samples, _) = stage.row(fragment), surface_samples(stage, fragment)
        measured = stage.oracle.surface_triangles(fragment)
        spread = np.repeat(measured, POINTS_A_TRIANGLE, axis=0)
        points = np.einsum("ti,tij->tj", random.dirichlet(np.ones(3), len(spread)), spread)
        farthest = cKDTree(samples).query(np.concatenate((points, measured.reshape(-1, 3))))[0].max()
        corners = stage.oracle.surface_triangles(fragment, ALL_KINDS).reshape(-1, 3)
        box = pools.fragment.box[row]
        outside = max((box[:3] - corners).max(), (corners - box[3:]).max())
        missed = sum(not sphere_may_touch(pools, row, *corner, ROUNDING) for corner in corners.tolist())
        owner, certain = owners(partition, samples)
        astray = 0.0
        for other in set(owner[certain].tolist()) - {0, fragment}:
            inside = samples[certain & (owner == other)]
            astray = max(astray, distances(inside, stage.oracle.surface_triangles(other, ALL_KINDS)).max())
        checks.append(FragmentCheck(fragment, stage.generations, gap, farthest, outside, missed, astray))
    return checks


def assert_kept(checks: list[FragmentCheck]) -> None:
    assert not [c for c in checks if c.farthest > c.gap * (1.0 + ROUNDING)]
    assert not [c for c in checks if c.outside_box > SOLVED or c.cells_missed]


QUICK = [
    ("torus", "flat", 3), ("l_block", "flat", 3), ("ball", "flat", 0),
    ("ball", "curved", 0), ("brick", "curved", 2), ("torus", "curved", 5),
]  # fmt: skip


@pytest.mark.timeout(1200)
@pytest.mark.parametrize(
    ("body", "cracks", "generations", "seed"),
    [
        *(pytest.param(COARSEST[s], c, 2, seed, id=f"{s}-{c}-{seed}") for s, c, seed in QUICK),
        *(pytest.param(SHAPES[s], c, 5, 3, id=f"{s}-{c}", marks=pytest.mark.slow)
          for s in SHAPES for c in ("flat", "curved")),
    ],
)  # fmt: skip
def test_guarantees_of_surfaces_hold_when_neighbours_break(body, cracks: str, generations: int, seed: int) -> None:
    case = fractured_world(body(), 3 + generations, generations, curved=cracks == "curved", seed=seed)
    for stage in after_each_fracture(case):
        checks = check_fragments(stage, seed)
        assert_kept(checks)
        if cracks == "flat":
            assert max(c.samples_astray for c in checks) <= ROUNDING


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
