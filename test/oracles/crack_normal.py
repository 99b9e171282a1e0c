"""The slow twin of core/field/crack_normal: normal and depth of a contact between two fragments of one body.

Uses the oracle's polygons and planes alone: all polygons that the two share are measured, and the exit point is the
ray's first crossing of any of the fragment's surface triangles.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fracture_collision.geometry.tetrahedra import EDGE_VERTICES
from oracles.brute_force import distances_to_triangles
from oracles.fragmented_body import FragmentedBody, SurfacePolygon

TIMES_NEAREST = 3.0
FARTHER = 0.03
OBLIQUE, LITTLE = 4.0, 1e-3
# Two polygons whose distances differ by less than this share of R are equally near: rounding may choose either.
TIE = 1e-9


class Turned(NamedTuple):
    normal: np.ndarray  # (3,) unit, out of the queried fragment
    depth: float  # [m] along it, negative outside; NaN: the ray does not exit near enough


class SharedCrack:
    """The polygons that fragment `f` of a body shares with `g`, and all of f's border."""

    def __init__(self, body: FragmentedBody, f: int, g: int) -> None:
        self._body, self._f, self._g = body, f, g
        self._polygons = [polygon for polygon in body.surface_polygons(f) if polygon.other == g]
        self._triangles = np.array([polygon.points for polygon in self._polygons]).reshape(-1, 3, 3)
        self._border = body.surface_triangles(f)
        self._radius = 0.5 * float(np.ptp(body.vertices, axis=0).max())

    def turned(self, x: np.ndarray, depth: float, near: float) -> list[Turned]:
        """All correct answers for a sample of g at x (3,) [m], `depth` [m] from the border of f, negative outside.

        `near` [m]: the detection tolerance. Several where polygons are equally near; none where no crack is near, or x
        is outside the unbroken body.
        """
        if not len(self._triangles) or (depth < 0.0 and self._body.locate(x[None])[0] < 0):
            return []
        within = depth + FARTHER * self._radius if depth >= 0.0 else max(-TIMES_NEAREST * depth, near)
        distance, _ = distances_to_triangles(x, self._triangles)
        if distance.min() > within:
            return []
        answers, longest = [], within if depth >= 0.0 else near
        for i in np.flatnonzero(distance <= distance.min() + TIE * self._radius):
            normal = self._direction(self._polygons[i])
            length = self._first_crossing(x, normal if depth >= 0.0 else -normal)
            found = length <= min(longest, OBLIQUE * distance[i] + LITTLE * self._radius)
            answers.append(Turned(normal, float(np.copysign(length, depth)) if found else float("nan")))
        return answers

    def _direction(self, polygon) -> np.ndarray:
        total = self._sum_of_planes(polygon.tetrahedron)
        return total / np.linalg.norm(total) if total.any() else _normal_of(polygon)

    def _sum_of_planes(self, t: int) -> np.ndarray:
        """Sum over the cut edges of tetrahedron t between the two, of each plane's normal out of f."""
        total = np.zeros(3)
        for a, b in np.sort(self._body.tetrahedra[t][EDGE_VERTICES], axis=1).tolist():
            ends = int(self._body.labels[a]), int(self._body.labels[b])
            if set(ends) == {self._f, self._g}:
                total += self._body.planes[a, b][:3] * (1.0 if ends[0] == self._f else -1.0)
        return total

    def _first_crossing(self, x: np.ndarray, way: np.ndarray) -> float:
        """Length [m] of the ray to the nearest of the border's triangles (Moeller, Trumbore 1997); infinity: none."""
        a = self._border[:, 0]
        u, v = self._border[:, 1] - a, self._border[:, 2] - a
        p = np.cross(way, v)
        determinant = (u * p).sum(axis=1)
        with np.errstate(divide="ignore", invalid="ignore"):
            inverse = 1.0 / determinant
            s = x - a
            first = (s * p).sum(axis=1) * inverse
            q = np.cross(s, u)
            second = q @ way * inverse
            length = (v * q).sum(axis=1) * inverse
            hit = (first >= -1e-9) & (second >= -1e-9) & (first + second <= 1.0 + 1e-9) & (length >= 0.0)
        return float(length[hit].min()) if hit.any() else float("inf")


def _normal_of(polygon: SurfacePolygon) -> np.ndarray:
    normal = np.cross(polygon.points[1] - polygon.points[0], polygon.points[2] - polygon.points[0])
    return normal / np.linalg.norm(normal)
