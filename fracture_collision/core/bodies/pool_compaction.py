"""Garbage collection of the pools: drops rows that no living fragment refers to and closes the gaps.

Rows keep their order, so that nothing that depends on it changes: an answer has the same bytes before and after. The
cost is one copy of the pools; called when they have doubled, it is constant per byte appended.
"""

from __future__ import annotations

import numpy as np

from fracture_collision.core.bodies.pool_tables import PoolTables
from fracture_collision.core.edges.ridges import RIDGE_LEAF
from fracture_collision.core.memory.kinds import TETRAHEDRA, TRIANGLES
from fracture_collision.core.memory.pools import (
    BODY_EDGE,
    BODY_NODE,
    BODY_TETRAHEDRON,
    CELL,
    CELL_TETRAHEDRON,
    CUT_PLANE,
    EDGE,
    FRAGMENT,
    LEAF,
    MESH,
    NEVER_BROKEN,
    NODE,
    NODE_BEGIN,
    NODE_TETRAHEDRON,
    POLYGON,
    PSEUDONORMAL,
    ROW,
    SAMPLE,
    SAMPLE_LEAF,
    SEED,
    SEED_PAIR,
    SURFACE,
    TETRAHEDRON,
    TREE_NODE,
    TRIANGLE,
    WORD,
)
from fracture_collision.core.memory.tables import Moves, Table, moves_of, moves_of_ranges
from fracture_collision.core.mesh.occupancy import ends_of_pyramids
from fracture_collision.core.mesh.sample_numbers import EDGES, FIRST_EDGE, FIRST_NODE, FIRST_TETRAHEDRON, NODES
from fracture_collision.core.patches.shapes import OF_ROWS

# Columns of FragmentPool that lead from a mesh's rows to those of a body, their rows, and where the mesh's begin.
_SHIFTS = (
    ("node_shift", BODY_NODE, FIRST_NODE), ("tet_shift", BODY_TETRAHEDRON, FIRST_TETRAHEDRON),
    ("edge_shift", BODY_EDGE, FIRST_EDGE),
)  # fmt: skip


def compact(tables: PoolTables, rows: np.ndarray) -> dict[str, Moves]:
    """Keep fragments `rows` (n,), ascending, and what they refer to; returns the Moves of all rows."""
    moves: dict[str, Moves] = {}
    fragment = tables.fragment
    stays = np.zeros(fragment["kind"].used, bool)
    stays[rows] = True
    moves[FRAGMENT] = moves_of(stays)
    _move_meshes(tables, rows, moves)
    _move_surfaces(tables, rows, moves)
    bodies = _one_row_of_each_broken_body(tables, rows)
    _move_bodies(tables, bodies, moves)
    _move_what_fragments_own(tables, rows, bodies, moves)

    kind, mesh = fragment["kind"].view[rows], fragment["mesh"].view[rows]
    is_broken = fragment["node_shift"].view[rows] != NEVER_BROKEN
    at_mesh = tables.mesh["first"].view[mesh[is_broken]].astype(np.int64)
    begins = [fragment[name].view[rows[is_broken]] + at_mesh[:, first] for name, _, first in _SHIFTS]
    tables.all.move(moves)
    for of, number in ((TETRAHEDRA, MESH), (TRIANGLES, SURFACE)):
        fragment["mesh"].view[kind == of] = moves[number].of(mesh[kind == of])
    at_mesh = tables.mesh["first"].view[fragment["mesh"].view[is_broken]]
    for begin, (name, body_rows, first) in zip(begins, _SHIFTS, strict=True):
        fragment[name].view[is_broken] = moves[body_rows].of(begin) - at_mesh[:, first]
    return moves


def _one_row_of_each_broken_body(tables: PoolTables, rows: np.ndarray) -> np.ndarray:
    """One of `rows` per broken body (b,): fragments of one body share their node_shift and their mesh."""
    shift, mesh = tables.fragment["node_shift"].view[rows], tables.fragment["mesh"].view[rows]
    broken = np.flatnonzero(shift != NEVER_BROKEN)
    _, first = np.unique(np.column_stack([shift[broken], mesh[broken]]), axis=0, return_index=True)
    return rows[broken[first]]


def _used(tables: PoolTables, rows: np.ndarray, kind: int, count: int) -> np.ndarray:
    """Which of `count` meshes, or surfaces, fragments `rows` have."""
    stays = np.zeros(count, bool)
    stays[tables.fragment["mesh"].view[rows[tables.fragment["kind"].view[rows] == kind]]] = True
    return stays


def _spans(table: Table, begin: str, end: str, stays: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return table[begin].view[stays].astype(np.int64), table[end].view[stays].astype(np.int64)


def _move_meshes(tables: PoolTables, rows: np.ndarray, moves: dict[str, Moves]) -> None:
    table = tables.mesh
    first, dims = table["first"].view.astype(np.int64), table["grid_dims"].view.astype(np.int64)
    index = np.arange(len(first))
    # the rows of a mesh end where those of the next begin; it has one row more than nodes in node_tets_begin
    node = np.append(first[:, FIRST_NODE], table["nodes"].used)
    edge = np.append(first[:, FIRST_EDGE], table["edges"].used)
    tet = np.append(first[:, FIRST_TETRAHEDRON], table["tetrahedra"].used)
    cell = np.append(dims[:, 3], table["cell_begin"].used)
    stays = _used(tables, rows, TETRAHEDRA, len(first))
    moves[MESH] = moves_of(stays)
    for name, begin, end in (
        (NODE, node[:-1], node[1:]), (EDGE, edge[:-1], edge[1:]), (TETRAHEDRON, tet[:-1], tet[1:]),
        (NODE_BEGIN, node[:-1] + index, node[1:] + index + 1), (CELL, cell[:-1], cell[1:]),
    ):  # fmt: skip
        moves[name] = moves_of_ranges(int(end[-1]) if len(end) else 0, begin[stays], end[stays])
    for name, column, begin, end in (
        (NODE_TETRAHEDRON, "node_tets_begin", node[:-1] + index, node[1:] + index),
        (CELL_TETRAHEDRON, "cell_begin", cell[:-1], cell[1:] - 1),
    ):  # fmt: skip
        begins = table[column].view
        moves[name] = moves_of_ranges(
            table["node_tets" if name == NODE_TETRAHEDRON else "cell_tets"].used, begins[begin[stays]],
            begins[end[stays]],
        )  # fmt: skip


def _move_surfaces(tables: PoolTables, rows: np.ndarray, moves: dict[str, Moves]) -> None:
    table = tables.triangles
    nodes, triangles = table["node_range"].view, table["triangle_range"].view
    stays = _used(tables, rows, TRIANGLES, len(nodes))
    moves[SURFACE] = moves_of(stays)
    moves[TREE_NODE] = moves_of_ranges(table["node_box"].used, *nodes[stays].T)
    moves[TRIANGLE] = moves_of_ranges(table["corners"].used, *triangles[stays].T)
    # the normals of each surface, edges first, begin where those of the previous one end
    edges = 3 * (triangles[:, 1] - triangles[:, 0]).astype(np.int64) // 2
    begin = np.append(table["first_vertex"].view - edges, table["pseudonormals"].used)
    moves[PSEUDONORMAL] = moves_of_ranges(int(begin[-1]), begin[:-1][stays], begin[1:][stays])


def _move_bodies(tables: PoolTables, bodies: np.ndarray, moves: dict[str, Moves]) -> None:
    """What belongs to broken bodies, by one fragment of each."""
    body, fragment = tables.body, tables.fragment
    meshes = fragment["mesh"].view[bodies]
    first = tables.mesh["first"].view.astype(np.int64)
    tets = np.diff(np.append(first[:, FIRST_TETRAHEDRON], tables.mesh["tetrahedra"].used))
    counts = {BODY_NODE: first[:, NODES], BODY_TETRAHEDRON: tets, BODY_EDGE: first[:, EDGES]}
    used = {BODY_NODE: "node_fragment", BODY_TETRAHEDRON: "regions", BODY_EDGE: "edge_plane"}
    for shift, name, at in _SHIFTS:
        begin = fragment[shift].view[bodies] + first[meshes, at]
        moves[name] = moves_of_ranges(body[used[name]].used, begin, begin + counts[name][meshes])
    has = moves[BODY_TETRAHEDRON].stays & (body["cut_count"].view > 0)
    begin = body["regions"].view[has, ROW].astype(np.int64)
    moves[POLYGON] = moves_of_ranges(body["triangles"].used, begin, begin + body["cut_count"].view[has])
    planes = body["edge_plane"].view[moves[BODY_EDGE].stays]
    stays = np.zeros(body["planes"].used, bool)
    stays[planes[planes >= 0]] = True
    moves[CUT_PLANE] = moves_of(stays)


def _move_what_fragments_own(
    tables: PoolTables, rows: np.ndarray, bodies: np.ndarray, moves: dict[str, Moves]
) -> None:  # fmt: skip
    """Samples, cells, seeds, ridges and shapes; those of a whole mesh or surface stay with it, for later bodies."""
    owners = (
        (tables.fragment, rows), (tables.whole, moves[MESH].stays), (tables.whole_surface, moves[SURFACE].stays)
    )  # fmt: skip
    for name, column, begin, end in (
        (SAMPLE, "points", "sample_begin", "sample_end"), (SAMPLE_LEAF, "entries", "leaf_begin", "leaf_end"),
    ):  # fmt: skip
        spans = [_spans(table, begin, end, stays) for table, stays in owners]
        moves[name] = moves_of_ranges(tables.samples[column].used, *map(np.concatenate, zip(*spans, strict=True)))
    cells = np.concatenate([table["cells"].view[stays] for table, stays in owners[:2]])
    cells = cells[cells[:, 3] > 0]  # the others have no grid
    moves[WORD] = moves_of_ranges(tables.occupancy.used, cells[:, 6], ends_of_pyramids(cells))
    moves[SEED_PAIR] = moves_of_ranges(tables.seeds["keys"].used, *tables.fragment["seeds"].view[bodies].T)
    seeds = tables.seeds["ranges"].view[moves[SEED_PAIR].stays]
    moves[SEED] = moves_of_ranges(tables.seeds["edges"].used, *seeds.T)
    if tables.ridges["first"].used:
        first, leaves = tables.ridges["first"].view[rows], -(-tables.ridges["count"].view[rows] // LEAF)
        moves[RIDGE_LEAF] = moves_of_ranges(tables.ridges["most"].used, first, first + leaves)
        begin, end = (tables.shapes[name].view[rows] for name in ("begin", "end"))
        last = tables.shapes["end"].view.max(axis=0)
        for k, name in enumerate(OF_ROWS):
            moves[name] = moves_of_ranges(int(last[k]), begin[:, k], end[:, k])
