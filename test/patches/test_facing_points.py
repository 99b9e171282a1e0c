"""Facing points against rays, for surfaces of several kinds in any position."""

from __future__ import annotations

import igl
import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from fracture_collision.core.patches.facing_points import (
    FacingPoints,
    Posed,
    axes_along,
    facing_points,
    overlap_along,
)
from fracture_collision.core.patches.surface import Surface, make_surface

SHAPES = {
    "box": trimesh.creation.box((1.0, 0.6, 0.4)),
    "ball": trimesh.creation.icosphere(1),
    "cylinder": trimesh.creation.cylinder(0.4, 1.2, sections=9),
    "torus": trimesh.creation.torus(0.6, 0.2, major_sections=8, minor_sections=6),
}


def surface_of(mesh: trimesh.Trimesh) -> Surface:
    return make_surface(mesh.triangles.reshape(-1, 9).copy())


def two_shapes(random: np.random.Generator) -> tuple[list[trimesh.Trimesh], np.ndarray]:
    """Anywhere about each other, and a unit direction."""
    pair = [SHAPES[name].copy() for name in random.choice(list(SHAPES), 2)]
    for mesh in pair:
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = Rotation.random(random_state=random).as_matrix(), random.normal(size=3) * 0.25
        mesh.apply_transform(pose)
    n = random.normal(size=3)
    return pair, n / np.linalg.norm(n)


@pytest.mark.parametrize("shape", SHAPES)
def test_a_surface_has_the_convex_edges_of_trimesh(shape: str) -> None:
    mesh = SHAPES[shape]
    surface = surface_of(mesh)
    assert len(surface.corners) == len(mesh.vertices) and len(surface.triangles) == len(mesh.faces)
    turns = mesh.face_adjacency_convex & (mesh.face_adjacency_angles > 1e-4)
    truth = {frozenset(map(tuple, mesh.vertices[ends])) for ends in mesh.face_adjacency_edges[turns]}
    assert {frozenset(map(tuple, surface.corners[ends])) for ends in surface.edges} == truth


def heights(mesh: trimesh.Trimesh, sign: float, axes: np.ndarray, places: np.ndarray) -> list[np.ndarray]:
    """For each place (n, 2) across the last of `axes`, the heights of the faces towards it (sign 1) or against it."""
    corners = mesh.triangles[sign * (mesh.face_normals @ axes[2]) > 0.05] @ axes.T
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    ab, ac = b - a, c - a
    area = ab[:, 0] * ac[:, 1] - ac[:, 0] * ab[:, 1]
    found = []
    for u, v in places:
        of_b = ((u - a[:, 0]) * ac[:, 1] - ac[:, 0] * (v - a[:, 1])) / area
        of_c = (ab[:, 0] * (v - a[:, 1]) - (u - a[:, 0]) * ab[:, 1]) / area
        over = (of_b >= 0.0) & (of_c >= 0.0) & (of_b + of_c <= 1.0)
        found.append((a[:, 2] + of_b * ab[:, 2] + of_c * ac[:, 2])[over])
    return found


def away(mesh: trimesh.Trimesh, points: np.ndarray) -> float:
    faces = mesh.faces.astype(np.int64)
    squared = igl.point_mesh_squared_distance(np.ascontiguousarray(points), mesh.vertices.astype(float), faces)[0]
    return float(np.sqrt(squared.max()))


def test_no_ray_finds_less_than_the_least_gap() -> None:
    random, excess = np.random.default_rng(5), []
    for _ in range(60):
        (a, b), n = two_shapes(random)
        found: FacingPoints = facing_points(Posed(*surface_of(a)), Posed(*surface_of(b)), n, (-np.inf, 1e9), 1.0)
        axes = axes_along(n)
        seen_a, seen_b = (mesh.vertices @ axes.T for mesh in (a, b))
        low = np.maximum(seen_a.min(axis=0), seen_b.min(axis=0))
        high = np.minimum(seen_a.max(axis=0), seen_b.max(axis=0))
        if (low > high)[:2].any():
            assert len(found.gaps) == 0
            continue
        places = random.uniform(low[:2], high[:2], (1500, 2))
        both = zip(heights(a, 1.0, axes, places), heights(b, -1.0, axes, places), strict=True)
        least = min((of_b.min() - of_a.max() for of_a, of_b in both if len(of_a) and len(of_b)), default=np.inf)
        if not len(found.gaps):
            assert least == np.inf
            continue
        assert found.gaps.min() <= least + 1e-12
        excess.append(least - found.gaps.min())
        assert max(away(a, found.points), away(b, found.points + found.gaps[:, None] * n)) < 1e-8
        limit = found.gaps.min() + 0.05
        near = facing_points(Posed(*surface_of(a)), Posed(*surface_of(b)), n, (-np.inf, limit), 1.0)
        wanted = {tuple(row) for row in found.features[found.gaps <= limit].tolist()}
        assert {tuple(row) for row in near.features.tolist()} == wanted
    assert len(excess) > 40 and np.median(excess) < 0.01


def test_what_is_nowhere_over_the_other_has_no_point() -> None:
    a, b = SHAPES["box"].copy(), SHAPES["box"].copy()
    b.apply_translation([1.01, 0.0, 0.4])
    up = np.array([0.0, 0.0, 1.0])
    assert len(facing_points(Posed(*surface_of(a)), Posed(*surface_of(b)), up, (-np.inf, 1.0), 1.0).gaps) == 0
    # flush rims count
    b.apply_translation([-0.01, 0.0, 0.0])
    found = facing_points(Posed(*surface_of(a)), Posed(*surface_of(b)), up, (-np.inf, 1.0), 1.0)
    assert len(found.gaps) and np.abs(found.gaps).max() < 1e-12


def test_the_overlap_is_that_of_the_deepest_point() -> None:
    """Of those that are not deeper than asked for; where it may end early, some overlap beyond what is enough."""
    random, deep = np.random.default_rng(6), 0
    for _ in range(60):
        pair, n = two_shapes(random)
        posed = [Posed(*surface_of(mesh)) for mesh in pair]
        gaps = facing_points(*posed, n, (-np.inf, 0.0), 1.0).gaps
        overlap = max(-gaps.min(initial=0.0), 0.0)
        assert overlap_along(*posed, n, -np.inf, np.inf, 1.0) == overlap
        least = -0.6 * overlap
        assert overlap_along(*posed, n, least, np.inf, 1.0) == max(-gaps[gaps >= least].min(initial=0.0), 0.0)
        early = overlap_along(*posed, n, -np.inf, 0.5 * overlap, 1.0)
        assert (0.5 * overlap < early <= overlap) or overlap == early == 0.0
        deep += overlap > 0.1
    assert deep > 20
