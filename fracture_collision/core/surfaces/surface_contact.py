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
from fracture_collision.core.surfaces.surface_search import Margins, inward, search_triangle

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
def put_surface_contact(pools, pair, judgement, epsilon, near, sink, scratch):
    """Write the contact of a Judgement that found a point to row 0 of a Sink.

    The point is in surface_work.best, which is overwritten; epsilon, near [m]: as in a Rule.
    """
    number = judgement.side
    own, other = (pair.a, pair.b) if number == 0 else (pair.b, pair.a)
    stack, best, triangle = scratch.surface_work.stack, scratch.surface_work.best, scratch.surface_work.triangle
    rotation, translation = pair.rotation[number], pair.translation[number]
    put_triangle(pools, own, judgement.piece, judgement.triangle, rotation, translation, triangle)
    for k in range(9):
        stack[0, k] = triangle[k]
    sharp = SHARPEST * epsilon
    way = inward(triangle)
    slack = room_for_rounding(pools, other, own)
    margins = Margins(sharp, sharp, FINEST * sharp, MOST_SHARPENED)
    _, depth, _ = search_triangle(pools, other, judgement.depth, margins, way, slack, best, scratch)
    point = best[0], best[1], best[2]
    answer = bounded_probe(pools, other, point, 0.0, math.inf, -1, False, scratch)
    sample = FIRST_OF_SURFACES + TRIANGLES_EACH * judgement.piece + min(judgement.triangle, TRIANGLES_EACH - 1)
    put_contact(sink, 0, number, sample, point, answer)
    if pools.normals != FACING:
        return
    if _turn_across_edges(pools, pair, number, triangle, sharp, sink.contacts[0], scratch):
        return
    outward = (-way[0], -way[1], -way[2])
    turn_surface_point(pools, pair, number, outward, near, sink, scratch)


@inlined_kernel
def _turn_across_edges(pools, pair, side, p, sharp, row, scratch):
    """Turn a contact where an edge of the triangle p (9,) crosses one of the other fragment; returns whether it did.

    side: whose triangle it is (0: a's), in the other's frame; sharp [m]: resolution of the point; row (10,): see Sink.
    """
    own, other = (pair.a, pair.b) if side == 0 else (pair.b, pair.a)
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
    point = x - step * tx, y - step * ty, z - step * tz
    before = bounded_probe(pools, other, point, 0.0, math.inf, -1, False, scratch)
    point = x + step * tx, y + step * ty, z + step * tz
    behind = bounded_probe(pools, other, point, 0.0, math.inf, -1, False, scratch)
    if before.status != INSIDE or behind.status != INSIDE:
        return False
    ux, uy, uz, vx, vy, vz = before.nx, before.ny, before.nz, behind.nx, behind.ny, behind.nz
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
    of_u = ux * (before.x - x) + uy * (before.y - y) + uz * (before.z - z)
    of_v = vx * (behind.x - x) + vy * (behind.y - y) + vz * (behind.z - z)
    s, t = (of_u - c * of_v) / (1.0 - c * c), (of_v - c * of_u) / (1.0 - c * c)
    way = nx * (s * ux + t * vx) + ny * (s * uy + t * vy) + nz * (s * uz + t * vz)
    if not depth <= way * (1.0 + 1e-9) + sharp or way > OBLIQUE * depth:
        return False
    # the interior of own must be behind its edge
    px, py, pz = to_other(pair.rotation[1 - side], pair.translation[1 - side], x + way * nx, y + way * ny, z + way * nz)
    if bounded_probe(pools, own, (px, py, pz), 0.0, 0.0, -1, False, scratch).status != INSIDE:
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
