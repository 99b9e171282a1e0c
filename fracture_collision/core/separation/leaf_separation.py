"""The separating plane of two fragments' hulls, or the nearest to one, and half-spaces where contacts can be.

Of the pairs whose boxes overlap in a pile, nineteen in twenty touch nowhere, and most of these have a separating plane.
It is found by the algorithm of Gilbert, Johnson, Keerthi, "A fast procedure for computing the distance between complex
objects in three-dimensional space" (1988), which walks over the difference of the hulls towards its point nearest to
the origin, over the leaves of samples and in single precision. The extents of both fragments along the direction are
those of all their samples, whose hull contains all of the border (corner_samples.py): the bound is valid even if GJK
does not converge. A plane that does not separate the two still shows that most samples are beyond the other.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from fracture_collision.core.memory.compiled import query_kernel
from fracture_collision.core.memory.kinds import PLANE
from fracture_collision.core.memory.rotations import rotated, to_other
from fracture_collision.core.mesh.closest_point import closest_on_triangle
from fracture_collision.core.samples.sample_leaves import farthest_sample, sample_about_middle
from fracture_collision.core.separation.approach import nearer_along
from fracture_collision.core.separation.oriented_boxes import way_between

# Most GJK steps. In a pile, of the pairs with a separating plane two thirds need one step, and all but one in two
# hundred no more than this; touching pairs use all of them.
MOST_STEPS = 12
# GJK ends when the possible gain is less than this share of the distance.
SETTLED = 1e-3


@query_kernel
def parting_plane_of_leaves(pools, pair, leaves, distance, toward, bounds, most_steps=MOST_STEPS):
    """The direction of greatest separation, or least overlap, of the hulls of a Pair that the search finds.

    leaves: Leaves of a and of b. toward (3,): initial direction in b's frame, zeros: unknown (neighbour_lists.Listing);
    replaced by the direction found. The search stops beyond `distance` [m]. bounds: working space, scratch.along.
    most_steps: 1: along `toward` only.

    Returns ((x, y, z), low, high): a unit vector in b's frame; along it all of a is at `low` or above, all of b at
    `high` or below [m]. These may be off by the rounding given in both middles.
    """
    a, b, rotation, translation = pair
    of_a, of_b = leaves
    ax, ay, az = to_other(rotation[0], translation[0], of_a.middle[0], of_a.middle[1], of_a.middle[2])
    # from b's middle to a's, in b's frame
    mx, my, mz = ax - of_b.middle[0], ay - of_b.middle[1], az - of_b.middle[2]
    v = (toward[0], toward[1], toward[2])
    if v[0] == 0.0 and v[1] == 0.0 and v[2] == 0.0:
        v = way_between(pools.fragment.box[a], pools.fragment.box[b], rotation[0], translation[0])
    k0, k1, k2 = v, v, v
    found, best, best_low, best_high = v, -math.inf, 0.0, 0.0
    at_a = at_b = 0
    for step in range(most_steps):
        length = math.sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2])
        if not length > 0.0:
            break
        n = v[0] / length, v[1] / length, v[2] / length
        own = rotated(rotation[1], -n[0], -n[1], -n[2])
        at_a, reach_a = farthest_sample(of_a, own, at_a, bounds)
        at_b, reach_b = farthest_sample(of_b, n, at_b, bounds)
        low = n[0] * ax + n[1] * ay + n[2] * az - reach_a
        high = n[0] * of_b.middle[0] + n[1] * of_b.middle[1] + n[2] * of_b.middle[2] + reach_b
        along = low - high
        if along > best:
            best, found, best_low, best_high = along, n, low, high
        if along > distance:
            break
        px, py, pz = sample_about_middle(of_a, at_a)
        px, py, pz = rotated(rotation[0], px, py, pz)
        qx, qy, qz = sample_about_middle(of_b, at_b)
        new = mx + px - qx, my + py - qy, mz + pz - qz
        if step == 0:
            k0, k1, k2, v = new, new, new, new
            continue
        if length - along <= SETTLED * length or encloses_origin(new, k0, k1, k2):
            break
        v, k0, k1, k2 = next_simplex(new, k0, k1, k2)
    toward[0], toward[1], toward[2] = found
    if best == -math.inf:
        return found, -math.inf, math.inf
    return found, best_low, best_high


@query_kernel
def next_simplex(new, k0, k1, k2):
    """Of the triangles formed by `new` and two of the corners k0, k1, k2, the one nearest to the origin.

    Returns (its nearest point (x, y, z), its three corners).
    """
    least, x, y, z, _ = _nearest_to_origin(new, k0, k1)
    v, dropped = (x, y, z), 2
    nearer, x, y, z, _ = _nearest_to_origin(new, k1, k2)
    if nearer < least:
        least, v, dropped = nearer, (x, y, z), 0
    nearer, x, y, z, _ = _nearest_to_origin(new, k0, k2)
    if nearer < least:
        v, dropped = (x, y, z), 1
    if dropped == 0:
        return v, new, k1, k2
    if dropped == 1:
        return v, k0, new, k2
    return v, k0, k1, new


@query_kernel
def _nearest_to_origin(a, b, c):
    return closest_on_triangle(0.0, 0.0, 0.0, a[0], a[1], a[2], b[0], b[1], b[2], c[0], c[1], c[2])


@query_kernel
def encloses_origin(new, k0, k1, k2):
    """Whether the tetrahedron encloses the origin, known not to be beyond the face opposite its newest corner."""
    return (
        _same_side(new, k0, k1, k2) and _same_side(new, k1, k2, k0) and _same_side(new, k2, k0, k1)
    )  # fmt: skip


@query_kernel
def _same_side(a, b, c, d):
    """Whether the origin and d are on one side of the plane through a, b, c."""
    ux, uy, uz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    wx, wy, wz = c[0] - a[0], c[1] - a[1], c[2] - a[2]
    nx, ny, nz = uy * wz - uz * wy, uz * wx - ux * wz, ux * wy - uy * wx
    of_origin = nx * a[0] + ny * a[1] + nz * a[2]
    of_d = nx * (a[0] - d[0]) + ny * (a[1] - d[1]) + nz * (a[2] - d[2])
    return of_origin * of_d > 0.0


class Approach(NamedTuple):
    """Where samples of a fragment may come near the other while the two move."""

    plane: tuple[float, float, float, float]  # all of the other is behind it: unit normal, offset [m]; zeros: unknown
    within: float  # [m] near
    reach: float  # [m] no point moves farther, relative to the other
    way: np.ndarray  # (WAY,) float64: how they move (motion.put_way)


@query_kernel
def half_spaces(pools, pair, side, middle, approach, planes):
    """Half-spaces outside of which no sample of one side's fragment may be near the other, by an Approach.

    middle (4,): see Leaves. Writes half-spaces n . x <= o relative to `middle`, rows (n, o [m]), to `planes` (8, 4)
    float32; returns their number.
    """
    other = pair.b if side == 0 else pair.a
    kind, box, used = pools.fragment.kind[other], pools.fragment.box[other], 0
    m = to_other(pair.rotation[side], pair.translation[side], middle[0], middle[1], middle[2])
    within = approach.within + middle[3]
    back = pair.rotation[1 - side]
    if kind == PLANE:
        shape = pools.fragment.shape[other]
        n = shape[0], shape[1], shape[2]
        return _put_half_space(back, n, shape[3] + within, approach, m, planes, 0)
    x, y, z, offset = approach.plane
    if x != 0.0 or y != 0.0 or z != 0.0:  # most samples are beyond this one
        used = _put_half_space(back, (x, y, z), offset + within, approach, m, planes, used)
    for d in range(3):
        x, y, z = 1.0 if d == 0 else 0.0, 1.0 if d == 1 else 0.0, 1.0 if d == 2 else 0.0
        used = _put_half_space(back, (x, y, z), box[d + 3] + within, approach, m, planes, used)
        used = _put_half_space(back, (-x, -y, -z), -box[d] + within, approach, m, planes, used)
    return used


@query_kernel
def _put_half_space(back, normal, offset, approach, m, planes, row):
    """Write row `row` of `planes`: n . x <= offset in the other's frame, extended by the motion of an Approach.

    m: own's middle in the other's frame; back (3, 3): rotation to own's frame, where the row is relative to that
    middle. Returns the next row.
    """
    nx, ny, nz = normal
    if approach.reach > 0.0:
        offset += min(approach.reach, nearer_along(approach.way, nx, ny, nz))
    x, y, z = rotated(back, nx, ny, nz)
    planes[row, 0], planes[row, 1], planes[row, 2] = np.float32(x), np.float32(y), np.float32(z)
    planes[row, 3] = np.float32(offset - (nx * m[0] + ny * m[1] + nz * m[2]))
    return row + 1
