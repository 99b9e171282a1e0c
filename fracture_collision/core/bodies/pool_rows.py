"""Where a mesh, samples and a fragment are in the pools, and how many bytes they take there."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fracture_collision.core.bodies.pool_tables import PoolTables
from fracture_collision.core.memory.pools import NEVER_BROKEN
from fracture_collision.core.mesh.occupancy import pyramid_words

OF_BODY_EDGES = ("edge_plane", "edge_event", "edge_share")
OF_BODY_TETRAHEDRA = ("regions", "cut_count")
OF_POLYGONS = ("triangles", "faces", "sides")
_MOMENTS_AND_GAP = 88  # [bytes] per fragment outside its table


class SampleRows(NamedTuple):
    """Rows of samples in the pools, and of their leaves."""

    begin: int
    end: int
    leaf_begin: int
    leaf_end: int
    middle: np.ndarray  # (4,) see sample_leaves.Leaves


class MeshRows(NamedTuple):
    """Rows of a tetrahedral mesh in the pools."""

    number: int  # of the mesh
    node: int
    tet: int
    edge: int
    samples: SampleRows
    cells: np.ndarray
    counts: tuple[int, int, int]  # nodes, tetrahedra, edges


class SurfaceMeshRows(NamedTuple):
    """Rows of the mesh of a rigid body of triangles."""

    number: int  # of the mesh
    samples: SampleRows


def bytes_of_fragments(tables: PoolTables, rows: np.ndarray, mesh: MeshRows | None, has_own_samples: bool) -> int:
    """Bytes that `compact` would free without `rows` (n,), all fragments of one body, except its mesh.

    mesh: of a body of tetrahedra; it may be shared. has_own_samples: false if its samples belong to the mesh, even
    before it breaks.
    """
    fragment = tables.fragment
    one = sum(column.row_bytes for column in fragment.values()) + _MOMENTS_AND_GAP
    total = len(rows) * one
    row = int(rows[0])
    is_broken = fragment["node_shift"].view[row] != NEVER_BROKEN
    if is_broken or (mesh is None and has_own_samples):
        for name, table in (("sample", tables.samples), ("leaf", tables.leaves)):
            count = fragment[f"{name}_end"].view[rows].astype(np.int64) - fragment[f"{name}_begin"].view[rows]
            total += int(count.sum()) * sum(column.row_bytes for column in table.values())
    if mesh is None or not is_broken:
        return total
    nodes, tets, edges = mesh.counts
    body = tables.body
    for names, count in ((("node_fragment",), nodes), (OF_BODY_TETRAHEDRA, tets), (OF_BODY_EDGES, edges)):
        total += count * sum(body[name].row_bytes for name in names)
    first = mesh.tet + int(fragment["tet_shift"].view[row])
    polygons = int(body["cut_count"].view[first : first + tets].sum())
    total += polygons * sum(body[name].row_bytes for name in OF_POLYGONS)
    return total + 8 * sum(pyramid_words(cells) for cells in fragment["cells"].view[rows])


def bytes_of_broken(tables: PoolTables, row: int, touched: np.ndarray) -> int:
    """Bytes that `compact` would free after fragment `row` broke, before anything is rebuilt.

    touched (n,): rows of the mesh's tetrahedra whose polygons will be replaced. Not of a body that breaks for the first
    time: its samples belong to its mesh.
    """
    fragment, body = tables.fragment, tables.body
    total = sum(column.row_bytes for column in fragment.values()) + _MOMENTS_AND_GAP
    for name, table in (("sample", tables.samples), ("leaf", tables.leaves)):
        count = int(fragment[f"{name}_end"].view[row]) - int(fragment[f"{name}_begin"].view[row])
        total += count * sum(column.row_bytes for column in table.values())
    polygons = int(body["cut_count"].view[touched + int(fragment["tet_shift"].view[row])].sum())
    total += polygons * sum(body[name].row_bytes for name in OF_POLYGONS)
    return total + 8 * pyramid_words(fragment["cells"].view[row])


def bytes_of_mesh(prepared: NamedTuple) -> int:
    """Approximate bytes of a mesh, or a surface, in the pools: the size of its preprocess."""
    parts = [array for part in prepared if isinstance(part, tuple) for array in part]
    return sum(array.nbytes for array in parts if isinstance(array, np.ndarray))
