"""Contacts of an analytic sphere: one at each local minimum of the distance from its centre to the other's surface.

A ball in a corner touches both wall and floor. Each is a local minimum of the distance between the centre and the
surface, and each is a contact; a single nearest point would miss the others. A point of a triangle is such a minimum if
no triangle that touches it comes nearer: distances to convex sets have no other minima. Planes, spheres and boxes have
one contact in closed form. A body that contains the centre has one contact, too: its nearest surface gives a depth
beyond the sphere's radius.

A contact is identified by its triangle, numbered within the mesh: it keeps its id while the sphere stays on that
triangle, independent of the sphere's other contacts.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from fracture_collision.core.contacts.deepest_contacts import GAP, make_heap, sort_by_sample, sort_heap, swap_contacts
from fracture_collision.core.contacts.known_samples import ID_AT, ID_SAMPLE, ID_SIDE, ID_SOURCE, ID_TETRAHEDRON
from fracture_collision.core.field.elementary_queries import INSIDE, OUTSIDE, bounded_probe, inside_tetrahedron
from fracture_collision.core.field.flood import NO_SOURCE
from fracture_collision.core.field.tetrahedra_near import tetrahedra_near
from fracture_collision.core.memory.compiled import query_kernel
from fracture_collision.core.memory.kinds import SPHERE, TETRAHEDRA, TRIANGLES, is_mesh
from fracture_collision.core.memory.pools import BACK_SIDE, FRONT_SIDE, NEVER_BROKEN, OWNER, ROW
from fracture_collision.core.memory.vectors import (
    corners_of,
    divided,
    dot,
    minus,
    plus_scaled,
    scaled,
    vector,
    vector_at,
)
from fracture_collision.core.mesh.closest_point import (
    ON_FACE,
    box_distance_squared,
    closest_on_triangle,
    unit_normal,
)
from fracture_collision.core.mesh.cut_tetrahedron import face_corners
from fracture_collision.core.mesh.sample_numbers import FIRST_TETRAHEDRON
from fracture_collision.core.mesh.triangle_field import triangle_distance

# Sample number of a sphere's contact without a triangle.
NO_TRIANGLE = -1
# A triangle of a tetrahedral body is ROWS_EACH tetrahedron + place: faces 0 .. 3 of one with a single owner, else 4 +
# its row among those of the tetrahedron.
ROWS_EACH = 1024
# A triangle no farther from a point than this share of R touches it.
TOUCHES = 1e-9
# Rounding of a distance, as a share of it and of R.
DISTANCE_ROUNDING = 16.0 * np.finfo(np.float64).eps
# Places no farther apart than this share of R are one: a rounding error in a distance moves its foot along a surface by
# the square root of it.
ONE_PLACE = 1e-6
# How far before a rim the side of the surface is tested, as a share of R.
BEFORE = 1e-6
# Maximum number of halvings of the reach until the triangles within it fit in the buffer.
HALVINGS = 12
# Maximum number of triangles tested where the work is limited.
LEAST_WITHIN = 32
# At most this many contacts are spread in direction, the others chosen by depth: comparing all is quadratic.
SPREAD = 16


# Column of Near.boxes behind the box.
DISTANCE = 6


class Near(NamedTuple):
    """The other's triangles within a sphere's reach: those that touch at a place of theirs are among them."""

    codes: np.ndarray  # (k,) int64
    boxes: np.ndarray  # (k, 7) float64 [m] around each: least, most; its distance from the centre


class Place(NamedTuple):
    """Where a sphere may touch: a point of the other's surface, seen from the sphere's centre."""

    is_place: bool  # whether it is a local minimum of the distance, and its triangle the first that contains it
    distance: float  # [m] signed
    normal: tuple[float, float, float]  # outward unit direction
    point: tuple[float, float, float]  # [m]


@query_kernel
def sphere_contacts(pools, pair, rule, sink, scratch):
    """The contacts of the sphere of a Pair, of a if both are, by a Rule.

    Those within rule.near: the deepest, then others as far apart in direction as possible until there are rule.wanted,
    and all that are deeper than rule.epsilon, at most rule.most. If more triangles are within reach than there is room
    for, of which there is less where rule.every is more than 1, only the nearer ones are tested.

    Fills the first rows of a Sink as far as they go; fewer than wanted are in the order of their numbers. Returns
    (contacts found, missed depth bound [m] of all other places of the sphere, whether a limit left out any that are
    deeper than epsilon).
    """
    number = 0 if pools.fragment.kind[pair.a] == SPHERE else 1
    ball, other = (pair.a, pair.b) if number == 0 else (pair.b, pair.a)
    center = vector(pair.translation, number)
    contacts, ids = sink
    radius, size = pools.fragment.shape[ball, 0], pools.fragment.radius[other]
    answer = bounded_probe(pools, other, center, radius + rule.near, math.inf, -1, False, scratch)
    d = answer.distance
    if answer.status == OUTSIDE or d - radius > rule.near:
        return 0, 0.0, False
    within, places = scratch.within, scratch.places
    kind, sample = pools.fragment.kind[other], NO_TRIANGLE
    if is_mesh(kind):
        sample = _first_at(pools, other, (answer.x, answer.y, answer.z), scratch)
    nearest = Place(True, d, (answer.nx, answer.ny, answer.nz), (answer.x, answer.y, answer.z))
    _put(places, 0, number, sample, center, radius, nearest)
    found, kept, bound, cut = 1, 1, 0.0, False
    if sample != NO_TRIANGLE and answer.status != INSIDE:
        reach, room = radius + rule.near, min(len(within), LEAST_WITHIN if rule.every > 1 else len(within))
        count, _ = _triangles_within(pools, other, center, reach, within[:room], scratch)
        for _ in range(HALVINGS):
            if count <= room:
                break
            cut = True
            reach = d + 0.5 * (reach - d)
            count, _ = _triangles_within(pools, other, center, reach, within[:room], scratch)
        if count > room:
            reach, count = d, 0
        if cut:
            bound = max(radius - reach, 0.0)
            cut = bound > rule.epsilon
        near = Near(within[:count], scratch.boxes_within[:count])
        _measure(pools, other, near, center)
        for k in range(count):
            place = _place_of(pools, other, near, k, center, scratch)
            if not place.is_place or _is_listed(places.contacts, found, place, ONE_PLACE * size):
                continue
            if found == len(places.contacts):
                bound = max(bound, radius - place.distance)
                cut = bound > rule.epsilon
            else:
                _put(places, found, number, _number(pools, other, within[k]), center, radius, place)
                found += 1
        kept = found
    if found > rule.wanted:
        kept, left_out = _choose(
            places.contacts[:found], places.ids[:found], rule.wanted, rule.epsilon, rule.most
        )
        bound, cut = max(bound, left_out), cut or left_out > rule.epsilon
    for k in range(min(kept, len(contacts))):
        for c in range(contacts.shape[1]):
            contacts[k, c] = places.contacts[k, c]
        for c in range(ids.shape[1]):
            ids[k, c] = places.ids[k, c]
    if kept < rule.wanted:
        sort_by_sample(contacts, ids, min(kept, len(contacts)))
    return kept, bound, cut


@query_kernel
def _put(sink, at, number, sample, center, radius, place):
    """Write the contact at a Place to row `at`."""
    row, ids = sink.contacts[at], sink.ids[at]
    row[0], row[1], row[2] = minus(center, scaled(radius, place.normal))
    row[3], row[4], row[5] = place.point
    row[6], row[7], row[8] = place.normal
    row[GAP] = place.distance - radius
    ids[ID_SIDE], ids[ID_SAMPLE] = number, sample
    ids[ID_SOURCE], ids[ID_TETRAHEDRON], ids[ID_AT] = NO_SOURCE, -1, -1


@query_kernel
def _is_listed(contacts, count, place, one_place):
    """Whether one of `count` rows has its witness within `one_place` [m] of a Place."""
    for i in range(count):
        away = minus(vector_at(contacts[i], 3), place.point)
        if dot(away, away) <= one_place * one_place:
            return True
    return False


@query_kernel
def _choose(contacts, ids, wanted, epsilon, most):
    """Move the rows to keep to the front; returns (their number, depth [m] of the deepest of the others)."""
    count = len(contacts)
    make_heap(contacts, ids, count)
    sort_heap(contacts, ids, count)
    chosen = min(wanted, most, SPREAD)
    for k in range(1, chosen):
        best, least = k, math.inf
        for i in range(k, count):
            along = -math.inf
            for j in range(k):
                along = max(along, dot(vector_at(contacts[i], 6), vector_at(contacts[j], 6)))
            if along < least:
                best, least = i, along
        # those between keep their order
        for i in range(best, k, -1):
            swap_contacts(contacts, ids, i, i - 1)
    kept = chosen
    while kept < min(count, most) and (kept < wanted or -contacts[kept, GAP] > epsilon):
        kept += 1
    return kept, max(-contacts[kept, GAP], 0.0) if kept < count else 0.0


@query_kernel
def _measure(pools, f, near, center):
    """Write the boxes and distances of triangles Near a sphere's centre."""
    for k in range(len(near.codes)):
        triangle, _ = _triangle(pools, f, near.codes[k])
        (ax, ay, az), (bx, by, bz), (cx, cy, cz) = triangle
        box = near.boxes[k]
        box[0], box[1], box[2] = min(ax, bx, cx), min(ay, by, cy), min(az, bz, cz)
        box[3], box[4], box[5] = max(ax, bx, cx), max(ay, by, cy), max(az, bz, cz)
        box[DISTANCE] = math.sqrt(closest_on_triangle(center, triangle)[0])


@query_kernel
def _place_of(pools, f, near, k, center, scratch):
    """The point of f's triangle k of those Near nearest to a sphere's centre outside f: a Place."""
    triangle, n = _triangle(pools, f, near.codes[k])
    d2, q, feature = closest_on_triangle(center, triangle)
    d, away, size = math.sqrt(d2), minus(center, q), pools.fragment.radius[f]
    nothing = Place(False, d, n, q)
    if feature == ON_FACE:
        if not dot(away, n) > 0.0:
            return nothing
    elif not d > TOUCHES * size:
        return nothing
    nearer = d - DISTANCE_ROUNDING * (d + size)
    if _goes_on(pools, f, near, k, q, TOUCHES * size, nearer):
        return nothing
    if feature != ON_FACE:
        n = divided(away, d)
        if _holds(pools, f, plus_scaled(q, min(BEFORE * size, 0.5 * d), n), scratch):
            return nothing
    return Place(True, d, n, q)


@query_kernel
def _goes_on(pools, f, near, k, q, touches, nearer):
    """Whether a triangle within `touches` [m] of the point q of triangle k is before it or comes `nearer` [m]."""
    x, y, z = q
    for turn in range(2 * len(near.codes)):  # those listed beside it lie beside it most often
        i = k + (turn + 1) // 2 if turn % 2 == 1 else k - turn // 2
        if i < 0 or i >= len(near.codes):
            continue
        box = near.boxes[i]
        if (near.codes[i] < near.codes[k] or box[DISTANCE] < nearer) and (
            box[0] - touches <= x <= box[3] + touches and box[1] - touches <= y <= box[4] + touches
            and box[2] - touches <= z <= box[5] + touches and _distance(pools, f, near.codes[i], q) <= touches
        ):  # fmt: skip
            return True
    return False


@query_kernel
def _holds(pools, f, point, scratch):
    x, y, z = point
    if pools.fragment.kind[f] == TETRAHEDRA:
        return inside_tetrahedron(pools, f, x, y, z) >= 0
    k, radius = pools.fragment.mesh[f], pools.fragment.radius[f]
    return triangle_distance(pools.triangles, k, radius, x, y, z, scratch.stack)[0] < 0.0


@query_kernel
def _first_at(pools, f, point, scratch):
    """Number of the first triangle of f at a point of its surface; NO_TRIANGLE if the point is on none."""
    touches = TOUCHES * pools.fragment.radius[f]
    _, first = _triangles_within(pools, f, point, touches, scratch.within[:0], scratch)
    return NO_TRIANGLE if first == NO_SOURCE else _number(pools, f, first)


@query_kernel
def _number(pools, f, code):
    """Number of triangle `code` within its mesh: rows of the pools depend on the other contents."""
    k = pools.fragment.mesh[f]
    if pools.fragment.kind[f] == TRIANGLES:
        return code - pools.triangles.triangle_range[k, 0]
    return code - ROWS_EACH * pools.mesh.first[k, FIRST_TETRAHEDRON]


@query_kernel
def _triangle(pools, f, code):
    """(corners, outward unit normal) of a triangle of f's surface."""
    if pools.fragment.kind[f] == TRIANGLES:
        triangle = corners_of(pools.triangles.corners[code])
        return triangle, unit_normal(triangle)
    t, place = code // ROWS_EACH, code % ROWS_EACH
    if place < 4:
        triangle = face_corners(pools.mesh, t, place)
        return triangle, unit_normal(triangle)
    i = pools.body.regions[t + pools.fragment.tet_shift[f], ROW] + place - 4
    sign = 1.0 if pools.body.sides[i, FRONT_SIDE] == f else -1.0
    return corners_of(pools.body.triangles[i]), scaled(sign, vector(pools.body.faces, i))


@query_kernel
def _distance(pools, f, code, point):
    triangle, _ = _triangle(pools, f, code)
    return math.sqrt(closest_on_triangle(point, triangle)[0])


@query_kernel
def _triangles_within(pools, f, point, r, found, scratch):
    """Triangles of f's surface within `r` [m] of a point, as many as `found` has room for.

    Returns (their number, the first of them or NO_SOURCE).
    """
    x, y, z = point
    seen, r2 = (0, NO_SOURCE), r * r
    if pools.fragment.kind[f] == TRIANGLES:
        meshes = pools.triangles
        node, end = meshes.node_range[pools.fragment.mesh[f]]
        while node < end:
            if box_distance_squared(x, y, z, meshes.node_box[node]) > r2:
                node = meshes.node_skip[node]
                continue
            begin = meshes.node_first[node]
            for t in range(begin, begin + meshes.node_count[node]):
                seen = _note(pools, f, t, point, r, found, seen)
            node += 1
        return seen
    for k in range(tetrahedra_near(pools, f, x, y, z, r, scratch)):
        t = scratch.heap_tet[k]
        if box_distance_squared(x, y, z, pools.mesh.boxes[t]) <= r2:
            seen = _note_tetrahedron(pools, f, t, point, r, found, seen)
    return seen


@query_kernel
def _note(pools, f, code, point, r, found, seen):
    if not _distance(pools, f, code, point) <= r:
        return seen
    count, first = seen
    if count < len(found):
        found[count] = code
    return count + 1, min(first, code)


@query_kernel
def _note_tetrahedron(pools, f, t, point, r, found, seen):
    mesh, body, shift = pools.mesh, pools.body, pools.fragment.tet_shift[f]
    if shift == NEVER_BROKEN or body.regions[t + shift, OWNER] >= 0:
        for face in range(4):
            if mesh.neighbours[t, face] < 0:
                seen = _note(pools, f, ROWS_EACH * t + face, point, r, found, seen)
    if shift == NEVER_BROKEN:
        return seen
    begin = body.regions[t + shift, ROW]
    for i in range(begin, begin + body.cut_count[t + shift]):
        if body.sides[i, FRONT_SIDE] == f or body.sides[i, BACK_SIDE] == f:
            seen = _note(pools, f, ROWS_EACH * t + 4 + i - begin, point, r, found, seen)
    return seen
