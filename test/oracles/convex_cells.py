"""Convex polyhedra as lists of labelled faces: clipping by half-spaces, volume moments.

No tolerance enters a clip: a point is inside, outside or exactly on the plane by the sign of its computed value, and
the two sides of one plane get exactly opposite values. Two complementary clips therefore divide a polyhedron without
gap or overlap beyond the rounding of the new points.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np


class Face(NamedTuple):
    label: tuple
    points: np.ndarray  # (k, 3), counter-clockwise from outside


def tetrahedron(corners: np.ndarray) -> list[Face]:
    """The four faces of a positively oriented tetrahedron, face i opposite corner i, labelled ("face", i)."""
    order = ((1, 2, 3), (0, 3, 2), (0, 1, 3), (0, 2, 1))
    return [Face(("face", i), corners[list(corner)]) for i, corner in enumerate(order)]


def clip(cell: list[Face], normal: np.ndarray, offset: float, label: tuple) -> list[Face]:
    """The part of a convex cell where normal . x >= offset; the new face carries `label`. Empty if nothing is left."""
    values = [face.points @ normal - offset for face in cell]
    if all(np.all(v >= 0.0) for v in values):
        return cell
    if all(np.all(v <= 0.0) for v in values):
        return []
    kept, rim = [], {}
    for face, value in zip(cell, values, strict=True):
        points = clip_polygon(face.points, value)
        on_plane = [tuple(p) for p, v in zip(face.points, value, strict=True) if v == 0.0]
        rim.update(dict.fromkeys(on_plane))
        rim.update(dict.fromkeys(tuple(p) for p, v in _crossings(face.points, value)))
        if len(points) >= 3:
            kept.append(Face(face.label, points))
    if len(rim) >= 3:
        kept.append(Face(label, _counter_clockwise(np.array(list(rim)), -normal)))
    return kept


def clip_polygon(points: np.ndarray, values: np.ndarray) -> np.ndarray:
    """The part of a convex polygon where the linear function with these `values` at its points is not negative."""
    if values.min(initial=0.0) >= 0.0:
        return points
    crossing = {i: p for p, i in _crossings(points, values)}
    result = []
    for i in range(len(points)):
        if values[i] >= 0.0:
            result.append(points[i])
        if i in crossing:
            result.append(crossing[i])
    return np.array(result).reshape(-1, 3)


def _crossings(points: np.ndarray, values: np.ndarray) -> list[tuple[np.ndarray, int]]:
    """Points where the outline crosses zero, with the index of the preceding corner.

    Always computed from the inner end, so that two faces that share an edge get the same bytes.
    """
    found, values = [], values.tolist()
    for i in range(len(points)):
        j = i + 1 if i + 1 < len(points) else 0
        inner, outer = (i, j) if values[i] > 0.0 else (j, i)
        if values[inner] > 0.0 > values[outer]:
            t = values[inner] / (values[inner] - values[outer])
            found.append((points[inner] + t * (points[outer] - points[inner]), i))
    return found


def _counter_clockwise(points: np.ndarray, normal: np.ndarray) -> np.ndarray:
    helper = np.zeros(3)
    helper[np.argmin(np.abs(normal))] = 1.0
    u = cross(normal, helper)
    u /= np.linalg.norm(u)
    v = cross(normal / np.linalg.norm(normal), u)
    centred = points - points.mean(axis=0)
    return points[np.argsort(np.arctan2(centred @ v, centred @ u), kind="stable")]


def cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """As numpy.cross for (3,) or (n, 3), without its overhead on small arrays."""
    (a0, a1, a2), (b0, b1, b2) = a.T, b.T
    return np.stack((a1 * b2 - a2 * b1, a2 * b0 - a0 * b2, a0 * b1 - a1 * b0), axis=-1)


def area_vector(points: np.ndarray) -> np.ndarray:
    """Area [m2] times unit normal of a polygon."""
    edges = points[1:] - points[0]
    return 0.5 * cross(edges[:-1], edges[1:]).sum(axis=0)


def moments(cell: list[Face]) -> tuple[float, np.ndarray, np.ndarray]:
    """Integrals of 1, x and x x^T over the cell: volume, (3,), (3, 3)."""
    volume, first, second = 0.0, np.zeros(3), np.zeros((3, 3))
    apex = np.concatenate([face.points for face in cell]).mean(axis=0) if cell else np.zeros(3)
    for face in cell:
        for b, c in zip(face.points[1:-1], face.points[2:], strict=True):
            corners = np.array([apex, face.points[0], b, c])
            v = np.linalg.det(corners[1:] - apex) / 6.0
            total = corners.sum(axis=0)
            volume += v
            first += v * total / 4.0
            second += v / 20.0 * (corners.T @ corners + np.outer(total, total))
    return volume, first, second
