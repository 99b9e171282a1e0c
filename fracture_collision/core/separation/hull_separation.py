"""The separating plane of two fragments' convex hulls, or the nearest to one, computed before any sample is queried.

Of the pairs whose boxes overlap in a pile, nineteen in twenty touch nowhere, and most of these have a separating plane.
It is found by the algorithm of Gilbert, Johnson, Keerthi, "A fast procedure for computing the distance between complex
objects in three-dimensional space" (1988), which walks over the difference of the hulls towards its point nearest to
the origin. That needs the lowest point of a fragment along a direction, and a sphere tree (Glondu 2014, section 5.1)
finds it by visiting a small part of its nodes. The extents of both fragments along the direction are then measured over
all points that span them, so the bound is valid even if GJK does not converge. A plane that does not separate the two
still shows that most samples are beyond the other.

The hull of a fragment's samples contains all of its border (corner_samples.py).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from fracture_collision.core.memory.compiled import inlined_kernel, query_kernel
from fracture_collision.core.memory.pools import SIZE
from fracture_collision.core.memory.rotations import rotated
from fracture_collision.core.mesh.closest_point import closest_on_triangle

# Most GJK steps. In a pile, of the pairs with a separating plane two thirds need one step, and all but one in two
# hundred no more than this; touching pairs use all of them.
MOST_STEPS = 12
# GJK ends when the possible gain is less than this share of the distance.
SETTLED = 1e-3
# Subtrees of up to this many entries are scanned: culling their branches would take longer.
BUNCH = 48


class Hull(NamedTuple):
    """Points that span the hull of a fragment, in its body frame: rows of TreePool."""

    spheres: np.ndarray  # (s, 4) float64 [m]
    entries: np.ndarray  # (s, 3) int32


@inlined_kernel
def hull_of(pools, f):
    """The Hull of fragment `f`: views of its tree."""
    fragment = pools.fragment
    begin, end = fragment.tree_begin[f], fragment.tree_end[f]
    return Hull(pools.tree.spheres[begin:end], pools.tree.entries[begin:end])


@query_kernel
def parting_plane(a, b, way, rotation, translation, distance):
    """The direction of greatest separation, or least overlap, of the Hulls `a` and `b` that the search finds.

    rotation (2, 3, 3), translation (2, 3): from a's frame to b's and back; way: (x, y, z), from about b's middle to
    a's, in b's frame. The search stops at a direction along which they are more than `distance` [m] apart.

    Returns (x, y, z, low, high): a unit vector in b's frame; along it all of a is at `low` or above, all of b at `high`
    or below [m].
    """
    vx, vy, vz = way  # current point: after the first step the nearest point of a simplex of the difference a - b
    k0, k1, k2 = way, way, way  # that simplex, doubled where it has less than three corners
    at_a = at_b = 0
    best, found, best_a, best_b = -math.inf, way, 0, 0
    for step in range(MOST_STEPS):
        length = math.sqrt(vx * vx + vy * vy + vz * vz)
        if not length > 0.0:
            break
        n = vx / length, vy / length, vz / length
        at_a = _lowest(a, rotated(rotation[1], n[0], n[1], n[2]), at_a)
        at_b = _lowest(b, (-n[0], -n[1], -n[2]), at_b)
        new = _difference(rotation[0], translation[0], a.spheres[at_a], b.spheres[at_b])
        along = _dot(n, new)
        if along > distance:
            low, high = _extents(a, b, n, at_a, at_b, rotation, translation)
            if low - high > distance:
                return n[0], n[1], n[2], low, high
        if along > best:
            best, found, best_a, best_b = along, n, at_a, at_b
        if step == 0:
            k0, k1, k2 = new, new, new
            vx, vy, vz = new
            continue
        if length - along <= SETTLED * length or encloses_origin(new, k0, k1, k2):
            break
        (vx, vy, vz), k0, k1, k2 = next_simplex(new, k0, k1, k2)
    if best == -math.inf:
        return 0.0, 0.0, 0.0, 0.0, 0.0
    low, high = _extents(a, b, found, best_a, best_b, rotation, translation)
    return found[0], found[1], found[2], low, high


@inlined_kernel
def _extents(a, b, n, at_a, at_b, rotation, translation):
    """The lowest of a and the highest of b along n; at_a, at_b: rows of those points in their trees."""
    own = rotated(rotation[1], n[0], n[1], n[2])
    return _dot(own, a.spheres[at_a]) + _dot(n, translation[0]), _dot(n, b.spheres[at_b])


@inlined_kernel
def _dot(n, p):
    return n[0] * p[0] + n[1] * p[1] + n[2] * p[2]


@inlined_kernel
def _lowest(hull, n, hint):
    """Row of the tree's lowest point along the unit vector n; `hint`: a guess."""
    at, lowest = hint, _dot(n, hull.spheres[hint])
    i, end = 0, len(hull.spheres)
    while i < end:
        along, radius = _dot(n, hull.spheres[i]), hull.spheres[i, 3]
        size = hull.entries[i, SIZE]
        if along < lowest:
            at, lowest = i, along
        if along - radius >= lowest:
            i += size
        elif size > BUNCH:
            i += 1
        else:
            for j in range(i + 1, i + size):
                along = _dot(n, hull.spheres[j])
                if along < lowest:
                    at, lowest = j, along
            i += size
    return at


@inlined_kernel
def _difference(rotation, translation, p, q):
    """p, transformed to b's frame, minus q."""
    x, y, z = rotated(rotation, p[0], p[1], p[2])
    return x + translation[0] - q[0], y + translation[1] - q[1], z + translation[2] - q[2]


@inlined_kernel
def next_simplex(new, k0, k1, k2):
    """Of the triangles formed by `new` and two of the corners k0, k1, k2, the one nearest to the origin.

    Returns (its nearest point (x, y, z), its three corners).
    """
    least, x, y, z, _ = _nearest_to_origin(new, k0, k1)
    v, dropped = (x, y, z), 2
    nearer, x, y, z, _ = _nearest_to_origin(new, k1, k2)
    if nearer < least:
        least, v, dropped = nearer, (x, y, z), 0
    nearer, x, y, z, _ = _nearest_to_origin(new, k0, k2)
    if nearer < least:
        v, dropped = (x, y, z), 1
    if dropped == 0:
        return v, new, k1, k2
    if dropped == 1:
        return v, k0, new, k2
    return v, k0, k1, new


@inlined_kernel
def _nearest_to_origin(a, b, c):
    return closest_on_triangle(0.0, 0.0, 0.0, a[0], a[1], a[2], b[0], b[1], b[2], c[0], c[1], c[2])


@inlined_kernel
def encloses_origin(new, k0, k1, k2):
    """Whether the tetrahedron encloses the origin, known not to be beyond the face opposite its newest corner."""
    return (
        _same_side(new, k0, k1, k2) and _same_side(new, k1, k2, k0) and _same_side(new, k2, k0, k1)
    )  # fmt: skip


@inlined_kernel
def _same_side(a, b, c, d):
    """Whether the origin and d are on one side of the plane through a, b, c."""
    ux, uy, uz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    wx, wy, wz = c[0] - a[0], c[1] - a[1], c[2] - a[2]
    nx, ny, nz = uy * wz - uz * wy, uz * wx - ux * wz, ux * wy - uy * wx
    of_origin = nx * a[0] + ny * a[1] + nz * a[2]
    of_d = nx * (a[0] - d[0]) + ny * (a[1] - d[1]) + nz * (a[2] - d[2])
    return of_origin * of_d > 0.0
