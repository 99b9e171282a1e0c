"""Hulls and surfaces of all fragments, which their contacts are made from."""

from __future__ import annotations

import math
from typing import Annotated

import numpy as np

from fracture_collision.core.edges.ridges import Ridges
from fracture_collision.core.memory.compiled import kernel, query_kernel
from fracture_collision.core.memory.kinds import BOX, TETRAHEDRA, TRIANGLES
from fracture_collision.core.memory.pools import BACK_SIDE, FRAGMENT, FRONT_SIDE, NEVER_BROKEN, OWNER, ROW, Pools
from fracture_collision.core.memory.struct import Struct
from fracture_collision.core.memory.tables import Column, Table
from fracture_collision.core.memory.vectors import area_vector, corners_of, cross, dot, length, minus, vector, vector_at
from fracture_collision.core.mesh.cut_tetrahedron import FACE_VERTICES
from fracture_collision.core.mesh.sample_numbers import FIRST_TETRAHEDRON
from fracture_collision.core.mesh.surface_elements import count_triangles, put_triangle
from fracture_collision.core.patches.surface import CONVEX_EDGE, CORNER, FACET, Surface, make_surface
from fracture_collision.core.separation.convex_hull import convex_hull
from fracture_collision.core.separation.parting_direction import HULL_CORNER, HULL_FACE, HULL_RIDGE, Hull

# A fragment is convex if its hull's volume exceeds its own by no more than this share.
CONVEX = 1e-6
# It is surely not where a corner is above the plane of a triangle by this share of its size. So many triangles are
# looked at for that first: curved fragments need no hull.
CONCAVE, LOOKED_AT = 1e-3, 16


# What has rows in `begin` and `end` of Shapes.
OF_ROWS = (HULL_CORNER, HULL_FACE, HULL_RIDGE, CORNER, FACET, CONVEX_EDGE)


class Shapes(Struct):
    """Rows of each fragment are together; indices within them count from its first."""

    begin: Annotated[np.ndarray, Column(FRAGMENT, np.int64, 6, OF_ROWS)]  # first row of each kind
    end: Annotated[np.ndarray, Column(FRAGMENT, np.int64, 6, OF_ROWS)]
    size: Annotated[np.ndarray, Column(FRAGMENT, np.float64)]  # [m] longest side of its box; 0: no hull, no surface
    is_convex: Annotated[np.ndarray, Column(FRAGMENT, np.bool_)]
    hull: Hull
    surface: Surface


NO_SHAPES = Table(Shapes).view


def append_shapes(table: Table[Shapes], triangles: np.ndarray, begin: np.ndarray) -> None:
    """Add the shapes of the next fragments, by their triangles_of."""
    ends, size, is_convex, hull, surface = shapes_of(triangles, begin)
    hulls, surfaces = table.tables["hull"], table.tables["surface"]
    first = np.array([
        *(hulls[name].used for name in ("x", "faces", "ridges")),
        *(surfaces[name].used for name in ("corners", "triangles", "edges")),
    ])  # fmt: skip
    for columns, rows in ((hulls, hull), (surfaces, surface)):
        for column, values in zip(columns, rows, strict=True):
            column.append(values)
    table["begin"].append(first + np.vstack((np.zeros((1, 6), np.int64), ends[:-1])))
    table["end"].append(first + ends)
    table["size"].append(size)
    table["is_convex"].append(is_convex)


class Geometry(Struct):
    """What a search reads."""

    pools: Pools
    edges: Ridges  # of all rows; NO_RIDGES where crossings are not searched
    shapes: Shapes = NO_SHAPES  # of all rows; NO_SHAPES where no contacts are patches


@query_kernel
def have_patches(shapes, a, b):
    """Whether contacts of fragments a and b are patches (NO_SHAPES: none are)."""
    return len(shapes.size) > 0 and shapes.is_convex[a] and shapes.is_convex[b]


@kernel
def shapes_of(triangles, begin):
    """Of fragments with triangles begin[k] .. begin[k + 1]: first (k, 6), size, is_convex, hull and surface of Shapes.

    Rows of `first` are the ends of each one's rows. Fragments that are surely concave get none, and size 0.
    """
    n, count = len(triangles), len(begin) - 1
    first, size, is_convex = np.zeros((count, 6), np.int64), np.empty(count), np.empty(count, np.bool_)
    hull = Hull(
        np.empty(3 * n), np.empty(3 * n), np.empty(3 * n), np.empty((6 * n, 4)), np.empty((9 * n, 4), np.int64)
    )  # fmt: skip
    surface = Surface(
        np.empty((3 * n, 3)), np.empty((n, 3), np.int32), np.empty((n, 3)), np.empty((3 * n, 2), np.int32),
        np.empty((3 * n, 2), np.int32), np.empty(3 * n, np.bool_),
    )  # fmt: skip
    at = np.zeros(6, np.int64)
    for k in range(count):
        own = triangles[begin[k] : begin[k + 1]]
        h, s, size[k], is_convex[k] = shape_of(own[: 0 if _is_surely_concave(own) else len(own)])
        end = at + np.array(
            [len(h.x), len(h.faces), len(h.ridges), len(s.corners), len(s.triangles), len(s.edges)]
        )  # fmt: skip
        hull.x[at[0] : end[0]], hull.y[at[0] : end[0]], hull.z[at[0] : end[0]] = h.x, h.y, h.z
        hull.faces[at[1] : end[1]], hull.ridges[at[2] : end[2]] = h.faces, h.ridges
        surface.corners[at[3] : end[3]], surface.is_sharp[at[3] : end[3]] = s.corners, s.is_sharp
        surface.triangles[at[4] : end[4]], surface.normals[at[4] : end[4]] = s.triangles, s.normals
        surface.edges[at[5] : end[5]], surface.beside[at[5] : end[5]] = s.edges, s.beside
        first[k] = at = end
    hull = Hull(hull.x[: at[0]], hull.y[: at[0]], hull.z[: at[0]], hull.faces[: at[1]], hull.ridges[: at[2]])
    surface = Surface(
        surface.corners[: at[3]], surface.triangles[: at[4]], surface.normals[: at[4]], surface.edges[: at[5]],
        surface.beside[: at[5]], surface.is_sharp[: at[3]],
    )  # fmt: skip
    return first, size, is_convex, hull, surface


@kernel
def _is_surely_concave(triangles):
    low, high = np.full(3, math.inf), np.full(3, -math.inf)
    for t in range(len(triangles)):
        for k in range(9):
            low[k % 3], high[k % 3] = min(low[k % 3], triangles[t, k]), max(high[k % 3], triangles[t, k])
    size = max(high[0] - low[0], high[1] - low[1], high[2] - low[2])
    for turn in range(min(LOOKED_AT, len(triangles))):
        c = triangles[turn * len(triangles) // LOOKED_AT if len(triangles) > LOOKED_AT else turn]
        n = area_vector(corners_of(c))
        area = length(n)
        if not area > CONCAVE * size * size:
            continue  # the plane of a sliver is uncertain
        for t in range(len(triangles)):
            for k in range(0, 9, 3):
                if dot(n, minus(vector_at(triangles[t], k), c)) > CONCAVE * size * area:
                    return True
    return False


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
    size, volume, o = 0.0, 0.0, (vector(corners, 0) if len(corners) else (0.0, 0.0, 0.0))
    for t in range(len(surface.triangles)):
        p, q, r = surface.triangles[t]
        a, b, c = minus(vector(corners, p), o), minus(vector(corners, q), o), minus(vector(corners, r), o)
        n = cross(b, c)
        volume += a[0] * n[0] + a[1] * n[1]
        volume += a[2] * n[2]
    for d in range(3 if len(corners) else 0):
        size = max(size, corners[:, d].max() - corners[:, d].min())
    return hull, surface, size, len(corners) > 0 and volume / 6.0 >= (1.0 - CONVEX) * points.volume


@kernel
def hull_of(shapes, f):
    """The Hull of fragment f: views."""
    c, d = shapes.begin[f], shapes.end[f]
    h = shapes.hull
    return Hull(h.x[c[0] : d[0]], h.y[c[0] : d[0]], h.z[c[0] : d[0]], h.faces[c[1] : d[1]], h.ridges[c[2] : d[2]])


@kernel
def surface_of(shapes, f):
    """The Surface of fragment f: views."""
    c, d = shapes.begin[f], shapes.end[f]
    s = shapes.surface
    return Surface(
        s.corners[c[3] : d[3]], s.triangles[c[4] : d[4]], s.normals[c[4] : d[4]], s.edges[c[5] : d[5]],
        s.beside[c[5] : d[5]], s.is_sharp[c[3] : d[3]],
    )  # fmt: skip


@kernel
def triangles_of(pools, first, end):
    """Triangles of the surfaces of fragments first .. end - 1, of one body if they are several.

    Returns (corners (n, 9) [m] in the body frame, counter-clockwise from outside; first row of each fragment, and the
    total (end - first + 1,)). Triangles without a plane are degenerate by rounding and left out.
    """
    begin = np.zeros(end - first + 1, np.int64)
    kind = pools.fragment.kind[first]
    if kind in (BOX, TRIANGLES):
        return _rigid_triangles(pools, first, begin)
    if kind != TETRAHEDRA:
        return np.empty((0, 9)), begin
    mesh, body = pools.mesh, pools.body
    k, shift = pools.fragment.mesh[first], pools.fragment.tet_shift[first]
    low, high = mesh.first[k, FIRST_TETRAHEDRON], len(mesh.tetrahedra)
    if k + 1 < len(mesh.first):
        high = mesh.first[k + 1, FIRST_TETRAHEDRON]
    out = np.empty((0, 9))
    for turn in range(2):
        if turn == 1:
            total = 0
            for f in range(end - first + 1):
                total, begin[f] = total + begin[f], total
            out = np.empty((total, 9))
        for t in range(low, high):
            alone = first if shift == NEVER_BROKEN else body.regions[t + shift, OWNER]
            if first <= alone < end:
                for face in range(4):
                    if mesh.neighbours[t, face] < 0:
                        if turn == 1:
                            v, w = mesh.tetrahedra[t], FACE_VERTICES[face]
                            for i in range(3):
                                for d in range(3):
                                    out[begin[alone - first], 3 * i + d] = mesh.nodes[v[w[i]], d]
                        begin[alone - first] += 1
            if shift == NEVER_BROKEN or body.cut_count[t + shift] == 0:
                continue
            row = body.regions[t + shift, ROW]
            for i in range(row, row + body.cut_count[t + shift]):
                if math.isnan(body.faces[i, 3]):
                    continue
                for side in (FRONT_SIDE, BACK_SIDE):
                    f = body.sides[i, side] - first
                    if not 0 <= f < end - first:
                        continue
                    if turn == 1:
                        q, r = (3, 6) if side == FRONT_SIDE else (6, 3)
                        for d in range(3):
                            out[begin[f], d] = body.triangles[i, d]
                            out[begin[f], 3 + d] = body.triangles[i, q + d]
                            out[begin[f], 6 + d] = body.triangles[i, r + d]
                    begin[f] += 1
    for f in range(end - first, 0, -1):
        begin[f] = begin[f - 1]
    begin[0] = 0
    return out, begin


@kernel
def _rigid_triangles(pools, f, begin):
    """triangles_of for one box or rigid triangle mesh."""
    pieces = np.arange(6)
    if pools.fragment.kind[f] == TRIANGLES:
        k = pools.fragment.mesh[f]
        pieces = np.arange(pools.triangles.triangle_range[k, 0], pools.triangles.triangle_range[k, 1])
    each = count_triangles(pools, f, 0)
    out, still, here = np.empty((each * len(pieces), 9)), np.eye(3), np.zeros(3)
    for i in range(len(pieces)):
        for k in range(each):
            put_triangle(pools, f, pieces[i], k, still, here, out[each * i + k])
    begin[1] = len(out)
    return out, begin
