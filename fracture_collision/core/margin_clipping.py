"""Polygons in a cut tetrahedron clipped to where one fragment's margin is the largest (symbols: cut_tetrahedron.py).

Planes of cracks through nodes and along faces, and planes that several edges share, make margins equal all over a
polygon; then clipping to g >= m would keep it for both sides, or, with rounding, tear it. What lies beside the polygon
decides such ties.
"""

from __future__ import annotations

import math

import numpy as np

from fracture_collision.core.compiled import query_kernel

# Where two margins differ by no more than this share of the farthest coordinate they are equal, but for rounding.
TIE = 32.0 * np.finfo(np.float64).eps


@query_kernel
def clip(polygon, count, spare, a, b, c, o):
    """Keep the part of a convex polygon with a x + b y + c z - o >= 0, in place; returns its vertex count."""
    kept = 0
    px, py, pz = polygon[count - 1, 0], polygon[count - 1, 1], polygon[count - 1, 2]
    pv = a * px + b * py + c * pz - o
    for i in range(count):
        qx, qy, qz = polygon[i, 0], polygon[i, 1], polygon[i, 2]
        qv = a * qx + b * qy + c * qz - o
        if (pv < 0.0) != (qv < 0.0):
            t = pv / (pv - qv)
            spare[kept, 0], spare[kept, 1], spare[kept, 2] = px + t * (qx - px), py + t * (qy - py), pz + t * (qz - pz)
            kept += 1
        if qv >= 0.0:
            spare[kept, 0], spare[kept, 1], spare[kept, 2] = qx, qy, qz
            kept += 1
        px, py, pz, pv = qx, qy, qz, qv
    for i in range(kept):
        polygon[i, 0], polygon[i, 1], polygon[i, 2] = spare[i, 0], spare[i, 1], spare[i, 2]
    return kept if kept >= 3 else 0


@query_kernel
def tie_limit(corners):
    """TIE for this tetrahedron [m]."""
    farthest = 0.0
    for i in range(4):
        for d in range(3):
            farthest = max(farthest, abs(corners[i, d]))
    return TIE * farthest


@query_kernel
def _clip_on_face(work, count, corners, face, inward, limit, g, m, at_tie):
    """Clip work.polygon, part of a face of `corners`, to g >= m; `inward`: 1 for their tetrahedron, -1 for the other.

    Where the two are equal all over the face, what they are inside decides, and `at_tie` if they are equal there too:
    else both would have the face.
    """
    a, b, c, o = g[0] - m[0], g[1] - m[1], g[2] - m[2], g[3] - m[3]
    for k in range(4):
        x = corners[k]
        if k != face and abs(a * x[0] + b * x[1] + c * x[2] - o) > limit:
            return clip(work.polygon, count, work.spare, a, b, c, o)
    x = corners[face]
    inside = inward * (a * x[0] + b * x[1] + c * x[2] - o)
    return count if inside > limit or (inside >= -limit and at_tie) else 0


@query_kernel
def clip_to_region(count, slots, work, owner, corners, face, inward):
    """Clip work.polygon to where the choice of the others' minima holds and no functional of `owner` is below them.

    corners, face, inward: as in `_clip_on_face`.
    """
    functionals, counts, limit = work.functionals, work.counts, tie_limit(corners)
    for s in range(slots):
        if s == owner:
            continue
        m = functionals[s, work.choice[s]]
        for q in range(counts[owner]):
            if count:
                first = work.labels[owner] < work.labels[s]
                count = _clip_on_face(work, count, corners, face, inward, limit, functionals[owner, q], m, first)
        for q in range(counts[s]):
            if q != work.choice[s] and count:
                first = work.choice[s] < q
                count = _clip_on_face(work, count, corners, face, inward, limit, functionals[s, q], m, first)
    return count


@query_kernel
def _clip_or_tie(work, count, limit, g, m):
    """Clip work.polygon to g >= m: (vertices left, False), or as it was and True where the two are equal all over."""
    a, b, c, o = g[0] - m[0], g[1] - m[1], g[2] - m[2], g[3] - m[3]
    for i in range(count):
        x = work.polygon[i]
        if abs(a * x[0] + b * x[1] + c * x[2] - o) > limit:
            return clip(work.polygon, count, work.spare, a, b, c, o), False
    return count, True


@query_kernel
def clip_to_choice(count, slots, work, limit, owner, other):
    """Clip an interface of `owner` and `other` to where the choice of minima holds and no third margin is larger.

    Where more margins meet in its plane than the two, one side of it can differ from the other: `_separates` decides.
    """
    functionals, choice = work.functionals, work.choice
    f = functionals[owner, choice[owner]]
    any_tie = False
    for s in range(slots):
        m = functionals[s, choice[s]]
        for q in range(work.counts[s]):
            if q != choice[s] and count:
                count, tie = _clip_or_tie(work, count, limit, functionals[s, q], m)
                any_tie = any_tie or tie
        if s != owner and s != other and count:
            count, tie = _clip_or_tie(work, count, limit, f, m)
            any_tie = any_tie or tie
    if any_tie and count and not _separates(count, slots, work, limit, owner, other):
        return 0
    return count


@query_kernel
def _separates(count, slots, work, limit, owner, other):
    """Whether work.polygon, in the plane where the chosen margins of the two are equal, parts `owner` from `other`.

    Just beside it, a margin is its value in the plane and its slope across. True for one choice of minima only: those
    that hold on the owner's side, or, where the two are equal there, on the other's.
    """
    functionals, labels, polygon = work.functionals, work.labels, work.polygon
    f, g = functionals[owner, work.choice[owner]], functionals[other, work.choice[other]]
    a, b, c = g[0] - f[0], g[1] - f[1], g[2] - f[2]
    steepness = TIE * math.sqrt(a * a + b * b + c * c)
    x = y = z = 0.0
    for i in range(count):
        x, y, z = x + polygon[i, 0] / count, y + polygon[i, 1] / count, z + polygon[i, 2] / count
    compared = False
    for side in range(2):
        away = -1.0 if side == 0 else 1.0
        best, best_value, best_slope = -1, -np.inf, 0.0
        own_slope = other_slope = 0.0
        for s in range(slots):
            value, slope = np.inf, 0.0
            for q in range(work.counts[s]):
                h = functionals[s, q]
                height = h[0] * x + h[1] * y + h[2] * z - h[3]
                rise = away * (h[0] * a + h[1] * b + h[2] * c)
                if height < value - limit or (height <= value + limit and rise < slope):
                    value, slope, work.order[s] = height, rise, q
            if s == owner:
                own_slope = slope
            if s == other:
                other_slope = slope
            equal = abs(value - best_value) <= limit
            level = equal and abs(slope - best_slope) <= steepness
            larger = value > best_value + limit or (equal and slope > best_slope + steepness)
            if larger or (level and labels[s] < labels[best]):
                best, best_value, best_slope = s, value, slope
        if best != (owner if side == 0 else other):
            return False
        if not compared and abs(own_slope - other_slope) > steepness:
            compared = True
            for s in range(slots):
                if work.order[s] != work.choice[s]:
                    return False
    return compared
