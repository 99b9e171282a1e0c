"""A fragment's surface as closed, oriented triangles with shared vertices: for viewers and files, not for queries.

The triangles that queries measure against leave out what has no area by rounding, so that others end in the middle of
their sides. Here a tetrahedron is divided by its labels alone (cut_patterns.py), and vertices are identified by the
node, edge, face or tetrahedron that they belong to, not by their place. So neighbours agree on the sides of their
triangles whatever the planes are, and each side belongs to two triangles.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fracture_collision.core.fracture.cut_hub import load_crossings
from fracture_collision.core.fracture.cut_loading import load_pattern
from fracture_collision.core.fracture.cut_patterns import (
    FAN,
    FAN_COUNT,
    PART_OF_SIDE,
    PIECE_COUNT,
    PIECES,
    SECTION,
    SECTION_COUNT,
    WHOLE,
)
from fracture_collision.core.fracture.surface_rows import Broken
from fracture_collision.core.memory.compiled import kernel, query_kernel
from fracture_collision.core.memory.pools import FANNED, NEVER_BROKEN, OWNER, ROW, Pools
from fracture_collision.core.mesh.cut_tetrahedron import (
    CROSSING,
    FACE_POINT,
    HUB,
    POINTS,
    make_cut_scratch,
)
from fracture_collision.geometry.unique_rows import unique_rows

# Initial capacity in triangles; a fragment that has more is collected again.
FIRST_ROOM = 4096


class _Triangles(NamedTuple):
    """Triangles as they are found, as far as there is room."""

    corners: np.ndarray  # (n, 3, 3) float64 [m]
    keys: np.ndarray  # (n, 3) float64: integers, equal for corners that are one vertex
    is_crack: np.ndarray  # (n,) bool


def closed_surface(pools: Pools, row: int, tets: range) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Vertices (n, 3) [m], triangles (t, 3), counter-clockwise from outside, and is_crack (t,) of a fragment.

    `row`, of tetrahedra; `tets`: the rows of its body's mesh. Vertices may have the same place.
    """
    fragment = pools.fragment
    shifts = int(fragment.node_shift[row]), int(fragment.tet_shift[row]), int(fragment.edge_shift[row])
    broken = Broken(row, row, row + 1, int(fragment.mesh[row]), *shifts)
    scratch, key = make_cut_scratch(), np.zeros(POINTS, np.int64)
    room, count = 0, FIRST_ROOM
    while count > room:
        room = count
        out = _Triangles(np.empty((room, 3, 3)), np.empty((room, 3)), np.empty(room, np.bool_))
        count = _collect(pools, broken, tets.start, tets.stop, out, scratch, key)
    chosen, index = unique_rows(out.keys[:count].reshape(-1, 1))
    return out.corners[:count].reshape(-1, 3)[chosen], index.reshape(-1, 3), out.is_crack[:count]


@kernel
def _collect(pools, broken, first_tet, last_tet, out, work, key):
    """Write the triangles of fragment broken.parent to `out`, as far as it has room; returns their total number."""
    mesh, body, f = pools.mesh, pools.body, broken.parent
    used = 0
    for t in range(first_tet, last_tet):
        pattern = WHOLE
        if broken.tet_shift != NEVER_BROKEN:
            pattern = load_pattern(mesh, body, broken, t, work)
            if f not in (work.labels[0], work.labels[1], work.labels[2], work.labels[3]):
                continue
        else:
            for i in range(4):
                work.labels[i] = f
                work.points[i] = mesh.nodes[mesh.tetrahedra[t, i]]
        _set_keys(mesh, t, key)
        if pattern != WHOLE:
            load_crossings(mesh, body, broken.edge_shift, t, pattern, work)
            if body.regions[t + broken.tet_shift, OWNER] == FANNED:
                _load_stored(body, body.regions[t + broken.tet_shift, ROW], pattern, work)
                used = _add_fan(pattern, f, work, key, out, used)
            else:
                used = _add_section(f, work, key, out, used)
        for face in range(4):
            if mesh.neighbours[t, face] < 0:
                for k in range(PIECE_COUNT[pattern, face]):
                    row = PIECES[pattern, face, k]
                    if work.labels[row[4]] == f:
                        used = _add(work, key, (row[0], row[1], row[2]), False, out, used)
    return used


@query_kernel
def _set_keys(mesh, t, key):
    """Set the identities of all points of a tetrahedron; a face's is one of two tetrahedra, the smaller one's."""
    edges, faces = len(mesh.nodes), len(mesh.nodes) + len(mesh.edges)
    for i in range(4):
        key[i] = mesh.tetrahedra[t, i]
        other, face = mesh.neighbours[t, i], i
        owner = t
        if 0 <= other < t:
            owner = other
            for j in range(4):
                if mesh.neighbours[other, j] == t:
                    face = j
        key[FACE_POINT + i] = faces + 4 * np.int64(owner) + face
    for e in range(6):
        key[CROSSING + e] = edges + mesh.tetrahedron_edges[t, e]
    key[HUB] = faces + 4 * np.int64(len(mesh.tetrahedra)) + t


@query_kernel
def _load_stored(body, first, pattern, work):
    """Load hub and face points of a tetrahedron from its polygons, rows of `body` from `first` on."""
    for d in range(3):
        work.hub[d] = body.triangles[first, d]
    for k in range(FAN_COUNT[pattern]):
        point = FAN[pattern, k, 0]
        if point >= FACE_POINT:
            for d in range(3):
                work.points[point, d] = body.triangles[first + k, 3 + d]


@query_kernel
def _add_fan(pattern, f, work, key, out, used):
    for k in range(FAN_COUNT[pattern]):
        row = FAN[pattern, k]
        if work.labels[row[3]] == f:
            used = _add(work, key, (HUB, np.int64(row[0]), np.int64(row[1])), True, out, used)
        elif work.labels[row[4]] == f:
            used = _add(work, key, (HUB, np.int64(row[1]), np.int64(row[0])), True, out, used)
    return used


@query_kernel
def _add_section(f, work, key, out, used):
    side = 0
    for i in range(4):
        side += (work.labels[i] == f) << i
    for k in range(SECTION_COUNT[side]):
        a, b, c = SECTION[side, k]
        if PART_OF_SIDE[side] == 1:
            b, c = c, b
        used = _add(work, key, (a, b, c), True, out, used)
    return used


@query_kernel
def _add(work, key, points, is_crack, out, used):
    """Append a triangle of three points of the tetrahedron; returns the number of triangles."""
    if used < len(out.is_crack):
        for i in range(3):
            out.keys[used, i] = key[points[i]]
            for d in range(3):
                out.corners[used, i, d] = work.points[points[i], d]
        out.is_crack[used] = is_crack
    return used + 1
