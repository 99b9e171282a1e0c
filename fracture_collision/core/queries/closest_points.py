"""The nearest point of one fragment's surface to each of many points, however far, and which of them it contains."""

from __future__ import annotations

import math

from fracture_collision.core.field.elementary_queries import INSIDE, bounded_probe
from fracture_collision.core.memory.compiled import kernel, query_kernel
from fracture_collision.core.memory.kinds import TETRAHEDRA
from fracture_collision.core.memory.vectors import corners_of, divided, length, minus, opposite, vector
from fracture_collision.core.mesh.closest_point import ON_FACE, unit_normal
from fracture_collision.core.mesh.triangle_field import nearest_triangle

_ANY = (0.0, 0.0, 0.0)
# As a share of R: so near to an edge, the direction to it says nothing, and the face's normal is taken.
ROUNDING = 1e-12


@kernel
def contained(pools, f, points, scratch, out):
    """Write which of the points (n, 3) [m], in the body frame, fragment row `f` contains."""
    for k in range(len(points)):
        out[k] = bounded_probe(pools, f, vector(points, k), 0.0, 0.0, -1, False, scratch).status == INSIDE


@kernel
def closest(pools, trees, f, points, scratch, out):
    """Write of each point (n, 3) [m]: the distance from fragment row `f`, negative inside, nearest point, and normal.

    In the body frame; trees: SurfaceTrees; out: (n,), (n, 3), (n, 3).
    """
    distances, nearest, normals = out
    for k in range(len(points)):
        d, q, n = closest_point(pools, trees, f, vector(points, k), scratch)
        distances[k] = d
        for i in range(3):
            nearest[k, i], normals[k, i] = q[i], n[i]


@query_kernel
def closest_point(pools, trees, f, point, scratch):
    """(signed distance [m], nearest point of the surface, outward normal), all in the body frame of row `f`."""
    if pools.fragment.kind[f] != TETRAHEDRA:
        found = bounded_probe(pools, f, point, math.inf, math.inf, -1, False, scratch)
        return found.distance, (found.x, found.y, found.z), (found.nx, found.ny, found.nz)
    is_inside = bounded_probe(pools, f, point, 0.0, 0.0, -1, False, scratch).status == INSIDE
    _, q, feature, t = nearest_triangle(trees, f, point, math.inf, _ANY, scratch.stack)
    away = minus(point, q)
    d = length(away)
    if feature == ON_FACE or not d > ROUNDING * pools.fragment.radius[f]:
        n = unit_normal(corners_of(trees.corners[t]))
    else:
        n = divided(opposite(away) if is_inside else away, d)
    return -d if is_inside else d, q, n
