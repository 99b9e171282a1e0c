"""Garbage collection of the pools: drops rows that no living fragment refers to and closes the gaps.

Rows keep their order, so that nothing that depends on it changes: an answer has the same bytes before and after. The
cost is one copy of the pools; called when half of them is garbage, it is constant per byte removed.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fracture_collision.core.bodies.pool_rows import (
    OF_BODY_EDGES,
    OF_BODY_TETRAHEDRA,
    OF_POLYGONS,
    MeshRows,
    SampleRows,
    SurfaceMeshRows,
)
from fracture_collision.core.bodies.pool_tables import PoolTables
from fracture_collision.core.memory.kinds import TETRAHEDRA, TRIANGLES
from fracture_collision.core.memory.moves import Moves, moves_of, moves_of_ranges
from fracture_collision.core.memory.pools import (
    BACK,
    BACK_SIDE,
    FANNED,
    FRONT,
    LABELS,
    NEVER_BROKEN,
    OWNER,
    PARTED,
    REGION,
    ROW,
    GrowableArray,
)
from fracture_collision.core.mesh.occupancy import pyramid_words
from fracture_collision.core.mesh.sample_numbers import EDGES, FIRST_EDGE, FIRST_NODE, FIRST_TETRAHEDRON, NODES

_ON_NODES = ("nodes", "on_surface", "node_normals")
_ON_TETRAHEDRA = ("tetrahedra", "neighbours", "tetrahedron_edges", "boxes", "barycentric", "walls", "moments")
_ON_EDGES = ("edges", "edge_tets")
_ON_CELLS = ("cell_tets", "cell_parts")
_ON_MESHES = ("first", "grid", "grid_dims")


class Compacted(NamedTuple):
    """Moves of rows that others than the pools refer to."""

    fragments: Moves
    nodes: Moves  # of BodyPool
    meshes: Moves


def compact(
    tables: PoolTables, more: tuple[GrowableArray, ...], rows: np.ndarray, meshes: list[MeshRows],
    surfaces: list[SurfaceMeshRows],
) -> tuple[Compacted, list[tuple[int, MeshRows]], list[tuple[int, SurfaceMeshRows]]]:  # fmt: skip
    """Keep fragments `rows` (n,), ascending, and what they refer to.

    more: columns beside those of tables.fragment, one row per fragment. Of `meshes` and `surfaces` (all in the pools)
    those used by one of `rows` stay. Returns a Compacted, and the remaining meshes and surfaces, each with its old
    index.
    """
    fragment = tables.fragment
    kind, mesh = fragment["kind"].view[rows], fragment["mesh"].view[rows]
    used_meshes, used_surfaces = set(mesh[kind == TETRAHEDRA].tolist()), set(mesh[kind == TRIANGLES].tolist())
    meshes = [each for each in meshes if each.number in used_meshes]
    surfaces = [each for each in surfaces if each.number in used_surfaces]
    stays = np.zeros(fragment["kind"].used, bool)
    stays[rows] = True
    moved = moves_of(stays)
    bodies = _one_row_of_each_broken_body(tables, rows)

    shared = [mesh.samples for mesh in meshes] + [surface.samples for surface in surfaces]
    samples, leaves = _sample_moves(tables, rows, shared)
    words = _word_moves(tables, rows, meshes)
    mesh_moves = _compact_meshes(tables, meshes)
    # the seeds' edges are rows of the mesh pool
    seeds = _compact_seeds(tables, bodies, moved, mesh_moves.edges)
    body = _compact_bodies(tables, bodies, {each.number: each for each in meshes}, moved)
    triangles = _compact_triangles(tables, surfaces)
    new_meshes = [
        each._replace(
            number=int(mesh_moves.meshes.of(each.number)), node=int(mesh_moves.nodes.of(each.node)),
            tet=int(mesh_moves.tetrahedra.of(each.tet)), edge=int(mesh_moves.edges.of(each.edge)),
            samples=_moved_samples(each.samples, samples, leaves), cells=_moved_cells(each.cells[None], words)[0],
        )  # fmt: skip
        for each in meshes
    ]
    new_surfaces = [
        SurfaceMeshRows(int(triangles.of(each.number)), _moved_samples(each.samples, samples, leaves))
        for each in surfaces
    ]

    old_first = {each.number: (each.node, each.tet, each.edge) for each in meshes}
    new_first = {each.number: (new.node, new.tet, new.edge) for each, new in zip(meshes, new_meshes, strict=True)}
    moved.keep(fragment, *fragment)
    for column in more:
        column.keep(stays)
    is_broken = fragment["node_shift"].view != NEVER_BROKEN
    broken_mesh = mesh[is_broken].tolist()
    for at, name in enumerate(("node_shift", "tet_shift", "edge_shift")):
        shift = fragment[name].view[is_broken]
        old = np.array([old_first[k][at] for k in broken_mesh], np.int64)
        new = np.array([new_first[k][at] for k in broken_mesh], np.int64)
        fragment[name].view[is_broken] = body[at].of(shift + old) - new
    fragment["mesh"].view[kind == TETRAHEDRA] = mesh_moves.meshes.of(mesh[kind == TETRAHEDRA])
    fragment["mesh"].view[kind == TRIANGLES] = triangles.of(mesh[kind == TRIANGLES])
    for name, of in (
        ("sample_begin", samples), ("sample_end", samples), ("leaf_begin", leaves), ("leaf_end", leaves)
    ):  # fmt: skip
        fragment[name].replace(of.of(fragment[name].view))
    fragment["cells"].replace(_moved_cells(fragment["cells"].view, words))
    fragment["seeds"].replace(seeds.of(fragment["seeds"].view))
    samples.keep(tables.samples, *tables.samples)
    leaves.keep(tables.leaves, *tables.leaves)
    tables.occupancy.keep(words.stays)
    return (
        Compacted(moved, body[0], mesh_moves.meshes),
        [(each.number, new) for each, new in zip(meshes, new_meshes, strict=True)],
        [(each.number, new) for each, new in zip(surfaces, new_surfaces, strict=True)],
    )


def _one_row_of_each_broken_body(tables: PoolTables, rows: np.ndarray) -> np.ndarray:
    """One of `rows` per broken body (b,): fragments of one body share their node_shift and their mesh."""
    shift, mesh = tables.fragment["node_shift"].view[rows], tables.fragment["mesh"].view[rows]
    broken = np.flatnonzero(shift != NEVER_BROKEN)
    _, first = np.unique(np.column_stack([shift[broken], mesh[broken]]), axis=0, return_index=True)
    return rows[broken[first]]


def _sample_moves(tables: PoolTables, rows: np.ndarray, shared: list[SampleRows]) -> tuple[Moves, Moves]:
    """(moves of samples, moves of leaves) of fragments `rows`; shared: those of whole meshes, for later bodies."""
    own = [tables.fragment[name].view[rows] for name in ("sample_begin", "sample_end", "leaf_begin", "leaf_end")]
    ends = [np.concatenate([column, [each[k] for each in shared]]).astype(np.int64) for k, column in enumerate(own)]
    return (
        moves_of_ranges(tables.samples["points"].used, ends[0], ends[1]),
        moves_of_ranges(tables.leaves["entries"].used, ends[2], ends[3]),
    )


def _moved_samples(rows: SampleRows, samples: Moves, leaves: Moves) -> SampleRows:
    return SampleRows(
        int(samples.of(rows.begin)), int(samples.of(rows.end)), int(leaves.of(rows.leaf_begin)),
        int(leaves.of(rows.leaf_end)), rows.middle,
    )  # fmt: skip


def _word_moves(tables: PoolTables, rows: np.ndarray, meshes: list[MeshRows]) -> Moves:
    cells = np.concatenate([tables.fragment["cells"].view[rows], *(m.cells[None] for m in meshes)])
    cells = cells[cells[:, 3] > 0]  # the others have no grid
    ends = cells[:, 6] + np.array([pyramid_words(row) for row in cells], np.int64)
    return moves_of_ranges(tables.occupancy.used, cells[:, 6], ends)


def _moved_cells(cells: np.ndarray, words: Moves) -> np.ndarray:
    has_grid = cells[:, 3] > 0
    return np.column_stack([cells[:, :6], np.where(has_grid, words.of(cells[:, 6]), 0)]).astype(np.int32)


class _MeshMoves(NamedTuple):
    meshes: Moves
    nodes: Moves
    tetrahedra: Moves
    edges: Moves


def _compact_meshes(tables: PoolTables, meshes: list[MeshRows]) -> _MeshMoves:
    table = tables.mesh
    index = np.array([m.number for m in meshes], np.int64)
    counts = np.array([m.counts for m in meshes], np.int64).reshape(-1, 3)
    node, tet, edge = (np.array([getattr(m, n) for m in meshes], np.int64) for n in ("node", "tet", "edge"))
    moves = _MeshMoves(
        moves_of_ranges(table["grid"].used, index, index + 1),
        moves_of_ranges(table["nodes"].used, node, node + counts[:, 0]),
        moves_of_ranges(table["tetrahedra"].used, tet, tet + counts[:, 1]),
        moves_of_ranges(table["edges"].used, edge, edge + counts[:, 2]),
    )
    if moves.meshes.stays.all():
        return moves  # the columns may be shared with the preprocess: do not write to them
    # each mesh has one row more than nodes
    begin_row = node + index
    node_tets_begin = moves_of_ranges(table["node_tets_begin"].used, begin_row, begin_row + counts[:, 0] + 1)
    begins = table["node_tets_begin"].view
    node_tets = moves_of_ranges(table["node_tets"].used, begins[begin_row], begins[begin_row + counts[:, 0]])
    first_cell = table["grid_dims"].view[:, 3].astype(np.int64)
    cell_rows = np.append(first_cell, table["cell_begin"].used)
    cell_begin = moves_of_ranges(table["cell_begin"].used, cell_rows[index], cell_rows[index + 1])
    begins = table["cell_begin"].view
    cells = moves_of_ranges(table["cell_tets"].used, begins[cell_rows[index]], begins[cell_rows[index + 1] - 1])

    moves.nodes.keep(table, *_ON_NODES)
    moves.tetrahedra.keep(table, *_ON_TETRAHEDRA)
    moves.edges.keep(table, *_ON_EDGES)
    moves.meshes.keep(table, *_ON_MESHES)
    node_tets_begin.keep(table, "node_tets_begin")
    node_tets.keep(table, "node_tets")
    cell_begin.keep(table, "cell_begin")
    cells.keep(table, *_ON_CELLS)
    for name, of in (
        ("tetrahedra", moves.nodes), ("neighbours", moves.tetrahedra), ("tetrahedron_edges", moves.edges),
        ("edges", moves.nodes), ("edge_tets", moves.tetrahedra), ("node_tets_begin", node_tets),
        ("node_tets", moves.tetrahedra), ("cell_begin", cells), ("cell_tets", moves.tetrahedra),
    ):  # fmt: skip
        table[name].replace(of.of(table[name].view))
    first = table["first"].view
    table["first"].replace(
        np.column_stack(
            [
                moves.nodes.of(first[:, FIRST_NODE]), moves.edges.of(first[:, FIRST_EDGE]), first[:, NODES],
                moves.tetrahedra.of(first[:, FIRST_TETRAHEDRON]), first[:, EDGES],
            ]
        )
    )
    dims = table["grid_dims"].view
    table["grid_dims"].replace(np.column_stack([dims[:, :3], cell_begin.of(dims[:, 3])]))
    return moves


def _compact_seeds(tables: PoolTables, bodies: np.ndarray, moved: Moves, mesh_edges: Moves) -> Moves:
    """Returns the moves of the rows of SeedPool.keys."""
    seeds, own = tables.seeds, tables.fragment["seeds"].view[bodies]
    keys = moves_of_ranges(seeds["keys"].used, own[:, 0], own[:, 1])
    ranges = seeds["ranges"].view[keys.stays]
    edges = moves_of_ranges(seeds["edges"].used, ranges[:, 0], ranges[:, 1])
    keys.keep(seeds, "keys", "ranges")
    edges.keep(seeds, "edges")
    pairs = seeds["keys"].view
    seeds["keys"].replace(moved.of(pairs >> 32) << 32 | moved.of(pairs & 0xFFFFFFFF))
    seeds["ranges"].replace(edges.of(ranges))
    seeds["edges"].replace(mesh_edges.of(seeds["edges"].view))
    return keys


def _compact_bodies(
    tables: PoolTables, bodies: np.ndarray, meshes: dict[int, MeshRows], moved: Moves
) -> tuple[Moves, Moves, Moves]:
    """Returns the moves of the rows of nodes, tetrahedra and edges."""
    body, fragment = tables.body, tables.fragment
    of_meshes = [meshes[k] for k in fragment["mesh"].view[bodies].tolist()]
    moves = []
    for shift, first, at, name in (
        ("node_shift", "node", 0, "node_fragment"), ("tet_shift", "tet", 1, "regions"),
        ("edge_shift", "edge", 2, "edge_plane"),
    ):  # fmt: skip
        begin = fragment[shift].view[bodies] + np.array([getattr(m, first) for m in of_meshes], np.int64)
        count = np.array([m.counts[at] for m in of_meshes], np.int64)
        moves.append(moves_of_ranges(body[name].used, begin, begin + count))
    nodes, tetrahedra, edges = moves
    nodes.keep(body, "node_fragment")
    tetrahedra.keep(body, *OF_BODY_TETRAHEDRA)
    edges.keep(body, *OF_BODY_EDGES)
    regions, count = body["regions"].view, body["cut_count"].view
    begin = regions[:, ROW].astype(np.int64)
    has = count > 0
    polygons = moves_of_ranges(body["triangles"].used, begin[has], begin[has] + count[has])
    is_cut = body["edge_plane"].view >= 0
    stays = np.zeros(body["planes"].used, bool)
    stays[body["edge_plane"].view[is_cut]] = True
    planes = moves_of(stays)
    polygons.keep(body, *OF_POLYGONS)
    planes.keep(body, "planes")
    for name, of in (("node_fragment", moved), ("edge_plane", planes)):
        body[name].replace(of.of(body[name].view))
    # edges that are not cut have no event
    body["edge_event"].replace(np.where(is_cut, planes.of(body["edge_event"].view), 0))
    sides = body["sides"].view
    sides[:, : BACK_SIDE + 1] = moved.of(sides[:, : BACK_SIDE + 1])
    regions[:, ROW] = np.where(has, polygons.of(begin), 0)
    is_parted, is_fanned = regions[:, OWNER] == PARTED, regions[:, OWNER] == FANNED
    regions[:, OWNER] = moved.of(regions[:, OWNER])
    regions[is_parted, FRONT : BACK + 1] = moved.of(regions[is_parted, FRONT : BACK + 1])
    regions[is_fanned, LABELS:REGION] = moved.of(regions[is_fanned, LABELS:REGION])
    return nodes, tetrahedra, edges


def _compact_triangles(tables: PoolTables, surfaces: list[SurfaceMeshRows]) -> Moves:
    """Returns the moves of the rows of `node_range`."""
    table = tables.triangles
    index = np.array([s.number for s in surfaces], np.int64)
    meshes = moves_of_ranges(table["node_range"].used, index, index + 1)
    node, triangle = table["node_range"].view[index], table["triangle_range"].view[index]
    nodes = moves_of_ranges(table["node_box"].used, node[:, 0], node[:, 1])
    triangles = moves_of_ranges(table["corners"].used, triangle[:, 0], triangle[:, 1])
    # the normals of each mesh, edges first, begin where those of the previous mesh end
    edges = 3 * (table["triangle_range"].view[:, 1] - table["triangle_range"].view[:, 0]).astype(np.int64) // 2
    normal_rows = np.append(table["first_vertex"].view - edges, table["pseudonormals"].used)
    normals = moves_of_ranges(table["pseudonormals"].used, normal_rows[index], normal_rows[index + 1])
    meshes.keep(table, "node_range", "triangle_range", "first_vertex")
    nodes.keep(table, "node_box", "node_skip", "node_first", "node_count")
    triangles.keep(table, "corners", "features")
    normals.keep(table, "pseudonormals")
    for name, of in (
        ("features", normals), ("node_skip", nodes), ("node_first", triangles), ("node_range", nodes),
        ("triangle_range", triangles), ("first_vertex", normals),
    ):  # fmt: skip
        table[name].replace(of.of(table[name].view))
    return meshes
