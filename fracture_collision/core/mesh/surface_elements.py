"""A fragment's surface in small, nearly flat pieces, for tests that must cover all of it.

An *element* is a fragment's surface within one tetrahedron of its mesh, a triangle of a rigid mesh, or a side of a box.
Its corners span it. Elements are made on first use and then stay unchanged: a fracture beside a fragment divides its
surface anew, but does not move it (cut_tetrahedron.py).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from fracture_collision.core.memory.compiled import inlined_kernel, kernel
from fracture_collision.core.memory.kinds import BOX, TRIANGLES, WITH_FACES
from fracture_collision.core.memory.pools import BACK_SIDE, FRONT_SIDE, NEVER_BROKEN, OWNER, ROW, GrowableArray, Pools
from fracture_collision.core.memory.rotations import to_other
from fracture_collision.core.mesh.cut_tetrahedron import FACE_VERTICES
from fracture_collision.core.mesh.point_location import region_holds
from fracture_collision.core.mesh.sample_numbers import FIRST_TETRAHEDRON

# Single-precision error bound of a corner, relative to the fragment's origin, as a share of the fragment's size.
CORNER_ROUNDING = 2e-7
# The sides of a box, 2 d at the lower end of axis d and 2 d + 1 at its upper one, by their corners, counter-clockwise
# from outside; bit d of a corner is its end along axis d.
_CORNERS_OF_SIDE = np.array([[0, 4, 6, 2], [1, 3, 7, 5], [0, 1, 5, 4], [2, 6, 7, 3], [0, 2, 3, 1], [4, 5, 7, 6]])
# Initial capacity for a fragment: elements, and corners per element.
_FIRST_ROOM, _CORNERS_EACH = 1024, 8
# No element has more corners: a tetrahedron has cut_tetrahedron.POINTS.
MOST_CORNERS = 24


class Elements(NamedTuple):
    """Elements of all fragments that have any, contiguous per fragment."""

    begin: np.ndarray  # (F,) int64 first element of a row of FragmentPool; -1: not made
    end: np.ndarray  # (F,) int64
    origin: np.ndarray  # (F, 3) float64 [m] in the body frame; the coordinates below are relative to it
    piece: np.ndarray  # (E,) int32: tetrahedron, triangle (rows of their pools) or side
    spheres: np.ndarray  # (E, 4) float32 [m]: centre and radius of a bounding ball
    first: np.ndarray  # (E + 1,) int32: first row of its corners
    corners: np.ndarray  # (C, 3) float32 [m]


class ElementTable:
    """Owns the arrays. Valid as long as no row of the pools is renumbered."""

    def __init__(self) -> None:
        self._begin, self._end = np.full(0, -1), np.full(0, -1)
        self._origin = np.zeros((0, 3))
        self._piece, self._spheres = GrowableArray(0, np.int32), GrowableArray(4, np.float32)
        self._first, self._corners = GrowableArray(0, np.int32), GrowableArray(3, np.float32)
        self._first.append(np.zeros(1, np.int32))

    def of(self, pools: Pools, rows: np.ndarray) -> Elements:
        """Elements of at least `rows` (n,) of FragmentPool; planes and spheres have none."""
        count = len(pools.fragment.kind)
        if len(self._begin) < count:
            more = count - len(self._begin)
            self._begin = np.concatenate([self._begin, np.full(more, -1)])
            self._end = np.concatenate([self._end, np.full(more, -1)])
            self._origin = np.concatenate([self._origin, np.zeros((more, 3))])
        for f in rows[self._begin[rows] < 0].tolist():
            self._make(pools, f)
        return Elements(
            self._begin, self._end, self._origin, self._piece.view, self._spheres.view, self._first.view,
            self._corners.view,
        )  # fmt: skip

    def _make(self, pools: Pools, f: int) -> None:
        kind, box = pools.fragment.kind[f], pools.fragment.box[f]
        self._begin[f] = self._end[f] = self._piece.used
        if kind not in WITH_FACES:
            return
        self._origin[f] = 0.5 * (box[:3] + box[3:])
        room = _FIRST_ROOM
        while True:
            piece, corners = np.empty(room, np.int32), np.empty((_CORNERS_EACH * room, 3), np.float32)
            first, spheres = np.empty(room, np.int32), np.empty((room, 4), np.float32)
            used, points = _elements_of(pools, f, self._origin[f], (piece, spheres, first, corners))
            if used <= room and points <= len(corners):
                break
            room = max(2 * room, used, points // _CORNERS_EACH + 1)
        self._piece.append(piece[:used])
        self._spheres.append(spheres[:used])
        self._first.append(first[:used] + np.int32(self._corners.used))
        self._corners.append(corners[:points])
        self._end[f] = self._piece.used


@kernel
def _elements_of(pools, f, origin, out):
    """Write the elements of fragment `f` to `out`, as far as capacity allows.

    origin (3,) [m]: the point that corners are relative to. out: see _put; first (n,) of it: end row of an element's
    corners. Returns (number of elements, number of their corners), which may exceed the capacity.
    """
    used, points, kind = 0, 0, pools.fragment.kind[f]
    work = np.empty((MOST_CORNERS, 3))
    if kind == BOX:
        half = pools.fragment.shape[f]
        for side in range(6):
            for k in range(4):
                _put_box_corner(half, _CORNERS_OF_SIDE[side, k], work[k])
            points = _put(origin, work, 4, side, (used, points), out)
            used += 1
        return used, points
    if kind == TRIANGLES:
        begin, end = pools.triangles.triangle_range[pools.fragment.mesh[f]]
        for t in range(begin, end):
            c = pools.triangles.corners[t]
            count = _add_triangle(c[0:3], c[3:6], c[6:9], work, 0)
            points = _put(origin, work, count, t, (used, points), out)
            used += 1
        return used, points
    mesh, cells, k = pools.mesh, pools.fragment.cells[f], pools.fragment.mesh[f]
    _, ny, nz, first_cell = mesh.grid_dims[k]
    first_tet = mesh.first[k, FIRST_TETRAHEDRON]
    last_tet = mesh.first[k + 1, FIRST_TETRAHEDRON] if k + 1 < len(mesh.first) else len(mesh.tetrahedra)
    is_seen = np.zeros(last_tet - first_tet, np.bool_)
    for i in range(cells[3]):
        for j in range(cells[4]):
            for l in range(cells[5]):  # noqa: E741
                if not pools.occupancy[cells[6] + (i * cells[4] + j) * cells[5] + l]:
                    continue
                c = first_cell + ((i + cells[0]) * ny + j + cells[1]) * nz + l + cells[2]
                for e in range(mesh.cell_begin[c], mesh.cell_begin[c + 1]):
                    t = mesh.cell_tets[e]
                    if is_seen[t - first_tet]:
                        continue
                    is_seen[t - first_tet] = True
                    count = _corners_in(pools, f, t, work)
                    if count:
                        points = _put(origin, work, count, t, (used, points), out)
                        used += 1
    return used, points


@inlined_kernel
def _corners_in(pools, f, t, work):
    """Write the corners of f's surface in tetrahedron `t`, each once, to `work`; returns their number."""
    mesh, body, shift, count = pools.mesh, pools.body, pools.fragment.tet_shift[f], 0
    alone = f
    if shift != NEVER_BROKEN:
        if not region_holds(body.regions[t + shift], f):
            return 0
        alone = body.regions[t + shift, OWNER]
    if alone >= 0:
        v = mesh.tetrahedra[t]
        for face in range(4):
            if mesh.neighbours[t, face] < 0:
                w = FACE_VERTICES[face]
                count = _add_triangle(mesh.nodes[v[w[0]]], mesh.nodes[v[w[1]]], mesh.nodes[v[w[2]]], work, count)
    if shift == NEVER_BROKEN:
        return count
    begin = body.regions[t + shift, ROW]
    for i in range(begin, begin + body.cut_count[t + shift]):
        if _has_triangle(body, i, f):
            c = body.triangles[i]
            count = _add_triangle(c[0:3], c[3:6], c[6:9], work, count)
    return count


@inlined_kernel
def _has_triangle(body, i, f):
    """Whether a row of body.triangles belongs to f's surface; one without a plane is degenerate by rounding."""
    return (body.sides[i, FRONT_SIDE] == f or body.sides[i, BACK_SIDE] == f) and not math.isnan(body.faces[i, 3])


@inlined_kernel
def count_triangles(pools, f, piece):
    """Upper bound of the number of f's triangles in an element: the range of `k` in put_triangle."""
    kind = pools.fragment.kind[f]
    if kind == BOX:
        return 2
    if kind == TRIANGLES:
        return 1
    shift = pools.fragment.tet_shift[f]
    return 4 if shift == NEVER_BROKEN else 4 + pools.body.cut_count[piece + shift]


@inlined_kernel
def put_triangle(pools, f, piece, k, rotation, translation, out):
    """Write the corners of the k-th triangle of an element, transformed to another frame, to out (9,) [m].

    Corners are counter-clockwise from outside; rotation (3, 3), translation (3,) [m]: to that frame. Returns whether
    the triangle exists.
    """
    kind = pools.fragment.kind[f]
    if kind == TRIANGLES:
        c = pools.triangles.corners[piece]
        _put_moved(rotation, translation, c[0:3], c[3:6], c[6:9], out)
        return True
    if kind == BOX:
        half, corners = pools.fragment.shape[f], _CORNERS_OF_SIDE[piece]
        for i in range(3):
            _put_box_corner(half, corners[0 if i == 0 else i + k], out[3 * i : 3 * i + 3])
        _put_moved(rotation, translation, out[0:3], out[3:6], out[6:9], out)
        return True
    mesh, body, shift = pools.mesh, pools.body, pools.fragment.tet_shift[f]
    if k < 4:
        if mesh.neighbours[piece, k] >= 0 or (shift != NEVER_BROKEN and body.regions[piece + shift, OWNER] != f):
            return False
        v, w = mesh.tetrahedra[piece], FACE_VERTICES[k]
        _put_moved(rotation, translation, mesh.nodes[v[w[0]]], mesh.nodes[v[w[1]]], mesh.nodes[v[w[2]]], out)
        return True
    i = body.regions[piece + shift, ROW] + k - 4
    if not _has_triangle(body, i, f):
        return False
    c = body.triangles[i]
    if body.sides[i, FRONT_SIDE] == f:
        _put_moved(rotation, translation, c[0:3], c[3:6], c[6:9], out)
    else:
        _put_moved(rotation, translation, c[0:3], c[6:9], c[3:6], out)
    return True


@inlined_kernel
def _put_moved(rotation, translation, p, q, r, out):
    out[0], out[1], out[2] = to_other(rotation, translation, p[0], p[1], p[2])
    out[3], out[4], out[5] = to_other(rotation, translation, q[0], q[1], q[2])
    out[6], out[7], out[8] = to_other(rotation, translation, r[0], r[1], r[2])


@inlined_kernel
def _put_box_corner(half, bits, out):
    for d in range(3):
        out[d] = half[d] if (bits >> d) & 1 else -half[d]


@inlined_kernel
def _add_triangle(p, q, r, work, count):
    count = _add_corner(p, work, count)
    count = _add_corner(q, work, count)
    return _add_corner(r, work, count)


@inlined_kernel
def _add_corner(p, work, count):
    for k in range(count):
        if work[k, 0] == p[0] and work[k, 1] == p[1] and work[k, 2] == p[2]:
            return count
    work[count, 0], work[count, 1], work[count, 2] = p[0], p[1], p[2]
    return count + 1


@inlined_kernel
def _put(origin, work, count, number, at, out):
    """Write an element from the first `count` rows of `work`, if there is room; returns the corner total.

    at: which element, and the corner total before it; out: piece, spheres, first and corners of Elements.
    """
    used, points = at
    piece, spheres, first, corners = out
    if used < len(piece) and points + count <= len(corners):
        piece[used], first[used] = number, points + count
        for d in range(3):
            low = high = work[0, d]
            for k in range(1, count):
                low, high = min(low, work[k, d]), max(high, work[k, d])
            spheres[used, d] = 0.5 * (low + high) - origin[d]
        radius = 0.0
        for k in range(count):
            away = 0.0
            for d in range(3):
                corners[points + k, d] = work[k, d] - origin[d]
                away += (work[k, d] - origin[d] - np.float64(spheres[used, d])) ** 2
            radius = max(radius, math.sqrt(away))
        spheres[used, 3] = radius * (1.0 + CORNER_ROUNDING)
    return points + count
