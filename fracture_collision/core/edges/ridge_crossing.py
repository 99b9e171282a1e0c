"""Crossing of two ridges: its place, direction and gap or depth; and a test whether the fragments overlap there.

Where both stick out towards each other, the direction across both is the one that separates them (the Gauss map test of
Gregorius, "The Separating Axis Test between Convex Polyhedra", 2013, on one pair of edges at a time). Where they
overlap, each ridge must pass through the other fragment: edges that only face each other across something else make no
contact.
"""

from __future__ import annotations

import math

from fracture_collision.core.edges.ridges import LENGTH, TURN
from fracture_collision.core.field.elementary_queries import INSIDE, bounded_probe
from fracture_collision.core.memory.compiled import query_kernel
from fracture_collision.core.memory.rotations import to_other

# Edges at less than 3 degrees have no direction across both: samples at their ends give the contacts.
LEAST_SINE = 0.05
# The direction may point beyond the faces of a ridge by this sine: edges of faces that lie flush on each other.
BEYOND_FACE = 0.05
# A crossing is on both edges up to this share of their lengths.
ON_END = 1e-9
# Between samples, a ridge of length l passes through one that turns by t no deeper than l t / 4. Pairs where that is no
# more than epsilon, in either order, are skipped.
MATTERS = 4.0
# A ridge passes through the other fragment if its depth there is at least this share of that behind the other ridge.
REALLY = 0.25
# The direction across two edges turns by no more than this factor times the rotation of one of them, over the sine
# between them.
OF_TURN = 1.6


@query_kernel
def matters(r, s, shallow):
    """Whether two ridges can cross deeper than samples at their ends show.

    One as long as r enters what turns as little as s only to a depth of about a quarter of their product.
    """
    return min(r[LENGTH] * s[TURN], s[LENGTH] * r[TURN]) >= MATTERS * shallow


@query_kernel
def may_cross(r, s, shallow, near, deep, turn):
    """Whether ridges r, of a, and s, of b, may cross after a rotation of no more than `turn`.

    shallow [m]: see Listing. True if the direction across both, with either sign,
    may point out of both, and their distance along it is between -deep and near [m]; also for parallel ridges.
    """
    if not matters(r, s, shallow):
        return False
    nx, ny, nz, sine, along = _across(r, s)
    if not sine > 0.0:
        return True
    room = BEYOND_FACE + turn + OF_TURN * turn / min(sine, max(sine - turn, LEAST_SINE))
    # either sign: which one applies depends on the rotation
    if -deep <= along <= near and _points_out(r, s, nx, ny, nz, room):
        return True
    return -deep <= -along <= near and _points_out(r, s, -nx, -ny, -nz, room)


@query_kernel
def _across(r, s):
    """Direction across ridges r and s, and their distance along it.

    Returns (x, y, z, sine, along): a unit vector, the sine between the ridges, and the distance [m] of r's line from
    the line of s along the vector.
    """
    ux, uy, uz = r[3] - r[0], r[4] - r[1], r[5] - r[2]
    vx, vy, vz = s[3] - s[0], s[4] - s[1], s[5] - s[2]
    nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    length = math.sqrt(nx * nx + ny * ny + nz * nz)
    nx, ny, nz = nx / length, ny / length, nz / length
    along = nx * (r[0] - s[0]) + ny * (r[1] - s[1]) + nz * (r[2] - s[2])
    return nx, ny, nz, length / (r[LENGTH] * s[LENGTH]), along


@query_kernel
def _points_out(r, s, nx, ny, nz, room):
    """Whether a direction points out of the fragment of s at its ridge, and into that of r at its own."""
    return (
        nx * s[6] + ny * s[7] + nz * s[8] <= room and nx * s[9] + ny * s[10] + nz * s[11] <= room
        and nx * r[6] + ny * r[7] + nz * r[8] >= -room and nx * r[9] + ny * r[10] + nz * r[11] >= -room
    )  # fmt: skip


@query_kernel
def crossing(r, s, shallow, near, deep, out):
    """Whether ridges r, of a, and s, of b, cross, with a gap from -deep to near [m].

    shallow [m]: see Listing. If so, writes to `out` (10,) a point of r, one of s, the direction out of b, and the gap
    [m], as in a Sink for a sample of a.
    """
    if not matters(r, s, shallow):
        return False
    nx, ny, nz, sine, gap = _across(r, s)
    if not sine >= LEAST_SINE:
        return False
    if nx * (s[12] - r[12]) + ny * (s[13] - r[13]) + nz * (s[14] - r[14]) < 0.0:
        nx, ny, nz, gap = -nx, -ny, -nz, -gap
    if not -deep <= gap <= near or not _points_out(r, s, nx, ny, nz, BEYOND_FACE):
        return False
    ux, uy, uz = (r[3] - r[0]) / r[LENGTH], (r[4] - r[1]) / r[LENGTH], (r[5] - r[2]) / r[LENGTH]
    vx, vy, vz = (s[3] - s[0]) / s[LENGTH], (s[4] - s[1]) / s[LENGTH], (s[5] - s[2]) / s[LENGTH]
    wx, wy, wz = r[0] - s[0], r[1] - s[1], r[2] - s[2]
    uv, uw, vw = ux * vx + uy * vy + uz * vz, ux * wx + uy * wy + uz * wz, vx * wx + vy * wy + vz * wz
    n2 = sine * sine
    k, l = (uv * vw - uw) / n2, (vw - uv * uw) / n2  # noqa: E741
    if not (abs(k - 0.5 * r[LENGTH]) <= (0.5 + ON_END) * r[LENGTH]):
        return False
    if not (abs(l - 0.5 * s[LENGTH]) <= (0.5 + ON_END) * s[LENGTH]):
        return False
    out[0], out[1], out[2] = r[0] + k * ux, r[1] + k * uy, r[2] + k * uz
    out[3], out[4], out[5] = s[0] + l * vx, s[1] + l * vy, s[2] + l * vz
    out[6], out[7], out[8], out[9] = nx, ny, nz, gap
    return True


@query_kernel
def _into_wedge(r, s, k, n, deep):
    """Where ridge r is well inside the wedge of ridge s's faces.

    k [m]: distance of the crossing's foot from r's begin; n: out of s; deep [m]: depth of the crossing. Returns
    (distance along r from that foot [m], how far r is behind the nearer face there [m]).
    """
    ux, uy, uz = (r[3] - r[0]) / r[LENGTH], (r[4] - r[1]) / r[LENGTH], (r[5] - r[2]) / r[LENGTH]
    vx, vy, vz = (s[3] - s[0]) / s[LENGTH], (s[4] - s[1]) / s[LENGTH], (s[5] - s[2]) / s[LENGTH]
    # normals of the faces: along the ridge the first is on its left
    fx, fy, fz = vy * s[8] - vz * s[7], vz * s[6] - vx * s[8], vx * s[7] - vy * s[6]
    gx, gy, gz = s[10] * vz - s[11] * vy, s[11] * vx - s[9] * vz, s[9] * vy - s[10] * vx
    one, other = deep * (fx * n[0] + fy * n[1] + fz * n[2]), deep * (gx * n[0] + gy * n[1] + gz * n[2])
    rate, rate_of_other = -(fx * ux + fy * uy + fz * uz), -(gx * ux + gy * uy + gz * uz)
    if other < one:
        one, other, rate, rate_of_other = other, one, rate_of_other, rate
    if one >= 0.5 * deep or rate == 0.0:
        return 0.0, one
    # away from the nearer face, until it is far enough or the other face is nearer
    sign = 1.0 if rate > 0.0 else -1.0
    way = (0.5 * deep - one) / abs(rate)
    if sign * rate_of_other < abs(rate):
        way = min(way, (other - one) / (abs(rate) - sign * rate_of_other))
    way = min(way, r[LENGTH] - k if sign > 0.0 else k)
    return sign * way, one + way * abs(rate)


@query_kernel
def overlap(pools, pair, r, s, c, scratch):
    """Whether ridges r, of a, and s, of b, are each inside the other's fragment next to their crossing.

    r, s: in b's frame; c: of `crossing`.
    """
    for side in range(2):
        own, other, f, at, sign = (r, s, pair.b, 0, 1.0) if side == 0 else (s, r, pair.a, 3, -1.0)
        k = math.sqrt((c[at] - own[0]) ** 2 + (c[at + 1] - own[1]) ** 2 + (c[at + 2] - own[2]) ** 2)
        way, behind = _into_wedge(own, other, k, (sign * c[6], sign * c[7], sign * c[8]), -c[9])
        if not behind > 0.0:
            return False
        part, least = way / own[LENGTH], REALLY * behind
        x, y, z = c[at], c[at + 1], c[at + 2]
        x, y, z = x + part * (own[3] - own[0]), y + part * (own[4] - own[1]), z + part * (own[5] - own[2])
        if side == 1:
            x, y, z = to_other(pair.rotation[1], pair.translation[1], x, y, z)
        answer = bounded_probe(pools, f, (x, y, z), 0.0, least, -1, False, scratch)
        if answer.status != INSIDE or answer.distance > -least:
            return False
    return True
