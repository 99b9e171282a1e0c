"""Where the surfaces of two fragments pierce each other, exactly: pairs of triangles, and the parts that are inside.

Two closed surfaces of which neither holds the other have a point in common only where an edge of one passes through a
triangle of the other. Where none does, they are apart; that is a proof, whatever the density of either mesh.

Triangles that pierce each other, and those that hang together inside the other body, bound one overlap of the two. Its
area is the integral over the line in which the surfaces meet, half of r x dr: seen from a, the direction in which the
overlap shrinks fastest when b is moved along it.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from fracture_collision.core.memory.compiled import kernel, query_kernel
from fracture_collision.core.memory.transforms import rotated, to_other
from fracture_collision.core.memory.vectors import (
    between,
    cross,
    divided,
    dot,
    length,
    minus,
    plus,
    put,
    scaled,
    vector,
    vector_at,
)
from fracture_collision.core.mesh.connected_pieces import root_of
from fracture_collision.core.patches.facing_points import axes_along, box_around, seen_along
from fracture_collision.core.patches.surface import Surface
from fracture_collision.core.samples.sample_leaves import place_on_curve

_OUTSIDE = -1  # of all overlaps
BLOCK = 8  # triangles whose common box is looked at first
ROUNDING = 1e-12  # of coordinates, as a share
PARALLEL = 1e-6  # square of the sine of an angle between parallel sides


class Overlaps(NamedTuple):
    """Parts in which two fragments overlap, numbered by their first pair of triangles."""

    of_a: np.ndarray  # (triangles of a,) int64: the overlap that it pierces or bounds, or -1
    of_b: np.ndarray  # (triangles of b,) int64
    areas: np.ndarray  # (n, 3) [m2] a's area vector inside b
    spreads: np.ndarray  # (n,) [m2] area of the lines' cones from their middle: near the area's if there is one line


@kernel
def no_overlaps():
    """Overlaps of surfaces that pierce nothing."""
    return Overlaps(np.empty(0, np.int64), np.empty(0, np.int64), np.empty((0, 3)), np.empty(0))


@kernel
def pierced_pairs(a, b, n):
    """Pairs (k, 2) int64 of triangles of two Posed surfaces of which an edge of one passes through the other.

    n: see close_pairs.
    """
    return pierced_of(a, b, close_pairs(a, b, n, 0.0))


class _Side(NamedTuple):
    """Triangles (k,) of one surface that may meet the other, seen along n."""

    rows: np.ndarray  # (k,) int64
    boxes: np.ndarray  # (k, 6) float64 [m] least and most
    blocks: np.ndarray  # (m, 6) float64 [m] boxes around each BLOCK of them
    flat: np.ndarray  # (k, 13) float64: see _flat; where known
    is_known: np.ndarray  # (k,) bool
    surface: Surface
    pose: tuple[np.ndarray, np.ndarray]  # for flat


@kernel
def close_pairs(a, b, n, reach):
    """Pairs (k, 2) int64 of triangles that may pierce each other where b is moved by up to `reach` [m].

    n: any unit vector; the less the surfaces overlap along it, the fewer triangles are looked at.
    """
    axes = axes_along(n)
    of_a, of_b = seen_along(a.corners, axes), seen_along(b.corners, axes)
    box, slack = _where_both_are(of_a, of_b, reach)
    unmoved = np.eye(3), np.zeros(3)
    side_a, side_b = _side_of(a, of_a, unmoved, box, slack), _side_of(b, of_b, unmoved, box, 0.0)
    pairs, used, distances = np.empty((64, 2), np.int64), 0, np.empty(6)
    near, hits = np.empty(len(side_b.blocks), np.int64), np.empty(BLOCK, np.int64)
    for i in range(len(side_a.blocks)):
        many = _meeting(side_a.blocks, i, side_b.blocks, 0, len(side_b.blocks), near)
        for t in range(i * BLOCK, min((i + 1) * BLOCK, len(side_a.rows))):
            for k in range(many):
                if not _do_meet(side_a.boxes, t, side_b.blocks, near[k]):
                    continue
                first, last = near[k] * BLOCK, min((near[k] + 1) * BLOCK, len(side_b.rows))
                for h in range(_meeting(side_a.boxes, t, side_b.boxes, first, last, hits)):
                    s = hits[h]
                    _know(side_a, t)
                    _know(side_b, s)
                    if _planes_cut(side_a.flat, t, side_b.flat, s, slack, distances):
                        if used == len(pairs):
                            pairs = np.vstack((pairs, np.empty_like(pairs)))
                        pairs[used, 0], pairs[used, 1] = side_a.rows[t], side_b.rows[s]
                        used += 1
    return pairs[:used]


@kernel
def do_pierce(a, b, poses, n, listed):
    """Whether two Surfaces have pierced_pairs: quicker, most of all where they have none.

    poses: rotations (3, 3) and positions (3,) [m] of both; n: see close_pairs; listed: rows (k, 2) int32 for all pairs
    of triangles that may pierce each other where b is moved by up to a reach [m], and that. Returns (whether; number of
    pairs listed, -1: they pierce each other, or there are more).
    """
    axes, (rows, reach), used = axes_along(n), listed, 0
    turn_a, turn_b = _product(axes, poses[0][0]), _product(axes, poses[1][0])
    of_a, of_b = seen_along(a.corners, turn_a), seen_along(b.corners, turn_b)
    _move(of_a, rotated(axes, poses[0][1]))
    _move(of_b, rotated(axes, poses[1][1]))
    box, slack = _where_both_are(of_a, of_b, reach)
    side_a, side_b = _side_of(a, of_a, poses[0], box, slack), _side_of(b, of_b, poses[1], box, 0.0)
    near, distances = np.empty(len(side_b.blocks), np.int64), np.empty(6)
    for i in range(len(side_a.blocks)):
        many = _meeting(side_a.blocks, i, side_b.blocks, 0, len(side_b.blocks), near)
        for t in range(i * BLOCK, min((i + 1) * BLOCK, len(side_a.rows))):
            for k in range(many):
                if not _do_meet(side_a.boxes, t, side_b.blocks, near[k]):
                    continue
                for s in range(near[k] * BLOCK, min((near[k] + 1) * BLOCK, len(side_b.rows))):
                    if not _do_meet(side_a.boxes, t, side_b.boxes, s):
                        continue
                    _know(side_a, t)
                    _know(side_b, s)
                    if not _planes_cut(side_a.flat, t, side_b.flat, s, reach, distances):
                        continue
                    if reach > 0.0 and _are_beyond(side_a.flat[t], side_b.flat[s], reach):
                        continue
                    if _edges_pierce(side_a.flat, t, side_b.flat, s, distances):
                        return True, -1
                    if 0 <= used < len(rows):
                        rows[used, 0], rows[used, 1] = side_a.rows[t], side_b.rows[s]
                        used += 1
                    else:
                        used = -1
    return False, used


@kernel
def do_listed_pierce(a, b, poses, rows):
    """Whether any of pairs (k, 2) of triangles of two Surfaces pierce each other, see do_pierce: to the last bit."""
    flat, distances, last = np.empty((2, 13)), np.empty(6), -1
    for k in range(len(rows)):
        if rows[k, 0] != last:  # do_pierce lists all of one after the other
            last = rows[k, 0]
            _put_flat(a, last, poses[0], flat[0])
        if _is_beside_plane(flat[0], b, rows[k, 1], poses[1]):
            continue
        _put_flat(b, rows[k, 1], poses[1], flat[1])
        if _planes_cut(flat, 0, flat, 1, 0.0, distances) and _edges_pierce(flat, 0, flat, 1, distances):
            return True
    return False


@query_kernel
def _is_beside_plane(flat, surface, t, pose):
    """Whether the corners of a row of a _flat are all on one side of the plane of a triangle of a Surface at a pose.

    The first half of _planes_cut without the rest of _put_flat: few of the triangles listed get past it.
    """
    turn, place = pose
    normal = rotated(turn, vector(surface.normals, t))
    height = dot(normal, to_other(turn, place, vector(surface.corners, surface.triangles[t, 0])))
    x, y, z = dot(normal, vector_at(flat, 0)), dot(normal, vector_at(flat, 3)), dot(normal, vector_at(flat, 6))
    return not (min(x, y, z) - height < 0.0 and max(x, y, z) - height > 0.0)


@query_kernel
def _edges_pierce(a, i, b, j, distances):
    """Whether an edge of one row of a _flat passes through the other; distances: see _planes_cut."""
    for side in range(0, 6, 3):
        x, y, z = distances[side], distances[side + 1], distances[side + 2]
        if not (min(x, y, z) < 0.0 and max(x, y, z) > 0.0):
            return False
    for edge in range(6):  # noqa: SIM110 (numba has no generators in expressions)
        if _crossing_at(a, i, b, j, edge, distances) >= 0.0:
            return True
    return False


@kernel
def _product(a, b):
    out = np.zeros((3, 3))
    for d in range(3):
        for k in range(3):
            for e in range(3):
                out[d, e] += a[d, k] * b[k, e]
    return out


@query_kernel
def _move(places, by):
    """Move places (k, 3) by a vector."""
    for k in range(len(places)):
        put(places, k, plus(vector(places, k), by))


@kernel
def _where_both_are(of_a, of_b, reach):
    """(the box (6,) [m] in which both places (k, 3) have a part, `reach` [m] and the rounding; these)."""
    box, size = np.empty(6), 0.0
    box_a, box_b = box_around(of_a), box_around(of_b)
    for d in range(3):
        box[d], box[3 + d] = max(box_a[d], box_b[d]), min(box_a[3 + d], box_b[3 + d])
        size = max(size, abs(box[d]), abs(box[3 + d]))
    slack = reach + ROUNDING * size
    for d in range(3):
        box[d], box[3 + d] = box[d] - slack, box[3 + d] + slack
    return box, slack


@kernel
def _side_of(surface, places, pose, box, by):
    """The _Side of the triangles whose boxes, wider by `by` [m], meet a box; places (c, 3) [m]: of corners, as seen."""
    rows = triangles_within(surface.triangles, places, box, by)
    boxes = np.empty((len(rows), 6))
    for k in range(len(rows)):
        p, q, r = surface.triangles[rows[k], 0], surface.triangles[rows[k], 1], surface.triangles[rows[k], 2]
        for d in range(3):
            x, y, z = places[p, d], places[q, d], places[r, d]
            boxes[k, d], boxes[k, 3 + d] = min(x, y, z) - by, max(x, y, z) + by
    flat, is_known = np.empty((len(rows), 13)), np.zeros(len(rows), np.bool_)
    return _Side(rows, boxes, _blocks(boxes), flat, is_known, surface, pose)


@query_kernel
def _know(side, k):
    """Write flat of a triangle, if it is not known: few of those that may meet the other have neighbours that do."""
    if not side.is_known[k]:
        side.is_known[k] = True
        _put_flat(side.surface, side.rows[k], side.pose, side.flat[k])


@query_kernel
def _put_flat(surface, t, pose, out):
    """Write a triangle of a Surface at a pose to a row of a _flat."""
    turn, place = pose
    for i in range(3):
        corner = vector(surface.corners, surface.triangles[t, i])
        out[3 * i], out[3 * i + 1], out[3 * i + 2] = to_other(turn, place, corner)
    out[9], out[10], out[11] = rotated(turn, vector(surface.normals, t))
    out[12] = dot(vector_at(out, 9), out)


@query_kernel
def _do_meet(one, i, other, j):
    return (
        (one[i, 0] <= other[j, 3]) & (one[i, 3] >= other[j, 0]) & (one[i, 1] <= other[j, 4])
        & (one[i, 4] >= other[j, 1]) & (one[i, 2] <= other[j, 5]) & (one[i, 5] >= other[j, 2])
    )  # fmt: skip


@query_kernel
def _meeting(own, row, others, first, last, hits):
    """Write which rows of `others` (k, 6) between two meet a row of `own` (n, 6); returns their number."""
    x0, y0, z0, x1, y1, z1 = own[row, 0], own[row, 1], own[row, 2], own[row, 3], own[row, 4], own[row, 5]
    count = 0
    for k in range(first, last):
        hits[count] = k
        count += (
            (others[k, 0] <= x1) & (others[k, 3] >= x0) & (others[k, 1] <= y1) & (others[k, 4] >= y0)
            & (others[k, 2] <= z1) & (others[k, 5] >= z0)
        )  # fmt: skip
    return count


@kernel
def _blocks(boxes):
    """Boxes (k, 6) around each BLOCK of boxes (n, 6)."""
    out = np.empty((-(-len(boxes) // BLOCK), 6))
    for i in range(len(out)):
        out[i] = boxes[i * BLOCK]
        for k in range(i * BLOCK + 1, min((i + 1) * BLOCK, len(boxes))):
            for d in range(3):
                out[i, d], out[i, 3 + d] = min(out[i, d], boxes[k, d]), max(out[i, 3 + d], boxes[k, 3 + d])
    return out


@kernel
def pierced_of(a, b, close):
    """Those of the pairs `close` (k, 2) that pierce each other."""
    flat_a, flat_b = _flat(a, close[:, 0]), _flat(b, close[:, 1])
    distances, pierced = np.empty(6), np.zeros(len(close), np.bool_)
    for k in range(len(close)):
        if _planes_cut(flat_a, k, flat_b, k, 0.0, distances):
            for edge in range(6):
                pierced[k] = pierced[k] or _crossing_at(flat_a, k, flat_b, k, edge, distances) >= 0.0
    return close[pierced]


@kernel
def overlaps_of(a, b, pairs):
    """The Overlaps of two Posed surfaces with these pairs (k, 2) of triangles, k > 0."""
    cut_a, cut_b = _no_cuts(a), _no_cuts(b)
    ends = np.empty((len(pairs), 2, 3))
    distances = np.empty(6)
    flat_a, flat_b = _flat(a, pairs[:, 0]), _flat(b, pairs[:, 1])
    for k in range(len(pairs)):
        t, s = pairs[k]
        _planes_cut(flat_a, k, flat_b, k, 0.0, distances)
        found = 0
        for edge in range(6):
            share = _crossing_at(flat_a, k, flat_b, k, edge, distances)
            if share < 0.0:
                continue
            own, row, i, cut = (flat_a, t, edge, cut_a) if edge < 3 else (flat_b, s, edge - 3, cut_b)
            point = between(vector_at(own[k], 3 * i), vector_at(own[k], 3 * ((i + 1) % 3)), share)
            is_going_out = distances[edge] < 0.0
            if share < cut[row, i, 0]:
                cut[row, i, 0], cut[row, i, 2] = share, 1.0 if is_going_out else 0.0
            if share > cut[row, i, 1]:
                cut[row, i, 1], cut[row, i, 3] = share, 0.0 if is_going_out else 1.0
            for end in range(found, 2):
                ends[k, end] = point
            found += 1
        # along n_a x n_b the inside of b is on the left, as seen from outside a
        way, first, last = cross(vector(a.normals, t), vector(b.normals, s)), vector(ends[k], 0), vector(ends[k], 1)
        if dot(way, minus(last, first)) < 0.0:
            ends[k, 0], ends[k, 1] = last, first
    return _joined(a, b, pairs, ends, (_inside(a, cut_a), _inside(b, cut_b)))


@kernel
def _joined(a, b, pairs, ends, inside):
    """The Overlaps: triangles that pierce each other, or share a corner inside the other, are of one."""
    ta, tb, ca = len(a.triangles), len(b.triangles), len(a.corners)
    parent = np.arange(ta + tb + ca + len(b.corners))
    for k in range(len(pairs)):
        _join(parent, pairs[k, 0], ta + pairs[k, 1])
    for side in range(2):
        own, first, corner = (a, 0, ta + tb) if side == 0 else (b, ta, ta + tb + ca)
        for t in range(len(own.triangles)):
            for i in range(3):
                if inside[side][own.triangles[t, i]]:
                    _join(parent, first + t, corner + own.triangles[t, i])
    number, count = np.full(len(parent), _OUTSIDE), 0
    for k in range(len(pairs)):
        root = root_of(parent, pairs[k, 0])
        if number[root] == _OUTSIDE:
            number[root] = count
            count += 1
    of_a, of_b = np.empty(ta, np.int64), np.empty(tb, np.int64)
    for t in range(ta):
        of_a[t] = number[root_of(parent, t)]
    for t in range(tb):
        of_b[t] = number[root_of(parent, ta + t)]
    sums, many = np.zeros((count, 3)), np.zeros(count)
    for k in range(len(pairs)):
        c = of_a[pairs[k, 0]]
        many[c] += 2.0
        put(sums, c, plus(vector(sums, c), plus(vector(ends[k], 0), vector(ends[k], 1))))
    areas, spreads = np.zeros((count, 3)), np.zeros(count)
    for k in range(len(pairs)):
        c = of_a[pairs[k, 0]]
        middle = divided(vector(sums, c), many[c])
        first, last = minus(vector(ends[k], 0), middle), minus(vector(ends[k], 1), middle)
        area = cross(scaled(0.5, first), last)
        put(areas, c, plus(vector(areas, c), area))
        spreads[c] += length(area)
    return Overlaps(of_a, of_b, areas, spreads)


@kernel
def _no_cuts(posed):
    """For each side of each triangle (t, 3, 4): first and last share where it is cut, whether its ends are inside."""
    cuts = np.zeros((len(posed.triangles), 3, 4))
    cuts[:, :, 0] = math.inf
    cuts[:, :, 1] = -math.inf
    return cuts


@kernel
def _inside(posed, cuts):
    """Corners (c,) bool inside the other: ends of sides that are cut, and what hangs together with them by others."""
    inside = np.zeros(len(posed.corners), np.bool_)
    for t in range(len(posed.triangles)):
        for i in range(3):
            if cuts[t, i, 0] <= 1.0:
                p, q = posed.triangles[t, i], posed.triangles[t, (i + 1) % 3]
                inside[p] = inside[p] or cuts[t, i, 2] > 0.0
                inside[q] = inside[q] or cuts[t, i, 3] > 0.0
    has_more = True
    while has_more:
        has_more = False
        for t in range(len(posed.triangles)):
            for i in range(3):
                p, q = posed.triangles[t, i], posed.triangles[t, (i + 1) % 3]
                if inside[p] != inside[q] and cuts[t, i, 0] > 1.0:
                    inside[p] = inside[q] = True
                    has_more = True
    return inside


@query_kernel
def _join(parent, j, k):
    j, k = root_of(parent, j), root_of(parent, k)
    parent[max(j, k)] = min(j, k)


@kernel
def triangles_within(triangles, places, box, by):
    """Rows (k,) of triangles whose boxes, wider by `by` [m], meet a box (6,)."""
    beyond = np.empty(len(places), np.uint8)  # a bit for each side of the box
    x0, y0, z0, x1, y1, z1 = box[0] - by, box[1] - by, box[2] - by, box[3] + by, box[4] + by, box[5] + by
    for c in range(len(places)):
        x, y, z = places[c, 0], places[c, 1], places[c, 2]
        beyond[c] = (
            (x < x0) | ((x > x1) << 1) | ((y < y0) << 2) | ((y > y1) << 3) | ((z < z0) << 4) | ((z > z1) << 5)
        )  # fmt: skip
    rows, used = np.empty(len(triangles), np.int64), 0
    for t in range(len(triangles)):
        rows[used] = t
        used += beyond[triangles[t, 0]] & beyond[triangles[t, 1]] & beyond[triangles[t, 2]] == 0
    return rows[:used]


@kernel
def in_order(triangles):
    """Rows (n,) of triangles (n, 9) [m] along a curve on which near ones are near: close_pairs is quick with these."""
    low, high, middles = np.full(3, math.inf), np.full(3, -math.inf), np.empty((len(triangles), 3))
    for t in range(len(triangles)):
        for d in range(3):
            middles[t, d] = (triangles[t, d] + triangles[t, 3 + d] + triangles[t, 6 + d]) / 3.0
            low[d], high[d] = min(low[d], middles[t, d]), max(high[d], middles[t, d])
    places = np.empty(len(triangles), np.uint32)
    for t in range(len(triangles)):
        places[t] = place_on_curve(middles[t], low, high)
    return np.argsort(places, kind="mergesort")


@kernel
def _flat(posed, rows):
    """Corners [m], normal, and the plane's distance from the origin [m], of triangles (k,): (k, 13)."""
    flat = np.empty((len(rows), 13))
    for k in range(len(rows)):
        t, out = rows[k], flat[k]
        for i in range(3):
            out[3 * i], out[3 * i + 1], out[3 * i + 2] = vector(posed.corners, posed.triangles[t, i])
        out[9], out[10], out[11] = vector(posed.normals, t)
        out[12] = dot(vector_at(out, 9), out)
    return flat


@query_kernel
def _planes_cut(a, i, b, j, reach, distances):
    """Whether rows of two _flat have corners on both sides of each other's plane, or no farther from it than `reach`.

    distances (6,): of a's corners from b's plane [m], then of b's from a's; positive outside.
    """
    near = True
    for side in range(2):
        low, high = math.inf, -math.inf
        for k in range(3):
            d = _above(b[j], a[i], k) if side == 0 else _above(a[i], b[j], k)
            distances[3 * side + k] = d
            low, high = min(low, d), max(high, d)
        near = near and low < reach and high > -reach
        if not near:
            break
    return near


@query_kernel
def _are_beyond(a, b, reach):
    """Whether rows of two _flat are farther than `reach` [m] from each other, along one of the axes of two triangles.

    The planes' own are left to _planes_cut; with all of them, triangles that are apart are so along one (Ericson 2005).
    """
    for i in range(3):
        p = minus(vector_at(a, 3 * ((i + 1) % 3)), vector_at(a, 3 * i))
        q = minus(vector_at(b, 3 * ((i + 1) % 3)), vector_at(b, 3 * i))
        if _are_beyond_along(a, b, cross(p, vector_at(a, 9)), dot(p, p), reach):
            return True
        if _are_beyond_along(a, b, cross(q, vector_at(b, 9)), dot(q, q), reach):
            return True
        for j in range(3):
            r = minus(vector_at(b, 3 * ((j + 1) % 3)), vector_at(b, 3 * j))
            if _are_beyond_along(a, b, cross(p, r), dot(p, p) * dot(r, r), reach):
                return True
    return False


@query_kernel
def _are_beyond_along(a, b, axis, size, reach):
    """The same along an axis, unless rounding decides its direction; size: of the square of its length, the most."""
    square = dot(axis, axis)
    if square < PARALLEL * size:
        return False
    x, y, z = dot(axis, vector_at(a, 0)), dot(axis, vector_at(a, 3)), dot(axis, vector_at(a, 6))
    u, v, w = dot(axis, vector_at(b, 0)), dot(axis, vector_at(b, 3)), dot(axis, vector_at(b, 6))
    gap = max(min(x, y, z) - max(u, v, w), min(u, v, w) - max(x, y, z))
    return gap > 0.0 and gap * gap > (1.0 + PARALLEL) * reach * reach * square


@query_kernel
def _above(a, b, corner):
    """Height [m] of a corner of one row of a _flat above the plane of another."""
    return dot(vector_at(a, 9), vector_at(b, 3 * corner)) - a[12]


@query_kernel
def _crossing_at(a, i, b, j, edge, distances):
    """At which share a side of a row of a _flat passes through one of another, -1: does not; sides 3 to 5 are b's."""
    k = edge % 3
    d, e = distances[edge], distances[edge - k + (k + 1) % 3]
    if not d * e < 0.0:
        return -1.0
    own, m, other, n = (a, i, b, j) if edge < 3 else (b, j, a, i)
    x, y, z = _volume(own[m], k, other[n], 0), _volume(own[m], k, other[n], 1), _volume(own[m], k, other[n], 2)
    if (x > 0.0 and y > 0.0 and z > 0.0) or (x < 0.0 and y < 0.0 and z < 0.0):
        return d / (d - e)
    return -1.0


@query_kernel
def _volume(a, k, b, side):
    """Six times the signed volume [m3] of a tetrahedron with side k of one triangle and a side of another."""
    p, q = vector_at(a, 3 * k), vector_at(a, 3 * ((k + 1) % 3))
    r, s = vector_at(b, 3 * side), vector_at(b, 3 * ((side + 1) % 3))
    return dot(minus(q, p), cross(minus(r, p), minus(s, p)))
