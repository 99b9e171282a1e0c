"""All tables of a world, and what appends to several of their columns."""

from __future__ import annotations

import numpy as np

from fracture_collision.core.memory.kinds import TETRAHEDRA
from fracture_collision.core.memory.pools import (
    SAMPLES_OF_WHOLE,
    BodyPool,
    FragmentPool,
    Measures,
    MeshPool,
    Pools,
    SamplePool,
    SeedPool,
    TriangleMeshPool,
    Whole,
    WholeSurface,
)
from fracture_collision.core.memory.struct import Struct
from fracture_collision.core.memory.tables import GrowableArray, Table
from fracture_collision.core.mesh.tet_mesh import TetMesh
from fracture_collision.core.patches.shapes import Geometry
from fracture_collision.core.samples.sample_leaves import fill_leaves, leaf_count


class _World(Struct):
    geometry: Geometry
    measures: Measures
    whole: Whole
    whole_surface: WholeSurface


class PoolTables:
    """The tables by name. Those of ridges and shapes stay empty for the method of the paper."""

    def __init__(self) -> None:
        self.all: Table[_World] = Table(_World)
        self.geometry: Table[Geometry] = self.all.tables["geometry"]
        self.measures: Table[Measures] = self.all.tables["measures"]
        self.whole: Table[Whole] = self.all.tables["whole"]
        self.whole_surface: Table[WholeSurface] = self.all.tables["whole_surface"]
        self.ridges, self.shapes = self.geometry.tables["edges"], self.geometry.tables["shapes"]
        pools: Table[Pools] = self.geometry.tables["pools"]
        self._pools, of = pools, pools.tables
        self.mesh: Table[MeshPool] = of["mesh"]
        self.body: Table[BodyPool] = of["body"]
        self.fragment: Table[FragmentPool] = of["fragment"]
        self.samples: Table[SamplePool] = of["samples"]
        self.triangles: Table[TriangleMeshPool] = of["triangles"]
        self.seeds: Table[SeedPool] = of["seeds"]

    @property
    def pools(self) -> Pools:
        """The pools as kernels read them: the same until a column changes."""
        return self._pools.view

    @property
    def roomy(self) -> Pools:
        """`pools` with the spare capacity behind each column's rows: the same until a column is reallocated."""
        return self._pools.whole

    @property
    def occupancy(self) -> GrowableArray:
        """The column of Pools.occupancy."""
        return self._pools["occupancy"]

    @property
    def bytes_used(self) -> int:
        """Bytes of all rows, without spare capacity."""
        return self.all.bytes_used

    def moment_origins(self, rows: np.ndarray) -> np.ndarray:
        """(n, 3) [m] points that the moments of fragments `rows` (n,), of tetrahedra or triangles, are about."""
        origins = self.fragment["box"].view[rows, :3]
        is_tetrahedral = self.fragment["kind"].view[rows] == TETRAHEDRA
        grids = self.fragment["mesh"].view[rows[is_tetrahedral]]
        origins[is_tetrahedral] = self.mesh["grid"].view[grids, :3]
        return origins

    def append_samples(self, points: np.ndarray, numbers: np.ndarray) -> dict[str, np.ndarray]:
        """Append samples (s, 3) [m] with `numbers` (s,), and their leaves; returns SAMPLES_OF_WHOLE, a row each."""
        leaves, middles = leaf_count(len(points)), np.empty((1, 4))
        values, entries = (self.samples[name].reserve(leaves) for name in ("values", "entries"))
        fill_leaves(np.ascontiguousarray(points), np.array([0, len(points)]), values, entries, middles)
        leaf = self.samples["values"].advance(leaves)
        self.samples["entries"].advance(leaves)
        self.samples["numbers"].append(numbers)
        begin = self.samples["points"].append(points)
        rows = (np.array([row]) for row in (begin, begin + len(points), leaf, leaf + leaves))
        return dict(zip(SAMPLES_OF_WHOLE, (*rows, middles), strict=True))

    def append_mesh(self, mesh: TetMesh) -> int:
        """Append a mesh; returns its row."""
        table = self.mesh
        node, tet, edge = table["nodes"].used, table["tetrahedra"].used, table["edges"].used
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
        table["grid_dims"].append(np.append(mesh.grid_dims, first_cell)[None])
        return table["grid"].append(np.append(mesh.grid_origin, mesh.grid_cell)[None])
