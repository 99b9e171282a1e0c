"""Depth of two bodies' surfaces in each other, at dense points, by libigl. Independent of the service.

A triangle that could contain a deeper point than required is halved until its points are no farther apart than
`finest`: depth is 1-Lipschitz.
"""

from __future__ import annotations

from typing import NamedTuple

import igl
import numpy as np

SLIVER = 1e-3
FOLDED = 1e-9  # [m] corners this near coincide


class Deepest(NamedTuple):
    depth: float  # [m] of the deepest tested point; 0: none is inside
    point: np.ndarray  # (3,) [m] in the frame of the solid


class Solid:
    """A closed surface (t, 3, 3) [m], counter-clockwise from outside."""

    def __init__(self, triangles: np.ndarray) -> None:
        self.triangles = _without_folds(np.ascontiguousarray(triangles, dtype=np.float64))
        self._vertices = self.triangles.reshape(-1, 3)
        self._faces = np.arange(len(self._vertices)).reshape(-1, 3)
        self._tree = igl.AABB()
        self._tree.init(self._vertices, self._faces)
        a, b, c = self.triangles.transpose(1, 0, 2)
        normals = np.cross(b - a, c - a)
        area = np.linalg.norm(normals, axis=1)
        self._normals = normals / np.maximum(area, 1e-300)[:, None]
        longest = np.linalg.norm(self.triangles - np.roll(self.triangles, 1, axis=1), axis=2).max(axis=1)
        self._is_sliver = area < SLIVER * longest**2  # a sliver's normal is unreliable
        self.low, self.high = self._vertices.min(axis=0), self._vertices.max(axis=0)

    def holds(self, points: np.ndarray) -> np.ndarray:
        """Whether each point is inside, (n,) bool, by the winding number."""
        if not len(points):
            return np.zeros(0, bool)
        return np.atleast_1d(igl.fast_winding_number(self._vertices, self._faces, np.ascontiguousarray(points))) > 0.5

    def signed(self, points: np.ndarray) -> np.ndarray:
        """Distance (n,) [m] of points (n, 3) from the surface, negative inside."""
        if not len(points):
            return np.zeros(0)
        points = np.ascontiguousarray(points)
        squared, face, closest = self._tree.squared_distance(self._vertices, self._faces, points)
        away, distance = points - np.atleast_2d(closest), np.sqrt(np.atleast_1d(squared))
        above = (away * self._normals[np.atleast_1d(face)]).sum(axis=1)
        # the nearest triangle's side is reliable if the direction to it is along its normal: not at its rim, and not
        # where the oracle's surface is folded
        unsure = np.flatnonzero((np.abs(above) < distance * (1.0 - 1e-9)) | self._is_sliver[np.atleast_1d(face)])
        inside = above < 0.0
        if len(unsure):
            inside[unsure] = self.holds(points[unsure])
        return np.where(inside, -distance, distance)

    def deepest_of(self, triangles: np.ndarray, more_than: float, finest: float) -> Deepest:
        """The deepest point of `triangles` (t, 3, 3) [m] in this solid; depth 0 if none is deeper than `more_than` [m].

        Wherever a point may be deeper, a tested point is within `finest`.
        """
        best, deepest = Deepest(0.0, np.zeros(3)), max(more_than, 0.0)
        corners = triangles
        while len(corners):
            middle = corners.mean(axis=1)
            r = np.linalg.norm(corners - middle[:, None], axis=2).max(axis=1)
            beyond = np.maximum(np.maximum(self.low - middle, middle - self.high), 0.0)
            near = (beyond**2).sum(axis=1) < r**2
            corners, middle, r = corners[near], middle[near], r[near]
            depth = -self.signed(middle)
            deeper = np.flatnonzero(depth > deepest)
            deeper = deeper[self.holds(middle[deeper])]
            if len(deeper):
                k = deeper[np.argmax(depth[deeper])]
                deepest = float(depth[k])
                best = Deepest(deepest, middle[k])
            corners = _halved(corners[(depth + r > deepest) & (r > finest)])
        return best


def _without_folds(triangles: np.ndarray) -> np.ndarray:
    """Without triangles that another covers with opposite orientation: nothing is between the two."""
    places = np.sort(np.round(triangles / FOLDED).astype(np.int64).view("i8,i8,i8").reshape(-1, 3), axis=1)
    _, same, count = np.unique(places, axis=0, return_inverse=True, return_counts=True)
    return triangles[count[same.ravel()] == 1]


def _halved(corners: np.ndarray) -> np.ndarray:
    """Each triangle (t, 3, 3) split at the middle of its longest side."""
    sides = np.linalg.norm(corners - np.roll(corners, -1, axis=1), axis=2)
    turned = (np.argmax(sides, axis=1)[:, None] + np.arange(3)) % 3
    a, b, c = (corners[np.arange(len(corners)), turned[:, k]] for k in range(3))
    middle = 0.5 * (a + b)
    return np.concatenate([np.stack([a, middle, c], axis=1), np.stack([middle, b, c], axis=1)])
