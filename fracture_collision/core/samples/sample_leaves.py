"""The samples of a fragment's surface for searching: eight per leaf, in the order of a space-filling curve.

A sphere tree (Glondu 2014, section 5.1; core/glondu2014) has to be walked node by node to find all samples that may
touch another fragment. Here all leaves of a fragment are tested at once, in single-precision loops that vectorize eight
wide: which boxes reach into a few half-spaces, and how far they reach along a direction. The results are used for
culling only, never returned, with a margin for rounding.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from fracture_collision.core.memory.compiled import kernel, query_kernel
from fracture_collision.core.memory.pools import LEAF, LEAF_VALUES, SAMPLE_ROUNDING

# Cells of the curve along each side of a fragment's box.
CURVE = 1024
_BITS_A_PASS, _PASSES = 8, 4  # of the radix sort along the curve, with 30-bit places


class Leaves(NamedTuple):
    """The n leaves of one fragment."""

    values: np.ndarray  # (LEAF_VALUES n,) float32 [m] from `middle`: x y z of lower corners, of upper ones, of samples
    entries: np.ndarray  # (LEAF n,) int32 index among the fragment's samples, -1: none
    middle: np.ndarray  # (4,) float64 [m]: x y z in the body frame; rounding error bound along a unit vector


@query_kernel
def leaf_count(samples):
    """Number of leaves of so many samples."""
    return (samples + LEAF - 1) // LEAF


@query_kernel
def leaves_of(pools, f):
    """The Leaves of fragment `f`: views of the pools."""
    begin, end = pools.fragment.leaf_begin[f], pools.fragment.leaf_end[f]
    return Leaves(
        pools.samples.values[LEAF_VALUES * begin : LEAF_VALUES * end],
        pools.samples.entries[LEAF * begin : LEAF * end],
        pools.fragment.middle[f],
    )


def most_leaves(leaves: int, new_samples: int, fragments: int) -> int:
    """Upper bound of the leaves of all fragments of a broken fragment with `leaves` leaves."""
    return leaves + new_samples // LEAF + fragments + 1


@kernel
def fill_leaves(points, begins, values, entries, middles):
    """Write the leaves of fragments with samples begins[f] .. begins[f + 1] - 1 of `points` (S, 3), consecutively.

    values (leaves, LEAF_VALUES), entries (leaves, LEAF): leaf_count each; middles (n, 4): see Leaves.
    """
    most = 0
    for f in range(len(begins) - 1):
        most = max(most, begins[f + 1] - begins[f])
    rows, places = np.empty((2, most), np.int32), np.empty((2, most), np.uint32)
    buckets = np.empty(1 << _BITS_A_PASS, np.int32)
    first = 0
    for f in range(len(begins) - 1):
        used = begins[f + 1] - begins[f]
        low, high = np.full(3, np.inf), np.full(3, -np.inf)
        for k in range(used):
            rows[0, k] = begins[f] + k
            for d in range(3):
                low[d], high[d] = min(low[d], points[rows[0, k], d]), max(high[d], points[rows[0, k], d])
        middles[f] = 0.0
        if used:
            for d in range(3):
                middles[f, d] = 0.5 * (low[d] + high[d])
                middles[f, 3] += SAMPLE_ROUNDING * (high[d] - low[d])
        for k in range(used):
            places[0, k] = place_on_curve(points[rows[0, k]], low, high)
        _sort_by_place(rows, places, used, buckets)
        n = leaf_count(used)
        flat = values[first : first + n].reshape(LEAF_VALUES * n)
        own_entries = entries[first : first + n].reshape(LEAF * n)
        for k in range(LEAF * n):
            row = rows[0, min(k, used - 1)]
            own_entries[k] = row - begins[f] if k < used else -1
            leaf = k // LEAF
            for d in range(3):
                v = np.float32(points[row, d] - middles[f, d])
                flat[6 * n + LEAF * n * d + k] = v
                if k % LEAF == 0:
                    flat[n * d + leaf] = flat[n * (3 + d) + leaf] = v
                else:
                    flat[n * d + leaf] = min(flat[n * d + leaf], v)
                    flat[n * (3 + d) + leaf] = max(flat[n * (3 + d) + leaf], v)
        first += n


@query_kernel
def place_on_curve(point, low, high):
    """Place of a point of a box on the curve of Morton (1966): the interleaved bits of its three cell numbers."""
    place = np.uint32(0)
    for d in range(3):
        side = high[d] - low[d]
        cell = np.uint32(min(CURVE * ((point[d] - low[d]) / side), CURVE - 1.0)) if side > 0.0 else np.uint32(0)
        cell = (cell | (cell << np.uint32(16))) & np.uint32(0x030000FF)
        cell = (cell | (cell << np.uint32(8))) & np.uint32(0x0300F00F)
        cell = (cell | (cell << np.uint32(4))) & np.uint32(0x030C30C3)
        cell = (cell | (cell << np.uint32(2))) & np.uint32(0x09249249)
        place |= cell << np.uint32(d)
    return place


@query_kernel
def _sort_by_place(rows, places, count, buckets):
    """Sort the first `count` of rows[0] by places[0]: a stable radix sort, lowest bits first."""
    for turn in range(_PASSES):
        shift, of, to = np.uint32(_BITS_A_PASS * turn), turn % 2, 1 - turn % 2
        buckets[:] = 0
        for k in range(count):
            buckets[_digit(places[of, k], shift)] += 1
        begin = 0
        for digit in range(len(buckets)):
            buckets[digit], begin = begin, begin + buckets[digit]
        for k in range(count):
            digit = _digit(places[of, k], shift)
            places[to, buckets[digit]], rows[to, buckets[digit]] = places[of, k], rows[of, k]
            buckets[digit] += 1


@query_kernel
def _digit(place, shift):
    return np.int64((place >> shift) & np.uint32((1 << _BITS_A_PASS) - 1))


@query_kernel
def worst_of_leaves(leaves, planes, used, worst):
    """Write a lower bound of each leaf box's distance beyond the farthest of half-spaces n . x <= o to `worst`.

    worst (n,) float32 [m]; 0 or less: the box reaches into all. planes (used, 4) float32: n unit, o [m], relative to
    the leaves' middle.
    """
    n = len(leaves.entries) // LEAF
    values = leaves.values
    for k in range(n):
        worst[k] = np.float32(-1.0)
    for p in range(used):
        plane = planes[p]
        x = values[0:n] if plane[0] > 0.0 else values[3 * n : 4 * n]
        y = values[n : 2 * n] if plane[1] > 0.0 else values[4 * n : 5 * n]
        z = values[2 * n : 3 * n] if plane[2] > 0.0 else values[5 * n : 6 * n]
        _see_beyond(plane, x, y, z, n, worst)


@query_kernel
def _see_beyond(plane, x, y, z, count, worst):
    nx, ny, nz, offset = plane[0], plane[1], plane[2], plane[3]
    for k in range(count):
        beyond = nx * x[k] + ny * y[k] + nz * z[k] - offset
        worst[k] = beyond if beyond > worst[k] else worst[k]


@query_kernel
def worst_of_samples(leaves, planes, used, worst, looked_at, reaching):
    """Find the leaves that reach into all half-spaces, and how far each of their samples is beyond the farthest.

    worst: of worst_of_leaves, for the same planes. Writes these leaves to `reaching`, the places of their samples to
    looked_at[:3] (LEAF per leaf), and their distances [m], 0 or less if in all half-spaces, to looked_at[3]. Returns
    the number of leaves.
    """
    n = len(leaves.entries) // LEAF
    values, count = leaves.values, 0
    for leaf in range(n):
        if worst[leaf] > np.float32(0.0):
            continue
        reaching[count] = leaf
        for d in range(3):
            of, to = values[(6 + LEAF * d) * n + LEAF * leaf :], looked_at[d, LEAF * count :]
            for k in range(LEAF):
                to[k] = of[k]
        count += 1
    beyond = looked_at[3]
    for k in range(LEAF * count):
        beyond[k] = np.float32(-1.0)
    for p in range(used):
        _see_beyond(planes[p], looked_at[0], looked_at[1], looked_at[2], LEAF * count, beyond)
    return count


@query_kernel
def farthest_sample(leaves, direction, hint, bounds):
    """(place in `entries`, height [m]) of the sample farthest along a direction (x, y, z), a unit vector.

    The height is relative to the leaves' middle, in single precision. hint: a likely place; `bounds` (n,) float32:
    working space.
    """
    n = len(leaves.entries) // LEAF
    values = leaves.values
    nx, ny, nz = np.float32(direction[0]), np.float32(direction[1]), np.float32(direction[2])
    x = values[3 * n : 4 * n] if nx > 0.0 else values[0:n]
    y = values[4 * n : 5 * n] if ny > 0.0 else values[n : 2 * n]
    z = values[5 * n : 6 * n] if nz > 0.0 else values[2 * n : 3 * n]
    for k in range(n):
        bounds[k] = nx * x[k] + ny * y[k] + nz * z[k]
    at, best = hint, np.float32(-np.inf)
    if n:
        best = nx * values[6 * n + at] + ny * values[(6 + LEAF) * n + at] + nz * values[(6 + 2 * LEAF) * n + at]
    for leaf in range(n):
        if not bounds[leaf] > best:
            continue
        for k in range(LEAF * leaf, LEAF * leaf + LEAF):
            px, py, pz = values[6 * n + k], values[(6 + LEAF) * n + k], values[(6 + 2 * LEAF) * n + k]
            along = nx * px + ny * py + nz * pz
            if along > best:
                at, best = k, along
    return at, best


@query_kernel
def nearest_sample(leaves, x, y, z, bounds):
    """Upper bound [m] of the distance of the nearest sample from a point; infinity if there is none.

    (x, y, z) [m]: the point, relative to the leaves' middle; `bounds` (n,) float32: working space.
    """
    n = len(leaves.entries) // LEAF
    values = leaves.values
    px, py, pz, zero = np.float32(x), np.float32(y), np.float32(z), np.float32(0.0)
    for k in range(n):
        dx = max(values[k] - px, px - values[3 * n + k], zero)
        dy = max(values[n + k] - py, py - values[4 * n + k], zero)
        dz = max(values[2 * n + k] - pz, pz - values[5 * n + k], zero)
        bounds[k] = dx * dx + dy * dy + dz * dz
    first = 0
    for k in range(1, n):
        if bounds[k] < bounds[first]:
            first = k
    least = np.float32(np.inf)
    for turn in range(-1, n):
        leaf = turn if turn >= 0 else first
        if n == 0 or not bounds[leaf] < least or leaf == turn == first:
            continue
        for k in range(LEAF * leaf, LEAF * leaf + LEAF):
            dx, dy, dz = values[6 * n + k] - px, values[(6 + LEAF) * n + k] - py, values[(6 + 2 * LEAF) * n + k] - pz
            least = min(least, dx * dx + dy * dy + dz * dz)
    # the error of each coordinate has the bound of a projection onto a unit vector
    return math.sqrt(np.float64(least)) * (1.0 + SAMPLE_ROUNDING) + leaves.middle[3]


@query_kernel
def sample_about_middle(leaves, at):
    """(x, y, z) [m] of the sample at a place in `entries`, relative to the leaves' middle."""
    n = len(leaves.entries) // LEAF
    values = leaves.values
    return (
        np.float64(values[6 * n + at]), np.float64(values[(6 + LEAF) * n + at]),
        np.float64(values[(6 + 2 * LEAF) * n + at]),
    )  # fmt: skip
