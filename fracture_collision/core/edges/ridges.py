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
    room = np.empty((_FIRST_ROOM, RIDGE))
    for k in range(len(begin) - 1):
        f, its = first + k, triangles[begin[k] : begin[k + 1]]
        count = find_ridges(its, pools.fragment.radius[f], room)
        if count > len(room):
            room = np.empty((2 * count, RIDGE))
            find_ridges(its, pools.fragment.radius[f], room)
        leaves = -(-count // LEAF)
        rows, boxes, most, lines = (table[name].reserve(leaves) for name in ("rows", "boxes", "most", "lines"))
        _put_on_curve(
            room, count, pools.fragment.middle[f], rows.reshape(-1, RIDGE), boxes.reshape(-1), most,
            lines.reshape(-1, LINE, LEAF),
        )  # fmt: skip
        table["first"].append(np.array([table["rows"].advance(leaves)]))
        for name in ("boxes", "most", "lines"):
            table[name].advance(leaves)
        table["count"].append(np.array([count]))


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
        nx, ny, nz, length = _normal(c)
        if not length > 0.0:
            continue
        for i in range(3):
            p, q = c[3 * i : 3 * i + 3], c[3 * ((i + 1) % 3) : 3 * ((i + 1) % 3) + 3]
            tx, ty, tz = q[0] - p[0], q[1] - p[1], q[2] - p[2]
            length = math.sqrt(tx * tx + ty * ty + tz * tz)
            if not length > 0.0:
                continue
            tx, ty, tz = tx / length, ty / length, tz / length
            x, y, z = ny * tz - nz * ty, nz * tx - nx * tz, nx * ty - ny * tx
            place = _hash(p[0] + q[0], p[1] + q[1], p[2] + q[2]) & (places - 1)
            while seen_at[place] >= 0 and not (
                is_open[seen_at[place]] and _is_reverse(seen[seen_at[place]], p, q)
            ):
                place = (place + 1) & (places - 1)
            if seen_at[place] < 0:
                seen_at[place], r = count, seen[count]
                for d in range(3):
                    r[d], r[3 + d] = p[d], q[d]
                r[6], r[7], r[8], r[9], r[10], r[11] = x, y, z, nx, ny, nz
                count += 1
                continue
            r = seen[seen_at[place]]
            is_open[seen_at[place]] = False
            turn = math.sqrt(max(2.0 * (1.0 + x * r[6] + y * r[7] + z * r[8]), 0.0))
            falls_away = x * r[9] + y * r[10] + z * r[11] < 0.0
            if not falls_away or turn < LEAST_TURN or length < LEAST_LENGTH * radius:
                continue
            if used < len(out):
                row = out[used]
                for d in range(9):
                    row[d] = r[d]
                row[9], row[10], row[11] = x, y, z
                # where the faces fold back there is no half-way normal
                ox, oy, oz = r[9] + nx - r[6] - x, r[10] + ny - r[7] - y, r[11] + nz - r[8] - z
                far = math.sqrt(ox * ox + oy * oy + oz * oz)
                row[12], row[13], row[14] = ox / far, oy / far, oz / far
                row[LENGTH], row[TURN] = length, turn
            used += 1
    return used


@query_kernel
def _normal(c):
    """Unit normal (x, y, z) of a triangle (9,), and its length before normalisation."""
    ux, uy, uz = c[3] - c[0], c[4] - c[1], c[5] - c[2]
    vx, vy, vz = c[6] - c[0], c[7] - c[1], c[8] - c[2]
    nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    length = math.sqrt(nx * nx + ny * ny + nz * nz)
    return nx / length, ny / length, nz / length, length


@query_kernel
def _is_reverse(row, p, q):
    return (
        row[0] == q[0] and row[1] == q[1] and row[2] == q[2] and row[3] == p[0] and row[4] == p[1] and row[5] == p[2]
    )


@query_kernel
def _hash(x, y, z):
    h = _bits(x) * 0x1F7B1EA1 ^ _bits(y) * 0x2545F491 ^ _bits(z) * 0x5851F42D
    h = (h ^ (h >> 33)) * 0x62A9D9ED799705F5
    return h ^ (h >> 29)


@query_kernel
def _bits(x):
    """Bits of a number; both zeros have the same."""
    return np.float64(x + 0.0).view(np.int64)


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
