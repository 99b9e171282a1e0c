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
from fracture_collision.core.memory.rotations import rotated, to_other
from fracture_collision.core.mesh.closest_point import triangle_normal
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
            px, py, pz = to_other(rotation[1 - side], translation[1 - side], row[0], row[1], row[2])
            ux, uy, uz = own_normal(pools, own, sample, px, py, pz)
            outward = rotated(rotation[side], ux, uy, uz)
            _turn_to_facing(pools, f, own, outward, near, row, scratch)


@query_kernel
def _turn_to_facing(pools, f, own, outward, near, row, scratch):
    """Turn a contact of a point of `own` with `f` to the nearest surface of f that faces the point, if that is near.

    outward (x, y, z): the normal of own's surface in f's frame, not unit; zeros if unknown. Sets witness, normal and
    gap of `row` (10,), see Sink.
    """
    x, y, z, d = row[0], row[1], row[2], row[9]
    ox, oy, oz = outward
    along = ox * row[6] + oy * row[7] + oz * row[8]
    radius = min(pools.fragment.radius[f], pools.fragment.radius[own])
    slack = ROUNDING * radius
    inside = d <= slack
    limit = FARTHER * radius - d if inside else near
    if along <= SAME_WAY:
        if abs(d) > slack or along <= -SAME_WAY:
            return
        # where the two just touch, rounding decides the direction: of surfaces equally near take one that faces
        limit = 2.0 * slack
    found, qx, qy, qz, nx, ny, nz = _nearest_facing(pools, f, inside, (x, y, z), limit, outward, scratch)
    if not found:
        return
    gap = nx * (x - qx) + ny * (y - qy) + nz * (z - qz)
    # along a rim the distance along the normal may be less than the depth; never report less than the depth
    if gap > d + slack if inside else gap < -slack or gap > near:
        return
    row[3], row[4], row[5] = qx, qy, qz
    row[6], row[7], row[8] = nx, ny, nz
    row[9] = gap


@query_kernel
def own_normal(pools, f, sample, x, y, z):
    """Outward normal of f's own surface at one of its samples, not unit; zeros if unknown.

    (x, y, z) [m]: the sample's place in f's body frame. Returns (nx, ny, nz) in that frame.
    """
    kind = pools.fragment.kind[f]
    if kind == BOX:
        half = pools.fragment.shape[f]
        return _face_sign(x, half[0]), _face_sign(y, half[1]), _face_sign(z, half[2])
    k = pools.fragment.mesh[f]
    if kind == TRIANGLES:
        n = pools.triangles.pseudonormals[pools.triangles.first_vertex[k] + sample]
        return n[0], n[1], n[2]
    first = pools.mesh.first[k]
    if is_node(first, sample):
        n = pools.mesh.node_normals[first[FIRST_NODE] + sample]
        return n[0], n[1], n[2]
    if is_crossing(first, sample):
        edge, side = edge_of(first, sample)
        p = pools.body.planes[pools.body.edge_plane[edge + pools.fragment.edge_shift[f]]]
        sign = 1.0 if side == 0 else -1.0
        return sign * p[0], sign * p[1], sign * p[2]
    return sum_of_planes(pools, f, ANYBODY, tetrahedron_of(first, sample))


@query_kernel
def _face_sign(x, half):
    if abs(x) < half * (1.0 - ON_BOX):
        return 0.0
    return 1.0 if x > 0.0 else -1.0


@query_kernel
def _nearest_facing(pools, f, inside, point, limit, toward, scratch):
    """Nearest point of f's surface, closer than `limit` [m], whose outward normal points against `toward`.

    Returns (found, x, y, z, nx, ny, nz).
    """
    x, y, z = point
    kind = pools.fragment.kind[f]
    if kind == BOX:
        return _facing_side(pools.fragment.shape[f], x, y, z, limit, toward)
    k = pools.fragment.mesh[f]
    if kind == TRIANGLES:
        _, qx, qy, qz, _, i = nearest_triangle(pools.triangles, k, x, y, z, limit, toward, scratch.stack)
        if i < 0:
            return False, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        c = pools.triangles.corners[i]
        nx, ny, nz = triangle_normal(c[0], c[1], c[2], c[3], c[4], c[5], c[6], c[7], c[8])
        return True, qx, qy, qz, nx, ny, nz
    t = tetrahedron_at(pools.mesh, k, x, y, z)
    only = (TOWARD, toward[0], toward[1], toward[2])
    if inside and t >= 0 and holds_fragment(pools, f, t):
        best = nearest_from_inside(pools, f, t, point, limit, only, scratch)
    else:
        best = nearest_from_outside(pools, f, t, point, limit, only, scratch)
    if best[5] == NO_SOURCE:
        return False, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    nx, ny, nz = source_normal(pools, f, best[5])
    return True, best[1], best[2], best[3], nx, ny, nz


@query_kernel
def _facing_side(half, x, y, z, limit, toward):
    """_nearest_facing for the six sides of a box of half edges `half` [m]."""
    best = (False, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    least = limit * limit
    cx, cy, cz = min(max(x, -half[0]), half[0]), min(max(y, -half[1]), half[1]), min(max(z, -half[2]), half[2])
    for axis in range(3):
        if toward[axis] == 0.0:
            continue
        s = -1.0 if toward[axis] > 0.0 else 1.0
        qx, qy, qz = cx, cy, cz
        nx = ny = nz = 0.0
        if axis == 0:
            qx, nx = s * half[0], s
        elif axis == 1:
            qy, ny = s * half[1], s
        else:
            qz, nz = s * half[2], s
        d2 = (x - qx) ** 2 + (y - qy) ** 2 + (z - qz) ** 2
        if d2 < least:
            least = d2
            best = (True, qx, qy, qz, nx, ny, nz)
    return best
