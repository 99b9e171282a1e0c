"""Meshes that scenes have no shape for, and flat bodies of each kind. Lengths in m."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from fracture_collision.geometry.generators import TetGeometry, brick, oriented

TRIANGLES = "triangles"  # the kind whose meshes the service gets as their surfaces alone: rigid bodies


def flat(kind: str, *sides: float) -> dict[str, Any]:
    """The shape of a body with flat sides [m]."""
    if kind == "box":
        return {"box": {"size": list(sides)}}
    # Of triangles two a side, however long it is, as in meshes that people bring.
    edge = max(sides) if kind == TRIANGLES else min(sides) / cells(kind)
    return {"brick": {"size_xyz": list(sides), "edge_length": edge}}


def cells(kind: str) -> int:
    """Of a mesh of this kind, along its shortest side."""
    return int(kind.removeprefix("brick")) if kind.startswith("brick") else 1


def mesh(geometry: TetGeometry) -> dict[str, Any]:
    """A shape that `scene_of` stores in a file, as scenes take it."""
    return {"mesh": geometry._asdict()}


def tetrahedron(edge: float) -> dict[str, Any]:
    """A regular one about its centre of mass, a corner above."""
    low, radius = -edge / math.sqrt(24.0), edge / math.sqrt(3.0)
    base = [(radius * math.cos(turn), radius * math.sin(turn), low) for turn in 2.0 * math.pi / 3.0 * np.arange(3)]
    return mesh(oriented(np.array([*base, (0.0, 0.0, -3.0 * low)]), np.array([(0, 1, 2, 3)])))


def needle(half_length: float, half_width: float) -> dict[str, Any]:
    """Two slim pyramids, base on base, along x."""
    x, y, z = np.diag([half_length, half_width, half_width])
    around = [(2, 4), (4, 3), (3, 5), (5, 2)]
    return mesh(oriented(np.array([x, -x, y, -y, z, -z]), np.array([(0, 1, *pair) for pair in around])))


def voussoir(kind: str, inner: float, outer: float, depth: float, angle: float) -> dict[str, Any]:
    """A stone of an arch about the y axis, `angle` [rad] of it, about the z axis; its faces are flat."""
    n = cells(kind)
    lattice = brick((n, n, n), 1.0)
    u, v, w = (lattice.vertices / n).T
    radius = inner + (outer - inner) * (w + 0.5)
    points = np.column_stack((2.0 * u * radius * math.sin(0.5 * angle), depth * v, radius * math.cos(0.5 * angle)))
    return mesh(oriented(points, lattice.tetrahedra))


def tube(kind: str, inner: float, outer: float, height: float, sides: int) -> dict[str, Any]:
    """A block along z with a hole through it, both regular polygons; inner, outer: from the axis to their sides."""
    n = cells(kind)
    lattice = brick((sides, n, n), 1.0)
    u, v, w = (lattice.vertices / (1, n, n)).T
    radius = (inner + (outer - inner) * (v + 0.5)) / math.cos(math.pi / sides)
    angle = 2.0 * math.pi * ((u + 0.5 * sides) % sides + 0.5) / sides
    points = np.column_stack((radius * np.cos(angle), radius * np.sin(angle), height * w))
    points, merged = np.unique(np.round(points, 12), axis=0, return_inverse=True)
    return mesh(oriented(points, merged.reshape(-1)[lattice.tetrahedra]))


def box_spins(*sides: float) -> np.ndarray:
    """Moments of inertia (3,) [m2] of a box, per mass."""
    squares = np.square(sides)
    return (squares.sum() - squares) / 12.0
