"""Closest points: on a triangle, of an axis-aligned box, of two segments.

Triangle and segments follow Ericson, Real-Time Collision Detection (2005), sections 5.1.5 and 5.1.9.
"""

from __future__ import annotations

from fracture_collision.core.memory.compiled import query_kernel
from fracture_collision.core.memory.vectors import (
    area_vector,
    between,
    divided,
    dot,
    length,
    minus,
    plus_scaled,
    scaled,
    vector_at,
)

# Which part of a triangle abc holds the closest point: the face, an edge ab, bc or ca (1 .. 3), a corner (4 .. 6).
ON_FACE = 0
ON_RIM = 1  # and above: an edge or a corner
# Below this share of R the direction between two points is unreliable (rounding changes it by a ten-thousandth there);
# use the surface normal instead.
DIRECTION_FLOOR = 1e-12


@query_kernel
def box_distance_squared(x, y, z, box):
    """Squared distance [m2] of a point from an axis-aligned box (6,) = lower corner, upper corner; 0 inside."""
    dx = max(box[0] - x, 0.0, x - box[3])
    dy = max(box[1] - y, 0.0, y - box[4])
    dz = max(box[2] - z, 0.0, z - box[5])
    return dx * dx + dy * dy + dz * dz


@query_kernel
def closest_on_triangle(p, triangle):
    """Closest point of a triangle, given by its corners: (squared distance, point, feature 0 .. 6)."""
    q, feature = _closest(p, triangle)
    away = minus(p, q)
    return dot(away, away), q, feature


@query_kernel
def _closest(p, triangle):
    a, b, c = triangle
    ab, ac, ap = minus(b, a), minus(c, a), minus(p, a)
    d1, d2 = dot(ab, ap), dot(ac, ap)
    if d1 <= 0.0 and d2 <= 0.0:
        return a, 4
    bp = minus(p, b)
    d3, d4 = dot(ab, bp), dot(ac, bp)
    if d3 >= 0.0 and d4 <= d3:
        return b, 5
    vc = d1 * d4 - d3 * d2
    if vc <= 0.0 and d1 >= 0.0 and d3 <= 0.0:
        return plus_scaled(a, d1 / (d1 - d3), ab), 1
    cp = minus(p, c)
    d5, d6 = dot(ab, cp), dot(ac, cp)
    if d6 >= 0.0 and d5 <= d6:
        return c, 6
    vb = d5 * d2 - d1 * d6
    if vb <= 0.0 and d2 >= 0.0 and d6 <= 0.0:
        return plus_scaled(a, d2 / (d2 - d6), ac), 3
    va = d3 * d6 - d5 * d4
    if va <= 0.0 and d4 - d3 >= 0.0 and d5 - d6 >= 0.0:
        return between(b, c, (d4 - d3) / ((d4 - d3) + (d5 - d6))), 2
    denominator = 1.0 / (va + vb + vc)
    return plus_scaled(plus_scaled(a, vb * denominator, ab), vc * denominator, ac), ON_FACE


@query_kernel
def unit_normal(triangle):
    """Unit normal of a triangle, given by its corners, right-handed; zeros for one without area."""
    n = area_vector(triangle)
    area = length(n)
    return divided(n, area) if area != 0.0 else (0.0, 0.0, 0.0)


@query_kernel
def triangle_normal(ax, ay, az, bx, by, bz, cx, cy, cz):
    """unit_normal of the corners' coordinates."""
    return unit_normal(((ax, ay, az), (bx, by, bz), (cx, cy, cz)))


@query_kernel
def segment_distance(r, s):
    """Distance [m] of two segments of non-zero length: r and s (6, or more), begin and end."""
    u, v, w = minus(vector_at(r, 3), r), minus(vector_at(s, 3), s), minus(r, s)
    k, l = nearest_of_segments(u, v, w)  # noqa: E741
    return length(minus(plus_scaled(w, k, u), scaled(l, v)))


@query_kernel
def nearest_of_segments(u, v, w):
    """Shares of two segments u and v, not of length 0, at which they are nearest: Ericson 2005, section 5.1.9.

    w: from the begin of the second to that of the first.
    """
    uu, vv, uv, uw, vw = dot(u, u), dot(v, v), dot(u, v), dot(u, w), dot(v, w)
    n2 = uu * vv - uv * uv
    k = min(max((uv * vw - uw * vv) / n2, 0.0), 1.0) if n2 > 0.0 else 0.0
    l = (uv * k + vw) / vv  # noqa: E741
    if not 0.0 <= l <= 1.0:
        l = 0.0 if l < 0.0 else 1.0  # noqa: E741
        k = min(max((uv * l - uw) / uu, 0.0), 1.0)
    return k, l
