"""The memory behind the pools: one growable table per pool, and methods that append structures to several columns."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from fracture_collision.core.memory.kinds import TETRAHEDRA
from fracture_collision.core.memory.pools import (
    LEAF,
    LEAF_VALUES,
    OWN_SAMPLE,
    REGION,
    SAMPLE,
    SIZE,
    SURFACE,
    BodyPool,
    FragmentPool,
    GrowableArray,
    MeshPool,
    Pools,
    SamplePool,
    SeedPool,
    TreePool,
    TriangleMeshPool,
)
from fracture_collision.core.mesh.tet_mesh import TetMesh
from fracture_collision.core.tree.sample_leaves import count_leaves, fill_leaves
from fracture_collision.core.tree.sphere_tree import SphereTree, surface_marks
from fracture_collision.grouping import begins_of


class PoolTables:
    """Columns of each pool by name, growing at their ends."""

    def __init__(self, traversal: int, field: int, normals: int) -> None:
        f8, f4, i4, u1, u8 = np.float64, np.float32, np.int32, np.uint8, np.uint64
        self.mesh = self._table(
            nodes=(3, f8), tetrahedra=(4, i4), neighbours=(4, i4), tetrahedron_edges=(6, i4), edges=(2, i4),
            edge_tets=(0, i4), boxes=(6, f4), barycentric=(12, f8), walls=(16, f4), moments=(10, f8),
            on_surface=(0, u1), node_normals=(3, f8), node_tets_begin=(0, i4), node_tets=(0, i4), first=(5, i4),
            grid=(4, f8), grid_dims=(4, i4), cell_begin=(0, i4), cell_tets=(0, i4), cell_parts=(0, u8),
            depth_grid=(4, f8), depth_grid_dims=(4, i4), grid_depth=(0, f8),
        )  # fmt: skip
        self.body = self._table(
            node_fragment=(0, i4), edge_plane=(0, i4), edge_event=(0, i4), edge_share=(0, f8), regions=(REGION, i4),
            cut_count=(0, i4), planes=(4, f8), triangles=(9, f8), faces=(4, f8),
            sides=(4, i4), node_field=(7, f8),
        )  # fmt: skip
        self.fragment = self._table(
            kind=(0, i4), mesh=(0, i4), node_shift=(0, i4), tet_shift=(0, i4), edge_shift=(0, i4), box=(6, f8),
            shape=(4, f8), radius=(0, f8), tree_begin=(0, i4), tree_end=(0, i4), cells=(7, i4),
            seeds=(2, i4), leaf_begin=(0, i4), leaf_end=(0, i4), middle=(4, f8),
        )  # fmt: skip
        self.tree = self._table(spheres=(4, f8), entries=(3, i4))
        self.samples = self._table(values=(LEAF_VALUES, f4), entries=(LEAF, i4))
        self.triangles = self._table(
            corners=(9, f8), features=(6, i4), pseudonormals=(3, f8), node_box=(6, f8), node_skip=(0, i4),
            node_first=(0, i4), node_count=(0, i4), node_range=(2, i4), triangle_range=(2, i4),
            first_vertex=(0, i4),
        )  # fmt: skip
        self.seeds = self._table(keys=(0, np.int64), ranges=(2, i4), edges=(0, i4))
        self.occupancy = GrowableArray(0, u8, self._changed)
        self._switches = traversal, field, normals
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
        mesh, body, fragment, tree, triangles, seeds = (
            {name: rows(column) for name, column in pool.items()}
            for pool in (self.mesh, self.body, self.fragment, self.tree, self.triangles, self.seeds)
        )
        samples = {name: rows(column).reshape(-1) for name, column in self.samples.items()}
        return Pools(
            MeshPool(**mesh), BodyPool(**body, region_planes=body["regions"].view(np.float32)),
            FragmentPool(**fragment), TreePool(**tree), SamplePool(**samples), rows(self.occupancy),
            TriangleMeshPool(**triangles), SeedPool(**seeds), *self._switches,
        )  # fmt: skip

    @property
    def bytes_used(self) -> int:
        """Bytes of all rows in the pools, without spare capacity."""
        pools = (self.mesh, self.body, self.fragment, self.tree, self.samples, self.triangles, self.seeds)
        columns = [column for pool in pools for column in pool.values()]
        return sum(column.used * column.row_bytes for column in (*columns, self.occupancy))

    def moment_origins(self, rows: np.ndarray) -> np.ndarray:
        """(n, 3) [m] points that the moments of fragments `rows` (n,), of tetrahedra or triangles, are about."""
        origins = self.fragment["box"].view[rows, :3]
        is_tetrahedral = self.fragment["kind"].view[rows] == TETRAHEDRA
        grids = self.fragment["mesh"].view[rows[is_tetrahedral]]
        origins[is_tetrahedral] = self.mesh["grid"].view[grids, :3]
        return origins

    def append_tree(self, tree: SphereTree) -> int:
        """Append a tree, or several consecutive ones; returns the row of the first root."""
        count = len(tree.size)
        spheres, entries = self.tree["spheres"].reserve(count), self.tree["entries"].reserve(count)
        spheres[:, :3], spheres[:, 3] = tree.center, tree.radius
        entries[:, SIZE], entries[:, SAMPLE] = tree.size, tree.sample
        entries[:, SURFACE] = surface_marks(tree.size, tree.on_surface)
        begin = self.tree["spheres"].advance(count)
        self.tree["entries"].advance(count)
        return begin

    def sphere_tree(self, row: int) -> SphereTree:
        """A copy of the tree of a fragment, by its row."""
        part = slice(int(self.fragment["tree_begin"].view[row]), int(self.fragment["tree_end"].view[row]))
        spheres, entries = self.tree["spheres"].view[part], self.tree["entries"].view[part]
        return SphereTree(
            spheres[:, :3].copy(), spheres[:, 3].copy(), entries[:, SIZE].copy(), entries[:, SAMPLE].copy(),
            (entries[:, SURFACE] == OWN_SAMPLE).astype(np.uint8),
        )  # fmt: skip

    def append_leaves(self, begins: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Append the leaves of samples of consecutive trees, rows begins[i] .. begins[i + 1] - 1 of the pool.

        begins (n + 1,). Returns where the leaves of each begin, (n + 1,), and their middles (n, 4).
        """
        spheres, entries = self.tree["spheres"].view, self.tree["entries"].view
        counts, middles = count_leaves(entries, begins), np.empty((len(begins) - 1, 4))
        total = int(counts.sum())
        columns = self.samples["values"].reserve(total), self.samples["entries"].reserve(total)
        fill_leaves(spheres, entries, begins, counts, *columns, middles)
        first = self.samples["values"].advance(total)
        self.samples["entries"].advance(total)
        return first + begins_of(counts), middles

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
        table["depth_grid"].append(np.zeros((1, 4)))
        table["depth_grid_dims"].append(np.zeros((1, 4)))
        return index, node, tet, edge
