"""Removal of triangles that have hardly any area from a closed surface, which stays closed and oriented.

An edge shorter than the tolerance is collapsed to one of its ends. A triangle that is lower than the tolerance is
removed by a flip: its longest side is replaced by the other diagonal of the two triangles at that side. Both keep the
surface a manifold: an edge is collapsed only if its ends have no common neighbours but those two of its triangles
(the link condition; Dey, Edelsbrunner, Guha, Nekhayev 1999), and no diagonal is made twice.

A *side* is 3 x triangle + corner that it starts at; its *twin* is the same edge in the other triangle.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from fracture_collision.core.memory.compiled import kernel, query_kernel
from fracture_collision.geometry.unique_rows import unique_rows

# A pass over all triangles may make others thin; what is left after this many stays.
PASSES = 30
NO_TWIN = -1


class _Links(NamedTuple):
    """A surface whose triangles change."""

    vertices: np.ndarray  # (n, 3) float64 [m]
    corners: np.ndarray  # (3 t,) int64 vertex that each side starts at
    twins: np.ndarray  # (3 t,) int64 NO_TWIN: at an edge of more or fewer than two triangles, which stays as it is
    is_left: np.ndarray  # (t,) bool
    marked: np.ndarray  # (t,) bool: moves with the triangle beside it


def without_thin_triangles(
    vertices: np.ndarray, triangles: np.ndarray, marked: np.ndarray, tolerance: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Vertices, triangles and marks of a closed surface, with edges and heights of triangles above `tolerance` [m].

    vertices (n, 3) [m], triangles (t, 3), marked (t,) bool. Some thin triangles may be left: where no change keeps the
    surface closed. Triangles keep their order.
    """
    corners = triangles.astype(np.int64).ravel()
    ends = np.roll(triangles, -1, axis=1).ravel()
    first, edge_of = unique_rows((np.minimum(corners, ends) * len(vertices) + np.maximum(corners, ends))[:, None])
    links = _Links(
        vertices.astype(np.float64), corners, np.empty(len(corners), np.int64), np.ones(len(triangles), np.bool_),
        marked.copy(),
    )  # fmt: skip
    _link(links, edge_of, first)
    _thin_out(links, tolerance)
    corners = corners.reshape(-1, 3)[links.is_left]
    is_used = np.zeros(len(vertices), np.bool_)
    is_used[corners] = True
    return vertices[is_used], (np.cumsum(is_used) - 1)[corners], links.marked[links.is_left]


@kernel
def _link(links, edge_of, first):
    """Fill the twins: of the edges' two sides, one begins where the other ends."""
    sides = np.zeros(len(first), np.int64)
    for h in range(len(edge_of)):
        sides[edge_of[h]] += 1
        links.twins[h] = NO_TWIN
    for h in range(len(edge_of)):
        g = first[edge_of[h]]
        if sides[edge_of[h]] == 2 and g != h and links.corners[g] != links.corners[h]:
            links.twins[h], links.twins[g] = g, h


@kernel
def _thin_out(links, tolerance):
    for _ in range(PASSES):
        changes = 0
        for t in range(len(links.is_left)):
            if links.is_left[t]:
                changes += _improve(links, t, tolerance)
        if changes == 0:
            break


@query_kernel
def _improve(links, t, tolerance):
    """Collapse the shortest side of a triangle or flip its longest, if it is thin; returns whether that was done."""
    shortest, longest, least, most = 0, 0, math.inf, -1.0
    for k in range(3):
        h = 3 * t + k
        square = _square(links.vertices[links.corners[h]], links.vertices[links.corners[_next(h)]])
        if square < least:
            shortest, least = h, square
        if square > most:
            longest, most = h, square
    if least <= tolerance * tolerance:
        return _collapse(links, shortest)
    v = links.vertices
    a, b, c = links.corners[3 * t], links.corners[3 * t + 1], links.corners[3 * t + 2]
    return _shape(v[a], v[b], v[c])[0] <= tolerance and _flip(links, longest)


@query_kernel
def _next(h):
    return h + 1 if h % 3 < 2 else h - 2


@query_kernel
def _square(p, q):
    x, y, z = q[0] - p[0], q[1] - p[1], q[2] - p[2]
    return x * x + y * y + z * z


@query_kernel
def _shape(a, b, c):
    """(height over the longest side [m], longest side [m]) of a triangle."""
    longest = math.sqrt(max(_square(a, b), _square(b, c), _square(c, a)))
    ux, uy, uz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    vx, vy, vz = c[0] - a[0], c[1] - a[1], c[2] - a[2]
    nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    return math.sqrt(nx * nx + ny * ny + nz * nz) / longest, longest


@query_kernel
def _onward(links, h):
    """The next side that starts at the vertex where `h` starts; NO_TWIN at an edge without."""
    return links.twins[_next(_next(h))]


@query_kernel
def _is_whole(links, h):
    """Whether the triangles around the vertex where `h` starts form one circle."""
    g = _onward(links, h)
    while g not in (h, NO_TWIN):
        g = _onward(links, g)
    return g == h


@query_kernel
def _are_joined(links, h, vertex):
    """Whether an edge joins the vertex where `h` starts, which is whole, with `vertex`."""
    g = h
    while True:
        if links.corners[_next(g)] == vertex:
            return True
        g = _onward(links, g)
        if g == h:
            return False


@query_kernel
def _collapse(links, h):
    """Move the end of side `h` to its start and remove the two triangles at it; returns whether that is allowed."""
    g = links.twins[h]
    if g == NO_TWIN or not _is_whole(links, h) or not _is_whole(links, g):
        return False
    if links.corners[g] < links.corners[h]:
        h, g = g, h
    common, side = 0, g
    while True:
        common += _are_joined(links, h, links.corners[_next(side)])
        side = _onward(links, side)
        if side == g:
            break
    sides = (_next(h), _next(_next(h)), _next(g), _next(_next(g)))
    if common != 2 or links.corners[sides[1]] == links.corners[sides[3]]:
        return False
    while True:
        links.corners[side] = links.corners[h]
        side = _onward(links, side)
        if side == g:
            break
    for k in range(2):
        x, y = links.twins[sides[2 * k]], links.twins[sides[2 * k + 1]]
        links.twins[x], links.twins[y] = y, x
    links.is_left[h // 3], links.is_left[g // 3] = False, False
    return True


@query_kernel
def _flip(links, h):
    """Replace side `h` by the other diagonal of its two triangles; returns whether that is allowed."""
    g = links.twins[h]
    if g == NO_TWIN:
        return False
    bc, ad = _next(h), _next(g)
    ca, db = _next(bc), _next(ad)
    a, b, c, d = links.corners[h], links.corners[g], links.corners[ca], links.corners[db]
    if c == d or not _is_whole(links, ca) or _are_joined(links, ca, d):
        return False
    p, q, r, s = links.vertices[a], links.vertices[b], links.vertices[c], links.vertices[d]
    one, two, new_one, new_two = _shape(p, q, r), _shape(q, p, s), _shape(p, s, r), _shape(s, q, r)
    is_higher = min(new_one[0], new_two[0]) > min(one[0], two[0])
    if not is_higher and max(new_one[1], new_two[1]) >= max(one[1], two[1]):
        return False
    outer = links.twins[ad], links.twins[ca], links.twins[db], links.twins[bc]
    if min(outer) == NO_TWIN:
        return False
    t, u = 3 * (h // 3), 3 * (g // 3)
    corners = a, d, c, d, b, c
    for k in range(3):
        links.corners[t + k], links.corners[u + k] = corners[k], corners[3 + k]
    inner = t, t + 2, u, u + 1
    for k in range(4):
        links.twins[inner[k]], links.twins[outer[k]] = outer[k], inner[k]
    links.twins[t + 1], links.twins[u + 2] = u + 2, t + 1
    links.marked[h // 3] = links.marked[g // 3]
    return True
