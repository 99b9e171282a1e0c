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
from fracture_collision.core.memory.transforms import rotated, to_other
from fracture_collision.core.memory.vectors import area_vector, divided, dot, length, minus, opposite, plus, vector_at
from fracture_collision.core.mesh.closest_point import closest_on_triangle
from fracture_collision.core.samples.sample_leaves import farthest_sample, sample_about_middle
from fracture_collision.core.separation.approach import nearer_along
from fracture_collision.core.separation.oriented_boxes import way_between

# Most GJK steps. In a pile, of the pairs with a separating plane two thirds need one step, and all but one in two
# hundred no more than this; touching pairs use all of them.
MOST_STEPS = 12
# GJK ends when the possible gain is less than this share of the distance.
SETTLED = 1e-3
_ORIGIN = 0.0, 0.0, 0.0


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
    middle = to_other(rotation[0], translation[0], of_a.middle)
    # from b's middle to a's, in b's frame
    m, v = minus(middle, of_b.middle), vector_at(toward, 0)
    if v == _ORIGIN:
        v = way_between(pools.fragment.box[a], pools.fragment.box[b], rotation[0], translation[0])
    k0, k1, k2 = v, v, v
    found, best, best_low, best_high = v, -math.inf, 0.0, 0.0
    at_a = at_b = 0
    for step in range(most_steps):
        apart = length(v)
        if not apart > 0.0:
            break
        n = divided(v, apart)
        at_a, reach_a = farthest_sample(of_a, rotated(rotation[1], opposite(n)), at_a, bounds)
        at_b, reach_b = farthest_sample(of_b, n, at_b, bounds)
        low, high = dot(n, middle) - reach_a, dot(n, of_b.middle) + reach_b
        along = low - high
        if along > best:
            best, found, best_low, best_high = along, n, low, high
        if along > distance:
            break
        p, q = rotated(rotation[0], sample_about_middle(of_a, at_a)), sample_about_middle(of_b, at_b)
        new = minus(plus(m, p), q)
        if step == 0:
            k0, k1, k2, v = new, new, new, new
            continue
        if apart - along <= SETTLED * apart or encloses_origin(new, k0, k1, k2):
            break
        v, k0, k1, k2 = next_simplex(new, k0, k1, k2)
    toward[0], toward[1], toward[2] = found
    if best == -math.inf:
        return found, -math.inf, math.inf
    return found, best_low, best_high


@query_kernel
def next_simplex(new, k0, k1, k2):
    """Of the triangles formed by `new` and two of the corners k0, k1, k2, the one nearest to the origin.

    Returns (its nearest point, its three corners).
    """
    least, v, _ = closest_on_triangle(_ORIGIN, (new, k0, k1))
    dropped = 2
    nearer, w, _ = closest_on_triangle(_ORIGIN, (new, k1, k2))
    if nearer < least:
        least, v, dropped = nearer, w, 0
    nearer, w, _ = closest_on_triangle(_ORIGIN, (new, k0, k2))
    if nearer < least:
        v, dropped = w, 1
    if dropped == 0:
        return v, new, k1, k2
    if dropped == 1:
        return v, k0, new, k2
    return v, k0, k1, new


@query_kernel
def encloses_origin(new, k0, k1, k2):
    """Whether the tetrahedron encloses the origin, known not to be beyond the face opposite its newest corner."""
    return _same_side(new, k0, k1, k2) and _same_side(new, k1, k2, k0) and _same_side(new, k2, k0, k1)


@query_kernel
def _same_side(a, b, c, d):
    """Whether the origin and d are on one side of the plane through a, b, c."""
    n = area_vector((a, b, c))
    return dot(n, a) * dot(n, minus(a, d)) > 0.0


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
    m = to_other(pair.rotation[side], pair.translation[side], middle)
    within = approach.within + middle[3]
    back = pair.rotation[1 - side]
    if kind == PLANE:
        shape = pools.fragment.shape[other]
        return _put_half_space(back, vector_at(shape, 0), shape[3] + within, approach, m, planes, 0)
    x, y, z, offset = approach.plane
    if x != 0.0 or y != 0.0 or z != 0.0:  # most samples are beyond this one
        used = _put_half_space(back, (x, y, z), offset + within, approach, m, planes, used)
    for d in range(3):
        axis = 1.0 if d == 0 else 0.0, 1.0 if d == 1 else 0.0, 1.0 if d == 2 else 0.0
        used = _put_half_space(back, axis, box[d + 3] + within, approach, m, planes, used)
        used = _put_half_space(back, opposite(axis), -box[d] + within, approach, m, planes, used)
    return used


@query_kernel
def _put_half_space(back, normal, offset, approach, m, planes, row):
    """Write row `row` of `planes`: n . x <= offset in the other's frame, extended by the motion of an Approach.

    m: own's middle in the other's frame; back (3, 3): rotation to own's frame, where the row is relative to that
    middle. Returns the next row.
    """
    if approach.reach > 0.0:
        offset += min(approach.reach, nearer_along(approach.way, normal))
    x, y, z = rotated(back, normal)
    planes[row, 0], planes[row, 1], planes[row, 2] = np.float32(x), np.float32(y), np.float32(z)
    planes[row, 3] = np.float32(offset - dot(normal, m))
    return row + 1
