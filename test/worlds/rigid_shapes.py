"""Closed triangle meshes for tests, with brute-force distances and winding numbers over all triangles."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from oracles.brute_force import nearest_on_triangles

from fracture_collision.geometry.generators import TetGeometry, ball
from fracture_collision.geometry.tetrahedra import boundary_triangles


class RigidShape(NamedTuple):
    vertices: np.ndarray  # (n, 3) [m]
    triangles: np.ndarray  # (t, 3), counter-clockwise from outside

    @property
    def corners(self) -> np.ndarray:
        return self.vertices[self.triangles]


def boundary_of(body: TetGeometry) -> RigidShape:
    """The surface of a tetrahedral mesh, its vertices renumbered."""
    triangles = boundary_triangles(body.tetrahedra)
    used, index = np.unique(triangles, return_inverse=True)
    return RigidShape(body.vertices[used], index.reshape(-1, 3))


def box_of_quads(x: np.ndarray, y: np.ndarray, z: np.ndarray, solid: np.ndarray) -> RigidShape:
    """The boundary of the solid cells of a grid with coordinates x, y, z; solid (nx - 1, ny - 1, nz - 1) bool."""
    points: dict[tuple[int, int, int], int] = {}
    triangles = []
    filled = np.pad(solid, 1)
    for cell in np.argwhere(filled):
        for axis in range(3):
            for side in (0, 1):
                beyond = cell.copy()
                beyond[axis] += 2 * side - 1
                if filled[tuple(beyond)]:
                    continue
                corner = cell - 1
                corner[axis] += side
                u, v = np.eye(3, dtype=int)[(axis + 1) % 3], np.eye(3, dtype=int)[(axis + 2) % 3]
                quad = [corner, corner + u, corner + u + v, corner + v]
                a, b, c, d = (points.setdefault(tuple(q.tolist()), len(points)) for q in (quad if side else quad[::-1]))
                triangles += [(a, b, c), (a, c, d)]
    grid = np.array(list(points))
    return RigidShape(np.column_stack([x[grid[:, 0]], y[grid[:, 1]], z[grid[:, 2]]]), np.array(triangles))


def cube() -> RigidShape:
    sides = np.array([-0.5, 0.5])
    return box_of_quads(sides, sides, sides, np.ones((1, 1, 1), bool))


def l_block() -> RigidShape:
    solid = np.ones((2, 2, 1), bool)
    solid[1, 1, 0] = False
    return box_of_quads(np.array([-1.0, 0.0, 0.7]), np.array([-0.5, 0.1, 1.0]), np.array([-0.3, 0.3]), solid)


def hollow_box() -> RigidShape:
    """A box with a cavity: two surfaces, the inner one oriented towards the cavity."""
    solid = np.ones((3, 3, 3), bool)
    solid[1, 1, 1] = False
    steps = np.array([-0.9, -0.5, 0.4, 0.9])
    return box_of_quads(steps, steps, steps, solid)


def torus(major: float = 1.0, minor: float = 0.35, around: int = 40, across: int = 18) -> RigidShape:
    u, v = np.meshgrid(np.arange(around), np.arange(across), indexing="ij")
    phi, theta = 2 * np.pi * u / around, 2 * np.pi * v / across
    rim = major + minor * np.cos(theta)
    vertices = np.stack([rim * np.cos(phi), rim * np.sin(phi), minor * np.sin(theta)], axis=-1).reshape(-1, 3)
    a, b = u * across + v, (u + 1) % around * across + v
    c, d = (u + 1) % around * across + (v + 1) % across, u * across + (v + 1) % across
    quads = np.stack([a, b, c, d], axis=-1).reshape(-1, 4)
    return RigidShape(vertices, np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]]))


def together(*shapes: RigidShape) -> RigidShape:
    first = np.cumsum([0] + [len(shape.vertices) for shape in shapes])
    return RigidShape(
        np.concatenate([shape.vertices for shape in shapes]),
        np.concatenate([shape.triangles + begin for shape, begin in zip(shapes, first, strict=False)]),
    )


def noisy_ball(seed: int = 8) -> RigidShape:
    """A ball with bumps and spikes: sharp convex and concave edges and corners everywhere."""
    shape = boundary_of(ball(1.0, 0.2))
    random = np.random.default_rng(seed)
    return shape._replace(vertices=shape.vertices * random.uniform(0.75, 1.25, (len(shape.vertices), 1)))


def true_distance(shape: RigidShape, points: np.ndarray) -> np.ndarray:
    """Signed distance (n,) [m], positive outside, over all triangles."""
    distance, _ = nearest_on_triangles(points, shape.corners)
    return np.where(winding_number(shape.corners, points) > 0.5, -distance, distance)


def winding_number(corners: np.ndarray, points: np.ndarray) -> np.ndarray:
    """The solid angles of all triangles (t, 3, 3), in turns: 1 inside, 0 outside (van Oosterom, Strackee 1983)."""
    result = np.empty(len(points))
    for i, x in enumerate(points):
        a, b, c = (corners[:, k] - x for k in range(3))
        la, lb, lc = (np.sqrt((v * v).sum(axis=1)) for v in (a, b, c))
        above = np.linalg.det(np.stack([a, b, c], axis=1))
        below = la * lb * lc + (a * b).sum(axis=1) * lc + (b * c).sum(axis=1) * la + (c * a).sum(axis=1) * lb
        result[i] = 2.0 * np.arctan2(above, below).sum() / (4.0 * np.pi)
    return result
