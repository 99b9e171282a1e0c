"""The ridges of fragments: convex edges of their surface, which can cross another's between samples.

They are computed when a fragment is made and do not change: fracture beside a fragment divides its surface anew, but
does not move it (cut_tetrahedron.py). So a ridge keeps its number for as long as its fragment lives.
"""

from __future__ import annotations

import math
from typing import Annotated

import numpy as np

from fracture_collision.core.memory.compiled import kernel
from fracture_collision.core.memory.pools import FRAGMENT, LEAF, Pools
from fracture_collision.core.memory.struct import Struct
from fracture_collision.core.memory.tables import Column, Table
from fracture_collision.core.memory.vectors import cross, divided, dot, length, minus, plus, vector
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


def append_ridges(table: Table[Ridges], pools: Pools, first: int, surface: tuple, ends: np.ndarray) -> None:
    """Add the ridges of the fragments from row `first` on, which were made last.

    surface: corners, triangles, normals, convex edges and the triangles beside these, see patches/surface.py, of all of
    them; ends (k, 3): of each one's corners, triangles and edges in these.
    """
    fragment, end = pools.fragment, first + len(ends)
    counts, leaves, *columns = ridges_of(surface, ends, fragment.radius[first:end], fragment.middle[first:end])
    table["first"].append(table["rows"].used + leaves[:-1])
    table["count"].append(counts)
    for name, values in zip(("rows", "boxes", "most", "lines"), columns, strict=True):
        table[name].append(values.reshape(leaves[-1], *table[name].view.shape[1:]))


@kernel
def ridges_of(surface, ends, radii, middles):
    """Of k fragments: counts, first leaves, and columns of Ridges; surface, ends: see append_ridges.

    radii (k,) [m], middles (k, 4): see FragmentPool. First leaves (k + 1,) include the end.
    """
    corners, triangles, normals, edges, beside = surface
    found, used = np.empty((len(edges), RIDGE)), 0
    fragments, begin = len(ends), np.zeros(3, np.int64)
    counts, leaves = np.empty(fragments, np.int64), np.zeros(fragments + 1, np.int64)
    for k in range(fragments):
        end = ends[k]
        counts[k] = _put_ridges(
            corners[begin[0] : end[0]], normals[begin[1] : end[1]], edges[begin[2] : end[2]],
            beside[begin[2] : end[2]], radii[k], found[used:],
        )  # fmt: skip
        used, begin = used + counts[k], end
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
def _put_ridges(corners, normals, edges, beside, radius, out):
    """Write those convex edges of a surface that are ridges to out (n, RIDGE); returns their number.

    radius [m]: R of the fragment. An edge of one triangle alone borders one lost to rounding, and is left out.
    """
    used = 0
    for e in range(len(edges)):
        if beside[e, 0] == beside[e, 1]:
            continue
        p, q = vector(corners, edges[e, 0]), vector(corners, edges[e, 1])
        one, other = vector(normals, beside[e, 0]), vector(normals, beside[e, 1])
        size = length(minus(q, p))
        first, second = cross(one, divided(minus(q, p), size)), cross(other, divided(minus(p, q), size))
        turn = math.sqrt(max(2.0 * (1.0 + second[0] * first[0] + second[1] * first[1] + second[2] * first[2]), 0.0))
        if not dot(second, one) < 0.0 or turn < LEAST_TURN or size < LEAST_LENGTH * radius:
            continue
        row = out[used]
        row[0], row[1], row[2] = p
        row[3], row[4], row[5] = q
        row[6], row[7], row[8] = first
        row[9], row[10], row[11] = second
        # where the faces fold back there is no half-way normal
        outward = minus(minus(plus(one, other), first), second)
        row[12], row[13], row[14] = divided(outward, length(outward))
        row[LENGTH], row[TURN] = size, turn
        used += 1
    return used


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
