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
from fracture_collision.core.memory.rotations import rotated
from fracture_collision.core.memory.tables import Column

# Ridges at less than 1.1 degrees from parallel have no direction across both.
LEAST_SINE = 0.02
# A class of directions goes before the next if its best is within this share of the tolerance of the best of all, and
# the first of a class that is within the other share of its best is taken: nearly parallel faces of two bodies that
# slide on each other would alternate.
CLASS_TIE, ROW_TIE = 0.5, 1e-6
# Directions between two that are tried where one separates now and the other at the end.
BLENDS = 19
LEAST_BLEND = 0.1
_NOT_APART, _APART = 0, 1


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
    x: float
    y: float
    z: float
    now: float  # [m]
    end: float  # [m]


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
            return Parting(True, 0.0, 0.0, 0.0, 0.0, 0.0)
    remembered[0] = 0.0
    ways, apart, across = np.empty((most, 3)), np.empty(most), np.empty(most, np.int64)
    best = -math.inf
    for k in range(most):
        n = _face_direction(a, b, relative, k)
        ways[k, 0], ways[k, 1], ways[k, 2] = n
        apart[k], across[k] = _apart_at_face(a, b, relative, k, n)
        if apart[k] > tolerance and _apart_at(a, b, relative, 1, n) > tolerance:
            remembered[0] = k + 1.0
            return Parting(True, 0.0, 0.0, 0.0, 0.0, 0.0)
        best = max(best, min(apart[k], 0.0))
    of_a, many_a = _ridges_that_may(a, b, relative, 0, apart, across, best - tolerance)
    of_b, many_b = _ridges_that_may(b, a, relative, 1, apart, across, best - tolerance)
    more, apart_across = _across_ridges(a, b, relative, of_a[:many_a], of_b[:many_b])
    for k in range(len(more)):
        n = more[k, 0], more[k, 1], more[k, 2]
        if apart_across[k] > tolerance and _apart_at(a, b, relative, 1, n) > tolerance:
            return Parting(True, 0.0, 0.0, 0.0, 0.0, 0.0)
        best = max(best, min(apart_across[k], 0.0))
    return _choose(a, b, relative, tolerance, np.vstack((ways, more)), np.append(apart, apart_across), best)


@kernel
def _choose(a, b, relative, tolerance, ways, now, best):
    """The Parting among directions `ways` (n, 3) that are apart by `now` (n,); best: the greatest of these below 0."""
    faces_a, faces = len(a.faces), len(a.faces) + len(b.faces)
    end, top = np.full(len(ways), -math.inf), -math.inf
    for k in range(len(ways)):
        if min(now[k], 0.0) >= best - tolerance:
            end[k] = _apart_at(a, b, relative, 1, (ways[k, 0], ways[k, 1], ways[k, 2]))
            top = max(top, end[k])
    if top < 0.0 and _pass_each_other(a, b, relative, ways, now):
        return Parting(True, 0.0, 0.0, 0.0, 0.0, 0.0)
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
                return Parting(False, ways[k, 0], ways[k, 1], ways[k, 2], now[k], end[k])
    return Parting(True, 0.0, 0.0, 0.0, 0.0, 0.0)  # not reached: the best of all is in some class


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
        end = _apart_at(a, b, relative, 1, (ways[k, 0], ways[k, 1], ways[k, 2]))
        if end > most:
            most, j = end, k
    if not most > 0.0:
        return False
    for step in range(1, BLENDS + 1):
        share = step / (BLENDS + 1)
        x = (1.0 - share) * ways[i, 0] + share * ways[j, 0]
        y = (1.0 - share) * ways[i, 1] + share * ways[j, 1]
        z = (1.0 - share) * ways[i, 2] + share * ways[j, 2]
        length = math.sqrt(x * x + y * y + z * z)
        if length > LEAST_BLEND:
            n = x / length, y / length, z / length
            if min(_apart_at(a, b, relative, 0, n), _apart_at(a, b, relative, 1, n)) > 0.0:
                return True
    return False


@query_kernel
def _face_direction(a, b, relative, k):
    """Direction k from a to b in b's frame: the normal of a face of a, then the opposite of one of b."""
    if k < len(a.faces):
        return _turned_back(relative.to_a[0], (a.faces[k, 0], a.faces[k, 1], a.faces[k, 2]))
    k -= len(a.faces)
    return -b.faces[k, 0], -b.faces[k, 1], -b.faces[k, 2]


@query_kernel
def _apart_at_face(a, b, relative, k, n):
    """(how far the two are apart now along direction k of _face_direction, n; the corner across from the face)."""
    if k < len(a.faces):
        lowest, corner = _lowest(b, n)
        return lowest - a.faces[k, 3] + _along(n, relative.between[0]), corner
    lowest, corner = _lowest(a, rotated(relative.to_a[0], -n[0], -n[1], -n[2]))
    return lowest - b.faces[k - len(a.faces), 3] + _along(n, relative.between[0]), corner


@query_kernel
def _turned_back(m, n):
    return (
        m[0, 0] * n[0] + m[1, 0] * n[1] + m[2, 0] * n[2],
        m[0, 1] * n[0] + m[1, 1] * n[1] + m[2, 1] * n[2],
        m[0, 2] * n[0] + m[1, 2] * n[1] + m[2, 2] * n[2],
    )


@query_kernel
def _along(n, p):
    return n[0] * p[0] + n[1] * p[1] + n[2] * p[2]


@query_kernel
def _lowest(hull, n):
    """(least, corner): how far the lowest corner along n is from the origin, and which it is."""
    least, at = math.inf, 0
    for k in range(len(hull.x)):
        along = n[0] * hull.x[k] + n[1] * hull.y[k] + n[2] * hull.z[k]
        if along < least:
            least, at = along, k
    return least, at


@query_kernel
def _apart_at(a, b, relative, when, n):
    """How far the two are apart along n, now (when = 0) or at the end (1)."""
    own = rotated(relative.to_a[when], -n[0], -n[1], -n[2])
    of_b = rotated(relative.to_b[when], n[0], n[1], n[2])
    return _lowest(a, own)[0] + _lowest(b, of_b)[0] + _along(n, relative.between[when])


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
        end = own.ridges[r, 0]
        p = own.x[end], own.y[end], own.z[end]
        m = own.faces[own.ridges[r, 2]]
        n = own.faces[own.ridges[r, 3]]
        most = math.inf
        for face in (own.ridges[r, 2], own.ridges[r, 3]):
            q = _corner_in(other, relative, side, across[first + face])
            w = q[0] - p[0], q[1] - p[1], q[2] - p[2]
            most = min(most, _most_between(m, n, w))
        if most >= least:
            found[count] = r
            count += 1
    return found, count


@query_kernel
def _corner_in(other, relative, side, k):
    """Corner k of the other fragment in the frame of the one on `side`."""
    x, y, z = other.x[k], other.y[k], other.z[k]
    t = relative.between[0]
    if side == 0:  # of b, in a's frame
        return rotated(relative.to_a[0], x + t[0], y + t[1], z + t[2])
    x, y, z = _turned_back(relative.to_a[0], (x, y, z))
    return x - t[0], y - t[1], z - t[2]


@query_kernel
def _most_between(m, n, w):
    """The greatest product of w with a unit vector on the shorter arc between unit vectors m and n."""
    along_m, along_n = _along(m, w), _along(n, w)
    c = m[0] * n[0] + m[1] * n[1] + m[2] * n[2]
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
    edges, normals = np.empty((len(of_b), 3)), np.empty((len(of_b), 6))
    for j in range(len(of_b)):
        r = b.ridges[of_b[j]]
        edges[j, 0], edges[j, 1], edges[j, 2] = b.x[r[1]] - b.x[r[0]], b.y[r[1]] - b.y[r[0]], b.z[r[1]] - b.z[r[0]]
        for d in range(3):
            normals[j, d], normals[j, 3 + d] = b.faces[r[2], d], b.faces[r[3], d]
    t = relative.between[0]
    for i in range(len(of_a)):
        r = a.ridges[of_a[i]]
        p = a.x[r[0]], a.y[r[0]], a.z[r[0]]
        q = a.x[r[1]], a.y[r[1]], a.z[r[1]]
        ux, uy, uz = _turned_back(relative.to_a[0], (q[0] - p[0], q[1] - p[1], q[2] - p[2]))
        start = _turned_back(relative.to_a[0], p)
        f, g = a.faces[r[2]], a.faces[r[3]]
        fx, fy, fz = _turned_back(relative.to_a[0], (f[0], f[1], f[2]))
        gx, gy, gz = _turned_back(relative.to_a[0], (g[0], g[1], g[2]))
        for j in range(len(of_b)):
            vx, vy, vz = edges[j, 0], edges[j, 1], edges[j, 2]
            # the arc of b's normals, reversed, is on both sides of the plane of a's arc, and the other way round
            of_left = ux * normals[j, 0] + uy * normals[j, 1] + uz * normals[j, 2]
            of_right = ux * normals[j, 3] + uy * normals[j, 4] + uz * normals[j, 5]
            if of_left * of_right >= 0.0:
                continue
            left, right = fx * vx + fy * vy + fz * vz, gx * vx + gy * vy + gz * vz
            if left * right >= 0.0:
                continue
            x, y, z = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
            length = math.sqrt(x * x + y * y + z * z)
            size = math.sqrt((ux * ux + uy * uy + uz * uz) * (vx * vx + vy * vy + vz * vz))
            if length < LEAST_SINE * size:
                continue
            # of both signs, that which points out of a at its ridge and into b at the other
            out = x * (fx + gx) + y * (fy + gy) + z * (fz + gz)
            into = x * (normals[j, 0] + normals[j, 3]) + y * (normals[j, 1] + normals[j, 4])
            into += z * (normals[j, 2] + normals[j, 5])
            if out * into >= 0.0:
                continue
            if out < 0.0:
                length = -length
            x, y, z = x / length, y / length, z / length
            if count == room:
                ways, apart, room = np.vstack((ways, np.empty((room, 3)))), np.append(apart, np.empty(room)), 2 * room
            e = b.ridges[of_b[j], 0]
            ways[count, 0], ways[count, 1], ways[count, 2] = x, y, z
            apart[count] = x * (b.x[e] + t[0] - start[0]) + y * (b.y[e] + t[1] - start[1])
            apart[count] += z * (b.z[e] + t[2] - start[2])
            count += 1
    return ways[:count], apart[:count]
