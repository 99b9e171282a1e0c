"""insideTest, penetration and sphereTest against a fragment of any kind (Glondu 2014, sections 3 and 4.3 - 4.5).

Points are in the body frame of the fragment that is asked. A probe answers all three at once, as far as the asker
needs: (status, distance, normal), the distance signed, positive outside, the normal outward, the closest point
x - distance * normal (exactly so for planes, spheres and boxes, else given).
"""

from __future__ import annotations

import math

from fracture_collision.core.closest_point import box_distance_squared
from fracture_collision.core.compiled import kernel
from fracture_collision.core.flood import (
    NO_SOURCE,
    nearest_from_inside,
    nearest_from_outside,
    outward_direction,
)
from fracture_collision.core.kinds import TETRAHEDRA, TRIANGLES
from fracture_collision.core.occupancy import sphere_may_touch
from fracture_collision.core.point_location import owner_in_tetrahedron, tetrahedron_at
from fracture_collision.core.primitives import primitive_distance
from fracture_collision.core.triangle_field import triangle_distance, triangle_within

OUTSIDE = 0  # not inside; no closest point asked or none near
NEAR = 1  # not inside, closest point within the asked distance
INSIDE = 2  # inside; closest point only if it was asked for


@kernel
def inside_tetrahedron(pools, f, x, y, z, scratch, thread):
    """insideTest: the tetrahedron row in which the point belongs to fragment `f`, -1 if it does not."""
    t = tetrahedron_at(pools.mesh, pools.fragment.mesh[f], x, y, z)
    if t >= 0 and owner_in_tetrahedron(pools, f, t, x, y, z, scratch, thread) != f:
        return -1
    return t


@kernel
def probe(pools, f, x, y, z, near, measure, scratch, thread):
    """All about one point: (status, distance [m], nx, ny, nz, closest x, y, z).

    `near` [m]: how far outside a closest point still counts; `measure`: whether the closest point is wanted inside.
    For an OUTSIDE point the distance is a lower bound, for an INSIDE one that was not measured minus infinity.
    """
    kind = pools.fragment.kind[f]
    if kind != TETRAHEDRA and kind != TRIANGLES:
        d, nx, ny, nz = primitive_distance(kind, pools.fragment.shape[f], x, y, z)
        status = INSIDE if d <= 0.0 else NEAR if d <= near else OUTSIDE
        return status, d, nx, ny, nz, x - d * nx, y - d * ny, z - d * nz
    reach = math.sqrt(box_distance_squared(x, y, z, pools.fragment.box[f]))
    if reach > near:
        return OUTSIDE, reach, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    if kind == TRIANGLES:
        d, nx, ny, nz, qx, qy, qz = triangle_distance(
            pools.triangles, pools.fragment.mesh[f], pools.fragment.radius[f], x, y, z
        )
        status = INSIDE if d <= 0.0 else NEAR if d <= near else OUTSIDE
        return status, d, nx, ny, nz, qx, qy, qz
    t = inside_tetrahedron(pools, f, x, y, z, scratch, thread)
    if t >= 0:
        if not measure:
            return INSIDE, -math.inf, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        b = nearest_from_inside(pools, f, t, x, y, z, scratch, thread)
        best = (b[0], b[1], b[2], b[3], b[4], b[5])
        nx, ny, nz = outward_direction(pools, f, x, y, z, best, True)
        return INSIDE, -math.sqrt(b[0]), nx, ny, nz, b[1], b[2], b[3]
    if near <= 0.0 or not sphere_may_touch(pools, f, x, y, z, near):
        return OUTSIDE, reach, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    best = nearest_from_outside(pools, f, x, y, z, near, scratch, thread)
    if best[5] == NO_SOURCE:
        return OUTSIDE, max(reach, near), 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    nx, ny, nz = outward_direction(pools, f, x, y, z, best, False)
    return NEAR, math.sqrt(best[0]), nx, ny, nz, best[1], best[2], best[3]


@kernel
def sphere_test(pools, f, distance, x, y, z, r):
    """sphereTest: False only if fragment `f` is farther than `r` [m] from a point outside it.

    `distance`: what probe said of the point, a lower bound of the true distance.
    """
    if distance > r:
        return False
    kind = pools.fragment.kind[f]
    if kind == TRIANGLES:
        k = pools.fragment.mesh[f]
        if distance > 0.0:
            return triangle_within(pools.triangles, k, x, y, z, r)
        return triangle_distance(pools.triangles, k, pools.fragment.radius[f], x, y, z)[0] <= r
    return kind != TETRAHEDRA or sphere_may_touch(pools, f, x, y, z, r)
