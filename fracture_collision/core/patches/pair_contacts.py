"""Contacts of two fragments along one direction: where their surfaces face each other, now or when they will touch."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from fracture_collision.core.contacts.known_samples import ID_AT, ID_SAMPLE, ID_SIDE, ID_SOURCE, ID_TETRAHEDRON
from fracture_collision.core.field.flood import NO_SOURCE
from fracture_collision.core.lookahead.motion import MOST_TURN, put_pose
from fracture_collision.core.memory.compiled import allocating_kernel, kernel, query_kernel
from fracture_collision.core.memory.rotations import relative_pose, rotated, to_other, turned_back
from fracture_collision.core.mesh.sample_numbers import FIRST_OF_PATCHES
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
# A step is divided so that neither body turns by more than MOST_TURN in a part.
MOST_PARTS = 64
_CROSSING_STRIDE = 1 << 24


# A direction along which few places are level.
_ASKEW = 0.5, 0.7, 0.51


class Placing(NamedTuple):
    """Poses of one fragment at the beginning and end of a part of the step, then at the step's end.

    All from b's frame of the part's beginning.
    """

    rotations: np.ndarray  # (3, 3, 3)
    positions: np.ndarray  # (3, 3) [m]


class Wanted(NamedTuple):
    """Which contacts."""

    near: float  # [m] the detection tolerance
    moved: float  # [m] how far the two moved since they were one, infinity: never
    most: int


class Patch(NamedTuple):
    """Contacts of one direction, in b's frame at the beginning; gaps are positive where the two touch later."""

    normal: np.ndarray  # (3,) unit, from a to b
    points: np.ndarray  # (k, 3) [m] on a
    others: np.ndarray  # (k, 3) [m] on b
    gaps: np.ndarray  # (k,) [m] along the normal
    numbers: np.ndarray  # (k,) int64: which feature it is of: a corner of b, of a, or a crossing
    overlap: float  # [m] at the beginning: no point of either is deeper in the other


@allocating_kernel
def put_patch(shapes, pair, moving, wanted, remembered, sink):
    """Write the contacts of a Pair of convex fragments, now or within the time of a Moving, to a Sink, if it has room.

    wanted: Wanted; remembered (3,): what kept the two apart before, which is tried first and has no influence on what
    is listed. Returns (contacts, missed depth bound [m], whether they depend on the motion).
    """
    i, j, rotations, positions, motion = moving
    hulls = hull_of(shapes, pair.a), hull_of(shapes, pair.b)
    parts = _parts(motion, i, j)
    turns, places, bound = np.empty((6, 3, 3)), np.empty((6, 3)), 0.0
    for part in range(max(parts, 1)):
        for end in range(3):
            t = motion.time * (part + end if end < 2 else parts) / parts if parts > 0 else 0.0
            for side in range(2):
                k, row = (i, end) if side == 0 else (j, 3 + end)
                if t > 0.0:
                    put_pose(motion, rotations, positions, k, t, turns[row], places[row])
                else:
                    turns[row], places[row] = rotations[k], positions[k]
        placings = seen_from(turns, places, 0), seen_from(turns, places, 3)
        more = max(parts - 1 - part, 0)
        patch = mesh_patch(shapes, (pair.a, pair.b), hulls, placings, more, wanted, remembered)
        count = len(patch.gaps)
        if part == 0:
            bound = patch.overlap
        if count > 0 and count <= len(sink.contacts):
            n = _turned(turns[3], patch.normal)
            n = _turned_back(rotations[j], n)
            for k in range(count):
                p, q = patch.points[k], patch.others[k]
                if part > 0:
                    p = _turned_back(placings[0].rotations[0], p - placings[0].positions[0])
                    p = _turned(pair.rotation[0], p) + pair.translation[0]
                put_contact(sink, k, p, q, n if part > 0 else patch.normal, patch.numbers[k])
        if count > 0:
            return count, bound, parts > 0
    return 0, bound, parts > 0


@query_kernel
def _parts(motion, i, j):
    """Number of parts that a step is divided into; 0: the two do not move against each other."""
    if not motion.time > 0.0:
        return 0
    turn, differs = 0.0, False
    for k in (i, j):
        w = motion.angular[k]
        turn += math.sqrt(w[0] * w[0] + w[1] * w[1] + w[2] * w[2])
    for d in range(3):
        differs = differs or motion.linear[i, d] != motion.linear[j, d]
    if not (turn > 0.0 or differs):
        return 0
    return min(max(int(math.ceil(motion.time * turn / MOST_TURN)), 1), MOST_PARTS)


@kernel
def put_contact(sink, k, p, q, n, number):
    """Write a contact to row k of a Sink, as a sample of a that meets b."""
    row, ids = sink.contacts[k], sink.ids[k]
    for d in range(3):
        row[d], row[3 + d], row[6 + d] = p[d], q[d], -n[d]
    row[9] = (q[0] - p[0]) * n[0] + (q[1] - p[1]) * n[1] + (q[2] - p[2]) * n[2]
    ids[ID_SIDE], ids[ID_SAMPLE] = 0, FIRST_OF_PATCHES + number
    ids[ID_SOURCE], ids[ID_TETRAHEDRON], ids[ID_AT] = NO_SOURCE, -1, -1


@kernel
def mesh_patch(shapes, rows, hulls, placings, more, wanted, remembered):
    """The Patch of two fragments with surfaces, by rows (a, b) of Shapes; without contacts where they stay apart.

    hulls, placings: of both; more: further parts of the step; wanted, remembered: see put_patch.
    """
    (a, b), tolerance = rows, wanted.near
    parting = parting_direction(hulls[0], hulls[1], _relative(placings), tolerance, remembered)
    n = np.array([parting.x, parting.y, parting.z])
    if parting.is_apart:
        return Patch(n, np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0), np.zeros(0, np.int64), 0.0)
    size = min(shapes.size[a], shapes.size[b])
    closing = max(parting.now - parting.end, 0.0)
    share = 0.0
    if parting.now > tolerance and parting.end < tolerance and closing > 0.0:
        share = min(parting.now / closing, 1.0)
    surface_a, surface_b = surface_of(shapes, a), surface_of(shapes, b)
    first, last = posed_at(surface_a, placings[0], share), posed_at(surface_b, placings[1], share)
    # where the two are stopped at one place, others may yet meet
    moves = _moves(placings, hulls[0])
    found = facing_points(first, last, n, (-math.inf, tolerance + (1.0 - share + more) * moves), size)
    # a point inside is no farther from the surface than both are moved to be apart, or were moved to get there
    overlap = min(max(-parting.now, 0.0), wanted.moved)
    return listed_patch(found, placings, (share, overlap), n, more, wanted, size)


@kernel
def listed_patch(found, placings, at, n, more, wanted, size):
    """The Patch of the best of FacingPoints, none where none is within the tolerance now or at the end.

    at: share of the part of the step at which they are, the overlap. A point is listed if it is within the tolerance
    then or at the end of the step.
    """
    (share, overlap), (tolerance, moved, most) = at, wanted
    count, touches = len(found.gaps), False
    points, others, gaps = np.empty((count, 3)), np.empty((count, 3)), np.empty(count)
    least = np.empty(count)
    order, numbers = np.empty(count, np.int64), np.empty(count, np.int64)
    used = 0
    undone_a, undone_b = _undone(placings[0], share), _undone(placings[1], share)
    ways = _ways_at_end(placings, n)
    for k in range(count):
        x, y, z, gap = found.points[k, 0], found.points[k, 1], found.points[k, 2], found.gaps[k]
        if gap < -(MOVED * moved + ONE_PLACE * size):
            continue
        of_a = _local(undone_a, x, y, z)
        of_b = _local(undone_b, x + gap * n[0], y + gap * n[1], z + gap * n[2])
        least[used] = min(gap, _gap_at_end(placings, of_a, of_b, ways))
        if least[used] > tolerance:
            continue
        touches = touches or gap <= tolerance or more == 0
        p, q = points[used], others[used]
        p[0], p[1], p[2] = x, y, z
        q[0], q[1], q[2] = x + gap * n[0], y + gap * n[1], z + gap * n[2]
        if share > 0.0:
            p[0], p[1], p[2] = _placed(placings[0], 0, of_a)
            q[0], q[1], q[2] = _placed(placings[1], 0, of_b)
            gap = (q[0] - p[0]) * n[0] + (q[1] - p[1]) * n[1] + (q[2] - p[2]) * n[2]
        gaps[used] = gap
        kind, i, j = found.features[k]
        # crossings after corners, those of b before those of a
        numbers[used] = (np.int64(kind) << 56) + (_CROSSING_STRIDE * i + j if kind == CROSSING else i)
        used += 1
    order = np.argsort(numbers[: used if touches else 0], kind="mergesort")
    order = order[: _one_per_place(points, order, ONE_PLACE * size)]
    chosen = _spread(points, (gaps, least), order, tolerance, most)
    return Patch(n, points[chosen], others[chosen], gaps[chosen], numbers[chosen], overlap)


@kernel
def _one_per_place(points, order, apart):
    """Move to the front of `order` the first of each place; returns their number."""
    count, kept = len(order), 0
    heights, is_kept = np.empty(count), np.zeros(count, np.bool_)
    for k in range(count):
        p = points[order[k]]
        heights[k] = _ASKEW[0] * p[0] + _ASKEW[1] * p[1] + _ASKEW[2] * p[2]
    by_height = np.argsort(heights, kind="mergesort")
    row, reach = np.empty(count, np.int64), (_ASKEW[0] + _ASKEW[1] + _ASKEW[2]) * apart
    for r in range(count):
        row[by_height[r]] = r
    for k in range(count):
        p, is_new = points[order[k]], True
        for way in (-1, 1):
            r = row[k] + way
            while is_new and 0 <= r < count and abs(heights[by_height[r]] - heights[k]) <= reach:
                if is_kept[by_height[r]]:
                    q = points[order[by_height[r]]]
                    is_new = not max(abs(p[0] - q[0]), abs(p[1] - q[1]), abs(p[2] - q[2])) < apart
                r += way
        is_kept[k] = is_new
    for k in range(count):
        if is_kept[k]:
            order[kept] = order[k]
            kept += 1
    return kept


@kernel
def _spread(points, depths, order, tolerance, most):
    """Rows of up to `most` points: the deepest now, then always that which is farthest from those before.

    depths: gaps now, and the least of now and the end. The distance is weighted by how deep it is there, from 1 at the
    deepest to 0 at a tolerance above the highest, by either gap.
    """
    count = len(order)
    chosen, used = np.empty(min(most, count), np.int64), 0
    far, taken, weight = np.full(count, math.inf), np.zeros(count, np.bool_), np.zeros(count)
    pick = -1
    for gaps in depths:
        deepest, highest = math.inf, -math.inf
        for k in range(count):
            deepest, highest = min(deepest, gaps[order[k]]), max(highest, gaps[order[k]])
        for k in range(count):
            weight[k] = max(weight[k], 1.0 - (gaps[order[k]] - deepest) / (highest - deepest + tolerance))
            if pick < 0 and gaps[order[k]] <= deepest + ALIKE * tolerance:
                pick = k
    while pick >= 0 and used < len(chosen):
        chosen[used], taken[pick] = order[pick], True
        used += 1
        p, best = points[order[pick]], 0.0
        for k in range(count):
            q = points[order[k]]
            away = math.sqrt((q[0] - p[0]) ** 2 + (q[1] - p[1]) ** 2 + (q[2] - p[2]) ** 2)
            far[k] = min(far[k], away)
            if not taken[k]:
                best = max(best, far[k] * weight[k])
        pick = -1
        if not best > 0.0:
            break
        for k in range(count):
            if not taken[k] and far[k] * weight[k] >= EQUAL * best:
                pick = k
                break
    return chosen[:used]


@kernel
def seen_from(turns, places, first):
    """The Placing of the fragment with world poses turns (6, 3, 3), places (6, 3) in the rows from `first` on.

    b's, in whose frame they are seen, are in the last three.
    """
    out = Placing(np.empty((3, 3, 3)), np.empty((3, 3)))
    for end in range(3):
        if first == 3 and end == 0:
            out.rotations[0], out.positions[0] = np.eye(3), np.zeros(3)
        else:
            row = first + end
            relative_pose(turns[row], places[row], turns[3], places[3], out.rotations[end], out.positions[end])
    return out


@kernel
def _turned(rotation, p):
    x, y, z = rotated(rotation, p[0], p[1], p[2])
    return np.array([x, y, z])


@kernel
def _turned_back(rotation, p):
    x, y, z = turned_back(rotation, p[0], p[1], p[2])
    return np.array([x, y, z])


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


@kernel
def _moves(placings, hull):
    """How far [m] a point of a, whose Hull is given, moves at most as seen from b."""
    a, b = placings
    turn, shift = np.empty((3, 3)), np.empty(3)
    for d in range(3):
        shift[d] = -a.positions[0, d]  # b is at the origin of its frame of the beginning
        for e in range(3):
            shift[d] += b.rotations[1, e, d] * (a.positions[1, e] - b.positions[1, e])
            turn[d, e] = -a.rotations[0, d, e]
            for k in range(3):
                turn[d, e] += b.rotations[1, k, d] * a.rotations[1, k, e]
    most = 0.0
    for k in range(len(hull.x)):
        x, y, z = rotated(turn, hull.x[k], hull.y[k], hull.z[k])
        x, y, z = x + shift[0], y + shift[1], z + shift[2]
        most = max(most, x * x + y * y + z * z)
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
def posed_at(surface, placing, share):
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
def _undone(placing, share):
    """What undoes the map of _mixed: (cofactors (3, 3), determinant, offset (3,))."""
    m, offset = _mixed(placing, share)
    # by Cramer's rule: the mixed matrix is near a rotation
    c = np.empty((3, 3))
    for d in range(3):
        i, j = (d + 1) % 3, (d + 2) % 3
        for e in range(3):
            k, l = (e + 1) % 3, (e + 2) % 3  # noqa: E741
            c[d, e] = m[i, k] * m[j, l] - m[i, l] * m[j, k]
    return c, m[0, 0] * c[0, 0] + m[0, 1] * c[0, 1] + m[0, 2] * c[0, 2], offset


@query_kernel
def _local(undone, x, y, z):
    """The point that an _undone map takes to (x, y, z)."""
    c, det, t = undone
    x, y, z = x - t[0], y - t[1], z - t[2]
    return (
        (c[0, 0] * x + c[1, 0] * y + c[2, 0] * z) / det,
        (c[0, 1] * x + c[1, 1] * y + c[2, 1] * z) / det,
        (c[0, 2] * x + c[1, 2] * y + c[2, 2] * z) / det,
    )


@query_kernel
def _placed(placing, row, local):
    """Where a point fixed to a fragment is at one of the poses of its Placing."""
    return to_other(placing.rotations[row], placing.positions[row], local[0], local[1], local[2])


@kernel
def _ways_at_end(placings, n):
    """Direction n at the end of the step, turned with a and with b: rows (2, 3)."""
    ways = np.empty((2, 3))
    for side in range(2):
        x, y, z = turned_back(placings[side].rotations[0], n[0], n[1], n[2])
        ways[side, 0], ways[side, 1], ways[side, 2] = rotated(placings[side].rotations[2], x, y, z)
    return ways


@query_kernel
def _gap_at_end(placings, of_a, of_b, ways):
    """Gap [m] of two points at the end of the step along one of `ways`: that which gives the smaller."""
    px, py, pz = _placed(placings[0], 2, of_a)
    qx, qy, qz = _placed(placings[1], 2, of_b)
    x, y, z = qx - px, qy - py, qz - pz
    return min(
        x * ways[0, 0] + y * ways[0, 1] + z * ways[0, 2], x * ways[1, 0] + y * ways[1, 1] + z * ways[1, 2]
    )
