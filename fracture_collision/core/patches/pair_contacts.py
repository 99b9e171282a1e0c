"""Contacts of two fragments along one direction: where their surfaces face each other, now or when they will touch."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from fracture_collision.core.memory.compiled import inlined_kernel, kernel
from fracture_collision.core.patches.facing_points import CROSSING, Posed, facing_points
from fracture_collision.core.patches.shapes import hull_of, surface_of
from fracture_collision.core.separation.parting_direction import Relative, parting_direction

# Points of one contact are at least this share of the smaller fragment's size apart.
ONE_PLACE = 1e-6
# Fragments of one body do not overlap in place: no gap between them is less than minus this times how far either has
# moved since they broke.
MOVED = 1.5
# The deepest contact comes first; depths within this share of the tolerance are alike. So are scores within the other.
ALIKE, EQUAL = 1e-3, 0.999
_CROSSING_STRIDE = 1 << 24


class Placing(NamedTuple):
    """Poses of one fragment in the frame of the query, b's of now: at the beginning and at the end of the step."""

    rotations: np.ndarray  # (2, 3, 3)
    positions: np.ndarray  # (2, 3) [m]


class Patch(NamedTuple):
    """Contacts of one direction, in the frame of the query."""

    normal: np.ndarray  # (3,) unit, from a to b
    points: np.ndarray  # (k, 3) [m] on a; those on b are `gaps` farther along the normal
    gaps: np.ndarray  # (k,) [m] now
    numbers: np.ndarray  # (k,) int64: which feature it is of: positive corners of b, negative of a, or crossings
    now: float  # [m] how far the hulls are apart along it
    end: float  # [m]


@kernel
def mesh_patch(shapes, rows, placings, tolerance, b_first, moved, most):
    """The Patch of two fragments with surfaces, by rows (a, b) of Shapes; without contacts where they stay apart.

    placings: of a and of b; tolerance [m]; moved [m]: how far they moved since they were one, infinity: never; most:
    contacts wanted.
    """
    a, b = rows
    hull_a, hull_b = hull_of(shapes, a), hull_of(shapes, b)
    parting = parting_direction(hull_a, hull_b, _relative(placings), tolerance, b_first)
    n = np.array([parting.x, parting.y, parting.z])
    nothing = Patch(n, np.zeros((0, 3)), np.zeros(0), np.zeros(0, np.int64), parting.now, parting.end)
    if parting.is_apart:
        return nothing
    size = min(shapes.size[a], shapes.size[b])
    closing = max(parting.now - parting.end, 0.0)
    share = 0.0
    if parting.now > tolerance and parting.end < tolerance and closing > 0.0:
        share = min(parting.now / closing, 1.0)
    surface_a, surface_b = surface_of(shapes, a), surface_of(shapes, b)
    first, last = _posed(surface_a, placings[0], share), _posed(surface_b, placings[1], share)
    spread = _turn(placings[0]) * shapes.size[a] + _turn(placings[1]) * shapes.size[b]
    limit = tolerance if share > 0.0 else tolerance + closing + spread
    found = facing_points(first, last, n, max(limit, tolerance), size)
    return _listed(found, placings, share, parting, n, tolerance, size, moved, most)


@kernel
def _listed(found, placings, share, parting, n, tolerance, size, moved, most):
    """The Patch of the best of FacingPoints."""
    count, least = len(found.gaps), math.inf
    for k in range(count):
        least = min(least, found.gaps[k])
    points, gaps = np.empty((count, 3)), np.empty(count)
    order, numbers = np.empty(count, np.int64), np.empty(count, np.int64)
    used = 0
    for k in range(count):
        p, gap = found.points[k], found.gaps[k]
        if gap < -(MOVED * moved + ONE_PLACE * size):
            continue
        q = np.array([p[0] + gap * n[0], p[1] + gap * n[1], p[2] + gap * n[2]])
        if share > 0.0:
            if gap > least + tolerance:
                continue
            p, q = _carried(placings[0], p, share, 0.0), _carried(placings[1], q, share, 0.0)
            gap = (q[0] - p[0]) * n[0] + (q[1] - p[1]) * n[1] + (q[2] - p[2]) * n[2]
        elif gap > tolerance:
            s, t = _carried(placings[0], p, 0.0, 1.0), _carried(placings[1], q, 0.0, 1.0)
            if (t[0] - s[0]) * n[0] + (t[1] - s[1]) * n[1] + (t[2] - s[2]) * n[2] > tolerance:
                continue
        points[used], gaps[used] = p, gap
        kind, i, j = found.features[k]
        # crossings after corners, those of b before those of a
        numbers[used] = (np.int64(kind) << 56) + (_CROSSING_STRIDE * i + j if kind == CROSSING else i)
        used += 1
    order = np.argsort(numbers[:used], kind="mergesort")
    order = order[: _one_per_place(points, order, ONE_PLACE * size)]
    chosen = _spread(points, gaps, order, tolerance, most)
    return Patch(n, points[chosen], gaps[chosen], numbers[chosen], parting.now, parting.end)


@inlined_kernel
def _one_per_place(points, order, apart):
    """Move to the front of `order` the first of each place; returns their number."""
    kept = 0
    for k in range(len(order)):
        p, is_new = points[order[k]], True
        for i in range(kept):
            q = points[order[i]]
            if max(abs(p[0] - q[0]), abs(p[1] - q[1]), abs(p[2] - q[2])) < apart:
                is_new = False
                break
        if is_new:
            order[kept] = order[k]
            kept += 1
    return kept


@kernel
def _spread(points, gaps, order, tolerance, most):
    """Rows of up to `most` points: the deepest, then always that which is farthest from those before, if it is near.

    The distance is weighted by how near the two surfaces are there, from 1 at the deepest to 0 at two tolerances more.
    """
    count = len(order)
    chosen, used = np.empty(min(most, count), np.int64), 0
    far, taken, deepest = np.full(count, math.inf), np.zeros(count, np.bool_), math.inf
    for k in range(count):
        deepest = min(deepest, gaps[order[k]])
    pick = -1
    for k in range(count):
        if gaps[order[k]] <= deepest + ALIKE * tolerance:
            pick = k
            break
    while pick >= 0 and used < len(chosen):
        chosen[used], taken[pick] = order[pick], True
        used += 1
        p, best = points[order[pick]], 0.0
        for k in range(count):
            q = points[order[k]]
            away = math.sqrt((q[0] - p[0]) ** 2 + (q[1] - p[1]) ** 2 + (q[2] - p[2]) ** 2)
            far[k] = min(far[k], away)
            if not taken[k]:
                best = max(best, far[k] * _nearness(gaps[order[k]], deepest, tolerance))
        pick = -1
        if not best > 0.0:
            break
        for k in range(count):
            if not taken[k] and far[k] * _nearness(gaps[order[k]], deepest, tolerance) >= EQUAL * best:
                pick = k
                break
    return chosen[:used]


@inlined_kernel
def _nearness(gap, deepest, tolerance):
    return min(max((deepest + 2.0 * tolerance - gap) / tolerance, 0.0), 1.0)


@kernel
def _relative(placings):
    """The Relative of two Placings."""
    to_a, to_b, between = np.empty((2, 3, 3)), np.empty((2, 3, 3)), np.empty((2, 3))
    for k in range(2):
        for d in range(3):
            between[k, d] = placings[1].positions[k, d] - placings[0].positions[k, d]
            for e in range(3):
                to_a[k, d, e] = placings[0].rotations[k, e, d]
                to_b[k, d, e] = placings[1].rotations[k, e, d]
    return Relative(to_a, to_b, between)


@inlined_kernel
def _turn(placing):
    """Upper bound of how far a point at distance 1 is turned in the step."""
    most = 0.0
    for d in range(3):
        for e in range(3):
            most += (placing.rotations[1, d, e] - placing.rotations[0, d, e]) ** 2
    return math.sqrt(most)


@kernel
def _mixed(placing, share):
    """(matrix (3, 3), offset (3,)) of the affine map at a share of the step, straight from its beginning to its end."""
    rotation, position = placing.rotations[0].copy(), placing.positions[0].copy()
    for d in range(3):
        position[d] += share * (placing.positions[1, d] - placing.positions[0, d])
        for e in range(3):
            rotation[d, e] += share * (placing.rotations[1, d, e] - placing.rotations[0, d, e])
    return rotation, position


@kernel
def _posed(surface, placing, share):
    """The Posed surface at a share of the step."""
    rotation, position = _mixed(placing, share)
    return Posed(
        _mapped(surface.corners, rotation, position), surface.triangles,
        _mapped(surface.normals, placing.rotations[0], np.zeros(3)), surface.edges, surface.beside, surface.is_sharp,
    )  # fmt: skip


@kernel
def _mapped(points, rotation, position):
    out = np.empty((len(points), 3))
    for k in range(len(points)):
        x, y, z = points[k, 0], points[k, 1], points[k, 2]
        for d in range(3):
            out[k, d] = rotation[d, 0] * x + rotation[d, 1] * y + rotation[d, 2] * z + position[d]
    return out


@kernel
def _carried(placing, p, before, after):
    """Where a point p (3,), fixed to a fragment, that is there at share `before` of the step is at `after`."""
    m, t = _mixed(placing, before)
    x, y, z = p[0] - t[0], p[1] - t[1], p[2] - t[2]
    # by Cramer's rule: the mixed matrix is near a rotation
    c = np.empty((3, 3))
    for d in range(3):
        i, j = (d + 1) % 3, (d + 2) % 3
        for e in range(3):
            k, l = (e + 1) % 3, (e + 2) % 3  # noqa: E741
            c[d, e] = m[i, k] * m[j, l] - m[i, l] * m[j, k]
    det = m[0, 0] * c[0, 0] + m[0, 1] * c[0, 1] + m[0, 2] * c[0, 2]
    local = np.empty(3)
    for e in range(3):
        local[e] = (c[0, e] * x + c[1, e] * y + c[2, e] * z) / det
    m, t = _mixed(placing, after)
    out = np.empty(3)
    for d in range(3):
        out[d] = m[d, 0] * local[0] + m[d, 1] * local[1] + m[d, 2] * local[2] + t[d]
    return out
