"""The distance of pairs of fragments, however far apart, and the two points that are nearest.

Two hierarchies of boxes are descended at once, the nearer boxes first; what is left are pairs of triangles (Ericson
2005, sections 5.1.10 and 6.5). Where surfaces pierce each other, or one fragment is inside another, the distance is 0.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from fracture_collision.core.field.elementary_queries import INSIDE, bounded_probe
from fracture_collision.core.memory.compiled import query_kernel, threaded_kernel
from fracture_collision.core.memory.kinds import PLANE, SPHERE
from fracture_collision.core.memory.transforms import rotated, to_other, turned_back
from fracture_collision.core.memory.vectors import (
    corners_of,
    cross,
    divided,
    dot,
    minus,
    opposite,
    plus_scaled,
    vector,
    vector_at,
)
from fracture_collision.core.mesh.closest_point import closest_on_triangle, nearest_of_segments
from fracture_collision.core.queries.closest_points import closest_point
from fracture_collision.core.search.scratch import Scratch

# Pairs of nodes that wait: each descent adds one, and hierarchies are at most 62 deep.
STACK = 128
# Triangles of each that are listed at most, and pairs of these that are looked at; how often the line is taken anew.
MOST, MOST_PAIRS, ROUNDS = 64, 256, 6
# Where more are near, only what reaches so far into the space between is looked at before the next line.
THIN = 0.1
# How often the line between two corners that face each other is taken.
TURNS = 2
NOWHERE = (0.0, 0.0, 0.0)


class Room(NamedTuple):
    """A thread's working memory."""

    scratch: Scratch
    turn: np.ndarray  # (3, 3)
    rows: np.ndarray  # (2, MOST) int64
    stack: tuple[np.ndarray, np.ndarray]  # pairs of nodes (STACK, 2) int64, bounds (STACK,)


def make_room(scratch: Scratch) -> Room:
    """Around a Scratch for the meshes of the world."""
    stack = np.empty((STACK, 2), np.int64), np.empty(STACK)
    return Room(scratch, np.empty((3, 3)), np.empty((2, MOST), np.int64), stack)


@threaded_kernel
def pair_distances(pools, trees, here, pairs, out, room, part):
    """Write the distance [m] of each pair (p, 2) of the fragments `here`, and the nearest point of each, world.

    Of the pairs that are a thread's, see Crew.share. trees: SurfaceTrees; here: rows (n,), positions (n, 3) [m],
    rotations (n, 3, 3); out: (p,), (p, 3), (p, 3).
    """
    (rows, positions, rotations), turn, (thread, threads) = here, room.turn, part
    distances, points_a, points_b = out
    for p in range(thread, len(pairs), threads):
        i, j = pairs[p]
        is_turned = pools.fragment.kind[rows[i]] in (PLANE, SPHERE)  # the other one first, if it has a mesh
        if is_turned:
            i, j = j, i
        # from the frame of j to that of i
        for row in range(3):
            for column in range(3):
                turn[row, column] = dot(_column_of(rotations[i], row), _column_of(rotations[j], column))
        place = turned_back(rotations[i], minus(vector(positions, j), vector(positions, i)))
        d, q, r = _between(pools, trees, (rows[i], rows[j]), (turn, place), room)
        q, r = to_other(rotations[i], vector(positions, i), q), to_other(rotations[i], vector(positions, i), r)
        if is_turned:
            q, r = r, q
        distances[p] = d
        for axis in range(3):
            points_a[p, axis], points_b[p, axis] = q[axis], r[axis]


@query_kernel
def _column_of(rotation, column):
    """A column of a rotation (3, 3)."""
    return rotation[0, column], rotation[1, column], rotation[2, column]


@query_kernel
def _between(pools, trees, two, pose, room):
    """(distance [m], nearest point of the first fragment, of the second), in the frame of the first."""
    (a, b), (turn, place), scratch = two, pose, room.scratch
    kind_b, shape = pools.fragment.kind[b], pools.fragment.shape[b]
    if kind_b == PLANE:
        n = rotated(turn, vector_at(shape, 0))
        return _from_plane(pools, trees, a, n, shape[3] + dot(n, place))
    if kind_b == SPHERE:
        d, q, n = closest_point(pools, trees, a, place, scratch)
        d -= shape[0]
        return (d, q, plus_scaled(q, d, n)) if d > 0.0 else (0.0, q, q)
    d, q, r, is_beside = _between_surfaces(trees, two, pose, room)
    if is_beside or not d > 0.0:
        return d, q, r
    is_inside = _holds(pools, a, r, scratch) or _holds(pools, b, turned_back(turn, minus(q, place)), scratch)
    return (0.0, q, q) if is_inside else (d, q, r)


@query_kernel
def _holds(pools, f, point, scratch):
    return bounded_probe(pools, f, point, 0.0, 0.0, -1, False, scratch).status == INSIDE


@query_kernel
def _from_plane(pools, trees, a, n, offset):
    """_between a fragment and the half-space n . x <= offset."""
    if pools.fragment.kind[a] == SPHERE:
        q = (-pools.fragment.shape[a, 0] * n[0], -pools.fragment.shape[a, 0] * n[1], -pools.fragment.shape[a, 0] * n[2])
        d = dot(n, q) - offset
        return (d, q, plus_scaled(q, -d, n)) if d > 0.0 else (0.0, q, q)
    best, q = math.inf, NOWHERE
    node, end = trees.node_range[a]
    while node < end:
        for t in range(trees.node_first[node], trees.node_first[node] + trees.node_count[node]):
            for corner in corners_of(trees.corners[t]):
                d = dot(n, corner) - offset
                if d < best:
                    best, q = d, corner
        node += 1
    return (best, q, plus_scaled(q, -best, n)) if best > 0.0 else (0.0, q, q)


@query_kernel
def _between_surfaces(trees, two, pose, room):
    """_between two surfaces of triangles; 0 only where they meet. And whether a plane is known to separate the two.

    Two triangles can be nearer than `far` only if they are so along any line, too. Along the line between the nearest
    points so far, few are: mostly all pairs of these can be looked at.
    """
    (a, b), (turn, place), rows = two, pose, room.rows
    is_beside = False
    nearest = _corners_that_face(trees, two, pose)
    for _ in range(ROUNDS):
        _, q, r = nearest
        far = math.sqrt(nearest[0])
        if far == 0.0:
            return 0.0, q, r, False
        n = divided(minus(r, q), far)
        m = turned_back(turn, n)
        back, shift = opposite(m), dot(n, place)
        high, low = dot(n, _farthest(trees, a, n)), dot(m, _farthest(trees, b, back)) + shift
        is_beside = is_beside or low - high > 0.0
        if not low - high < far:
            return far, q, r, is_beside
        of_a, of_b = _beyond(trees, a, n, low - far, rows[0]), _beyond(trees, b, back, shift - high - far, rows[1])
        is_all = of_a <= MOST and of_b <= MOST and of_a * of_b <= MOST_PAIRS
        if not is_all:
            thin = THIN * (far - low + high)
            of_a = _beyond(trees, a, n, high - thin, rows[0])
            of_b = _beyond(trees, b, back, shift - low - thin, rows[1])
        nearer = _nearest_of(trees, (rows[0, : min(of_a, MOST)], rows[1, : min(of_b, MOST)]), pose, (n, far), nearest)
        if is_all:
            return math.sqrt(nearer[0]), nearer[1], nearer[2], is_beside
        if not nearer[0] < nearest[0]:
            break
        nearest = nearer
    d, q, r = _descended(trees, two, pose, room.stack, nearest)
    return d, q, r, is_beside


@query_kernel
def _beyond(trees, f, n, height, out):
    """Write the triangles of a fragment that reach above a height [m] along n; returns how many, or one too many."""
    count, (node, end) = 0, trees.node_range[f]
    while node < end:
        if not _most(trees.node_box[node], n) > height:
            node = trees.node_skip[node]
            continue
        for t in range(trees.node_first[node], trees.node_first[node] + trees.node_count[node]):
            x, y, z = corners_of(trees.corners[t])
            if max(dot(n, x), dot(n, y), dot(n, z)) > height:
                if count == len(out):
                    return count + 1
                out[count] = t
                count += 1
        node += 1
    return count


@query_kernel
def _nearest_of(trees, rows, pose, along, nearest):
    """(squared distance, points) of the nearest of all pairs of triangles in `rows`, or `nearest` if none is nearer."""
    (turn, place), (n, far), (best, q, r) = pose, along, nearest
    for s in rows[1]:
        x, y, z = corners_of(trees.corners[s])
        other = to_other(turn, place, x), to_other(turn, place, y), to_other(turn, place, z)
        low = min(dot(n, other[0]), dot(n, other[1]), dot(n, other[2]))
        for t in rows[0]:
            one = corners_of(trees.corners[t])
            if low - max(dot(n, one[0]), dot(n, one[1]), dot(n, one[2])) < far:
                best, q, r = _nearer(one, other, best, q, r)
    return best, q, r


@query_kernel
def _descended(trees, two, pose, stack, nearest):
    """_between_surfaces for any two, by a descent of both hierarchies; nearest: squared distance and points so far.

    What lies farther apart along the line between the nearest points so far than these is skipped, as well as what lies
    in boxes that are farther: around the nearest points boxes overlap much, along that line hardly anything.
    """
    (a, b), (turn, place), (nodes, bounds), (best, q, r) = two, pose, stack, nearest
    nodes[0, 0], nodes[0, 1], bounds[0], top = trees.node_range[a, 0], trees.node_range[b, 0], 0.0, 1
    far = math.sqrt(best)  # along n, in the frame of a; m: in that of b
    n = divided(minus(r, q), far) if best > 0.0 else NOWHERE
    m = turned_back(turn, n)
    while top:
        top -= 1
        i, j = nodes[top]
        if bounds[top] >= best:
            continue
        shift = dot(n, place)
        if _least(trees.node_box[j], m) + shift - _most(trees.node_box[i], n) >= far:
            continue
        if trees.node_count[i] and trees.node_count[j]:
            before = best
            for s in range(trees.node_first[j], trees.node_first[j] + trees.node_count[j]):
                x, y, z = corners_of(trees.corners[s])
                other = to_other(turn, place, x), to_other(turn, place, y), to_other(turn, place, z)
                low = min(dot(n, other[0]), dot(n, other[1]), dot(n, other[2]))
                for t in range(trees.node_first[i], trees.node_first[i] + trees.node_count[i]):
                    one = corners_of(trees.corners[t])
                    if low - max(dot(n, one[0]), dot(n, one[1]), dot(n, one[2])) < far:
                        best, q, r = _nearer(one, other, best, q, r)
            if best < before:
                far = math.sqrt(best)
                n = divided(minus(r, q), far) if best > 0.0 else NOWHERE
                m = turned_back(turn, n)
            continue
        # the larger box is divided
        first = trees.node_count[j] > 0 or (
            trees.node_count[i] == 0 and _size(trees.node_box[i]) >= _size(trees.node_box[j])
        )
        left = (i if first else j) + 1
        right = trees.node_skip[left]
        near, other_one = left, right
        to_left = _apart(trees.node_box[left if first else i], trees.node_box[j if first else left], turn, place)
        to_right = _apart(trees.node_box[right if first else i], trees.node_box[j if first else right], turn, place)
        if to_right < to_left:
            near, other_one, to_left, to_right = right, left, to_right, to_left
        for child, bound in ((other_one, to_right), (near, to_left)):
            x, y = (child, j) if first else (i, child)
            if bound < best and _least(trees.node_box[y], m) + shift - _most(trees.node_box[x], n) < far:
                nodes[top, 0], nodes[top, 1], bounds[top] = x, y, bound
                top += 1
    return math.sqrt(best), q, r


@query_kernel
def _corners_that_face(trees, two, pose):
    """(squared distance, these) of corners of both that are farthest towards the other: a bound of the distance."""
    (a, b), (turn, place) = two, pose
    box_a, box_b = trees.node_box[trees.node_range[a, 0]], trees.node_box[trees.node_range[b, 0]]
    q, r = _middle(box_a), to_other(turn, place, _middle(box_b))
    best_q, best_r, best = q, r, math.inf
    for _ in range(TURNS):
        n = minus(r, q)
        q = _farthest(trees, a, n)
        r = to_other(turn, place, _farthest(trees, b, turned_back(turn, opposite(n))))
        away = minus(r, q)
        if not dot(away, away) < best:
            break
        best, best_q, best_r = dot(away, away), q, r
    return best, best_q, best_r


@query_kernel
def _middle(box):
    return 0.5 * (box[0] + box[3]), 0.5 * (box[1] + box[4]), 0.5 * (box[2] + box[5])


@query_kernel
def _farthest(trees, f, n):
    """The corner of a fragment's surface that is farthest along n."""
    best, found = -math.inf, NOWHERE
    node, end = trees.node_range[f]
    while node < end:
        if not _most(trees.node_box[node], n) > best:
            node = trees.node_skip[node]
            continue
        for t in range(trees.node_first[node], trees.node_first[node] + trees.node_count[node]):
            for corner in corners_of(trees.corners[t]):
                if dot(n, corner) > best:
                    best, found = dot(n, corner), corner
        node += 1
    return found


@query_kernel
def _least(box, n):
    """Least height [m] of a box along n."""
    return (
        n[0] * (box[0] if n[0] > 0.0 else box[3]) + n[1] * (box[1] if n[1] > 0.0 else box[4])
        + n[2] * (box[2] if n[2] > 0.0 else box[5])
    )  # fmt: skip


@query_kernel
def _most(box, n):
    """Largest height [m] of a box along n."""
    return -_least(box, opposite(n))


@query_kernel
def _size(box):
    return (box[3] - box[0]) + (box[4] - box[1]) + (box[5] - box[2])


@query_kernel
def _apart(a, b, turn, place):
    """Lower bound [m2] of the squared distance of box a from box b, which is turned and moved."""
    total = 0.0
    for d in range(3):
        center, half = place[d], 0.0
        for e in range(3):
            center += turn[d, e] * 0.5 * (b[e] + b[e + 3])
            half += abs(turn[d, e]) * 0.5 * (b[e + 3] - b[e])
        gap = max(a[d] - center - half, center - half - a[d + 3], 0.0)
        total += gap * gap
    return total


@query_kernel
def _nearer(one, other, best, q, r):
    """(squared distance [m2], nearest points) of two triangles, if that is less than `best`."""
    low, high = _heights(one, other)
    from_a, to_a = _heights(other, one)
    is_through = low < 0.0 < high and from_a < 0.0 < to_a
    gap = max(low, -high, from_a, -to_a)
    if gap > 0.0 and gap * gap >= best:
        return best, q, r
    for k in range(3):
        d, found, _ = closest_on_triangle(one[k], other)
        if d < best:
            best, q, r = d, one[k], found
        d, found, _ = closest_on_triangle(other[k], one)
        if d < best:
            best, q, r = d, found, other[k]
        for m in range(3):
            d, x, y = _between_segments(one[k], one[(k + 1) % 3], other[m], other[(m + 1) % 3])
            if d < best:
                best, q, r = d, x, y
    if is_through:
        for k in range(3):
            is_met, x = _passes(one[k], one[(k + 1) % 3], other)
            if not is_met:
                is_met, x = _passes(other[k], other[(k + 1) % 3], one)
            if is_met:
                return 0.0, x, x
    return best, q, r


@query_kernel
def _heights(one, other):
    """Least and largest height [m] of a triangle's corners above the plane of another."""
    n = cross(minus(other[1], other[0]), minus(other[2], other[0]))
    size = math.sqrt(dot(n, n))
    if not size > 0.0:
        return -math.inf, math.inf
    x, y, z = (
        dot(n, minus(one[0], other[0])) / size, dot(n, minus(one[1], other[0])) / size,
        dot(n, minus(one[2], other[0])) / size,
    )  # fmt: skip
    return min(x, y, z), max(x, y, z)


@query_kernel
def _passes(p, q, triangle):
    """Whether a segment passes through a triangle, and where."""
    d = minus(q, p)
    a, b, c = minus(triangle[0], p), minus(triangle[1], p), minus(triangle[2], p)
    u, v, w = dot(d, cross(b, c)), dot(d, cross(c, a)), dot(d, cross(a, b))
    if not ((u >= 0.0 and v >= 0.0 and w >= 0.0) or (u <= 0.0 and v <= 0.0 and w <= 0.0)):
        return False, p
    n = cross(minus(triangle[1], triangle[0]), minus(triangle[2], triangle[0]))
    along = dot(n, d)
    if along == 0.0:
        return False, p
    share = dot(n, a) / along
    return 0.0 <= share <= 1.0, plus_scaled(p, share, d)


@query_kernel
def _between_segments(p, p_end, q, q_end):
    """(squared distance [m2], nearest points) of two segments."""
    u, v = minus(p_end, p), minus(q_end, q)
    s, t = nearest_of_segments(u, v, minus(p, q))
    x, y = plus_scaled(p, s, u), plus_scaled(q, t, v)
    away = minus(x, y)
    return dot(away, away), x, y
