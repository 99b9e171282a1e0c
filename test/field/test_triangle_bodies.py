"""Rigid bodies of triangles only: the field against brute force, contacts, masses, and shared data."""

from __future__ import annotations

import numpy as np
import pytest
from oracles.fragmented_body import ALL_KINDS
from scipy.spatial.transform import Rotation
from truth.contact_truth import Poses, pairs_of, sample_ids
from worlds.fractured_worlds import SETTINGS, fractured_world, samples_of
from worlds.rigid_shapes import (
    RigidShape,
    cube,
    hollow_box,
    l_block,
    noisy_ball,
    torus,
    true_distance,
)
from worlds.sampled_worlds import EVERY, SampledWorld

from fracture_collision.core.bodies.collision_geometry import CollisionGeometry
from fracture_collision.core.bodies.prepared import prepare_surface
from fracture_collision.core.field.crack_normal import FARTHER
from fracture_collision.core.mesh.triangle_field import STACK, triangle_distance
from fracture_collision.geometry.generators import ball
from fracture_collision.records import CollisionBody, FragmentStates
from fracture_collision.world import CollisionWorld, Settings

SHAPES = {"torus": torus, "l_block": l_block, "cube": cube, "noisy_ball": noisy_ball, "hollow_box": hollow_box}
STACK_SPACE = np.empty(STACK, np.int32)


@pytest.fixture(scope="module", params=SHAPES)
def shape(request) -> RigidShape:
    return SHAPES[request.param]()


@pytest.fixture(scope="module")
def geometry(shape: RigidShape) -> CollisionGeometry:
    geometry = CollisionGeometry()
    # another mesh first, so that pool rows differ from indices
    geometry.add_triangles(prepare_surface(*noisy_ball(5)))
    assert geometry.add_triangles(prepare_surface(*shape)) == 1
    return geometry


def _points(shape: RigidShape) -> np.ndarray:
    """Points in and around the body, and close to its faces, edges and corners on both sides."""
    random = np.random.default_rng(2)
    low, high = shape.vertices.min(axis=0), shape.vertices.max(axis=0)
    spread = random.uniform(low - 0.2, high + 0.2, (250, 3))
    chosen = shape.corners[random.integers(0, len(shape.corners), 300)]
    weights = random.dirichlet(np.ones(3), 300)
    weights[100:200, 2] = 0.0
    weights[200:, 1:] = 0.0
    weights /= weights.sum(axis=1, keepdims=True)
    near = np.einsum("ij,ijk->ik", weights, chosen)
    steps = random.normal(size=near.shape) * 10.0 ** random.uniform(-7, -1, (300, 1))
    return np.vstack([spread, near + steps])


def test_signed_distance_equals_the_minimum_over_all_triangles(shape: RigidShape, geometry: CollisionGeometry) -> None:
    points = _points(shape)
    expected = true_distance(shape, points)
    assert (expected < 0).sum() > 50 and (expected > 0).sum() > 50
    pools, radius = geometry.pools, geometry.pools.fragment.radius[1]
    for point, distance in zip(points, expected, strict=True):
        d, *rest = triangle_distance(pools.triangles, 1, radius, *point, STACK_SPACE)
        normal, closest = np.array(rest[:3]), np.array(rest[3:])
        assert abs(d - distance) <= 1e-12
        assert true_distance(shape, closest[None])[0] == pytest.approx(0.0, abs=1e-12)
        assert np.linalg.norm(normal) == pytest.approx(1.0, abs=1e-12)
        # the direction leads from the closest point outward to the point, or from the point outward to it
        assert np.allclose(closest + d * normal, point, atol=1e-12)


def test_direction_on_a_face_is_its_normal(shape: RigidShape, geometry: CollisionGeometry) -> None:
    pools, radius = geometry.pools, geometry.pools.fragment.radius[1]
    for a, b, c in shape.corners[::3]:
        d, *rest = triangle_distance(pools.triangles, 1, radius, *((a + b + c) / 3.0), STACK_SPACE)
        normal = np.cross(b - a, c - a)
        assert abs(d) <= 1e-15
        assert np.allclose(rest[:3], normal / np.linalg.norm(normal), atol=1e-12)


def test_direction_on_edges_and_corners_is_the_pseudonormal() -> None:
    geometry = CollisionGeometry()
    geometry.add_triangles(prepare_surface(*cube()))
    for point in ([0.5, 0.5, 0.25], [-0.5, 0.125, 0.5], [0.5, -0.5, 0.5], [-0.5, -0.5, -0.5]):
        expected = np.sign(point) * (np.abs(point) == 0.5)
        d, *rest = triangle_distance(geometry.pools.triangles, 0, 0.5, *point, STACK_SPACE)
        assert d == 0.0
        assert np.allclose(rest[:3], expected / np.linalg.norm(expected), atol=1e-12)


def _world_of(shape: RigidShape, *others: CollisionBody, settings: Settings = SETTINGS, **fields) -> CollisionWorld:
    world = CollisionWorld(settings)
    world.add_body(CollisionBody(1, 1, vertices=shape.vertices.ravel(), triangles=shape.triangles.ravel(), **fields))
    for other in others:
        world.add_body(other)
    return world


def test_masses_equal_those_of_trimesh(shape: RigidShape) -> None:
    trimesh = pytest.importorskip("trimesh")
    theirs = trimesh.Trimesh(shape.vertices, shape.triangles, process=False)
    theirs.density = 900.0
    registry = _world_of(shape, density=900.0).fragments()
    assert registry.masses[0] == pytest.approx(theirs.mass, rel=1e-12)
    assert np.allclose(registry.centers_of_mass, theirs.center_mass, atol=1e-12)
    xx, xy, xz, yy, yz, zz = registry.inertias[0]
    assert np.allclose([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]], theirs.moment_inertia, atol=1e-9)


@pytest.mark.parametrize("kind", [CollisionWorld, SampledWorld], ids=["nearest", "facing"])
@pytest.mark.parametrize("jitter", [0.05, 0.2])
def test_fragments_against_a_rigid_body(shape: RigidShape, jitter: float, kind: type[CollisionWorld]) -> None:
    """Gaps both ways against brute force; no sample deeper than the bound is left out. R = 1 m.

    A facing surface may be farther than the nearest, by up to `crack_normal.FARTHER`.
    """
    farther = FARTHER if kind is SampledWorld else 0.0
    case = fractured_world(ball(1.0, 0.4), seeds=5, generations=1)
    world = kind(SETTINGS if kind is CollisionWorld else Settings(threads=1, contacts_per_pair=EVERY))
    world.add_body(case.messages[0][0]._replace(body_id=1))
    world.add_body(CollisionBody(2, 500, vertices=shape.vertices.ravel(), triangles=shape.triangles.ravel()))
    world.add_fracture(case.messages[1][0])
    base = case.states(jitter, seed=3)
    turn = Rotation.random(random_state=np.random.default_rng(4))
    offset = np.array([0.9, 0.3, 0.2])
    states = FragmentStates(
        1, 1, np.append(base.fragment_ids, 500), np.append(base.positions, offset),
        np.append(base.orientations, turn.as_quat()),
    )  # fmt: skip
    answer, poses, epsilon = world.contacts(states), Poses(states), SETTINGS.penetration_tolerance
    listed = pairs_of(answer)
    depth_in = {
        f: (lambda x, f=f: case.oracle.depth(f, x, ALL_KINDS)[0]) for f in case.oracle.fragment_ids
    }
    depth_in[500] = lambda x: np.maximum(-true_distance(shape, x), 0.0)
    geometry, checked = world._registry.geometry, 0
    for fragment in case.oracle.fragment_ids:
        rows, bound = listed.get((fragment, 500), (slice(0, 0), epsilon))
        assert bound <= epsilon + 1e-9
        gaps = dict(zip(answer.contact_ids[rows].tolist(), answer.gaps[rows].tolist(), strict=True))
        for own, other in ((fragment, 500), (500, fragment)):
            points, numbers = samples_of(geometry, world._registry.row_of(own))
            depths = depth_in[other](poses.to_body(other, poses.to_world(own, points)))
            for key, depth in zip(sample_ids(own, other, numbers).tolist(), depths, strict=True):
                if key not in gaps:
                    assert depth <= bound
                elif depth > 1e-9:
                    assert depth - 1e-9 <= -gaps[key] <= depth + farther + 1e-9
                    checked += 1
    assert checked >= 10


def test_equal_geometries_share_one_preprocess() -> None:
    shape = noisy_ball()
    world = _world_of(shape)
    for i in (2, 3):
        world.add_body(CollisionBody(i, i, vertices=shape.vertices.ravel(), triangles=shape.triangles.ravel()))
    assert world.fragments().fragment_ids.tolist() == [1, 2, 3]
    pools = world._registry.geometry.pools
    assert len(pools.triangles.node_range) == 1 and len(pools.triangles.corners) == len(shape.triangles)
    assert (pools.fragment.sample_begin == pools.fragment.sample_begin[0]).all()


def test_viewers_get_the_triangles_unchanged(shape: RigidShape) -> None:
    mesh = _world_of(shape).fragment_mesh(1)
    corners = mesh.vertices.reshape(-1, 3)[mesh.triangles.reshape(-1, 3)].reshape(-1, 9)
    assert np.array_equal(
        np.unique(corners, axis=0), np.unique(shape.corners.astype(np.float32).reshape(-1, 9), axis=0)
    )
    assert not mesh.is_crack.any()
