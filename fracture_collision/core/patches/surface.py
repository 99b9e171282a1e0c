"""A fragment's surface as its contacts need it: triangles that share corners, and the convex edges between them.

Triangles of a surface share whole edges, whose ends are equal to the last bit in both, so corners and edges are found
by hashes of these. Surfaces are made when a fragment is, and stay: a fracture beside a fragment divides its surface
anew, but does not move it (cut_tetrahedron.py).
"""

from __future__ import annotations

from typing import Annotated, NamedTuple

import numpy as np

from fracture_collision.core.memory.compiled import kernel, query_kernel
from fracture_collision.core.memory.tables import Column
from fracture_collision.core.memory.vectors import (
    area_vector,
    corners_of,
    cross,
    divided,
    dot,
    hash_of,
    length,
    minus,
    put,
    vector,
    vector_at,
)

# Sine of the least angle by which the surface turns outwards at an edge: flatter ones are within faces.
LEAST_TURN = 1e-4
# A triangle whose height is below this share of the longest edge of the surface is a sliver without a direction.
SLIVER = 1e-14
# Sine of the least turn of a line of edges at a corner.
STRAIGHT = 1e-7
_PLACES_EACH = 2  # of a hash table, for each entry
_NONE = -1


CORNER, FACET, CONVEX_EDGE = "corner", "facet", "convex edge"


class Surface(NamedTuple):
    """Places in the body frame."""

    corners: Annotated[np.ndarray, Column(CORNER, np.float64, 3)]  # [m], no two are equal
    triangles: Annotated[np.ndarray, Column(FACET, np.int32, 3)]  # rows of corners, counter-clockwise from outside
    normals: Annotated[np.ndarray, Column(FACET, np.float64, 3)]  # unit, outward
    edges: Annotated[np.ndarray, Column(CONVEX_EDGE, np.int32, 2)]  # ends of the convex ones
    beside: Annotated[np.ndarray, Column(CONVEX_EDGE, np.int32, 2)]  # the triangles at either side of these
    is_sharp: Annotated[np.ndarray, Column(CORNER, np.bool_)]  # those that may be outermost alone


@kernel
def make_surface(given):
    """The Surface of triangles `given` (n, 9) [m], without those that have no area."""
    n = len(given)
    corners, triangles, normals = np.empty((3 * n, 3)), np.empty((n, 3), np.int32), np.empty((n, 3))
    places = _room(3 * n)
    at_place = np.full(places, _NONE, np.int32)
    longest = 0.0
    for k in range(n):
        for d in range(3):
            longest = max(longest, abs(given[k, d] - given[k, 3 + d]), abs(given[k, d] - given[k, 6 + d]))
    used, kept = 0, 0
    for k in range(n):
        c = given[k]
        normal = area_vector(corners_of(c))
        area = length(normal)
        if not area > SLIVER * longest * longest:
            continue
        for i in range(3):
            p = vector_at(c, 3 * i)
            place = hash_of(p) & (places - 1)
            while at_place[place] != _NONE and vector(corners, at_place[place]) != p:
                place = (place + 1) & (places - 1)
            if at_place[place] == _NONE:
                at_place[place] = used
                put(corners, used, p)
                used += 1
            triangles[kept, i] = at_place[place]
        put(normals, kept, divided(normal, area))
        kept += 1
    edges, beside = _convex_edges(corners, triangles[:kept], normals)
    corners = corners[:used].copy()
    return Surface(
        corners, triangles[:kept].copy(), normals[:kept].copy(), edges, beside, _sharp_corners(corners, edges)
    )


@kernel
def _sharp_corners(corners, edges):
    """Ends of convex edges, but for those (c,) within a straight line of two: its ends are as near to anything."""
    many, beyond = np.zeros(len(corners), np.int64), np.empty(len(corners), np.int64)
    is_sharp = np.zeros(len(corners), np.bool_)
    for e in range(len(edges)):
        for end in range(2):
            at, other = edges[e, end], edges[e, 1 - end]
            is_sharp[at] = many[at] != 1 or not _is_between(corners[at], corners[beyond[at]], corners[other])
            many[at] += 1
            beyond[at] = other
    return is_sharp


@query_kernel
def _is_between(p, a, b):
    """Whether p is on the straight line between a and b."""
    u, v = minus(a, p), minus(b, p)
    across, square = cross(u, v), dot(u, u) * dot(v, v)
    return dot(u, v) < 0.0 and dot(across, across) < STRAIGHT * STRAIGHT * square


@kernel
def _convex_edges(corners, triangles, normals):
    """Convex edges (e, 2) and the triangles (e, 2) beside them.

    Where a surface touches itself, more than two triangles share an edge: each is paired with the first that has the
    edge the other way round and is not paired there yet. Where cracks are curved, one triangle may have two others
    along one side: all three sides are edges then, with themselves at both sides.
    """
    n = len(triangles)
    places = _room(3 * n)
    at_place, is_open = np.full(places, _NONE, np.int32), np.ones(3 * n, np.bool_)
    edges, beside, count = np.empty((3 * n, 2), np.int32), np.empty((3 * n, 2), np.int32), 0
    for t in range(n):
        for i in range(3):
            p, q = triangles[t, i], triangles[t, (i + 1) % 3]
            place = _hash_of_edge(p, q) & (places - 1)
            while at_place[place] != _NONE:
                side = at_place[place]
                s, j = side // 3, side % 3
                if is_open[side] and triangles[s, j] == q and triangles[s, (j + 1) % 3] == p:
                    break
                place = (place + 1) & (places - 1)
            if at_place[place] == _NONE:
                at_place[place] = 3 * t + i
                continue
            side = at_place[place]
            is_open[side] = is_open[3 * t + i] = False
            s = side // 3
            if _is_convex(corners[q], corners[p], normals[s], normals[t]):
                edges[count, 0], edges[count, 1] = q, p
                beside[count, 0], beside[count, 1] = s, t
                count += 1
    for side in range(3 * n):
        if is_open[side]:
            t, i = side // 3, side % 3
            edges[count, 0], edges[count, 1] = triangles[t, i], triangles[t, (i + 1) % 3]
            beside[count, 0] = beside[count, 1] = t
            count += 1
    return edges[:count].copy(), beside[:count].copy()


@query_kernel
def _is_convex(begin, end, left, right):
    """Whether the surface turns outwards at an edge; `left` has it from begin to end, `right` the other way round."""
    edge = minus(end, begin)
    if dot(cross(left, right), edge) > LEAST_TURN * length(edge):
        return True
    # a fin without thickness folds back
    return dot(left, right) < -1.0 + 1e-5


@query_kernel
def _room(entries):
    """A power of two that holds a hash table of so many entries."""
    places = 16
    while places < _PLACES_EACH * entries:
        places *= 2
    return places


@query_kernel
def _hash_of_edge(p, q):
    h = (np.int64(min(p, q)) << 32 | np.int64(max(p, q))) * 0x62A9D9ED799705F5
    return h ^ (h >> 29)
