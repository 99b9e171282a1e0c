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
from fracture_collision.core.mesh.closest_point import (
    ON_FACE,
    box_distance_squared,
    closest_on_triangle,
    triangle_normal,
)
from fracture_collision.core.mesh.cut_tetrahedron import FACE_VERTICES
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


class Place(NamedTuple):
    """Where a sphere may touch: a point of the other's surface, seen from the sphere's centre."""

    is_place: bool  # whether it is a local minimum of the distance, and its triangle the first that contains it
    distance: float  # [m] signed
    nx: float  # outward unit direction
    ny: float
    nz: float
    x: float  # [m] the point
    y: float
    z: float


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
    center = pair.translation[number, 0], pair.translation[number, 1], pair.translation[number, 2]
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
    nearest = Place(True, d, answer.nx, answer.ny, answer.nz, answer.x, answer.y, answer.z)
    _put(places, 0, number, sample, center, radius, nearest)
    found, kept, bound, cut = 1, 1, 0.0, False
    if sample != NO_TRIANGLE and answer.status != INSIDE:
        reach, room = radius + rule.near, min(len(within), LEAST_WITHIN if rule.every > 1 else len(within))
        count, _, _ = _triangles_within(pools, other, center, reach, center, within[:room], scratch)
        for _ in range(HALVINGS):
            if count <= room:
                break
            cut = True
            reach = d + 0.5 * (reach - d)
            count, _, _ = _triangles_within(pools, other, center, reach, center, within[:room], scratch)
        if count > room:
            reach, count = d, 0
        if cut:
            bound = max(radius - reach, 0.0)
            cut = bound > rule.epsilon
        for k in range(count):
            place = _place_of(pools, other, within[k], center, scratch)
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
    nx, ny, nz = place.nx, place.ny, place.nz
    row[0], row[1], row[2] = center[0] - radius * nx, center[1] - radius * ny, center[2] - radius * nz
    row[3], row[4], row[5] = place.x, place.y, place.z
    row[6], row[7], row[8] = nx, ny, nz
    row[GAP] = place.distance - radius
    ids[ID_SIDE], ids[ID_SAMPLE] = number, sample
    ids[ID_SOURCE], ids[ID_TETRAHEDRON], ids[ID_AT] = NO_SOURCE, -1, -1


@query_kernel
def _is_listed(contacts, count, place, one_place):
    """Whether one of `count` rows has its witness within `one_place` [m] of a Place."""
    for i in range(count):
        row = contacts[i]
        if (row[3] - place.x) ** 2 + (row[4] - place.y) ** 2 + (row[5] - place.z) ** 2 <= one_place * one_place:
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
                a, b = contacts[i], contacts[j]
                along = max(along, a[6] * b[6] + a[7] * b[7] + a[8] * b[8])
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
def _place_of(pools, f, code, center, scratch):
    """The point of f's triangle `code` nearest to a sphere's centre outside f: a Place."""
    x, y, z = center
    c, nx, ny, nz = _triangle(pools, f, code)
    d2, qx, qy, qz, feature = closest_on_triangle(x, y, z, c[0], c[1], c[2], c[3], c[4], c[5], c[6], c[7], c[8])
    d = math.sqrt(d2)
    size = pools.fragment.radius[f]
    nothing = Place(False, d, nx, ny, nz, qx, qy, qz)
    if feature == ON_FACE:
        if not (x - qx) * nx + (y - qy) * ny + (z - qz) * nz > 0.0:
            return nothing
    elif not d > TOUCHES * size:
        return nothing
    nearer = d - DISTANCE_ROUNDING * (d + size)
    _, first, least = _triangles_within(pools, f, (qx, qy, qz), TOUCHES * size, center, scratch.within[:0], scratch)
    if first < code or least < nearer:
        return nothing
    if feature != ON_FACE:
        nx, ny, nz = (x - qx) / d, (y - qy) / d, (z - qz) / d
        step = min(BEFORE * size, 0.5 * d)
        if _holds(pools, f, qx + step * nx, qy + step * ny, qz + step * nz, scratch):
            return nothing
    return Place(True, d, nx, ny, nz, qx, qy, qz)


@query_kernel
def _holds(pools, f, x, y, z, scratch):
    if pools.fragment.kind[f] == TETRAHEDRA:
        return inside_tetrahedron(pools, f, x, y, z) >= 0
    k, radius = pools.fragment.mesh[f], pools.fragment.radius[f]
    return triangle_distance(pools.triangles, k, radius, x, y, z, scratch.stack)[0] < 0.0


@query_kernel
def _first_at(pools, f, point, scratch):
    """Number of the first triangle of f at a point of its surface; NO_TRIANGLE if the point is on none."""
    touches = TOUCHES * pools.fragment.radius[f]
    _, first, _ = _triangles_within(pools, f, point, touches, point, scratch.within[:0], scratch)
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
    """Corners of a triangle of f's surface and its outward unit normal."""
    if pools.fragment.kind[f] == TRIANGLES:
        c = pools.triangles.corners[code]
        nx, ny, nz = triangle_normal(c[0], c[1], c[2], c[3], c[4], c[5], c[6], c[7], c[8])
        return (c[0], c[1], c[2], c[3], c[4], c[5], c[6], c[7], c[8]), nx, ny, nz
    t, place = code // ROWS_EACH, code % ROWS_EACH
    if place < 4:
        v, n = pools.mesh.tetrahedra[t], pools.mesh.nodes
        a, b, c = n[v[FACE_VERTICES[place, 0]]], n[v[FACE_VERTICES[place, 1]]], n[v[FACE_VERTICES[place, 2]]]
        nx, ny, nz = triangle_normal(a[0], a[1], a[2], b[0], b[1], b[2], c[0], c[1], c[2])
        return (a[0], a[1], a[2], b[0], b[1], b[2], c[0], c[1], c[2]), nx, ny, nz
    i = pools.body.regions[t + pools.fragment.tet_shift[f], ROW] + place - 4
    c, p = pools.body.triangles[i], pools.body.faces[i]
    sign = 1.0 if pools.body.sides[i, FRONT_SIDE] == f else -1.0
    return (c[0], c[1], c[2], c[3], c[4], c[5], c[6], c[7], c[8]), sign * p[0], sign * p[1], sign * p[2]


@query_kernel
def _distance(pools, f, code, x, y, z):
    c, _, _, _ = _triangle(pools, f, code)
    return math.sqrt(closest_on_triangle(x, y, z, c[0], c[1], c[2], c[3], c[4], c[5], c[6], c[7], c[8])[0])


@query_kernel
def _triangles_within(pools, f, point, r, center, found, scratch):
    """Triangles of f's surface within `r` [m] of a point, as many as `found` has room for.

    Returns (their number, the first of them or NO_SOURCE, the least of their distances from `center` [m]).
    """
    x, y, z = point
    seen, r2 = (0, NO_SOURCE, math.inf), r * r
    if pools.fragment.kind[f] == TRIANGLES:
        meshes = pools.triangles
        node, end = meshes.node_range[pools.fragment.mesh[f]]
        while node < end:
            if box_distance_squared(x, y, z, meshes.node_box[node]) > r2:
                node = meshes.node_skip[node]
                continue
            begin = meshes.node_first[node]
            for t in range(begin, begin + meshes.node_count[node]):
                seen = _note(pools, f, t, point, r, center, found, seen)
            node += 1
        return seen
    for k in range(tetrahedra_near(pools, f, x, y, z, r, scratch)):
        t = scratch.heap_tet[k]
        if box_distance_squared(x, y, z, pools.mesh.boxes[t]) <= r2:
            seen = _note_tetrahedron(pools, f, t, point, r, center, found, seen)
    return seen


@query_kernel
def _note(pools, f, code, point, r, center, found, seen):
    if not _distance(pools, f, code, point[0], point[1], point[2]) <= r:
        return seen
    count, first, least = seen
    if count < len(found):
        found[count] = code
    return count + 1, min(first, code), min(least, _distance(pools, f, code, center[0], center[1], center[2]))


@query_kernel
def _note_tetrahedron(pools, f, t, point, r, center, found, seen):
    mesh, body, shift = pools.mesh, pools.body, pools.fragment.tet_shift[f]
    if shift == NEVER_BROKEN or body.regions[t + shift, OWNER] >= 0:
        for face in range(4):
            if mesh.neighbours[t, face] < 0:
                seen = _note(pools, f, ROWS_EACH * t + face, point, r, center, found, seen)
    if shift == NEVER_BROKEN:
        return seen
    begin = body.regions[t + shift, ROW]
    for i in range(begin, begin + body.cut_count[t + shift]):
        if body.sides[i, FRONT_SIDE] == f or body.sides[i, BACK_SIDE] == f:
            seen = _note(pools, f, ROWS_EACH * t + 4 + i - begin, point, r, center, found, seen)
    return seen
