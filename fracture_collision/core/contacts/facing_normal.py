"""Normals that face the sample, where the nearest surface has the wrong direction.

A sample lies on its own surface and cannot have entered through a surface that it turns its back to. Where two blocks
are stacked flush, the nearest surface of a corner is the side of the other, at distance 0, however deep the corner is
in its top; a solver that uses it pushes sideways. So where the normal of the nearest surface points the same way as the
sample's own, the nearest surface that faces the sample is used, if it is near too, with its own normal and distance.
Selection and missed depth bound use distances and are unchanged. Between two fragments of one body, their shared crack
gives more information (crack_normal.py).
"""

from __future__ import annotations

from fracture_collision.core.contacts.known_samples import (
    ID_AT,
    ID_SAMPLE,
    ID_SIDE,
    ID_SOURCE,
    ID_TETRAHEDRON,
    share_a_body,
)
from fracture_collision.core.field.crack_normal import ANYBODY, FARTHER, sum_of_planes, turn_to_crack
from fracture_collision.core.field.flood import (
    NO_SOURCE,
    TOWARD,
    nearest_from_inside,
    nearest_from_outside,
    source_normal,
)
from fracture_collision.core.memory.compiled import query_kernel
from fracture_collision.core.memory.kinds import BOX, SPHERE, TRIANGLES, has_faces
from fracture_collision.core.memory.transforms import rotated, to_other
from fracture_collision.core.memory.vectors import corners_of, dot, minus, scaled, vector, vector_at
from fracture_collision.core.mesh.closest_point import unit_normal
from fracture_collision.core.mesh.point_location import holds_fragment, tetrahedron_at
from fracture_collision.core.mesh.sample_numbers import (
    FIRST_NODE,
    edge_of,
    is_crossing,
    is_crossing_of_ridges,
    is_node,
    tetrahedron_of,
)
from fracture_collision.core.mesh.triangle_field import nearest_triangle

# A normal at less than 75 degrees from the sample's own points the same way.
SAME_WAY = 0.25
# A sample this share of the half edge from a face of its box stands on it.
ON_BOX = 1e-9
# Rounding of distances, as a share of R.
ROUNDING = 1e-12
# What _nearest_facing returns where there is nothing near.
NOT_FOUND = False, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)


@query_kernel
def turn_contacts(pools, pair, near, sink, count, scratch):
    """Turn the first `count` contacts of a Sink to surfaces that face their samples.

    Sets witness, normal and gap; `near` [m] is the detection tolerance. Where ridges cross they already have the
    direction across both.
    """
    a, b, rotation, translation = pair
    contacts, ids = sink
    one_body = share_a_body(pools, a, b)
    for c in range(count):
        side, sample = ids[c, ID_SIDE], ids[c, ID_SAMPLE]
        if is_crossing_of_ridges(sample):
            continue
        f, own = (b, a) if side == 0 else (a, b)
        if one_body:
            witness = ids[c, ID_SOURCE], ids[c, ID_TETRAHEDRON], ids[c, ID_AT]
            turn_to_crack(pools, f, own, near, contacts[c], witness, scratch)
        elif pools.fragment.kind[own] != SPHERE and has_faces(pools.fragment.kind[f]):
            row = contacts[c]
            place = to_other(rotation[1 - side], translation[1 - side], row)
            outward = rotated(rotation[side], own_normal(pools, own, sample, place))
            _turn_to_facing(pools, f, own, outward, near, row, scratch)


@query_kernel
def _turn_to_facing(pools, f, own, outward, near, row, scratch):
    """Turn a contact of a point of `own` with `f` to the nearest surface of f that faces the point, if that is near.

    outward: the normal of own's surface in f's frame, not unit; zeros if unknown. Sets witness, normal and
    gap of `row` (10,), see Sink.
    """
    point, d = vector_at(row, 0), row[9]
    along = dot(outward, vector_at(row, 6))
    radius = min(pools.fragment.radius[f], pools.fragment.radius[own])
    slack = ROUNDING * radius
    inside = d <= slack
    limit = FARTHER * radius - d if inside else near
    if along <= SAME_WAY:
        if abs(d) > slack or along <= -SAME_WAY:
            return
        # where the two just touch, rounding decides the direction: of surfaces equally near take one that faces
        limit = 2.0 * slack
    found, q, n = _nearest_facing(pools, f, inside, point, limit, outward, scratch)
    if not found:
        return
    gap = dot(n, minus(point, q))
    # along a rim the distance along the normal may be less than the depth; never report less than the depth
    if gap > d + slack if inside else gap < -slack or gap > near:
        return
    row[3], row[4], row[5] = q
    row[6], row[7], row[8] = n
    row[9] = gap


@query_kernel
def own_normal(pools, f, sample, place):
    """Outward normal of f's own surface at one of its samples, not unit; zeros if unknown.

    place [m] of the sample, and the normal: in f's body frame.
    """
    kind = pools.fragment.kind[f]
    if kind == BOX:
        half = pools.fragment.shape[f]
        return _face_sign(place[0], half[0]), _face_sign(place[1], half[1]), _face_sign(place[2], half[2])
    k = pools.fragment.mesh[f]
    if kind == TRIANGLES:
        return vector(pools.triangles.pseudonormals, pools.triangles.first_vertex[k] + sample)
    first = pools.mesh.first[k]
    if is_node(first, sample):
        return vector(pools.mesh.node_normals, first[FIRST_NODE] + sample)
    if is_crossing(first, sample):
        edge, side = edge_of(first, sample)
        plane = pools.body.edge_plane[edge + pools.fragment.edge_shift[f]]
        return scaled(1.0 if side == 0 else -1.0, vector(pools.body.planes, plane))
    return sum_of_planes(pools, f, ANYBODY, tetrahedron_of(first, sample))


@query_kernel
def _face_sign(x, half):
    if abs(x) < half * (1.0 - ON_BOX):
        return 0.0
    return 1.0 if x > 0.0 else -1.0


@query_kernel
def _nearest_facing(pools, f, inside, point, limit, toward, scratch):
    """Nearest point of f's surface, closer than `limit` [m], whose outward normal points against `toward`.

    Returns (found, point, normal).
    """
    kind = pools.fragment.kind[f]
    if kind == BOX:
        return _facing_side(pools.fragment.shape[f], point, limit, toward)
    k = pools.fragment.mesh[f]
    if kind == TRIANGLES:
        _, q, _, i = nearest_triangle(pools.triangles, k, point, limit, toward, scratch.stack)
        if i < 0:
            return NOT_FOUND
        return True, q, unit_normal(corners_of(pools.triangles.corners[i]))
    t = tetrahedron_at(pools.mesh, k, point[0], point[1], point[2])
    only = (TOWARD, toward[0], toward[1], toward[2])
    if inside and t >= 0 and holds_fragment(pools, f, t):
        best = nearest_from_inside(pools, f, t, point, limit, only, scratch)
    else:
        best = nearest_from_outside(pools, f, t, point, limit, only, scratch)
    if best[5] == NO_SOURCE:
        return NOT_FOUND
    return True, (best[1], best[2], best[3]), source_normal(pools, f, best[5])


@query_kernel
def _facing_side(half, p, limit, toward):
    """_nearest_facing for the six sides of a box of half edges `half` [m]."""
    best, least = NOT_FOUND, limit * limit
    x, y, z = min(max(p[0], -half[0]), half[0]), min(max(p[1], -half[1]), half[1]), min(max(p[2], -half[2]), half[2])
    for axis in range(3):
        if toward[axis] == 0.0:
            continue
        s = -1.0 if toward[axis] > 0.0 else 1.0
        if axis == 0:
            q, n = (s * half[0], y, z), (s, 0.0, 0.0)
        elif axis == 1:
            q, n = (x, s * half[1], z), (0.0, s, 0.0)
        else:
            q, n = (x, y, s * half[2]), (0.0, 0.0, s)
        away = minus(p, q)
        if dot(away, away) < least:
            best, least = (True, q, n), dot(away, away)
    return best
