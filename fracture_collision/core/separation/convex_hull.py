"""The convex hull of points: corners, faces, and the ridges between faces.

Quickhull (Barber, Dobkin, Huhdanpaa, "The Quickhull Algorithm for Convex Hulls", 1996) makes triangles. Those that lie
flat beside a larger one become one face with it. Points outside by less than ROUNDING are no corners, so that coplanar
ones make no slivers; but a face's offset is that of the outermost of all points.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from fracture_collision.core.memory.compiled import kernel, query_kernel

# Share of the longest side of the points' box. The plane of a sliver as thin as this is wrong by the rounding of
# doubles over it, far less than this: with a smaller share, planes of slivers would make holes.
ROUNDING = 1e-7
# Triangles whose corners lie this near to the plane of a larger one, in the same unit, are part of its face: the single
# precision of mesh files moves corners by 1e-7, which a plane through three of them exaggerates.
FLAT = 1e-6
# Triangles, and free rows for new ones, for each point; the rest is room for small sets.
_EACH, _MORE = 6, 64
_FREE, _LIVE, _VISIBLE = 0, 1, 2
_NONE = -1


class ConvexHull(NamedTuple):
    """No corners: the points lie in a plane."""

    corners: np.ndarray  # (c,) int64 rows of the points, ascending; some may lie within a face or a ridge
    faces: np.ndarray  # (f, 4) float64: unit outward normal, offset [m]
    ridges: np.ndarray  # (r, 4) int64: rows of both ends; faces to the left and to the right, seen from outside
    volume: float  # [m3]
    outside: float  # [m] no point is farther outside of the corners' hull than this


class _Triangles(NamedTuple):
    """The triangles of the growing hull; rows in any order."""

    state: np.ndarray  # (m,) uint8
    corners: np.ndarray  # (m, 3) int64, counter-clockwise from outside
    beyond: np.ndarray  # (m, 3) int64: the triangle across the side from corner k to the next
    planes: np.ndarray  # (m, 4) float64
    first: np.ndarray  # (m,) int64: first of the points outside of it, a chain; _NONE: none
    farthest: np.ndarray  # (m,) int64 of them
    height: np.ndarray  # (m,) float64 [m] of that one


@kernel
def convex_hull(points):
    """The ConvexHull of points (n, 3) [m]."""
    n = len(points)
    nothing = ConvexHull(np.zeros(0, np.int64), np.zeros((0, 4)), np.zeros((0, 4), np.int64), 0.0, 0.0)
    if n < 4:
        return nothing
    size = 0.0
    for d in range(3):
        size = max(size, points[:, d].max() - points[:, d].min())
    enough = ROUNDING * size
    a, b, c, e = _first_corners(points)
    if not _height(_plane(points, a, b, c), points[e]) < -enough:
        return nothing
    m = _EACH * n + _MORE
    its = _Triangles(
        np.zeros(m, np.uint8), np.empty((m, 3), np.int64), np.empty((m, 3), np.int64), np.empty((m, 4)),
        np.full(m, -1), np.full(m, -1), np.zeros(m),
    )  # fmt: skip
    after = np.full(n, -1)  # the next point of a chain
    free = np.arange(m - 1, -1, -1)
    free_count = m
    starts_at = np.full(n, -1)  # by its first corner, a new triangle
    visible, borders = np.empty(m, np.int64), np.empty((m, 2), np.int64)
    waiting, waits = np.empty(m, np.int64), 0
    outside = enough
    _begin(points, its, (a, b, c, e), enough, after)
    free_count -= 4
    for t in range(4):
        if its.first[t] != _NONE:
            waiting[waits] = t
            waits += 1
    while waits:
        waits -= 1
        t = waiting[waits]
        if its.state[t] != _LIVE or its.first[t] == _NONE:
            continue
        top = its.farthest[t]
        seen, edges, is_simple = _see(points, its, t, top, enough, starts_at, (visible, borders))
        if not is_simple:
            # rounding has made a hole: leave the point out
            outside = max(outside, its.height[t])
            _drop(points, its, t, top, after)
            for k in range(seen):
                its.state[visible[k]] = _LIVE
            if its.first[t] != _NONE:
                waiting[waits] = t
                waits += 1
            continue
        free_count = _raise_cone(points, its, top, borders[:edges], free, free_count, starts_at)
        _hand_over(points, its, (visible[:seen], borders[:edges]), top, enough, after, starts_at)
        for k in range(edges):
            p = its.corners[borders[k, 0], borders[k, 1]]
            if its.first[starts_at[p]] != _NONE:
                waiting[waits] = starts_at[p]
                waits += 1
        for k in range(edges):
            starts_at[its.corners[borders[k, 0], borders[k, 1]]] = _NONE
        for k in range(seen):
            its.state[visible[k]] = _FREE
            free[free_count] = visible[k]
            free_count += 1
    return _merged(points, its, outside, FLAT * size)


@query_kernel
def _begin(points, its, first, enough, after):
    """Write the triangles of a first tetrahedron, four rows of points, to rows 0 .. 3; the others wait outside them.

    The last of the four is below the triangle of the others.
    """
    a, b, c, e = first
    for t, (p, q, r), (u, v, w) in (
        (0, (a, b, c), (1, 2, 3)), (1, (b, a, e), (0, 3, 2)), (2, (c, b, e), (0, 1, 3)), (3, (a, c, e), (0, 2, 1)),
    ):  # fmt: skip
        its.state[t] = _LIVE
        its.corners[t, 0], its.corners[t, 1], its.corners[t, 2] = p, q, r
        its.beyond[t, 0], its.beyond[t, 1], its.beyond[t, 2] = u, v, w
        _put_plane(points, its, t)
    for p in range(len(points)):
        if p != a and p != b and p != c and p != e:
            for t in range(4):
                if _keep_outside(points, its, t, p, enough, after):
                    break


@query_kernel
def _raise_cone(points, its, top, borders, free, free_count, starts_at):
    """Add the triangles between `borders` (k, 2), see _see, and the point `top`, in free rows.

    starts_at (n,): gets the new triangle of each corner of the borders. Returns how many free rows are left.
    """
    for k in range(len(borders)):
        free_count -= 1
        new, old, side = free[free_count], borders[k, 0], borders[k, 1]
        p, q = its.corners[old, side], its.corners[old, (side + 1) % 3]
        its.state[new] = _LIVE
        its.corners[new, 0], its.corners[new, 1], its.corners[new, 2] = p, q, top
        its.first[new], its.farthest[new] = np.int64(_NONE), np.int64(_NONE)
        its.height[new] = 0.0
        its.beyond[new, 0] = its.beyond[old, side]
        _put_plane(points, its, new)
        starts_at[p] = new
    for k in range(len(borders)):
        old, side = borders[k, 0], borders[k, 1]
        p, q = its.corners[old, side], its.corners[old, (side + 1) % 3]
        new, other = starts_at[p], its.beyond[old, side]
        its.beyond[new, 1] = starts_at[q]
        its.beyond[starts_at[q], 2] = new
        for i in range(3):
            if its.corners[other, i] == q and its.corners[other, (i + 1) % 3] == p:
                its.beyond[other, i] = new
    return free_count


@query_kernel
def _hand_over(points, its, seen, top, enough, after, starts_at):
    """Let the points outside of triangles that `top` sees wait outside the new ones; seen: as _see wrote them."""
    visible, borders = seen
    for k in range(len(visible)):
        p = its.first[visible[k]]
        while p != _NONE:
            following = after[p]
            if p != top:
                for i in range(len(borders)):
                    new = starts_at[its.corners[borders[i, 0], borders[i, 1]]]
                    if _keep_outside(points, its, new, p, enough, after):
                        break
            p = following


@query_kernel
def _first_corners(points):
    """Four points far from each other, rows of `points`; the last is below the triangle of the others."""
    n = len(points)
    a = b = c = e = 0
    widest = -1.0
    for d in range(3):
        low, high = points[:, d].argmin(), points[:, d].argmax()
        if points[high, d] - points[low, d] > widest:
            widest, a, b = points[high, d] - points[low, d], low, high
    farthest = -1.0
    ux, uy, uz = points[b, 0] - points[a, 0], points[b, 1] - points[a, 1], points[b, 2] - points[a, 2]
    for k in range(n):
        wx, wy, wz = points[k, 0] - points[a, 0], points[k, 1] - points[a, 1], points[k, 2] - points[a, 2]
        x, y, z = uy * wz - uz * wy, uz * wx - ux * wz, ux * wy - uy * wx
        if x * x + y * y + z * z > farthest:
            farthest, c = x * x + y * y + z * z, k
    plane = _plane(points, a, b, c)
    farthest, height_of_e = -1.0, 0.0
    for k in range(n):
        height = _height(plane, points[k])
        if abs(height) > farthest:
            farthest, height_of_e, e = abs(height), height, k
    if height_of_e > 0.0:
        b, c = c, b
    return a, b, c, e


@query_kernel
def _plane(points, a, b, c):
    """(x, y, z, offset) of the plane through three points: unit normal, or zeros if they are on a line."""
    x, y, z = _twice_area(points, (a, b, c))
    length = math.sqrt(x * x + y * y + z * z)
    if length > 0.0:
        x, y, z = x / length, y / length, z / length
    return x, y, z, x * points[a, 0] + y * points[a, 1] + z * points[a, 2]


@query_kernel
def _height(plane, p):
    return plane[0] * p[0] + plane[1] * p[1] + plane[2] * p[2] - plane[3]


@query_kernel
def _put_plane(points, its, t):
    its.planes[t, 0], its.planes[t, 1], its.planes[t, 2], its.planes[t, 3] = _plane(
        points, its.corners[t, 0], its.corners[t, 1], its.corners[t, 2]
    )


@query_kernel
def _keep_outside(points, its, t, p, enough, after):
    """Put a point into the chain of triangle t, if it is outside of it; returns whether it is."""
    height = _height(its.planes[t], points[p])
    if not height > enough:
        return False
    after[p] = its.first[t]
    its.first[t] = p
    if height > its.height[t]:
        its.height[t], its.farthest[t] = height, p
    return True


@query_kernel
def _drop(points, its, t, dropped, after):
    """Take a point out of the chain of triangle t."""
    p = its.first[t]
    its.first[t], its.farthest[t], its.height[t] = np.int64(_NONE), np.int64(_NONE), 0.0
    while p != _NONE:
        following = after[p]
        if p != dropped:
            _keep_outside(points, its, t, p, 0.0, after)
        p = following


@query_kernel
def _see(points, its, t, top, enough, starts_at, out):
    """Mark the triangles that the point `top`, outside of triangle t, sees, and find their border.

    Writes them to visible, and to borders (., 2) the triangle and side of each border inside it. Returns (number of
    triangles, of borders, whether these form one loop); starts_at (n,), all _NONE, is left so.
    """
    visible, borders = out
    seen, edges, done = 1, 0, 0
    visible[0] = t
    its.state[t] = _VISIBLE
    while done < seen:
        at = visible[done]
        done += 1
        for side in range(3):
            other = its.beyond[at, side]
            if its.state[other] == _LIVE and _height(its.planes[other], points[top]) > enough:
                its.state[other] = _VISIBLE
                visible[seen] = other
                seen += 1
    for k in range(seen):
        at = visible[k]
        for side in range(3):
            if its.state[its.beyond[at, side]] != _VISIBLE:
                borders[edges, 0], borders[edges, 1] = at, side
                edges += 1
    is_simple = edges >= 3
    for k in range(edges):
        p = its.corners[borders[k, 0], borders[k, 1]]
        is_simple = is_simple and starts_at[p] == _NONE
        starts_at[p] = k
    # follow the loop
    steps, k = 0, 0
    while is_simple and steps < edges:
        k = starts_at[its.corners[borders[k, 0], (borders[k, 1] + 1) % 3]]
        steps += 1
        is_simple = k != _NONE and (k != 0 or steps == edges)
    for k in range(edges):
        starts_at[its.corners[borders[k, 0], borders[k, 1]]] = _NONE
    return seen, edges, is_simple


@kernel
def _merged(points, its, outside, flat):
    """The ConvexHull of the triangles; flat [m]: see FLAT."""
    m, n = len(its.state), len(points)
    face_of, stack = np.full(m, -1), np.empty(m, np.int64)
    area, normals, faces, volume = np.zeros(m), np.zeros((m, 4)), 0, 0.0
    origin = np.int64(_NONE)
    for t in range(m):
        if its.state[t] == _LIVE:
            x, y, z = _twice_area(points, its.corners[t])
            area[t] = math.sqrt(x * x + y * y + z * z)
            if origin == _NONE:
                origin = its.corners[t, 0]
            p, q = points[its.corners[t, 0]], points[origin]
            volume += (x * (p[0] - q[0]) + y * (p[1] - q[1]) + z * (p[2] - q[2])) / 6.0
    for start in np.argsort(-area, kind="mergesort"):
        if its.state[start] != _LIVE or face_of[start] != _NONE:
            continue
        face_of[start] = faces
        stack[0], waits = start, 1
        while waits:
            waits -= 1
            t = stack[waits]
            x, y, z = _twice_area(points, its.corners[t])
            normals[faces, 0] += x
            normals[faces, 1] += y
            normals[faces, 2] += z
            for side in range(3):
                other = its.beyond[t, side]
                if face_of[other] != _NONE:
                    continue
                is_flat = True
                for k in range(3):
                    is_flat = is_flat and _height(its.planes[start], points[its.corners[other, k]]) >= -flat
                if is_flat:
                    face_of[other] = faces
                    stack[waits] = other
                    waits += 1
        faces += 1
    is_corner = np.zeros(n, np.bool_)
    ridges, count = np.empty((3 * m, 4), np.int64), 0
    for t in range(m):
        if its.state[t] != _LIVE:
            continue
        for side in range(3):
            other = its.beyond[t, side]
            p, q = its.corners[t, side], its.corners[t, (side + 1) % 3]
            is_corner[p] = True
            if p < q and face_of[other] != face_of[t]:
                ridges[count, 0], ridges[count, 1] = p, q
                ridges[count, 2], ridges[count, 3] = face_of[t], face_of[other]
                count += 1
    corners = np.flatnonzero(is_corner)
    for f in range(faces):
        x, y, z = normals[f, 0], normals[f, 1], normals[f, 2]
        length = math.sqrt(x * x + y * y + z * z)
        x, y, z = x / length, y / length, z / length
        offset = -math.inf
        for p in range(n):
            offset = max(offset, x * points[p, 0] + y * points[p, 1] + z * points[p, 2])
        normals[f, 0], normals[f, 1], normals[f, 2], normals[f, 3] = x, y, z, offset
    return ConvexHull(corners, normals[:faces].copy(), ridges[:count].copy(), volume, outside)


@query_kernel
def _twice_area(points, c):
    """Normal (x, y, z) of a triangle of three points, of twice its area in length."""
    ux, uy, uz = points[c[1], 0] - points[c[0], 0], points[c[1], 1] - points[c[0], 1], points[c[1], 2] - points[c[0], 2]
    vx, vy, vz = points[c[2], 0] - points[c[0], 0], points[c[2], 1] - points[c[0], 1], points[c[2], 2] - points[c[0], 2]
    return uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
