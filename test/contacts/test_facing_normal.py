"""Contact normals between bodies point to the surface that faces the sample: brute force over all triangles."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
import trimesh
from oracles.brute_force import distances_to_triangles
from scipy.spatial.transform import Rotation
from truth.contact_truth import Poses, sample_ids
from worlds.fractured_worlds import SETTINGS as NEAREST
from worlds.fractured_worlds import samples_of
from worlds.hard_worlds import block
from worlds.sampled_worlds import EVERY, SampledWorld, in_order

from fracture_collision.geometry.tetrahedra import boundary_triangles
from fracture_collision.records import FragmentStates
from fracture_collision.world import CollisionWorld, Settings

SETTINGS = Settings(threads=1, contacts_per_pair=EVERY)
# facing_normal.py: limits for parallel normals, for how much farther a facing surface may be, for rounding (R).
SAME_WAY, FARTHER, SLACK = 0.25, 0.03, 1e-12
SIZE = np.array([2.0, 1.6, 1.0])
KINDS = ("tetrahedra", "triangles", "box")


class Solid:
    """A block as triangles, and the normals of its samples."""

    def __init__(self, kind: str, number: int) -> None:
        self.body = block(kind, number, tuple(SIZE.tolist()))
        if kind == "box":
            self.mesh = trimesh.creation.box(SIZE)
        elif kind == "triangles":
            self.mesh = _mesh(self.body.vertices, self.body.triangles.reshape(-1, 3))
        else:
            self.mesh = _mesh(self.body.vertices, boundary_triangles(self.body.tetrahedra.reshape(-1, 4)))
        self.kind = kind

    def normals(self, samples: np.ndarray, points: np.ndarray) -> np.ndarray:
        if self.kind != "box":
            return np.asarray(self.mesh.vertex_normals)[samples]
        return np.where(np.abs(points) >= 0.5 * SIZE * (1.0 - 1e-9), np.sign(points), 0.0)

    def nearest_facing(self, x: np.ndarray, toward: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
        """(point, normal) of the triangles that face `toward` and contain the nearest point of all such."""
        normals = np.asarray(self.mesh.face_normals)
        faces = np.flatnonzero(normals @ toward < -1e-15)
        distance, feet = distances_to_triangles(x, np.asarray(self.mesh.triangles)[faces])
        return [(feet[i], normals[faces[i]]) for i in np.flatnonzero(distance <= distance.min() + SLACK)]


def _mesh(vertices: np.ndarray, triangles: np.ndarray) -> trimesh.Trimesh:
    return trimesh.Trimesh(vertices.reshape(-1, 3), triangles, process=False)


@pytest.mark.parametrize(("lower", "upper"), [*product(KINDS, repeat=2)])
def test_contacts_equal_those_of_the_slow_twin(lower: str, upper: str) -> None:
    solids = {1: Solid(lower, 1), 2: Solid(upper, 2)}
    worlds = CollisionWorld(NEAREST._replace(contacts_per_pair=EVERY)), SampledWorld(SETTINGS)
    for world, solid in product(worlds, solids.values()):
        world.add_body(solid.body)
    near = SETTINGS.detection_tolerance
    random = np.random.default_rng(7)
    turned = kept = 0
    for deep in (0.002, 0.01, 0.0, -0.001):
        turn = Rotation.from_rotvec(random.uniform(-0.003, 0.003, 3))
        shift = np.array([*random.uniform(-0.002, 0.002, 2), 1.0 - deep])
        quaternions = np.concatenate([[0.0, 0.0, 0.0, 1.0], turn.as_quat()])
        states = FragmentStates(1, 0, np.array([1, 2]), np.append(np.zeros(3), shift), quaternions)
        plain, answer = (in_order(world.contacts(states)) for world in worlds)
        assert np.array_equal(plain.contact_ids, answer.contact_ids)
        poses = Poses(states)
        for own, other in ((1, 2), (2, 1)):
            points, numbers = _samples(worlds[1], own)
            _, at, sample = np.intersect1d(answer.contact_ids, sample_ids(own, other, numbers), return_indices=True)
            own_normals = solids[own].normals(numbers, points) @ poses.rotation[own].T @ poses.rotation[other]
            x = poses.to_body(other, poses.to_world(own, points))
            witness = poses.to_body(other, (answer.points_b if own == 1 else answer.points_a).reshape(-1, 3))
            sign = -1.0 if own == 1 else 1.0
            before, after = (
                sign * found.normals.reshape(-1, 3) @ poses.rotation[other] for found in (plain, answer)
            )
            for i, k in zip(at.tolist(), sample.tolist(), strict=True):
                right = _right(solids[other], x[k], own_normals[k], before[i], plain.gaps[i], near)
                if right is None:
                    kept += 1
                    assert answer.gaps[i] == plain.gaps[i] and np.array_equal(after[i], before[i])
                    continue
                turned += 1
                off = [max(np.abs(after[i] - normal).max(), np.abs(witness[i] - q).max()) for q, normal in right]
                assert min(off) < 1e-9, (own, x[k], plain.gaps[i], right, after[i], witness[i])
    assert turned > 3 and kept > 20


def _samples(world: CollisionWorld, fragment: int) -> tuple[np.ndarray, np.ndarray]:
    return samples_of(world.geometry, world._registry.row_of(fragment))


def _right(other: Solid, x, own_normal, before, d: float, near: float) -> list | None:
    """All correct (witness, normal); None: unchanged."""
    along = own_normal @ before
    if along <= SAME_WAY:
        return None
    inside = d <= SLACK
    found = []
    for q, normal in other.nearest_facing(x, own_normal):
        gap = normal @ (x - q)
        reach = FARTHER - d if inside else near
        if np.linalg.norm(x - q) < reach and (gap <= d + SLACK if inside else -SLACK <= gap <= near):
            found.append((q, normal))
    return found or None
