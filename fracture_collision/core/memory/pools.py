"""The arrays every kernel reads: all meshes, bodies, fragments, polygons and samples, concatenated.

One flat array per quantity, independent of the number of bodies, so that a kernel takes everything in one tuple and
equal geometries share one preprocess. Rows are only appended; a retired fragment's samples stay as garbage until the
pools are compacted (pool_compaction.py) or the world is rebuilt. `GrowableArray` owns the memory (pool_tables.py holds
one per column), the NamedTuples are views for the kernels.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np


class GrowableArray:
    """An array that grows at its end: amortized O(1) per row, `view` contiguous.

    changed: called whenever `view` becomes a new array; its argument is true if `whole` is a new array, too.
    """

    def __init__(self, columns: int, dtype: type, changed: Callable[[bool], None] = lambda moved: None) -> None:
        self._buffer: np.ndarray = np.zeros((16, columns) if columns else 16, dtype=dtype)
        self.used = 0
        self._view: np.ndarray | None = None  # cached: a fracture reads the views of all columns several times
        self._changed = changed

    def append(self, rows: np.ndarray) -> int:
        """Copy `rows` to the end; returns the index of the first new row."""
        self.reserve(len(rows))[:] = rows
        return self.advance(len(rows))

    def fill(self, count: int, row) -> int:
        """Append `count` copies of `row`; returns the index of the first."""
        self.reserve(count)[:] = row
        return self.advance(count)

    def share(self, rows: np.ndarray) -> int:
        """As append, for rows that are never written again: the first call does not copy."""
        if self.used or rows.dtype != self._buffer.dtype or not rows.flags.c_contiguous:
            return self.append(rows)
        self._put(rows)
        return self.advance(len(rows))

    def reserve(self, count: int) -> np.ndarray:
        """The next `count` rows, for the caller to write; `advance` makes them part of the array."""
        end = self.used + count
        if end > len(self._buffer):
            grown = np.empty((max(end, 2 * len(self._buffer)), *self._buffer.shape[1:]), dtype=self._buffer.dtype)
            grown[: self.used] = self._buffer[: self.used]
            self._put(grown)
        return self._buffer[self.used : end]

    def advance(self, count: int) -> int:
        """Append the next `count` rows of the buffer, as written by the caller; returns the index of the first."""
        self.used, self._view = self.used + count, None
        self._changed(False)
        return self.used - count

    def keep(self, stays: np.ndarray) -> None:
        """Drop the rows where the mask `stays` (used,) is false."""
        if not stays.all():
            self.replace(self.view[stays])

    def replace(self, rows: np.ndarray) -> None:
        """Replace all rows; the old memory is released."""
        self.used = len(rows)
        self._put(np.ascontiguousarray(rows, dtype=self._buffer.dtype))

    def _put(self, buffer: np.ndarray) -> None:
        self._buffer, self._view = buffer, None
        self._changed(True)

    @property
    def row_bytes(self) -> int:
        """Size of a row [bytes]."""
        return self._buffer.dtype.itemsize * int(np.prod(self._buffer.shape[1:], dtype=np.int64))

    @property
    def view(self) -> np.ndarray:
        """The rows in use, contiguous; a new view after each change of their number."""
        if self._view is None:
            self._view = self._buffer[: self.used]
        return self._view

    @property
    def whole(self) -> np.ndarray:
        """`view` and the spare capacity behind it."""
        return self._buffer


class MeshPool(NamedTuple):
    """Distinct tetrahedral meshes (tet_mesh.py), indices shifted to be absolute."""

    nodes: np.ndarray  # (N, 3) float64 [m]
    tetrahedra: np.ndarray  # (M, 4) int32
    neighbours: np.ndarray  # (M, 4) int32, -1: the old surface
    tetrahedron_edges: np.ndarray  # (M, 6) int32
    edges: np.ndarray  # (E, 2) int32
    edge_tets: np.ndarray  # (E,) int32, one tetrahedron incident to each edge
    boxes: np.ndarray  # (M, 6) float32 [m], rounded outwards
    barycentric: np.ndarray  # (M, 12) float64
    walls: np.ndarray  # (M, 16) float32
    moments: np.ndarray  # (M, 10) float64
    on_surface: np.ndarray  # (N,) uint8
    node_normals: np.ndarray  # (N, 3) float64 unit, outward, of the old surface; zero inside
    node_tets_begin: np.ndarray  # (N + meshes,) int32; mesh k's rows start at first node + k
    node_tets: np.ndarray  # (4M,) int32
    first: np.ndarray  # (meshes, 5) int32: first node, first edge, number of nodes, first tetrahedron, number of edges
    grid: np.ndarray  # (meshes, 4) float64: origin [m], cell [m]
    grid_dims: np.ndarray  # (meshes, 4) int32: cells along x, y, z; first entry in cell_begin
    cell_begin: np.ndarray  # int32, cells + 1 per mesh
    cell_tets: np.ndarray  # int32
    cell_parts: np.ndarray  # uint64, one bit per part of the cell that this tetrahedron may meet (occupancy.py)


class BodyPool(NamedTuple):
    """Per-body state that fracture changes; only broken bodies have rows here."""

    node_fragment: np.ndarray  # int32 fragment row of each mesh node
    edge_plane: np.ndarray  # int32 row of `planes`, -1: not cut
    edge_event: np.ndarray  # int32 first row of `planes` of the fracture that cut it: increases with each fracture
    edge_share: np.ndarray  # float64: where a cut edge is crossed, as a share of its length from its first node
    regions: np.ndarray  # (., REGION) int32, per tetrahedron, its owners: columns from OWNER on, half a cache line
    region_planes: np.ndarray  # (., REGION) float32 view of the same memory, for PLANE, which is single precision
    cut_count: np.ndarray  # int32 per tetrahedron: number of its polygons
    planes: np.ndarray  # (P, 4) float64, unit normal from the edge's first node to its second, offset [m]
    triangles: np.ndarray  # (T, 9) float64 [m] corners, right-handed about the outward normal of `front`
    faces: np.ndarray  # (T, 4) float64 their planes: that unit normal and the offset [m]
    sides: np.ndarray  # (T, 4) int32 FRONT_SIDE, BACK_SIDE, KIND, VOID


class FragmentPool(NamedTuple):
    """One row per fragment, including bodies that never break."""

    kind: np.ndarray  # int32, kinds.py
    mesh: np.ndarray  # int32 row of grid or, for TRIANGLES, of node_range; -1 without a mesh
    node_shift: np.ndarray  # int32: mesh node + shift = row of node_fragment; NEVER_BROKEN for a whole body
    tet_shift: np.ndarray  # int32 likewise for regions, cut_count
    edge_shift: np.ndarray  # int32 likewise for edge_plane
    box: np.ndarray  # (F, 6) float64 [m], body frame
    shape: np.ndarray  # (F, 4) float64: plane (n, offset), sphere (radius), box (half edges) [m]
    radius: np.ndarray  # float64 [m] R of the body, half the longest side of its box; infinite for a plane
    sample_begin: np.ndarray  # int32 first row of SamplePool.points
    sample_end: np.ndarray  # int32
    cells: np.ndarray  # (F, 7) int32: first cell x y z, cells x y z, first word of `occupancy`
    seeds: np.ndarray  # (F, 2) int32: first row of SeedPool.keys of its body, end row
    leaf_begin: np.ndarray  # int32 first leaf of SamplePool
    leaf_end: np.ndarray  # int32
    middle: np.ndarray  # (F, 4) float64 [m], see sample_leaves.Leaves


class TriangleMeshPool(NamedTuple):
    """Distinct triangle meshes (triangle_field.py), indices shifted to be absolute."""

    corners: np.ndarray  # (T, 9) float64 [m]
    features: np.ndarray  # (T, 6) int32
    pseudonormals: np.ndarray  # (E + N, 3) float64
    node_box: np.ndarray  # (B, 6) float64 [m]
    node_skip: np.ndarray  # (B,) int32
    node_first: np.ndarray  # (B,) int32
    node_count: np.ndarray  # (B,) int32
    node_range: np.ndarray  # (meshes, 2) int32: first row of the nodes, end row
    triangle_range: np.ndarray  # (meshes, 2) int32 likewise
    first_vertex: np.ndarray  # (meshes,) int32: row of pseudonormals of its first vertex


class SamplePool(NamedTuple):
    """Samples of the fragments' surfaces and their leaves (sample_leaves.py), contiguous per fragment."""

    points: np.ndarray  # (S, 3) float64 [m] body frame
    numbers: np.ndarray  # (S,) int32 within the body, sample_numbers.py
    values: np.ndarray  # (LEAF_VALUES L,) float32 [m]
    entries: np.ndarray  # (LEAF L,) int32


# Samples per leaf: one SIMD instruction in single precision. A leaf has six numbers for its box and three per sample.
LEAF = 8
LEAF_VALUES = 6 + 3 * LEAF
# Error bound of a projection of these numbers onto a unit vector, as a share of the sides of the box of all samples:
# the numbers are rounded to 2^-25 of its sides, and so are each of the five operations and the vector's components.
SAMPLE_ROUNDING = 1e-6


class SeedPool(NamedTuple):
    """Crack seeds (crack_seeds.py).

    A body's rows are sorted by key, in the range given by FragmentPool.seeds. Its rows from before its last fracture
    stay as garbage, and so do the edges of broken fragments; other edges do not move.
    """

    keys: np.ndarray  # int64 smaller row of the fragment pool << 32 | larger row
    ranges: np.ndarray  # (., 2) int32: first row of `edges`, end row
    edges: np.ndarray  # int32 row of MeshPool.edges; each farther from those before it than all that follow


class Pools(NamedTuple):
    """All pools."""

    mesh: MeshPool
    body: BodyPool
    fragment: FragmentPool
    samples: SamplePool
    occupancy: np.ndarray  # uint64, multi-level grids (occupancy.py)
    triangles: TriangleMeshPool
    seeds: SeedPool


# Columns of BodyPool.regions.
OWNER = 0  # fragment row if one fragment owns the whole tetrahedron, else PARTED or FANNED
ROW = 1  # of a shared tetrahedron: the first row of its polygons
FRONT, BACK = 2, 3  # of a PARTED tetrahedron: fragment rows
PLANE = 4  # of a PARTED tetrahedron, four columns: the normal out of FRONT and the offset [m] from the grid's corner
LABELS = 4  # of a FANNED tetrahedron, four columns: fragment rows of its nodes
REGION = 8
# OWNER of shared tetrahedra (cut_tetrahedron.py): PARTED by one plane, common to all their rows between fragments; or
# FANNED about a hub, the first corner of these rows, which are sorted by face.
PARTED = -1
FANNED = -2
# Columns of BodyPool.sides: fragment rows, BACK_SIDE -1 outside the body; KIND is OLD_FACE + k for a piece of face k of
# a tetrahedron; for a triangle between two fragments it is the face it lies behind. VOID, of triangles about a hub: the
# part from the triangle to the node of its face in front has no volume (FRONT_VOID), or that to the node behind it
# (BACK_VOID).
FRONT_SIDE, BACK_SIDE, KIND, VOID = 0, 1, 2, 3
FRONT_VOID, BACK_VOID = 1, 2
OLD_FACE = 4
NEVER_BROKEN = np.iinfo(np.int32).min
