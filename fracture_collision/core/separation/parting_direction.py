"""The one direction along which two moving fragments are kept apart: that in which they would overlap least.

Candidates are the normals of both hulls' faces, and the directions across two of their ridges that the difference of
the hulls has a face for (Gregorius, "The Separating Axis Test between Convex Polyhedra", 2013). Directions from corner
to corner separate hulls that are apart, but no face lies across them: contacts along them stop what passes a rim.

Each is measured now and at the end of the step, if both move on as they do, with the direction fixed. Of those that
separate now, or overlap no more than the least by a tolerance, that is taken which overlaps least at the end: so a body
that enters a thin wall is held on the side that it came from, and one that slides past an edge is not held at all.
"""

from __future__ import annotations

import math
from typing import Annotated, NamedTuple

import numpy as np

from fracture_collision.core.memory.compiled import kernel, query_kernel
from fracture_collision.core.memory.tables import Column
from fracture_collision.core.memory.transforms import rotated, turned_back
from fracture_collision.core.memory.vectors import (
    cross,
    divided,
    dot,
    length,
    minus,
    opposite,
    plus,
    plus_scaled,
    put,
    scaled,
    vector,
)

# Ridges at less than 1.1 degrees from parallel have no direction across both.
LEAST_SINE = 0.02
# A class of directions goes before the next if its best is within this share of the tolerance of the best of all, and
# the first of a class that is within the other share of its best is taken: nearly parallel faces of two bodies that
# slide on each other would alternate.
CLASS_TIE, ROW_TIE = 0.5, 1e-6
# Directions between two that are tried where one separates now and the other at the end.
BLENDS = 19
LEAST_BLEND = 0.1


HULL_CORNER, HULL_FACE, HULL_RIDGE = "hull corner", "hull face", "hull ridge"


class Hull(NamedTuple):
    """A fragment's ConvexHull, about its own origin."""

    x: Annotated[np.ndarray, Column(HULL_CORNER, np.float64)]  # [m] of its corners
    y: Annotated[np.ndarray, Column(HULL_CORNER, np.float64)]  # [m]
    z: Annotated[np.ndarray, Column(HULL_CORNER, np.float64)]  # [m]
    faces: Annotated[np.ndarray, Column(HULL_FACE, np.float64, 4)]  # unit outward normal, offset [m]
    ridges: Annotated[np.ndarray, Column(HULL_RIDGE, np.int64, 4)]  # corners at both ends; its faces


class Relative(NamedTuple):
    """Poses of a pair now and at the end of the step, all from b's frame of now, where directions are given."""

    to_a: np.ndarray  # (2, 3, 3) rotation to a's frame of that time
    to_b: np.ndarray  # (2, 3, 3) rotation to b's frame of that time
    between: np.ndarray  # (2, 3) [m] from a's origin to b's


class Parting(NamedTuple):
    """A direction from a to b, and how far they are apart along it: negative, their overlap."""

    is_apart: bool  # farther than the tolerance, now and at the end: the rest is not set
    direction: tuple[float, float, float]
    now: float  # [m]
    end: float  # [m]


_APART = Parting(True, (0.0, 0.0, 0.0), 0.0, 0.0)


@kernel
def parting_direction(a, b, relative, tolerance, remembered):
    """The Parting of two fragments by their Hulls, as they move by `relative`.

    tolerance [m]: overlaps that differ by no more are alike; apart by more, now and at the end, is apart. remembered
    (3,): holds the number of the face along whose normal they were apart before, and gets that of now; 0: none. It is
    measured first, and the result does not depend on it.
    """
    faces_a, faces_b = len(a.faces), len(b.faces)
    most = faces_a + faces_b
    known = int(remembered[0]) - 1
    if 0 <= known < most:
        n = _face_direction(a, b, relative, known)
        if _apart_at_face(a, b, relative, known, n)[0] > tolerance and _apart_at(a, b, relative, 1, n) > tolerance:
            return _APART
    remembered[0] = 0.0
    ways, apart, across = np.empty((most, 3)), np.empty(most), np.empty(most, np.int64)
    best = -math.inf
    for k in range(most):
        n = _face_direction(a, b, relative, k)
        put(ways, k, n)
        apart[k], across[k] = _apart_at_face(a, b, relative, k, n)
        if apart[k] > tolerance and _apart_at(a, b, relative, 1, n) > tolerance:
            remembered[0] = k + 1.0
            return _APART
        best = max(best, min(apart[k], 0.0))
    of_a, many_a = _ridges_that_may(a, b, relative, 0, apart, across, best - tolerance)
    of_b, many_b = _ridges_that_may(b, a, relative, 1, apart, across, best - tolerance)
    more, apart_across = _across_ridges(a, b, relative, of_a[:many_a], of_b[:many_b])
    for k in range(len(more)):
        if apart_across[k] > tolerance and _apart_at(a, b, relative, 1, vector(more, k)) > tolerance:
            return _APART
        best = max(best, min(apart_across[k], 0.0))
    return _choose(a, b, relative, tolerance, np.vstack((ways, more)), np.append(apart, apart_across), best)


@kernel
def _choose(a, b, relative, tolerance, ways, now, best):
    """The Parting among directions `ways` (n, 3) that are apart by `now` (n,); best: the greatest of these below 0."""
    faces_a, faces = len(a.faces), len(a.faces) + len(b.faces)
    end, top = np.full(len(ways), -math.inf), -math.inf
    for k in range(len(ways)):
        if min(now[k], 0.0) >= best - tolerance:
            end[k] = _apart_at(a, b, relative, 1, vector(ways, k))
            top = max(top, end[k])
    if top < 0.0 and _pass_each_other(a, b, relative, ways, now):
        return _APART
    for turn in range(3):
        low, high = (0, faces_a) if turn == 0 else (faces_a, faces)
        if turn == 2:
            low, high = faces, len(ways)
        of_class = -math.inf
        for k in range(low, high):
            of_class = max(of_class, end[k])
        if of_class < top - CLASS_TIE * tolerance or of_class == -math.inf:
            continue
        for k in range(low, high):
            if end[k] >= of_class - ROW_TIE * tolerance:
                return Parting(False, vector(ways, k), now[k], end[k])
    return _APART  # not reached: the best of all is in some class


@query_kernel
def _pass_each_other(a, b, relative, ways, now):
    """Whether a direction between the best of now and the best of the end separates the two at both times.

    Those that separate the two now do not at the end.
    """
    i, j, most = 0, 0, -math.inf
    for k in range(len(ways)):
        if now[k] > now[i]:
            i = k
    if not now[i] > 0.0:
        return False
    for k in range(len(ways)):
        end = _apart_at(a, b, relative, 1, vector(ways, k))
        if end > most:
            most, j = end, k
    if not most > 0.0:
        return False
    for step in range(1, BLENDS + 1):
        share = step / (BLENDS + 1)
        blend = plus_scaled(scaled(1.0 - share, vector(ways, i)), share, vector(ways, j))
        size = length(blend)
        if size > LEAST_BLEND:
            n = divided(blend, size)
            if min(_apart_at(a, b, relative, 0, n), _apart_at(a, b, relative, 1, n)) > 0.0:
                return True
    return False


@query_kernel
def _face_direction(a, b, relative, k):
    """Direction k from a to b in b's frame: the normal of a face of a, then the opposite of one of b."""
    if k < len(a.faces):
        return turned_back(relative.to_a[0], vector(a.faces, k))
    return opposite(vector(b.faces, k - len(a.faces)))


@query_kernel
def _apart_at_face(a, b, relative, k, n):
    """(how far the two are apart now along direction k of _face_direction, n; the corner across from the face)."""
    if k < len(a.faces):
        lowest, corner = _lowest(b, n)
        return lowest - a.faces[k, 3] + dot(n, relative.between[0]), corner
    lowest, corner = _lowest(a, rotated(relative.to_a[0], opposite(n)))
    return lowest - b.faces[k - len(a.faces), 3] + dot(n, relative.between[0]), corner


@query_kernel
def corner_of(hull, k):
    """Corner k of a Hull [m]."""
    return hull.x[k], hull.y[k], hull.z[k]


@query_kernel
def _lowest(hull, n):
    """(least, corner): how far the lowest corner along n is from the origin, and which it is."""
    least, at = math.inf, 0
    for k in range(len(hull.x)):
        along = dot(n, corner_of(hull, k))
        if along < least:
            least, at = along, k
    return least, at


@query_kernel
def _apart_at(a, b, relative, when, n):
    """How far the two are apart along n, now (when = 0) or at the end (1)."""
    of_a, of_b = rotated(relative.to_a[when], opposite(n)), rotated(relative.to_b[when], n)
    return _lowest(a, of_a)[0] + _lowest(b, of_b)[0] + dot(n, relative.between[when])


@kernel
def _ridges_that_may(own, other, relative, side, apart, across, least):
    """Rows of the ridges of one (side 0: a, the first) across which the two may be apart by `least` [m] or more.

    Directions across a ridge lie between the normals of its faces, and its ends are the outermost corners along them.
    So along such a direction the two are no farther apart than the ridge and the corner of the other that is lowest
    along either normal. apart, across: of all faces, as in parting_direction.
    """
    found, count = np.empty(len(own.ridges), np.int64), 0
    first = 0 if side == 0 else len(apart) - len(own.faces)
    for r in range(len(own.ridges)):
        p, left, right = corner_of(own, own.ridges[r, 0]), own.ridges[r, 2], own.ridges[r, 3]
        m, n, most = vector(own.faces, left), vector(own.faces, right), math.inf
        for face in (left, right):
            q = _corner_in(other, relative, side, across[first + face])
            most = min(most, _most_between(m, n, minus(q, p)))
        if most >= least:
            found[count] = r
            count += 1
    return found, count


@query_kernel
def _corner_in(other, relative, side, k):
    """Corner k of the other fragment in the frame of the one on `side`."""
    p, t = corner_of(other, k), relative.between[0]
    if side == 0:  # of b, in a's frame
        return rotated(relative.to_a[0], plus(p, t))
    return minus(turned_back(relative.to_a[0], p), t)


@query_kernel
def _most_between(m, n, w):
    """The greatest product of w with a unit vector on the shorter arc between unit vectors m and n."""
    along_m, along_n, c = dot(m, w), dot(n, w), dot(m, n)
    # within the arc if w, projected to its plane, leans from each end towards the other
    if along_n - c * along_m > 0.0 and along_m - c * along_n > 0.0:
        s = max(1.0 - c * c, 1e-300)
        return math.sqrt((along_m * along_m - 2.0 * c * along_m * along_n + along_n * along_n) / s)
    return max(along_m, along_n)


@kernel
def _across_ridges(a, b, relative, of_a, of_b):
    """Directions across ridges of both, rows `of_a` and `of_b`, that the difference of the hulls has a face for.

    Returns (directions (n, 3) in b's frame, how far the two are apart along each now (n,) [m]).
    """
    room = 64
    ways, apart, count = np.empty((room, 3)), np.empty(room), 0
    edges, lefts, rights = np.empty((len(of_b), 3)), np.empty((len(of_b), 3)), np.empty((len(of_b), 3))
    for j in range(len(of_b)):
        begin, end, left, right = b.ridges[of_b[j]]
        put(edges, j, minus(corner_of(b, end), corner_of(b, begin)))
        put(lefts, j, vector(b.faces, left))
        put(rights, j, vector(b.faces, right))
    back = relative.to_a[0]
    for i in range(len(of_a)):
        begin, end, left, right = a.ridges[of_a[i]]
        u = turned_back(back, minus(corner_of(a, end), corner_of(a, begin)))
        start = turned_back(back, corner_of(a, begin))
        f, g = turned_back(back, vector(a.faces, left)), turned_back(back, vector(a.faces, right))
        for j in range(len(of_b)):
            v, p, q = vector(edges, j), vector(lefts, j), vector(rights, j)
            # the arc of b's normals, reversed, is on both sides of the plane of a's arc, and the other way round
            if dot(u, p) * dot(u, q) >= 0.0 or dot(f, v) * dot(g, v) >= 0.0:
                continue
            n = cross(u, v)
            size = length(n)
            if size < LEAST_SINE * math.sqrt(dot(u, u) * dot(v, v)):
                continue
            # of both signs, that which points out of a at its ridge and into b at the other
            out, into = dot(n, plus(f, g)), dot(n, plus(p, q))
            if out * into >= 0.0:
                continue
            n = divided(n, -size if out < 0.0 else size)
            if count == room:
                ways, apart, room = np.vstack((ways, np.empty((room, 3)))), np.append(apart, np.empty(room)), 2 * room
            end_of_b = plus(corner_of(b, b.ridges[of_b[j], 0]), relative.between[0])
            put(ways, count, n)
            apart[count] = dot(n, minus(end_of_b, start))
            count += 1
    return ways[:count], apart[:count]
