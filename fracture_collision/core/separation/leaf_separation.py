"""Separating planes computed from leaves of samples, and half-spaces about them that bound where contacts can be."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from fracture_collision.core.memory.compiled import inlined_kernel
from fracture_collision.core.memory.kinds import PLANE
from fracture_collision.core.memory.rotations import rotated, to_other
from fracture_collision.core.separation.approach import nearer_along
from fracture_collision.core.separation.hull_separation import (
    MOST_STEPS,
    SETTLED,
    encloses_origin,
    next_simplex,
)
from fracture_collision.core.separation.oriented_boxes import way_between
from fracture_collision.core.tree.sample_leaves import farthest_sample, sample_about_middle


@inlined_kernel
def parting_plane_of_leaves(pools, pair, leaves, distance, toward, bounds, most_steps=MOST_STEPS):
    """hull_separation.parting_plane over the leaves of a Pair, in single precision.

    leaves: Leaves of a and of b. toward (3,): initial direction in b's frame, zeros: unknown (neighbour_lists.Listing);
    replaced by the direction found. The search stops beyond `distance` [m]. bounds: working space, scratch.along.
    most_steps: 1: along `toward` only.

    Returns ((x, y, z), low, high); the bounds may be off by the rounding given in both middles.
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


class Approach(NamedTuple):
    """Where samples of a fragment may come near the other while the two move."""

    plane: tuple[float, float, float, float]  # all of the other is behind it: unit normal, offset [m]; zeros: unknown
    within: float  # [m] near
    reach: float  # [m] no point moves farther, relative to the other
    way: np.ndarray  # (WAY,) float64: how they move (motion.put_way)


@inlined_kernel
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


@inlined_kernel
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
