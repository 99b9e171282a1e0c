"""The ridges of fragments: convex edges of their surface, which can cross another's between samples.

They are computed when a fragment is made and do not change: fracture beside a fragment divides its surface anew, but
does not move it (cut_tetrahedron.py). So a ridge keeps its number for as long as its fragment lives.
"""

from __future__ import annotations

import math
from typing import Annotated

import numpy as np

from fracture_collision.core.memory.compiled import kernel, query_kernel
from fracture_collision.core.memory.pools import FRAGMENT, LEAF, Pools
from fracture_collision.core.memory.struct import Struct
from fracture_collision.core.memory.tables import Column, Table
from fracture_collision.core.memory.vectors import (
    area_vector,
    corners_of,
    cross,
    divided,
    dot,
    hash_of,
    length,
    minus,
    plus,
    vector_at,
)
from fracture_collision.core.samples.sample_leaves import place_on_curve

# Minimum turn of the surface at a ridge (chord of the angle), and minimum length as a share of R: where flatter or
# shorter ones cross, samples beside them are about as deep.
LEAST_TURN, LEAST_LENGTH = 0.06, 1e-4
# Ridges that turn by less, as between the triangles of a fine mesh, have leaves of their own: they matter to few.
SMOOTH = 0.12
# Columns of Ridges.rows, three each except for the last two.
BEGIN, END = 0, 3  # its ends [m]
FIRST_FACE, SECOND_FACE = 6, 9  # unit vectors across it into its two faces
OUTWARD = 12  # unit, half-way between the normals of these
LENGTH, TURN = 15, 16  # [m]; chord of the angle between these normals, 2 where the faces fold back
RIDGE = 17
# Columns of `lines`, for each ridge of a leaf: begin [m], direction, and as above.
LINE_BEGIN, ALONG, LINE_LENGTH, LINE_TURN, LINE = 0, 3, 6, 7, 8
_FIRST_ROOM = 4096
_MORE_THAN_EDGES = 2  # places of the hash table for each edge


RIDGE_LEAF = "ridge leaf"


class Ridges(Struct):
    """Ridges of all fragments, those of one together, sorted along a curve, eight to a leaf as in sample_leaves.py."""

    first: Annotated[np.ndarray, Column(FRAGMENT, np.int64, 0, RIDGE_LEAF)]  # first leaf of a fragment
    count: Annotated[np.ndarray, Column(FRAGMENT, np.int64)]  # how many it has
    # body frame; rows that pad a last leaf are not counted
    rows: Annotated[np.ndarray, Column(RIDGE_LEAF, np.float64, LEAF * RIDGE, shape=(-1, RIDGE))]
    # [m] of leaves as in sample_leaves.Leaves, about the fragment's `middle`
    boxes: Annotated[np.ndarray, Column(RIDGE_LEAF, np.float32, 6, shape=(-1,))]
    most: Annotated[np.ndarray, Column(RIDGE_LEAF, np.float32, 2)]  # the greatest length [m] and turn in each leaf
    # ridges of each leaf, likewise; single precision
    lines: Annotated[np.ndarray, Column(RIDGE_LEAF, np.float32, LINE * LEAF, shape=(-1, LINE, LEAF))]


NO_RIDGES = Table(Ridges).view


def append_ridges(table: Table[Ridges], pools: Pools, first: int, triangles: np.ndarray, begin: np.ndarray) -> None:
    """Add the ridges of the fragments from row `first` on, which were made last, by their triangles_of."""
    fragment, end = pools.fragment, first + len(begin) - 1
    counts, leaves, *columns = ridges_of(triangles, begin, fragment.radius[first:end], fragment.middle[first:end])
    table["first"].append(table["rows"].used + leaves[:-1])
    table["count"].append(counts)
    for name, values in zip(("rows", "boxes", "most", "lines"), columns, strict=True):
        table[name].append(values.reshape(leaves[-1], *table[name].view.shape[1:]))


@kernel
def ridges_of(triangles, begin, radii, middles):
    """Of fragments with triangles begin[k] .. begin[k + 1]: counts, first leaves, and columns of Ridges.

    radii (k,) [m], middles (k, 4): see FragmentPool. First leaves (k + 1,) include the end.
    """
    fragments, used, found = len(begin) - 1, 0, np.empty((_FIRST_ROOM, RIDGE))
    counts, leaves = np.empty(fragments, np.int64), np.zeros(fragments + 1, np.int64)
    for k in range(fragments):
        own = triangles[begin[k] : begin[k + 1]]
        counts[k] = find_ridges(own, radii[k], found[used:])
        if counts[k] > len(found) - used:
            found = np.vstack((found[:used], np.empty((used + 2 * counts[k], RIDGE))))
            find_ridges(own, radii[k], found[used:])
        used += counts[k]
        leaves[k + 1] = leaves[k] - (-counts[k] // LEAF)
    n, at = leaves[-1], 0
    rows, boxes, most, lines = (
        np.empty((LEAF * n, RIDGE)), np.empty(6 * n, np.float32), np.empty((n, 2), np.float32),
        np.empty((n, LINE, LEAF), np.float32),
    )  # fmt: skip
    for k in range(fragments):
        i, j = leaves[k], leaves[k + 1]
        _put_on_curve(
            found[at:], counts[k], middles[k], rows[LEAF * i : LEAF * j], boxes[6 * i : 6 * j], most[i:j], lines[i:j]
        )
        at += counts[k]
    return counts, leaves, rows, boxes, most, lines


@kernel
def find_ridges(triangles, radius, out):
    """Write the ridges of a surface as rows to out (n, RIDGE), as far as there is room; returns their total number.

    triangles (t, 9) [m]: corners, counter-clockwise from outside; radius [m]: R of the fragment.

    Triangles of a surface share whole edges, whose ends are equal to the last bit in both; they are matched by a hash
    of these. An edge of one triangle alone borders a triangle lost to rounding, and is left out.
    """
    edges = 3 * len(triangles)
    places = 16
    while places < _MORE_THAN_EDGES * edges:
        places *= 2
    seen_at = np.full(places, -1, np.int32)
    # ends, across it into the face, normal of the face
    seen, is_open = np.empty((edges, 12)), np.ones(edges, np.bool_)
    count, used = 0, 0
    for c in triangles:
        n = area_vector(corners_of(c))
        area = length(n)
        if not area > 0.0:
            continue
        n = divided(n, area)
        for i in range(3):
            p, q = vector_at(c, 3 * i), vector_at(c, 3 * ((i + 1) % 3))
            size = length(minus(q, p))
            if not size > 0.0:
                continue
            inward = cross(n, divided(minus(q, p), size))
            place = hash_of(plus(p, q)) & (places - 1)
            while seen_at[place] >= 0 and not (
                is_open[seen_at[place]] and _is_reverse(seen[seen_at[place]], p, q)
            ):
                place = (place + 1) & (places - 1)
            if seen_at[place] < 0:
                seen_at[place], r = count, seen[count]
                r[0], r[1], r[2] = p
                r[3], r[4], r[5] = q
                r[6], r[7], r[8] = inward
                r[9], r[10], r[11] = n
                count += 1
                continue
            r = seen[seen_at[place]]
            is_open[seen_at[place]] = False
            turn = math.sqrt(max(2.0 * (1.0 + inward[0] * r[6] + inward[1] * r[7] + inward[2] * r[8]), 0.0))
            falls_away = dot(inward, vector_at(r, 9)) < 0.0
            if not falls_away or turn < LEAST_TURN or size < LEAST_LENGTH * radius:
                continue
            if used < len(out):
                row = out[used]
                for d in range(9):
                    row[d] = r[d]
                row[9], row[10], row[11] = inward
                # where the faces fold back there is no half-way normal
                outward = minus(minus(plus(vector_at(r, 9), n), vector_at(r, 6)), inward)
                row[12], row[13], row[14] = divided(outward, length(outward))
                row[LENGTH], row[TURN] = size, turn
            used += 1
    return used


@query_kernel
def _is_reverse(row, p, q):
    return vector_at(row, 0) == q and vector_at(row, 3) == p


@kernel
def _put_on_curve(found, count, middle, rows, boxes, most, lines):
    """Sort ridges along a curve, the smooth ones last, and write the data of their leaves.

    found (count, RIDGE): the ridges; middle (4,): see Leaves. Writes rows (LEAF n, RIDGE) and, for the n leaves, boxes
    (6 n,), most and lines, see Ridges.
    """
    n = len(rows) // LEAF
    low, high, point = np.full(3, np.inf), np.full(3, -np.inf), np.empty(3)
    for k in range(count):
        for d in range(3):
            m = 0.5 * (found[k, d] + found[k, 3 + d])
            low[d], high[d] = min(low[d], m), max(high[d], m)
    places = np.empty(count, np.int64)
    for k in range(count):
        for d in range(3):
            point[d] = 0.5 * (found[k, d] + found[k, 3 + d])
        places[k] = np.int64(place_on_curve(point, low, high)) | (np.int64(found[k, TURN] < SMOOTH) << 40)
    order = np.argsort(places, kind="mergesort")
    for k in range(LEAF * n):
        rows[k] = found[order[min(k, count - 1)]]
        leaf, lane = k // LEAF, k % LEAF
        length, turn = np.float32(rows[k, LENGTH]), np.float32(rows[k, TURN])
        lines[leaf, LINE_LENGTH, lane], lines[leaf, LINE_TURN, lane] = length, turn
        most[leaf, 0] = max(most[leaf, 0], length) if lane else length
        most[leaf, 1] = max(most[leaf, 1], turn) if lane else turn
        for d in range(3):
            p, q = np.float32(rows[k, d] - middle[d]), np.float32(rows[k, 3 + d] - middle[d])
            lines[leaf, LINE_BEGIN + d, lane] = p
            lines[leaf, ALONG + d, lane] = (rows[k, 3 + d] - rows[k, d]) / rows[k, LENGTH]
            low_end, high_end = min(p, q), max(p, q)
            if lane:
                low_end = min(low_end, boxes[n * d + leaf])
                high_end = max(high_end, boxes[n * (3 + d) + leaf])
            boxes[n * d + leaf], boxes[n * (3 + d) + leaf] = low_end, high_end
