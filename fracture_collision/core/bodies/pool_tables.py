"""The memory behind the pools: one growable table per pool, and methods that append structures to several columns."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from fracture_collision.core.memory.kinds import TETRAHEDRA
from fracture_collision.core.memory.pools import (
    LEAF,
    LEAF_VALUES,
    REGION,
    BodyPool,
    FragmentPool,
    GrowableArray,
    MeshPool,
    Pools,
    SamplePool,
    SeedPool,
    TriangleMeshPool,
)
from fracture_collision.core.mesh.tet_mesh import TetMesh
from fracture_collision.core.samples.sample_leaves import fill_leaves, leaf_count


class PoolTables:
    """Columns of each pool by name, growing at their ends."""

    def __init__(self) -> None:
        f8, f4, i4, u1, u8 = np.float64, np.float32, np.int32, np.uint8, np.uint64
        self.mesh = self._table(
            nodes=(3, f8), tetrahedra=(4, i4), neighbours=(4, i4), tetrahedron_edges=(6, i4), edges=(2, i4),
            edge_tets=(0, i4), boxes=(6, f4), barycentric=(12, f8), walls=(16, f4), moments=(10, f8),
            on_surface=(0, u1), node_normals=(3, f8), node_tets_begin=(0, i4), node_tets=(0, i4), first=(5, i4),
            grid=(4, f8), grid_dims=(4, i4), cell_begin=(0, i4), cell_tets=(0, i4), cell_parts=(0, u8),
        )  # fmt: skip
        self.body = self._table(
            node_fragment=(0, i4), edge_plane=(0, i4), edge_event=(0, i4), edge_share=(0, f8), regions=(REGION, i4),
            cut_count=(0, i4), planes=(4, f8), triangles=(9, f8), faces=(4, f8),
            sides=(4, i4),
        )  # fmt: skip
        self.fragment = self._table(
            kind=(0, i4), mesh=(0, i4), node_shift=(0, i4), tet_shift=(0, i4), edge_shift=(0, i4), box=(6, f8),
            shape=(4, f8), radius=(0, f8), sample_begin=(0, i4), sample_end=(0, i4), cells=(7, i4),
            seeds=(2, i4), leaf_begin=(0, i4), leaf_end=(0, i4), middle=(4, f8),
        )  # fmt: skip
        self.samples = self._table(points=(3, f8), numbers=(0, i4))
        self.leaves = self._table(values=(LEAF_VALUES, f4), entries=(LEAF, i4))
        self.triangles = self._table(
            corners=(9, f8), features=(6, i4), pseudonormals=(3, f8), node_box=(6, f8), node_skip=(0, i4),
            node_first=(0, i4), node_count=(0, i4), node_range=(2, i4), triangle_range=(2, i4),
            first_vertex=(0, i4),
        )  # fmt: skip
        self.seeds = self._table(keys=(0, np.int64), ranges=(2, i4), edges=(0, i4))
        self.occupancy = GrowableArray(0, u8, self._changed)
        self._pools: Pools | None = None
        self._roomy: Pools | None = None

    def _table(self, **columns: tuple[int, type]) -> dict[str, GrowableArray]:
        return {name: GrowableArray(width, dtype, self._changed) for name, (width, dtype) in columns.items()}

    def _changed(self, moved: bool) -> None:
        self._pools = None
        if moved:
            self._roomy = None

    @property
    def pools(self) -> Pools:
        """The pools as kernels read them: views of all columns, cached until a column changes."""
        if self._pools is None:
            self._pools = self._pools_of(lambda column: column.view)
        return self._pools

    @property
    def roomy(self) -> Pools:
        """`pools` with the spare capacity behind each column's rows, for kernels that write there.

        It stays the same until a column is reallocated.
        """
        if self._roomy is None:
            self._roomy = self._pools_of(lambda column: column.whole)
        return self._roomy

    def _pools_of(self, rows: Callable[[GrowableArray], np.ndarray]) -> Pools:
        mesh, body, fragment, samples, triangles, seeds = (
            {name: rows(column) for name, column in pool.items()}
            for pool in (self.mesh, self.body, self.fragment, self.samples, self.triangles, self.seeds)
        )
        leaves = {name: rows(column).reshape(-1) for name, column in self.leaves.items()}
        return Pools(
            MeshPool(**mesh), BodyPool(**body, region_planes=body["regions"].view(np.float32)),
            FragmentPool(**fragment), SamplePool(**samples, **leaves), rows(self.occupancy),
            TriangleMeshPool(**triangles), SeedPool(**seeds),
        )  # fmt: skip

    @property
    def bytes_used(self) -> int:
        """Bytes of all rows in the pools, without spare capacity."""
        pools = (self.mesh, self.body, self.fragment, self.samples, self.leaves, self.triangles, self.seeds)
        columns = [column for pool in pools for column in pool.values()]
        return sum(column.used * column.row_bytes for column in (*columns, self.occupancy))

    def moment_origins(self, rows: np.ndarray) -> np.ndarray:
        """(n, 3) [m] points that the moments of fragments `rows` (n,), of tetrahedra or triangles, are about."""
        origins = self.fragment["box"].view[rows, :3]
        is_tetrahedral = self.fragment["kind"].view[rows] == TETRAHEDRA
        grids = self.fragment["mesh"].view[rows[is_tetrahedral]]
        origins[is_tetrahedral] = self.mesh["grid"].view[grids, :3]
        return origins

    def append_samples(self, points: np.ndarray, numbers: np.ndarray) -> tuple[int, int, np.ndarray]:
        """Append the samples (s, 3) [m] of one fragment, and their leaves; numbers (s,): sample_numbers.py.

        Returns (first sample, first leaf, middle (4,) of the Leaves).
        """
        count, middles = leaf_count(len(points)), np.empty((1, 4))
        values, entries = self.leaves["values"].reserve(count), self.leaves["entries"].reserve(count)
        fill_leaves(np.ascontiguousarray(points), np.array([0, len(points)]), values, entries, middles)
        first = self.leaves["values"].advance(count)
        self.leaves["entries"].advance(count)
        self.samples["numbers"].append(numbers)
        return self.samples["points"].append(points), first, middles[0]

    def append_mesh(self, mesh: TetMesh) -> tuple[int, int, int, int]:
        """Append a mesh; returns its row in `grid`, and its first node, tetrahedron and edge."""
        table = self.mesh
        index, node, tet, edge = table["grid"].used, table["nodes"].used, table["tetrahedra"].used, table["edges"].used
        first_cell = table["cell_begin"].used
        # Indices become absolute. The first mesh needs no shift, so its arrays are shared with the preprocess: this
        # halves the memory of a world with one mesh.
        for name, shift in (
            ("nodes", 0), ("tetrahedra", node), ("neighbours", tet), ("tetrahedron_edges", edge), ("edges", node),
            ("edge_tets", tet), ("boxes", 0), ("barycentric", 0), ("walls", 0), ("moments", 0), ("on_surface", 0),
            ("node_normals", 0), ("node_tets_begin", table["node_tets"].used), ("node_tets", tet),
            ("cell_begin", table["cell_tets"].used), ("cell_tets", tet), ("cell_parts", 0),
        ):  # fmt: skip
            rows = getattr(mesh, name)
            if shift:
                rows = np.where(rows < 0, -1, rows + shift)
            table[name].share(rows)
        table["first"].append(np.array([[node, edge, len(mesh.nodes), tet, len(mesh.edges)]], np.int32))
        table["grid"].append(np.append(mesh.grid_origin, mesh.grid_cell)[None])
        table["grid_dims"].append(np.append(mesh.grid_dims, first_cell)[None])
        return index, node, tet, edge
