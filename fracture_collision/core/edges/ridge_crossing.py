"""Crossing of two ridges: its place, direction and gap or depth; and a test whether the fragments overlap there.

Where both stick out towards each other, the direction across both is the one that separates them (the Gauss map test of
Gregorius, "The Separating Axis Test between Convex Polyhedra", 2013, on one pair of edges at a time). Where they
overlap, each ridge must pass through the other fragment: edges that only face each other across something else make no
contact.
"""

from __future__ import annotations

from fracture_collision.core.edges.ridges import END, FIRST_FACE, LENGTH, OUTWARD, SECOND_FACE, TURN
from fracture_collision.core.field.elementary_queries import INSIDE, bounded_probe
from fracture_collision.core.memory.compiled import query_kernel
from fracture_collision.core.memory.transforms import to_other
from fracture_collision.core.memory.vectors import (
    cross,
    distance,
    divided,
    dot,
    length,
    minus,
    opposite,
    plus_scaled,
    scaled,
    vector_at,
)

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
    n, sine, along = _across(r, s)
    if not sine > 0.0:
        return True
    room = BEYOND_FACE + turn + OF_TURN * turn / min(sine, max(sine - turn, LEAST_SINE))
    # either sign: which one applies depends on the rotation
    if -deep <= along <= near and _points_out(r, s, n, room):
        return True
    return -deep <= -along <= near and _points_out(r, s, opposite(n), room)


@query_kernel
def _across(r, s):
    """Direction across ridges r and s, and their distance along it.

    Returns (direction, sine, along): a unit vector, the sine between the ridges, and the distance [m] of r's line from
    the line of s along the vector.
    """
    n = cross(minus(vector_at(r, END), r), minus(vector_at(s, END), s))
    size = length(n)
    n = divided(n, size)
    return n, size / (r[LENGTH] * s[LENGTH]), dot(n, minus(r, s))


@query_kernel
def _direction(r):
    """Unit vector along a ridge."""
    return divided(minus(vector_at(r, END), r), r[LENGTH])


@query_kernel
def _points_out(r, s, n, room):
    """Whether a direction points out of the fragment of s at its ridge, and into that of r at its own."""
    return (
        dot(n, vector_at(s, FIRST_FACE)) <= room and dot(n, vector_at(s, SECOND_FACE)) <= room
        and dot(n, vector_at(r, FIRST_FACE)) >= -room and dot(n, vector_at(r, SECOND_FACE)) >= -room
    )  # fmt: skip


@query_kernel
def crossing(r, s, shallow, near, deep, out):
    """Whether ridges r, of a, and s, of b, cross, with a gap from -deep to near [m].

    shallow [m]: see Listing. If so, writes to `out` (10,) a point of r, one of s, the direction out of b, and the gap
    [m], as in a Sink for a sample of a.
    """
    if not matters(r, s, shallow):
        return False
    n, sine, gap = _across(r, s)
    if not sine >= LEAST_SINE:
        return False
    if dot(n, minus(vector_at(s, OUTWARD), vector_at(r, OUTWARD))) < 0.0:
        n, gap = opposite(n), -gap
    if not -deep <= gap <= near or not _points_out(r, s, n, BEYOND_FACE):
        return False
    u, v, w = _direction(r), _direction(s), minus(r, s)
    uv, uw, vw, n2 = dot(u, v), dot(u, w), dot(v, w), sine * sine
    k, l = (uv * vw - uw) / n2, (vw - uv * uw) / n2  # noqa: E741
    if not (abs(k - 0.5 * r[LENGTH]) <= (0.5 + ON_END) * r[LENGTH]):
        return False
    if not (abs(l - 0.5 * s[LENGTH]) <= (0.5 + ON_END) * s[LENGTH]):
        return False
    out[0], out[1], out[2] = plus_scaled(r, k, u)
    out[3], out[4], out[5] = plus_scaled(s, l, v)
    out[6], out[7], out[8] = n
    out[9] = gap
    return True


@query_kernel
def _into_wedge(r, s, k, n, deep):
    """Where ridge r is well inside the wedge of ridge s's faces.

    k [m]: distance of the crossing's foot from r's begin; n: out of s; deep [m]: depth of the crossing. Returns
    (distance along r from that foot [m], how far r is behind the nearer face there [m]).
    """
    u, v = _direction(r), _direction(s)
    # normals of the faces: along the ridge the first is on its left
    f, g = cross(v, vector_at(s, FIRST_FACE)), cross(vector_at(s, SECOND_FACE), v)
    one, other, rate, rate_of_other = deep * dot(f, n), deep * dot(g, n), -dot(f, u), -dot(g, u)
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
        foot = vector_at(c, at)
        way, behind = _into_wedge(own, other, distance(foot, own), scaled(sign, vector_at(c, 6)), -c[9])
        if not behind > 0.0:
            return False
        least = REALLY * behind
        p = plus_scaled(foot, way / own[LENGTH], minus(vector_at(own, END), own))
        if side == 1:
            p = to_other(pair.rotation[1], pair.translation[1], p)
        answer = bounded_probe(pools, f, p, 0.0, least, -1, False, scratch)
        if answer.status != INSIDE or answer.distance > -least:
            return False
    return True
