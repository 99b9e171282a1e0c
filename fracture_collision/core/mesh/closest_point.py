"""Closest points: on a triangle, of an axis-aligned box, of two segments.

Triangle and segments follow Ericson, Real-Time Collision Detection (2005), sections 5.1.5 and 5.1.9.
"""

from __future__ import annotations

import math

from fracture_collision.core.memory.compiled import query_kernel

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
def closest_on_triangle(px, py, pz, ax, ay, az, bx, by, bz, cx, cy, cz):
    """Closest point of a triangle: (squared distance, x, y, z, feature 0 .. 6)."""
    abx, aby, abz = bx - ax, by - ay, bz - az
    acx, acy, acz = cx - ax, cy - ay, cz - az
    apx, apy, apz = px - ax, py - ay, pz - az
    d1 = abx * apx + aby * apy + abz * apz
    d2 = acx * apx + acy * apy + acz * apz
    if d1 <= 0.0 and d2 <= 0.0:
        qx, qy, qz = ax, ay, az
        feature = 4
    else:
        bpx, bpy, bpz = px - bx, py - by, pz - bz
        d3 = abx * bpx + aby * bpy + abz * bpz
        d4 = acx * bpx + acy * bpy + acz * bpz
        if d3 >= 0.0 and d4 <= d3:
            qx, qy, qz = bx, by, bz
            feature = 5
        else:
            vc = d1 * d4 - d3 * d2
            if vc <= 0.0 and d1 >= 0.0 and d3 <= 0.0:
                v = d1 / (d1 - d3)
                qx, qy, qz = ax + v * abx, ay + v * aby, az + v * abz
                feature = 1
            else:
                cpx, cpy, cpz = px - cx, py - cy, pz - cz
                d5 = abx * cpx + aby * cpy + abz * cpz
                d6 = acx * cpx + acy * cpy + acz * cpz
                if d6 >= 0.0 and d5 <= d6:
                    qx, qy, qz = cx, cy, cz
                    feature = 6
                else:
                    vb = d5 * d2 - d1 * d6
                    if vb <= 0.0 and d2 >= 0.0 and d6 <= 0.0:
                        w = d2 / (d2 - d6)
                        qx, qy, qz = ax + w * acx, ay + w * acy, az + w * acz
                        feature = 3
                    else:
                        va = d3 * d6 - d5 * d4
                        if va <= 0.0 and d4 - d3 >= 0.0 and d5 - d6 >= 0.0:
                            w = (d4 - d3) / ((d4 - d3) + (d5 - d6))
                            qx, qy, qz = bx + w * (cx - bx), by + w * (cy - by), bz + w * (cz - bz)
                            feature = 2
                        else:
                            denominator = 1.0 / (va + vb + vc)
                            v, w = vb * denominator, vc * denominator
                            qx = ax + abx * v + acx * w
                            qy = ay + aby * v + acy * w
                            qz = az + abz * v + acz * w
                            feature = ON_FACE
    ex, ey, ez = px - qx, py - qy, pz - qz
    return ex * ex + ey * ey + ez * ez, qx, qy, qz, feature


@query_kernel
def triangle_normal(ax, ay, az, bx, by, bz, cx, cy, cz):
    """Unit normal, right-handed; zeros for a triangle without area."""
    ux, uy, uz = bx - ax, by - ay, bz - az
    vx, vy, vz = cx - ax, cy - ay, cz - az
    nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    length = math.sqrt(nx * nx + ny * ny + nz * nz)
    if length == 0.0:
        return 0.0, 0.0, 0.0
    return nx / length, ny / length, nz / length


@query_kernel
def segment_distance(r, s):
    """Distance [m] of two segments of non-zero length: r and s (6, or more), begin and end."""
    ux, uy, uz = r[3] - r[0], r[4] - r[1], r[5] - r[2]
    vx, vy, vz = s[3] - s[0], s[4] - s[1], s[5] - s[2]
    wx, wy, wz = r[0] - s[0], r[1] - s[1], r[2] - s[2]
    uu, vv, uv = ux * ux + uy * uy + uz * uz, vx * vx + vy * vy + vz * vz, ux * vx + uy * vy + uz * vz
    uw, vw = ux * wx + uy * wy + uz * wz, vx * wx + vy * wy + vz * wz
    n2 = uu * vv - uv * uv
    k = min(max((uv * vw - uw * vv) / n2, 0.0), 1.0) if n2 > 0.0 else 0.0
    l = (uv * k + vw) / vv  # noqa: E741
    if not 0.0 <= l <= 1.0:
        l = 0.0 if l < 0.0 else 1.0  # noqa: E741
        k = min(max((uv * l - uw) / uu, 0.0), 1.0)
    dx, dy, dz = wx + k * ux - l * vx, wy + k * uy - l * vy, wz + k * uz - l * vz
    return math.sqrt(dx * dx + dy * dy + dz * dz)
