"""The contact of a point that surface_certificate.py found between samples: its place, normal and number.

Where an edge of one fragment crosses an edge of the other, the nearest surface alternates between the two sides of that
edge; the direction across both edges separates the two. Elsewhere normals are those of samples (facing_normal.py,
crack_normal.py).
"""

from __future__ import annotations

import math

from fracture_collision.core.contacts.facing_normal import turn_surface_point
from fracture_collision.core.contacts.known_samples import put_contact
from fracture_collision.core.field.elementary_queries import INSIDE, bounded_probe
from fracture_collision.core.memory.compiled import inlined_kernel, query_kernel
from fracture_collision.core.memory.pools import FACING
from fracture_collision.core.memory.rotations import to_other
from fracture_collision.core.mesh.sample_numbers import FIRST_OF_SURFACES
from fracture_collision.core.mesh.surface_elements import put_triangle
from fracture_collision.core.surfaces.surface_avoidance import room_for_rounding
from fracture_collision.core.surfaces.surface_certificate import FINEST, SHARPEST
from fracture_collision.core.surfaces.surface_search import inward, search_triangle

# Contact numbers reserved for each element of a surface.
TRIANGLES_EACH = 64
# Points of its triangle queried at most to find a deeper one.
MOST_SHARPENED = 2_000
# A point is on an edge if it is within this factor times its resolution, in place or depth, of a side of its triangle.
ON_EDGE = 4.0
# An edge of the other: the cosine between its sides' normals is no more than this.
EDGE = 0.99
# The way out across both edges is used if it is no longer than this factor times the depth.
OBLIQUE = 3.0


@query_kernel
def put_surface_contact(
    pools, a, b, rotation, translation, judgement, epsilon, near, work, contacts, ids, scratch, thread
):
    """Write the contact of `judgement`, for which work.best holds a point, to row 0 of contacts (., 10) and ids (., 5),
    as query_pair does; near [m]: the detection tolerance.
    """
    side = judgement.side
    own, other = (a, b) if side == 0 else (b, a)
    stack, best = work.stack[thread], work.best[thread]
    triangle = work.triangle[thread]
    put_triangle(pools, own, judgement.piece, judgement.triangle, rotation[side], translation[side], triangle)
    for k in range(9):
        stack[0, k] = triangle[k]
    sharp = SHARPEST * epsilon
    way = inward(triangle)
    slack = room_for_rounding(pools, other, own)
    _, depth, _ = search_triangle(
        pools, other, stack, judgement.depth, sharp, sharp, FINEST * sharp, MOST_SHARPENED, slack, way, best,
        work.moved[thread], scratch, thread,
    )  # fmt: skip
    x, y, z = best[0], best[1], best[2]
    answer = bounded_probe(pools, other, x, y, z, 0.0, math.inf, -1, False, scratch, thread)
    number = FIRST_OF_SURFACES + TRIANGLES_EACH * judgement.piece + min(judgement.triangle, TRIANGLES_EACH - 1)
    put_contact(contacts, ids, 0, side, number, x, y, z, answer)
    if pools.normals != FACING:
        return
    row = contacts[0]
    if _turn_across_edges(pools, own, other, side, rotation, translation, triangle, sharp, row, scratch, thread):
        return
    outward = (-way[0], -way[1], -way[2])
    turn_surface_point(pools, a, b, side, outward, near, row, ids[0], scratch, thread)


@inlined_kernel
def _turn_across_edges(pools, own, other, side, rotation, translation, p, sharp, row, scratch, thread):
    """Turn a contact where a side of the triangle p (9,) of `own` crosses an edge of `other`; returns whether."""
    x, y, z, depth = row[0], row[1], row[2], -row[9]
    least, k = math.inf, 0
    for i in range(3):
        away = _distance_from_side(p, i, x, y, z)
        if away < least:
            least, k = away, i
    if least > ON_EDGE * sharp:
        return False
    i, j = 3 * k, 3 * ((k + 1) % 3)
    tx, ty, tz = p[j] - p[i], p[j + 1] - p[i + 1], p[j + 2] - p[i + 2]
    length = math.sqrt(tx * tx + ty * ty + tz * tz)
    tx, ty, tz = tx / length, ty / length, tz / length
    # before and behind the point along the own edge, different sides of the other's edge are nearest
    step = 0.5 * depth
    before = bounded_probe(
        pools, other, x - step * tx, y - step * ty, z - step * tz, 0.0, math.inf, -1, False, scratch, thread
    )
    behind = bounded_probe(
        pools, other, x + step * tx, y + step * ty, z + step * tz, 0.0, math.inf, -1, False, scratch, thread
    )
    if before[0] != INSIDE or behind[0] != INSIDE:
        return False
    ux, uy, uz, vx, vy, vz = before[2], before[3], before[4], behind[2], behind[3], behind[4]
    if ux * vx + uy * vy + uz * vz > EDGE:
        return False
    ex, ey, ez = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    nx, ny, nz = ty * ez - tz * ey, tz * ex - tx * ez, tx * ey - ty * ex
    length = math.sqrt(nx * nx + ny * ny + nz * nz)
    if not length > 0.0:
        return False
    if nx * (ux + vx) + ny * (uy + vy) + nz * (uz + vz) < 0.0:
        length = -length
    nx, ny, nz = nx / length, ny / length, nz / length
    if nx * ux + ny * uy + nz * uz <= 0.0 or nx * vx + ny * vy + nz * vz <= 0.0:
        return False
    # a point of the other's edge: on both planes, next to the point
    c = ux * vx + uy * vy + uz * vz
    of_u = ux * (before[5] - x) + uy * (before[6] - y) + uz * (before[7] - z)
    of_v = vx * (behind[5] - x) + vy * (behind[6] - y) + vz * (behind[7] - z)
    s, t = (of_u - c * of_v) / (1.0 - c * c), (of_v - c * of_u) / (1.0 - c * c)
    way = nx * (s * ux + t * vx) + ny * (s * uy + t * vy) + nz * (s * uz + t * vz)
    if not depth <= way * (1.0 + 1e-9) + sharp or way > OBLIQUE * depth:
        return False
    # the interior of own must be behind its edge
    px, py, pz = to_other(rotation[1 - side], translation[1 - side], x + way * nx, y + way * ny, z + way * nz)
    if bounded_probe(pools, own, px, py, pz, 0.0, 0.0, -1, False, scratch, thread)[0] != INSIDE:
        return False
    row[3], row[4], row[5] = x + way * nx, y + way * ny, z + way * nz
    row[6], row[7], row[8], row[9] = nx, ny, nz, -way
    return True


@inlined_kernel
def _distance_from_side(p, k, x, y, z):
    """Distance [m] of a point from the line through side k of triangle p (9,)."""
    i, j = 3 * k, 3 * ((k + 1) % 3)
    ex, ey, ez = p[j] - p[i], p[j + 1] - p[i + 1], p[j + 2] - p[i + 2]
    dx, dy, dz = x - p[i], y - p[i + 1], z - p[i + 2]
    cx, cy, cz = dy * ez - dz * ey, dz * ex - dx * ez, dx * ey - dy * ex
    return math.sqrt((cx * cx + cy * cy + cz * cz) / (ex * ex + ey * ey + ez * ez))
