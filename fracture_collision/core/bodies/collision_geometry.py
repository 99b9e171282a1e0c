"""Registry of all geometry of a world: bodies are added, fractures change it, the kernels read `pools`."""

from __future__ import annotations

import numpy as np

from fracture_collision.core.bodies.pool_compaction import compact
from fracture_collision.core.bodies.pool_tables import PoolTables
from fracture_collision.core.bodies.prepared import MassProperties, PreparedMesh, PreparedSurface, mass_of_shape
from fracture_collision.core.edges.ridges import append_ridges
from fracture_collision.core.fracture import touched_tetrahedra
from fracture_collision.core.fracture.crack_seeds import choose_seeds
from fracture_collision.core.fracture.crack_surfaces import rebuild_surfaces
from fracture_collision.core.fracture.surface_rows import Broken, Sums, SurfaceRows
from fracture_collision.core.fracture.touched_tetrahedra import Cut, Touched, touched_room
from fracture_collision.core.glondu2014.paper_geometry import PaperGeometry
from fracture_collision.core.memory.kinds import BOX, PLANE, SPHERE, TETRAHEDRA, TRIANGLES
from fracture_collision.core.memory.pools import FRAGMENT, MESH, NEVER_BROKEN, OWNER, REGION, SURFACE, Pools
from fracture_collision.core.memory.tables import GrowableArray, Moves, check_references
from fracture_collision.core.mesh.cut_tetrahedron import make_cut_scratch
from fracture_collision.core.mesh.moments import mass_properties
from fracture_collision.core.mesh.occupancy import cells_of_boxes, mark_all, mark_fragments
from fracture_collision.core.mesh.primitives import box_edge_points, box_sampling_gap
from fracture_collision.core.mesh.sample_numbers import FIRST_EDGE, FIRST_NODE, FIRST_TETRAHEDRON, NewSamples
from fracture_collision.core.mesh.triangle_field import append_triangle_mesh
from fracture_collision.core.patches.shapes import Geometry, append_shapes, triangles_of
from fracture_collision.core.samples.fragment_samples import deal_samples, new_samples
from fracture_collision.core.samples.sample_leaves import most_leaves

# [bytes] Less garbage is not worth a compaction: with the lists of all pairs, which it ends, it costs some 10 ms.
LEAST_GARBAGE = 1 << 25
# Columns of SamplePool: with a row for each sample, and for each leaf.
POINTS, LEAVES = ("points", "numbers"), ("values", "entries")


class CollisionGeometry:
    """Owns the pools. Fragments are addressed by row, in order of creation.

    paper: where the method of Glondu 2014 keeps what it needs; None: the geometry is for our method, with ridges and
    shapes instead.
    """

    def __init__(self, paper: PaperGeometry | None = None) -> None:
        self.paper = paper
        self._tables = PoolTables()
        self._scratch, self._room = make_cut_scratch(), touched_room(0)
        self._meshes: list[PreparedMesh] = []  # by row in the pools
        self._surfaces: list[PreparedSurface] = []
        self._has_garbage, self._kept = False, 0  # since the last compaction; [bytes] that it left

    @property
    def pools(self) -> Pools:
        """The pools as kernels read them; valid until the next change of the geometry."""
        return self._tables.pools

    @property
    def searched(self) -> Geometry:
        """The pools, with ridges and shapes of all fragments, which the method of the paper has not."""
        return self._tables.geometry.view

    def sampling_gaps(self, rows: np.ndarray) -> np.ndarray:
        """Upper bounds (n,) [m] of the distance from a surface point of fragments `rows` (n,) to its nearest sample."""
        return self._tables.measures["gaps"].view[rows]

    def tet_range(self, row: int) -> range:
        """Rows of the mesh of a tetrahedral fragment's body."""
        mesh = int(self._tables.fragment["mesh"].view[row])
        first = int(self._tables.mesh["first"].view[mesh, FIRST_TETRAHEDRON])
        return range(first, first + len(self._meshes[mesh].mesh.tetrahedra))

    def rigid_triangles(self, row: int) -> np.ndarray:
        """Corners (t, 3, 3) [m] of a rigid body of triangles."""
        begin, end = self._tables.triangles["triangle_range"].view[self._tables.fragment["mesh"].view[row]]
        return self._tables.triangles["corners"].view[begin:end].reshape(-1, 3, 3)

    def volume(self, row: int) -> float:
        """Volume [m3] of a body of tetrahedra or triangles, or of a fragment."""
        return float(self._tables.measures["moments"].view[row, 0])

    def mass_properties(self, rows: np.ndarray, density: np.ndarray) -> list[MassProperties]:
        """Mass properties of fragments `rows` (n,) with `density` (n,) [kg/m3] each."""
        kinds, shapes = (self._tables.fragment[name].view for name in ("kind", "shape"))
        meshed = np.isin(kinds[rows], (TETRAHEDRA, TRIANGLES))
        moments = self._tables.measures["moments"].view[rows[meshed]]
        origins = self._tables.moment_origins(rows[meshed])
        each = zip(*mass_properties(moments, origins, density[meshed]), strict=True)
        return [
            MassProperties(*next(each)) if mesh else mass_of_shape(int(kinds[row]), shapes[row], float(own))
            for row, own, mesh in zip(rows.tolist(), density, meshed.tolist(), strict=True)
        ]

    def retire_body(self) -> None:
        """All fragments of a body are gone: no query uses them again. `keep_only` frees their memory."""
        self._has_garbage = True

    def is_mostly_garbage(self) -> bool:
        """Whether there may be as much garbage as the last `keep_only` kept."""
        return self._has_garbage and self._tables.bytes_used > LEAST_GARBAGE + 2 * self._kept

    def keep_only(self, rows: np.ndarray) -> Moves:
        """Drop all data that fragments `rows` (n,) do not need; returns the Moves of their rows. Keeps their order."""
        moves = compact(self._tables, np.sort(rows))
        self._meshes = [self._meshes[k] for k in np.flatnonzero(moves[MESH].stays)]
        self._surfaces = [self._surfaces[k] for k in np.flatnonzero(moves[SURFACE].stays)]
        if self.paper is not None:
            self.paper.keep(moves)
        self._has_garbage, self._kept = False, self._tables.bytes_used
        return moves[FRAGMENT]

    def validate(self) -> None:
        """Raise AssertionError unless all rows agree with what their columns declare."""
        check_references(self._tables.all)

    def add_plane(self, normal: np.ndarray, offset: float) -> int:
        """Add a half-space normal . x <= offset [m], `normal` (3,) unit, outward; returns its row."""
        box = np.array([-np.inf] * 3 + [np.inf] * 3)
        return self._add_row(PLANE, box, np.append(normal, offset), np.inf, 0.0, -1)

    def add_sphere(self, radius: float) -> int:
        """Add a sphere of `radius` [m] about its frame's origin; returns its row.

        Its surface is searched as a whole (sphere_contacts.py), so its sampling gap is zero.
        """
        box = np.array([-radius] * 3 + [radius] * 3)
        return self._add_row(SPHERE, box, np.array([radius, 0.0, 0.0, 0.0]), radius, 0.0, -1)

    def add_box(self, half: np.ndarray) -> int:
        """Add a box of half edges `half` (3,) [m] about its frame's origin; returns its row."""
        points = box_edge_points(half)
        row = self._add_row(
            BOX, np.concatenate([-half, half]), np.append(half, 0.0), float(half.max()), box_sampling_gap(half), -1,
            **self._tables.append_samples(points, np.arange(len(points))),
        )  # fmt: skip
        if self.paper is not None:
            self.paper.add_body(points, np.ones(len(points), np.uint8), [])
        return row

    def add_tetrahedra(self, prepared: PreparedMesh) -> int:
        """Add a whole body of tetrahedra; equal `prepared` objects share their pool rows. Returns its row."""
        number, mesh = self._mesh_row(prepared), prepared.mesh
        row = self._add_row(
            TETRAHEDRA, mesh.box, np.zeros(4), 0.5 * float((mesh.box[3:] - mesh.box[:3]).max()), mesh.sampling_gap,
            number, **self._tables.whole.rows(number),
        )  # fmt: skip
        if self.paper is not None:
            self.paper.add_body(mesh.nodes, mesh.on_surface, prepared.paper)
        # summed one by one, as in a fracture, so that parts add up to the whole
        self._tables.measures["moments"].view[row] = mesh.moments.sum(axis=0)
        return row

    def add_triangles(self, prepared: PreparedSurface) -> int:
        """Add a rigid body of triangles; equal `prepared` objects share their pool rows. Returns its row."""
        number, box = self._surface_row(prepared), prepared.mesh.node_box[0]
        row = self._add_row(
            TRIANGLES, box, np.zeros(4), 0.5 * float((box[3:] - box[:3]).max()), prepared.sampling_gap, number,
            **self._tables.whole_surface.rows(number),
        )  # fmt: skip
        if self.paper is not None:
            self.paper.add_body(prepared.vertices, np.ones(len(prepared.vertices), np.uint8), prepared.paper)
        self._tables.measures["moments"].view[row] = prepared.moments
        return row

    def apply_fracture(
        self, row: int, nodes: np.ndarray, parts: np.ndarray, edges: np.ndarray, planes: np.ndarray, count: int
    ) -> int:
        """Break fragment `row` into `count` new rows; returns the first.

        nodes (n,): all its mesh nodes; parts (n,): the part of each, 0 .. count - 1; edges (k,): the cut mesh edges,
        ascending; planes (k, 4): unit normal from the edge's first node to its second, offset [m].
        """
        tables = self._tables
        prepared = self._meshes[int(tables.fragment["mesh"].view[row])]
        self._own_body_rows(row, prepared)
        first = [self._append(column, count) for column in (*tables.fragment, *tables.measures)][-1]
        cut = Cut(nodes, parts, edges, tables.body["planes"].append(planes))
        broken = Broken(
            row, first, first + count,
            *(int(tables.fragment[name].view[row]) for name in ("mesh", "node_shift", "tet_shift", "edge_shift")),
        )  # fmt: skip
        tetrahedra = len(prepared.mesh.tetrahedra)
        if len(self._room.kinds) < tetrahedra:
            self._room = touched_room(tetrahedra)
        touched = touched_tetrahedra.find_touched(tables.roomy, broken, cut, tetrahedra, self._sums(), self._room)
        self._has_garbage = True
        corners = self._rebuild_surfaces(broken, touched)
        new = new_samples(tables.roomy, broken, edges, corners)
        self._deal_samples(broken, new)
        self._choose_seeds(broken, len(prepared.mesh.edges), touched)
        if self.paper is not None:
            self.paper.break_fragment(self.pools, broken, new, (touched.rows, cut.first_plane), prepared.paper[0])
        self._find_ridges(broken.first, broken.end)
        return broken.first

    @staticmethod
    def _append(column: GrowableArray, count: int) -> int:
        """Append `count` rows, not initialized; returns the index of the first."""
        column.reserve(count)
        return column.advance(count)

    def _sums(self) -> Sums:
        """Sums of all fragments, to be changed in place."""
        measures = self._tables.measures
        return Sums(measures["moments"].view, measures["gaps"].view, self._tables.roomy.fragment.box)

    def _rebuild_surfaces(self, broken: Broken, touched: Touched) -> NewSamples:
        """Rebuild the polygons in the touched tetrahedra, and moments, boxes, gaps, cells of their fragments.

        Returns the samples at corners of these fragments.
        """
        tables = self._tables
        columns = [tables.body[name] for name in ("triangles", "faces", "sides")]
        first = columns[0].used
        room = SurfaceRows(first, *(column.reserve(touched.room) for column in columns))
        pools = tables.roomy
        written, corners, words = rebuild_surfaces(
            pools, broken, touched, room, tables.occupancy.used, self._sums(), self._scratch
        )
        for column in columns:
            column.advance(written)
        tables.occupancy.reserve(words)
        tables.occupancy.advance(words)
        mark_fragments(pools.mesh, pools.body, pools.fragment, tables.occupancy.whole, broken)
        return corners

    def _choose_seeds(self, broken: Broken, edges_of_mesh: int, touched: Touched) -> None:
        """Append the seeds of the body's pairs, after one of its fragments broke."""
        seeds, pools = self._tables.seeds, self._tables.roomy
        keys, ranges, edges = choose_seeds(
            pools, broken, edges_of_mesh, touched.cut, seeds["keys"].used, seeds["edges"].used
        )
        seeds["keys"].append(keys)
        seeds["ranges"].append(ranges)
        seeds["edges"].append(edges)

    def _own_body_rows(self, row: int, prepared: PreparedMesh) -> None:
        """Give a body that breaks for the first time its own labels, cuts and planes."""
        fragment, body, mesh = self._tables.fragment, self._tables.body, prepared.mesh
        if fragment["node_shift"].view[row] != NEVER_BROKEN:
            return
        number = int(fragment["mesh"].view[row])
        if self.paper is not None:
            self.paper.begin_body(mesh, number, prepared.paper[0])
        node = body["node_fragment"].fill(len(mesh.nodes), row)
        edge = body["edge_plane"].fill(len(mesh.edges), -1)
        body["edge_event"].fill(len(mesh.edges), 0)
        body["edge_share"].fill(len(mesh.edges), 0.0)
        whole = np.zeros(REGION, np.int32)
        whole[OWNER] = row
        tet = body["regions"].fill(len(mesh.tetrahedra), whole)
        body["cut_count"].fill(len(mesh.tetrahedra), 0)
        first = self._tables.mesh["first"].view[number]
        fragment["node_shift"].view[row] = node - first[FIRST_NODE]
        fragment["tet_shift"].view[row] = tet - first[FIRST_TETRAHEDRON]
        fragment["edge_shift"].view[row] = edge - first[FIRST_EDGE]

    def _deal_samples(self, broken: Broken, new: NewSamples) -> None:
        """Append the samples of the new fragments."""
        tables, fragment = self._tables, self._tables.fragment
        begin, end, leaf, leaf_end = (
            int(fragment[name].view[broken.parent])
            for name in ("sample_begin", "sample_end", "leaf_begin", "leaf_end")
        )
        most = end - begin + len(new.points), most_leaves(leaf_end - leaf, len(new.points), broken.end - broken.first)
        # reserving may reallocate a column
        room = [tables.samples[name].reserve(most[name in LEAVES]) for name in (*POINTS, *LEAVES)]
        first = tables.samples["points"].used, tables.samples["values"].used
        old = tables.samples["points"].view[begin:end], tables.samples["numbers"].view[begin:end]
        pools = tables.roomy
        counts = deal_samples(pools, old, broken, new, (*room, *first))
        for name in (*POINTS, *LEAVES):
            tables.samples[name].advance(counts[name in LEAVES])

    def _add_row(
        self, kind: int, box: np.ndarray, shape: np.ndarray, radius: float, gap: float, mesh: int,
        **samples: np.ndarray,
    ) -> int:  # fmt: skip
        """Add a row with these values; samples: SAMPLES_OF_WHOLE and cells, those that it has, a row each."""
        tables = self._tables
        values = dict(
            kind=kind, mesh=mesh, node_shift=NEVER_BROKEN, tet_shift=NEVER_BROKEN, edge_shift=NEVER_BROKEN, box=box,
            shape=shape, radius=radius,
        )  # fmt: skip
        given = {name: np.asarray(value)[None] for name, value in values.items()} | samples
        row = tables.fragment.append_row(**given)
        tables.measures.append_row(gaps=np.array([gap]))
        self._find_ridges(row, row + 1)
        if self.paper is not None and not samples:
            self.paper.add_without_tree()
        return row

    def _find_ridges(self, first: int, end: int) -> None:
        if self.paper is None:
            triangles, begin = triangles_of(self.pools, first, end)
            append_ridges(self._tables.ridges, self.pools, first, triangles, begin)
            append_shapes(self._tables.shapes, triangles, begin)

    def _mesh_row(self, prepared: PreparedMesh) -> int:
        row = next((k for k, known in enumerate(self._meshes) if known is prepared), None)
        if row is not None:
            return row
        mesh, tables = prepared.mesh, self._tables
        row = tables.append_mesh(mesh)
        cells = np.zeros((1, 7), np.int32)
        grid, dims = (tables.mesh[name].view[row] for name in ("grid", "grid_dims"))
        words = cells_of_boxes(mesh.box[None], grid, dims, tables.occupancy.used, cells)
        tables.occupancy.fill(words, 0)
        mark_all(self.pools.mesh, row, cells[0], tables.occupancy.view)
        on_surface = np.flatnonzero(mesh.on_surface)
        tables.whole.append_row(cells=cells, **tables.append_samples(mesh.nodes[on_surface], on_surface))
        self._meshes.append(prepared)
        return row

    def _surface_row(self, prepared: PreparedSurface) -> int:
        row = next((k for k, known in enumerate(self._surfaces) if known is prepared), None)
        if row is None:
            row, vertices = append_triangle_mesh(self._tables.triangles, prepared.mesh), prepared.vertices
            self._tables.whole_surface.append_row(**self._tables.append_samples(vertices, np.arange(len(vertices))))
            self._surfaces.append(prepared)
        return row
