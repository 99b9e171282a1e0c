"""Which tetrahedra a fracture concerns, and how each of them is cut: what all later passes of an update go by."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fracture_collision.core.cell_cut import cells_fill, clean_faces
from fracture_collision.core.compiled import inlined_kernel, kernel, query_kernel
from fracture_collision.core.cut_tetrahedron import CutScratch, make_cut_scratch
from fracture_collision.core.plain_cut import CELLS, LONE, MIXED, PlainScratch, kind_of_cut, make_plain_scratch
from fracture_collision.core.point_location import load_margins
from fracture_collision.core.surface_rows import MAX_SAMPLES, grow


class UpdateScratch(NamedTuple):
    """Working space of an update; its content never reaches an answer."""

    work: CutScratch
    behind: CutScratch
    near: CutScratch
    far: CutScratch
    plain: PlainScratch
    samples: np.ndarray  # (MAX_SAMPLES, 3) float64 [m]
    roots: np.ndarray  # (64,) float64


def make_update_scratch() -> UpdateScratch:
    return UpdateScratch(
        *(make_cut_scratch() for _ in range(4)), make_plain_scratch(), np.empty((MAX_SAMPLES, 3)), np.empty(64)
    )


class Touched(NamedTuple):
    """The tetrahedra that a fracture concerns, and what it finds out about them."""

    rows: np.ndarray  # int32: those with a node of the fragment, then their neighbours, then the neighbours of these
    own: int  # how many are of the first kind
    near: int  # of the first two
    first: int  # row of the mesh's first tetrahedron; the two arrays below begin there
    kinds: np.ndarray  # (m,) uint8, see plain_cut.py
    unclear: np.ndarray  # (m,) uint8: a bit for each face that may have a step (cell_cut.clean_faces)


@kernel
def tetrahedra_of_nodes(mesh, body, node_shift, first_node_row, first_tet, last_tet, nodes, fragment):
    """Touched of the fragment whose nodes are `nodes` (rows), all that carry the label `fragment`.

    first_tet .. last_tet - 1: the mesh's tetrahedra.
    """
    count = last_tet - first_tet
    seen = np.zeros(count, np.uint8)
    found = np.empty(count, dtype=np.int32)
    used = 0
    if 24 * len(nodes) > count:
        # most tetrahedra have one: reading all labels in order beats gathering
        for t in range(first_tet, last_tet):
            v = mesh.tetrahedra[t]
            own = False
            for i in range(4):
                own = own or body.node_fragment[v[i] + node_shift] == fragment
            if own:
                seen[t - first_tet] = 1
                found[used] = t
                used += 1
    else:
        for n in nodes:
            r = n + first_node_row
            for e in range(mesh.node_tets_begin[r], mesh.node_tets_begin[r + 1]):
                used = _note(mesh.node_tets[e], first_tet, seen, found, used)
    own = near = used
    if own < count:
        used = near = _note_neighbours(mesh, 0, own, first_tet, seen, found, used)
        used = _note_neighbours(mesh, own, near, first_tet, seen, found, used)
    return Touched(found[:used].copy(), own, near, first_tet, np.zeros(count, np.uint8), np.zeros(count, np.uint8))


@inlined_kernel
def _note_neighbours(mesh, first, last, first_tet, seen, found, used):
    for i in range(first, last):
        for face in range(4):
            n = mesh.neighbours[found[i], face]
            if n >= 0:
                used = _note(n, first_tet, seen, found, used)
    return used


@inlined_kernel
def _note(t, first_tet, seen, found, used):
    if seen[t - first_tet]:
        return used
    seen[t - first_tet] = 1
    found[used] = t
    return used + 1


@kernel
def tetrahedra_shared_by_three(mesh, body, node_shift, tets, low, high):
    """Those of `tets` that hold three or more fragments, one of them outside low .. high - 1."""
    found = np.empty(len(tets), dtype=np.int32)
    used = 0
    for t in tets:
        distinct = 0
        external = False
        for i in range(4):
            label = body.node_fragment[mesh.tetrahedra[t, i] + node_shift]
            external = external or label < low or label >= high
            new = True
            for j in range(i):
                if body.node_fragment[mesh.tetrahedra[t, j] + node_shift] == label:
                    new = False
            distinct += 1 if new else 0
        if external and distinct >= 3:
            found[used] = t
            used += 1
    return found[:used].copy()


@query_kernel
def classify(mesh, body, node_shift, edge_shift, touched, scratch):
    """Fill kinds and unclear of `touched`, for its rows; returns whether any is MIXED."""
    plain, work, first_tet, any_mixed = scratch.plain, scratch.work, touched.first, False
    for t in touched.rows:
        kind = kind_of_cut(mesh, body, node_shift, edge_shift, t, plain)
        if kind == MIXED:
            slots, clean = load_cut(mesh, body, node_shift, edge_shift, t, work), 0
            if cells_fill(slots, work):
                kind, clean = CELLS, clean_faces(slots, work)
            any_mixed = any_mixed or kind == MIXED
            for face in range(4):
                n = mesh.neighbours[t, face]
                if n >= 0 and (clean >> face) & 1 == 0:
                    behind = 0
                    while mesh.neighbours[n, behind] != t:
                        behind += 1
                    touched.unclear[t - first_tet] |= 1 << face
                    touched.unclear[n - first_tet] |= 1 << behind
        touched.kinds[t - first_tet] = kind
    return any_mixed


@inlined_kernel
def load_cut(mesh, body, node_shift, edge_shift, t, work):
    """Corners and margins of tetrahedron `t`; returns the number of slots."""
    for i in range(4):
        v = mesh.tetrahedra[t, i]
        for d in range(3):
            work.corners[i, d] = mesh.nodes[v, d]
    return load_margins(mesh, body, node_shift, edge_shift, t, work.labels, work.functionals, work.counts)


@kernel
def boxes_of_nodes(mesh, body, node_shift, nodes, boxes):
    """Grow the boxes (F, 6) of the fragments that hold `nodes` (rows)."""
    for n in nodes:
        p = mesh.nodes[n]
        grow(boxes[body.node_fragment[n + node_shift]], p[0], p[1], p[2])


@query_kernel
def mark_cells(mesh, k, body, node_shift, touched, low, high, cells, occupancy, held):
    """Set the level-0 cells of fragments low .. high - 1 (rows of `cells` (high - low, 7)) from their tetrahedra.

    held (cells of the mesh,) uint64, clear: working space, 64 fragments at a time.
    """
    one = np.uint64(1)
    ny, nz = mesh.grid_dims[k, 1], mesh.grid_dims[k, 2]
    for batch in range(low, high, 64):
        held[:] = 0
        for t in touched.rows[: touched.own]:
            mask = np.uint64(0)
            v = mesh.tetrahedra[t]
            for i in range(1 if touched.kinds[t - touched.first] == LONE else 4):
                label = body.node_fragment[v[i] + node_shift]
                if batch <= label < min(batch + 64, high):
                    mask |= one << np.uint64(label - batch)
            if mask:
                for e in range(mesh.tet_cells_begin[t + k], mesh.tet_cells_begin[t + k + 1]):
                    held[mesh.tet_cells[e]] |= mask
        for f in range(batch, min(batch + 64, high)):
            x0, y0, z0, nx, my, mz, at = cells[f - low]
            for i in range(x0, x0 + nx):
                for j in range(y0, y0 + my):
                    row = (i * ny + j) * nz
                    for l in range(z0, z0 + mz):  # noqa: E741
                        occupancy[at] = (held[row + l] >> np.uint64(f - batch)) & one
                        at += 1
