"""Hulls and surfaces of all fragments, which their contacts are made from."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fracture_collision.core.memory.compiled import inlined_kernel, kernel
from fracture_collision.core.memory.kinds import BOX, TRIANGLES, WITH_FACES
from fracture_collision.core.memory.pools import GrowableArray, Pools
from fracture_collision.core.mesh.point_location import holds_fragment
from fracture_collision.core.mesh.sample_numbers import FIRST_TETRAHEDRON
from fracture_collision.core.mesh.surface_elements import count_triangles, put_triangle
from fracture_collision.core.patches.surface import Surface, make_surface
from fracture_collision.core.separation.convex_hull import convex_hull
from fracture_collision.core.separation.parting_direction import Hull

# A fragment is convex if its hull's volume exceeds its own by no more than this share.
CONVEX = 1e-6


class Shapes(NamedTuple):
    """Rows of each fragment are together; indices within them count from its first."""

    first: np.ndarray  # (F + 1, 6) int64 first row of: hull corners, faces, ridges; surface corners, triangles, edges
    size: np.ndarray  # (F,) float64 [m] longest side of its box; 0: it has no surface
    is_convex: np.ndarray  # (F,) bool
    hull: Hull
    surface: Surface


class ShapeTable:
    """Owns the arrays; fragments have the same rows as in FragmentPool."""

    def __init__(self) -> None:
        self._first = GrowableArray(6, np.int64)
        self._first.append(np.zeros((1, 6), np.int64))
        self._size, self._is_convex = GrowableArray(0, np.float64), GrowableArray(0, np.bool_)
        self._hull = [
            *(GrowableArray(0, np.float64) for _ in range(3)), GrowableArray(4, np.float64), GrowableArray(4, np.int64),
        ]  # fmt: skip
        self._surface = [
            GrowableArray(3, np.float64), GrowableArray(3, np.int32), GrowableArray(3, np.float64),
            GrowableArray(2, np.int32), GrowableArray(2, np.int32), GrowableArray(0, np.bool_),
        ]  # fmt: skip

    @property
    def view(self) -> Shapes:
        """The Shapes of all fragments: views of the arrays."""
        return Shapes(
            self._first.view, self._size.view, self._is_convex.view, Hull(*(column.view for column in self._hull)),
            Surface(*(column.view for column in self._surface)),
        )  # fmt: skip

    def append(self, pools: Pools, first: int, end: int) -> None:
        """Add the shapes of the fragments first .. end - 1, which were made last."""
        for f in range(first, end):
            self.add(triangles_of(pools, f))

    def add(self, triangles: np.ndarray) -> None:
        """Add the shape of the next fragment: corners (n, 9) [m] of its surface."""
        hull, surface, size, is_convex = shape_of(triangles)
        for column, rows in zip((*self._hull, *self._surface), (*hull, *surface), strict=True):
            column.append(rows)
        counts = len(hull.x), len(hull.faces), len(hull.ridges), *map(len, (surface[0], surface[1], surface[3]))
        self._first.append(self._first.view[-1:] + counts)
        self._size.append(np.array([size]))
        self._is_convex.append(np.array([is_convex]))


@kernel
def shape_of(triangles):
    """Hull, Surface, longest side of its box [m], and whether it is convex, of a closed surface (n, 9) [m]."""
    surface = make_surface(triangles)
    corners = surface.corners
    points = convex_hull(corners)
    row = np.full(len(corners), -1)
    for k in range(len(points.corners)):
        row[points.corners[k]] = k
    ridges = points.ridges
    for r in range(len(ridges)):
        ridges[r, 0], ridges[r, 1] = row[ridges[r, 0]], row[ridges[r, 1]]
    chosen = corners[points.corners]
    hull = Hull(chosen[:, 0].copy(), chosen[:, 1].copy(), chosen[:, 2].copy(), points.faces, ridges)
    size, volume = 0.0, 0.0
    for t in range(len(surface.triangles)):
        p, q, r = surface.triangles[t]
        a, b, c = corners[p] - corners[0], corners[q] - corners[0], corners[r] - corners[0]
        volume += a[0] * (b[1] * c[2] - b[2] * c[1]) + a[1] * (b[2] * c[0] - b[0] * c[2])
        volume += a[2] * (b[0] * c[1] - b[1] * c[0])
    for d in range(3 if len(corners) else 0):
        size = max(size, corners[:, d].max() - corners[:, d].min())
    return hull, surface, size, len(corners) > 0 and volume / 6.0 >= (1.0 - CONVEX) * points.volume


@inlined_kernel
def hull_of(shapes, f):
    """The Hull of fragment f: views."""
    c, d = shapes.first[f], shapes.first[f + 1]
    h = shapes.hull
    return Hull(h.x[c[0] : d[0]], h.y[c[0] : d[0]], h.z[c[0] : d[0]], h.faces[c[1] : d[1]], h.ridges[c[2] : d[2]])


@inlined_kernel
def surface_of(shapes, f):
    """The Surface of fragment f: views."""
    c, d = shapes.first[f], shapes.first[f + 1]
    s = shapes.surface
    return Surface(
        s.corners[c[3] : d[3]], s.triangles[c[4] : d[4]], s.normals[c[4] : d[4]], s.edges[c[5] : d[5]],
        s.beside[c[5] : d[5]], s.is_sharp[c[3] : d[3]],
    )  # fmt: skip


@kernel
def triangles_of(pools, f):
    """Corners (n, 9) [m] in the body frame of the triangles of fragment f's surface, counter-clockwise from outside."""
    pieces = _pieces_of(pools, f)
    most = 0
    for piece in pieces:
        most += count_triangles(pools, f, piece)
    out, used, still, here = np.empty((most, 9)), 0, np.eye(3), np.zeros(3)
    for piece in pieces:
        for k in range(count_triangles(pools, f, piece)):
            if put_triangle(pools, f, piece, k, still, here, out[used]):
                used += 1
    return out[:used]


@inlined_kernel
def _pieces_of(pools, f):
    """Pieces that may hold triangles of fragment f's surface, for put_triangle."""
    kind, k = pools.fragment.kind[f], pools.fragment.mesh[f]
    if kind not in WITH_FACES:
        return np.arange(0)
    if kind == BOX:
        return np.arange(6)
    if kind == TRIANGLES:
        return np.arange(pools.triangles.triangle_range[k, 0], pools.triangles.triangle_range[k, 1])
    first = pools.mesh.first[k, FIRST_TETRAHEDRON]
    end = len(pools.mesh.tetrahedra)
    if k + 1 < len(pools.mesh.first):
        end = pools.mesh.first[k + 1, FIRST_TETRAHEDRON]
    pieces, used = np.empty(end - first, np.int64), 0
    for t in range(first, end):
        if holds_fragment(pools, f, t):
            pieces[used] = t
            used += 1
    return pieces[:used]
