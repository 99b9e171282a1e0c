"""insideTest, penetration and sphereTest against a fragment of any kind (Glondu 2014, sections 3 and 4.3 - 4.5).

Points are in the body frame of the queried fragment. A probe computes all three at once, as far as the caller needs:
(status, distance, normal), the distance signed, positive outside, the normal outward, the closest point
x - distance * normal (exact for planes, spheres and boxes, else returned separately).
"""

from __future__ import annotations

import math
from typing import NamedTuple

from fracture_collision.core.field.flood import (
    EVERYTHING,
    NO_SOURCE,
    nearest_from_inside,
    nearest_from_outside,
    outward_direction,
)
from fracture_collision.core.memory.compiled import query_kernel
from fracture_collision.core.memory.kinds import TETRAHEDRA, TRIANGLES, is_mesh
from fracture_collision.core.mesh.closest_point import box_distance_squared
from fracture_collision.core.mesh.occupancy import sphere_may_touch
from fracture_collision.core.mesh.point_location import owner_in_tetrahedron, tetrahedron_at, tetrahedron_from
from fracture_collision.core.mesh.primitives import primitive_distance
from fracture_collision.core.mesh.triangle_field import triangle_distance, triangle_within

OUTSIDE = 0  # not inside; closest point not requested or none near
NEAR = 1  # not inside, closest point within the requested distance
INSIDE = 2  # inside; closest point only if requested


class Probe(NamedTuple):
    """Answer for one point. The closest point and the normal are zeros where none was searched or found."""

    status: int  # OUTSIDE, NEAR or INSIDE
    distance: float  # [m] signed; OUTSIDE: a lower bound; minus infinity: INSIDE, deeper than searched
    nx: float  # outward normal at the closest point
    ny: float
    nz: float
    x: float  # [m] closest point of the surface
    y: float
    z: float
    most_depth: float  # [m] upper bound of the depth: -distance where that is exact or a lower bound
    source: int  # surface triangle of the closest point, flood.NO_SOURCE: not from a flood
    source_tetrahedron: int  # the tetrahedron that it is in, -1: none
    tetrahedron: int  # the tetrahedron that holds the point, -1: none, or not searched


@query_kernel
def inside_tetrahedron(pools, f, x, y, z):
    """insideTest: the tetrahedron row in which the point belongs to fragment `f`, -1 if it does not."""
    t = tetrahedron_at(pools.mesh, pools.fragment.mesh[f], x, y, z)
    if t >= 0 and owner_in_tetrahedron(pools, f, t, x, y, z) != f:
        return -1
    return t


@query_kernel
def probe(pools, f, point, near, deep, scratch):
    """All queries for one point (x, y, z): (status, distance [m], nx, ny, nz, closest x, y, z).

    `near` [m]: search limit of the closest point from outside; `deep` [m]: the same from inside (infinity: no limit).
    The distance of an OUTSIDE point is a lower bound, that of an INSIDE point deeper than
    `deep` is minus infinity.
    """
    answer = bounded_probe(pools, f, point, near, deep, -1, False, scratch)
    return answer.status, answer.distance, answer.nx, answer.ny, answer.nz, answer.x, answer.y, answer.z


@query_kernel
def bounded_probe(pools, f, point, near, deep, start, reached, scratch):
    """`probe` with everything computed for the point: a Probe.

    start: a tetrahedron near the point, -1 if none is known; reached: sphere_test returned that f may be within `near`.
    """
    x, y, z = point
    kind = pools.fragment.kind[f]
    if not is_mesh(kind):
        d, nx, ny, nz = primitive_distance(kind, pools.fragment.shape[f], x, y, z)
        status = INSIDE if d <= 0.0 else NEAR if d < near else OUTSIDE
        return Probe(status, d, nx, ny, nz, x - d * nx, y - d * ny, z - d * nz, -d, NO_SOURCE, -1, -1)
    reach = math.sqrt(box_distance_squared(x, y, z, pools.fragment.box[f]))
    if reach > near:
        return Probe(OUTSIDE, reach, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, -reach, NO_SOURCE, -1, -1)
    return _probe_mesh(pools, f, point, near, deep, start, reached, scratch)


@query_kernel  # a call, not inlined: with a copy in each of a dozen callers, code and compile time are twice as large
def _probe_mesh(pools, f, point, near, deep, start, reached, scratch):
    """bounded_probe of a mesh whose box is at most `near` [m] from the point, which is then not negative."""
    x, y, z = point
    kind = pools.fragment.kind[f]
    if kind == TRIANGLES:
        d, nx, ny, nz, qx, qy, qz = triangle_distance(
            pools.triangles, pools.fragment.mesh[f], pools.fragment.radius[f], x, y, z, scratch.stack
        )
        status = INSIDE if d <= 0.0 else NEAR if d < near else OUTSIDE
        return Probe(status, d, nx, ny, nz, qx, qy, qz, -d, NO_SOURCE, -1, -1)
    # saves most points the search for their tetrahedron
    if not reached and not sphere_may_touch(pools, f, x, y, z, near):
        return Probe(OUTSIDE, near, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, -near, NO_SOURCE, -1, -1)
    k = pools.fragment.mesh[f]
    t = tetrahedron_at(pools.mesh, k, x, y, z) if start < 0 else tetrahedron_from(pools.mesh, k, start, x, y, z)
    if t >= 0 and owner_in_tetrahedron(pools, f, t, x, y, z) == f:
        best = nearest_from_inside(pools, f, t, point, deep, EVERYTHING, scratch)
        if best[5] == NO_SOURCE:
            return Probe(INSIDE, -math.inf, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, math.inf, NO_SOURCE, -1, t)
        nx, ny, nz = outward_direction(pools, f, x, y, z, best, True)
        d = math.sqrt(best[0])
        return Probe(INSIDE, -d, nx, ny, nz, best[1], best[2], best[3], d, best[5], best[6], t)
    if near <= 0.0:
        return Probe(OUTSIDE, near, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, -near, NO_SOURCE, -1, t)
    best = nearest_from_outside(pools, f, t, point, near, EVERYTHING, scratch)
    if best[5] == NO_SOURCE:
        return Probe(OUTSIDE, near, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, -near, NO_SOURCE, -1, t)
    nx, ny, nz = outward_direction(pools, f, x, y, z, best, False)
    d = math.sqrt(best[0])
    return Probe(NEAR, d, nx, ny, nz, best[1], best[2], best[3], -d, best[5], best[6], t)


@query_kernel
def least_distance(pools, f, x, y, z):
    """The cheapest lower bound [m] of a point's signed distance: minus infinity if it may be inside."""
    kind = pools.fragment.kind[f]
    if not is_mesh(kind):
        return primitive_distance(kind, pools.fragment.shape[f], x, y, z)[0]
    d2 = box_distance_squared(x, y, z, pools.fragment.box[f])
    return math.sqrt(d2) if d2 > 0.0 else -math.inf


@query_kernel
def sphere_test(pools, f, distance, x, y, z, r, scratch):
    """sphereTest: False only if fragment `f` is farther than `r` [m] from the point.

    `distance`: a lower bound of the point's signed distance.
    """
    if distance > r:
        return False
    kind = pools.fragment.kind[f]
    if kind == TRIANGLES:
        k = pools.fragment.mesh[f]
        if distance > 0.0:
            return triangle_within(pools.triangles, k, x, y, z, r)
        return triangle_distance(pools.triangles, k, pools.fragment.radius[f], x, y, z, scratch.stack)[0] <= r
    return kind != TETRAHEDRA or sphere_may_touch(pools, f, x, y, z, r)
