"""Convex hulls against qhull, and the direction of least overlap against the hull of all differences."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import ConvexHull as Qhull
from scipy.spatial.transform import Rotation

from fracture_collision.core.separation.convex_hull import ConvexHull, convex_hull
from fracture_collision.core.separation.parting_direction import Hull, Parting, Relative, parting_direction

STILL = np.eye(3), np.zeros(3)
Pose = tuple[np.ndarray, np.ndarray]


def grid(count: int) -> np.ndarray:
    """(count^3, 3) points of a cube: most are within faces and edges."""
    return np.stack(np.meshgrid(*[np.arange(float(count))] * 3), axis=-1).reshape(-1, 3)


def cylinder(facets: int) -> np.ndarray:
    angle = np.arange(facets) * 2.0 * np.pi / facets
    ring = np.column_stack((np.cos(angle), np.sin(angle)))
    return np.vstack((np.column_stack((ring, np.zeros(facets))), np.column_stack((ring, np.ones(facets)))))


def clouds() -> dict[str, np.ndarray]:
    random = np.random.default_rng(1)
    ball = random.normal(size=(300, 3))
    turn = Rotation.random(random_state=1)
    return {
        **{f"{n} points": random.normal(size=(n, 3)) for n in (4, 8, 30, 1000)},
        "sphere": ball / np.linalg.norm(ball, axis=1)[:, None],
        "grid": grid(5),
        "turned grid": turn.apply(grid(5)),
        "far grid": turn.apply(grid(5)) + 1e4,
        "small grid": 1e-4 * turn.apply(grid(5)),
        "cylinder": cylinder(200),
        "needle": random.normal(size=(40, 3)) * [1.0, 1e-3, 1e-3],
    }


@pytest.mark.parametrize("name", clouds())
def test_a_hull_is_that_of_qhull(name: str) -> None:
    points = clouds()[name]
    hull, truth = convex_hull(points), Qhull(points)
    size = np.ptp(points, axis=0).max()
    beyond = points @ hull.faces[:, :3].T - hull.faces[:, 3]
    assert hull.volume == pytest.approx(truth.volume, rel=1e-3 if name == "needle" else 1e-6)
    assert beyond.max() <= 1e-12 * size and hull.outside < 2e-7 * size
    # its corners reach as far in the directions of qhull's faces
    assert (points[hull.corners] @ truth.equations[:, :3].T + truth.equations[:, 3]).max(axis=0).min() >= -hull.outside
    near = np.abs(truth.equations[:, None, :3] - hull.faces[None, :, :3]).max(axis=2).min(axis=1)
    assert near.max() < (1e-7 if name != "needle" else 1e-3)
    assert len(hull.corners) - len(hull.ridges) + len(hull.faces) == 2
    # each ridge ends on both of its faces
    for side in (2, 3):
        faces = hull.faces[hull.ridges[:, side]]
        for end in (0, 1):
            heights = (faces[:, :3] * points[hull.ridges[:, end]]).sum(axis=1) - faces[:, 3]
            assert np.abs(heights).max() < 1e-6 * size


@pytest.mark.parametrize("points", [np.ones((9, 3)), np.outer(np.arange(9.0), [1.0, 2.0, 3.0]), grid(4)[:16]])
def test_points_in_a_plane_have_no_hull(points: np.ndarray) -> None:
    assert len(convex_hull(points).corners) == 0


def test_faces_in_single_precision_stay_whole() -> None:
    for seed in range(50):
        points = Rotation.random(random_state=seed).apply(grid(5)).astype(np.float32).astype(np.float64)
        assert len(convex_hull(points).faces) == 6


def hull_of(points: np.ndarray) -> Hull:
    hull: ConvexHull = convex_hull(points)
    row = np.full(len(points), -1)
    row[hull.corners] = np.arange(len(hull.corners))
    ridges = np.column_stack((row[hull.ridges[:, :2]], hull.ridges[:, 2:]))
    return Hull(*np.ascontiguousarray(points[hull.corners].T), hull.faces, ridges)


def relative(a: tuple[Pose, Pose], b: tuple[Pose, Pose]) -> Relative:
    """From the poses of both, now and at the end."""
    frame = b[0][0]
    return Relative(
        np.array([pose[0].T @ frame for pose in a]), np.array([pose[0].T @ frame for pose in b]),
        np.array([frame.T @ (of_b[1] - of_a[1]) for of_a, of_b in zip(a, b, strict=True)]),
    )  # fmt: skip


def apart_along(a: np.ndarray, b: np.ndarray, n: np.ndarray) -> float:
    return float((b @ n).min() - (a @ n).max())


def placed(points: np.ndarray, pose: Pose) -> np.ndarray:
    return points @ pose[0].T + pose[1]


def test_the_direction_is_that_of_least_overlap() -> None:
    random, overlapping = np.random.default_rng(3), 0
    for trial in range(400):
        a, b = (random.normal(size=(random.integers(6, 30), 3)) for _ in range(2))
        if trial % 3 == 0:
            a = (grid(2) - 0.5) * random.uniform(0.3, 2.0, 3)
        if trial % 9 == 0:
            b = (grid(3) - 1.0) * random.uniform(0.3, 1.0, 3)
        poses = [(Rotation.random(random_state=random).as_matrix(), random.normal(size=3)) for _ in range(2)]
        parting: Parting = parting_direction(
            hull_of(a), hull_of(b), relative((poses[0],) * 2, (poses[1],) * 2), 1e-9, np.zeros(3)
        )
        of_a, of_b = placed(a, poses[0]), placed(b, poses[1])
        facets = Qhull((of_b[None] - of_a[:, None]).reshape(-1, 3)).equations
        if facets[:, 3].max() > 0.0:  # the origin is outside: they are apart
            continue
        overlapping += 1
        assert not parting.is_apart
        n = poses[1][0] @ [parting.x, parting.y, parting.z]
        assert parting.now == pytest.approx(apart_along(of_a, of_b, n), abs=1e-12)
        assert parting.now == pytest.approx(facets[:, 3].max(), abs=1e-8)
        assert parting.end == pytest.approx(parting.now, abs=1e-12)
    assert overlapping > 150


def of_cubes(now: list[float], end: list[float]) -> Parting:
    """A second cube of 0.1 m at `now`, `end` from the first."""
    cube = hull_of(0.1 * (grid(2) - 0.5))
    eye = np.eye(3)
    return parting_direction(
        cube, cube, relative((STILL, STILL), ((eye, np.array(now)), (eye, np.array(end)))), 1e-4, np.zeros(3)
    )


def test_two_that_pass_a_corner_are_apart() -> None:
    """Each face separates them at one time only."""
    assert of_cubes([0.2, 0.0, 0.05], [0.05, 0.0, 0.25]).is_apart
