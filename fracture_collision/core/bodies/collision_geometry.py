"""Registry of all geometry of a world: bodies are added, fractures change it, the kernels read `pools`."""

from __future__ import annotations

from collections import Counter

import numpy as np

from fracture_collision.core.bodies.pool_compaction import compact
from fracture_collision.core.bodies.pool_rows import (
    MeshRows,
    SampleRows,
    SurfaceMeshRows,
    bytes_of_broken,
    bytes_of_fragments,
    bytes_of_mesh,
)
from fracture_collision.core.bodies.pool_tables import PoolTables
from fracture_collision.core.bodies.prepared import MassProperties, PreparedMesh, PreparedSurface, mass_of_shape
from fracture_collision.core.edges.ridges import NO_RIDGES, Ridges, RidgeTable
from fracture_collision.core.fracture import touched_tetrahedra
from fracture_collision.core.fracture.crack_seeds import choose_seeds
from fracture_collision.core.fracture.crack_surfaces import rebuild_surfaces
from fracture_collision.core.fracture.surface_rows import Broken, Sums, SurfaceRows
from fracture_collision.core.fracture.touched_tetrahedra import Cut, Touched, touched_room
from fracture_collision.core.glondu2014.paper_geometry import PaperGeometry
from fracture_collision.core.memory.kinds import BOX, PLANE, SPHERE, TETRAHEDRA, TRIANGLES
from fracture_collision.core.memory.pools import NEVER_BROKEN, OWNER, REGION, GrowableArray, Pools
from fracture_collision.core.mesh.cut_tetrahedron import make_cut_scratch
from fracture_collision.core.mesh.moments import mass_properties
from fracture_collision.core.mesh.occupancy import cells_of_boxes, mark_all, mark_fragments
from fracture_collision.core.mesh.primitives import box_edge_points, box_sampling_gap
from fracture_collision.core.mesh.sample_numbers import NewSamples
from fracture_collision.core.mesh.triangle_field import append_triangle_mesh
from fracture_collision.core.patches.shapes import NO_SHAPES, Shapes, ShapeTable, triangles_of
from fracture_collision.core.samples.fragment_samples import deal_samples, new_samples
from fracture_collision.core.samples.sample_leaves import leaf_count, most_leaves

# [bytes] Less garbage is not worth a compaction.
LEAST_GARBAGE = 1 << 20
NO_SAMPLES = SampleRows(0, 0, 0, 0, np.zeros(4))


class CollisionGeometry:
    """Owns the pools. Fragments are addressed by row, in order of creation.

    paper: where the method of Glondu 2014 keeps what it needs; None: the geometry is for our method, with ridges and
    shapes instead.
    """

    def __init__(self, paper: PaperGeometry | None = None) -> None:
        self.paper = paper
        self._tables = PoolTables()
        self._moments = GrowableArray(10, np.float64)
        self._gaps = GrowableArray(0, np.float64)
        self._ridges = RidgeTable() if paper is None else None
        self._shapes = ShapeTable() if paper is None else None
        self._scratch, self._room = make_cut_scratch(), touched_room(0)
        self._meshes: list[tuple[PreparedMesh, MeshRows]] = []  # by row in the pools
        self._surfaces: list[tuple[PreparedSurface, SurfaceMeshRows]] = []
        self._bodies_of: Counter[int] = Counter()  # id of a preprocess -> number of bodies that use it
        self._garbage = 0  # [bytes] of bodies and fragments retired since the last compaction

    @property
    def pools(self) -> Pools:
        """The pools as kernels read them; valid until the next change of the geometry."""
        return self._tables.pools

    @property
    def ridges(self) -> Ridges:
        """Ridges of all fragments; empty for the method of the paper."""
        return NO_RIDGES if self._ridges is None else self._ridges.view

    @property
    def shapes(self) -> Shapes:
        """Hulls and surfaces of all fragments; empty for the method of the paper."""
        return NO_SHAPES if self._shapes is None else self._shapes.view

    def sampling_gaps(self, rows: np.ndarray) -> np.ndarray:
        """Upper bounds (n,) [m] of the distance from a surface point of fragments `rows` (n,) to its nearest sample."""
        return self._gaps.view[rows]

    def tet_range(self, row: int) -> range:
        """Rows of the mesh of a tetrahedral fragment's body."""
        prepared, rows = self._meshes[self._tables.fragment["mesh"].view[row]]
        return range(rows.tet, rows.tet + len(prepared.mesh.tetrahedra))

    def rigid_triangles(self, row: int) -> np.ndarray:
        """Corners (t, 3, 3) [m] of a rigid body of triangles."""
        begin, end = self._tables.triangles["triangle_range"].view[self._tables.fragment["mesh"].view[row]]
        return self._tables.triangles["corners"].view[begin:end].reshape(-1, 3, 3)

    def volume(self, row: int) -> float:
        """Volume [m3] of a body of tetrahedra or triangles, or of a fragment."""
        return float(self._moments.view[row, 0])

    def mass_properties(self, rows: np.ndarray, density: np.ndarray) -> list[MassProperties]:
        """Mass properties of fragments `rows` (n,) with `density` (n,) [kg/m3] each."""
        kinds, shapes = (self._tables.fragment[name].view for name in ("kind", "shape"))
        meshed = np.isin(kinds[rows], (TETRAHEDRA, TRIANGLES))
        moments, origins = self._moments.view[rows[meshed]], self._tables.moment_origins(rows[meshed])
        each = zip(*mass_properties(moments, origins, density[meshed]), strict=True)
        return [
            MassProperties(*next(each)) if mesh else mass_of_shape(int(kinds[row]), shapes[row], float(own))
            for row, own, mesh in zip(rows.tolist(), density, meshed.tolist(), strict=True)
        ]

    def retire_body(self, rows: np.ndarray) -> None:
        """Retire `rows` (n,), all fragments of one body: no query uses them again. `keep_only` frees their memory."""
        kind, index = (int(self._tables.fragment[name].view[rows[0]]) for name in ("kind", "mesh"))
        prepared: PreparedMesh | PreparedSurface | None = None
        if kind == TETRAHEDRA:
            prepared = self._meshes[index][0]
        elif kind == TRIANGLES:
            prepared = self._surfaces[index][0]
        self._garbage += bytes_of_fragments(
            self._tables, rows, self._meshes[index][1] if kind == TETRAHEDRA else None, kind != TRIANGLES
        )
        self._bodies_of[id(prepared)] -= 1
        if prepared is not None and not self._bodies_of[id(prepared)]:
            self._garbage += bytes_of_mesh(prepared)

    def is_mostly_garbage(self) -> bool:
        """Whether `keep_only` would copy at most as many bytes as were retired since the last call."""
        return self._garbage > LEAST_GARBAGE and 2 * self._garbage > self._tables.bytes_used

    def keep_only(self, rows: np.ndarray) -> np.ndarray:
        """Drop all data that fragments `rows` (n,) do not need; returns their new rows (n,). Keeps their order."""
        own = [own for _, own in self._meshes], [own for _, own in self._surfaces]
        moved, meshes, surfaces = compact(self._tables, (self._moments, self._gaps), np.sort(rows), *own)
        self._meshes = [(self._meshes[old][0], new) for old, new in meshes]
        self._surfaces = [(self._surfaces[old][0], new) for old, new in surfaces]
        if self._ridges is not None and self._shapes is not None:
            self._ridges.keep(moved.fragments.stays)
            self._shapes.keep(moved.fragments.stays)
        if self.paper is not None:
            self.paper.keep(*moved)
        self._garbage = 0
        return moved.fragments.position[rows]

    def add_plane(self, normal: np.ndarray, offset: float) -> int:
        """Add a half-space normal . x <= offset [m], `normal` (3,) unit, outward; returns its row."""
        box = np.array([-np.inf] * 3 + [np.inf] * 3)
        return self._add_row(PLANE, box, np.append(normal, offset), np.inf, NO_SAMPLES, 0.0)

    def add_sphere(self, radius: float) -> int:
        """Add a sphere of `radius` [m] about its frame's origin; returns its row.

        Its surface is searched as a whole (sphere_contacts.py), so its sampling gap is zero.
        """
        box = np.array([-radius] * 3 + [radius] * 3)
        return self._add_row(SPHERE, box, np.array([radius, 0.0, 0.0, 0.0]), radius, NO_SAMPLES, 0.0)

    def add_box(self, half: np.ndarray) -> int:
        """Add a box of half edges `half` (3,) [m] about its frame's origin; returns its row."""
        points = box_edge_points(half)
        own = self._append_samples(points, np.arange(len(points)))
        row = self._add_row(
            BOX, np.concatenate([-half, half]), np.append(half, 0.0), float(half.max()), own, box_sampling_gap(half)
        )
        if self.paper is not None:
            self.paper.add_body(points, np.ones(len(points), np.uint8), [])
        return row

    def add_tetrahedra(self, prepared: PreparedMesh) -> int:
        """Add a whole body of tetrahedra; equal `prepared` objects share their pool rows. Returns its row."""
        rows = self._mesh_rows(prepared)
        self._bodies_of[id(prepared)] += 1
        mesh = prepared.mesh
        row = self._add_row(
            TETRAHEDRA, mesh.box, np.zeros(4), 0.5 * float((mesh.box[3:] - mesh.box[:3]).max()), rows.samples,
            mesh.sampling_gap, rows.number, rows.cells,
        )  # fmt: skip
        if self.paper is not None:
            self.paper.add_body(mesh.nodes, mesh.on_surface, prepared.paper)
        # summed one by one, as in a fracture, so that parts add up to the whole
        self._moments.view[row] = mesh.moments.sum(axis=0)
        return row

    def add_triangles(self, prepared: PreparedSurface) -> int:
        """Add a rigid body of triangles; equal `prepared` objects share their pool rows. Returns its row."""
        rows = next((rows for known, rows in self._surfaces if known is prepared), None)
        if rows is None:
            tables = self._tables
            rows = SurfaceMeshRows(
                append_triangle_mesh(tables.triangles, prepared.mesh),
                self._append_samples(prepared.vertices, np.arange(len(prepared.vertices))),
            )
            self._surfaces.append((prepared, rows))
        self._bodies_of[id(prepared)] += 1
        box = prepared.mesh.node_box[0]
        row = self._add_row(
            TRIANGLES, box, np.zeros(4), 0.5 * float((box[3:] - box[:3]).max()), rows.samples, prepared.sampling_gap,
            rows.number,
        )  # fmt: skip
        if self.paper is not None:
            self.paper.add_body(prepared.vertices, np.ones(len(prepared.vertices), np.uint8), prepared.paper)
        self._moments.view[row] = prepared.moments
        return row

    def apply_fracture(
        self, row: int, nodes: np.ndarray, parts: np.ndarray, edges: np.ndarray, planes: np.ndarray, count: int
    ) -> int:
        """Break fragment `row` into `count` new rows; returns the first.

        nodes (n,): all its mesh nodes; parts (n,): the part of each, 0 .. count - 1; edges (k,): the cut mesh edges,
        ascending; planes (k, 4): unit normal from the edge's first node to its second, offset [m].
        """
        tables = self._tables
        prepared, rows = self._meshes[int(tables.fragment["mesh"].view[row])]
        was_broken = bool(tables.fragment["node_shift"].view[row] != NEVER_BROKEN)
        self._own_body_rows(row, prepared, rows)
        first = [self._append(column, count) for column in (*tables.fragment.values(), self._moments, self._gaps)][-1]
        cut = Cut(nodes, parts, edges, tables.body["planes"].append(planes))
        broken = Broken(
            row, first, first + count,
            *(int(tables.fragment[name].view[row]) for name in ("mesh", "node_shift", "tet_shift", "edge_shift")),
        )  # fmt: skip
        tetrahedra = len(prepared.mesh.tetrahedra)
        if len(self._room.kinds) < tetrahedra:
            self._room = touched_room(tetrahedra)
        touched = touched_tetrahedra.find_touched(tables.roomy, broken, cut, tetrahedra, self._sums(), self._room)
        if was_broken:
            self._garbage += bytes_of_broken(tables, row, touched.rows)
        corners = self._rebuild_surfaces(broken, touched)
        new = new_samples((tables.roomy.mesh, tables.roomy.body), broken, edges, corners)
        self._deal_samples(broken, new)
        self._choose_seeds(broken, rows, touched)
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
        return Sums(self._moments.view, self._gaps.view, self._tables.roomy.fragment.box)

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
            (pools.mesh, pools.body, pools.fragment), broken, touched, room, tables.occupancy.used, self._sums(),
            self._scratch,
        )  # fmt: skip
        for column in columns:
            column.advance(written)
        tables.occupancy.reserve(words)
        tables.occupancy.advance(words)
        mark_fragments(pools.mesh, pools.body, pools.fragment, tables.occupancy.whole, broken)
        return corners

    def _choose_seeds(self, broken: Broken, rows: MeshRows, touched: Touched) -> None:
        """Append the seeds of the body's pairs, after one of its fragments broke."""
        seeds, pools = self._tables.seeds, self._tables.roomy
        keys, ranges, edges = choose_seeds(
            (pools.mesh, pools.body, pools.fragment, pools.seeds), broken, rows.counts[2], touched.cut,
            seeds["keys"].used, seeds["edges"].used,
        )  # fmt: skip
        seeds["keys"].append(keys)
        seeds["ranges"].append(ranges)
        seeds["edges"].append(edges)

    def _own_body_rows(self, row: int, prepared: PreparedMesh, rows: MeshRows) -> None:
        """Give a body that breaks for the first time its own labels, cuts and planes."""
        if self._tables.fragment["node_shift"].view[row] != NEVER_BROKEN:
            return
        mesh = prepared.mesh
        if self.paper is not None:
            self.paper.begin_body(mesh, rows.number, prepared.paper[0])
        node = self._tables.body["node_fragment"].fill(len(mesh.nodes), row)
        edge = self._tables.body["edge_plane"].fill(len(mesh.edges), -1)
        self._tables.body["edge_event"].fill(len(mesh.edges), 0)
        self._tables.body["edge_share"].fill(len(mesh.edges), 0.0)
        whole = np.zeros(REGION, np.int32)
        whole[OWNER] = row
        tet = self._tables.body["regions"].fill(len(mesh.tetrahedra), whole)
        self._tables.body["cut_count"].fill(len(mesh.tetrahedra), 0)
        self._tables.fragment["node_shift"].view[row] = node - rows.node
        self._tables.fragment["tet_shift"].view[row] = tet - rows.tet
        self._tables.fragment["edge_shift"].view[row] = edge - rows.edge

    def _append_samples(self, points: np.ndarray, numbers: np.ndarray) -> SampleRows:
        begin, leaf, middle = self._tables.append_samples(points, numbers)
        return SampleRows(begin, begin + len(points), leaf, leaf + leaf_count(len(points)), middle)

    def _deal_samples(self, broken: Broken, new: NewSamples) -> None:
        """Append the samples of the new fragments."""
        tables, fragment = self._tables, self._tables.fragment
        begin, end, leaf, leaf_end = (
            int(fragment[name].view[broken.parent])
            for name in ("sample_begin", "sample_end", "leaf_begin", "leaf_end")
        )
        most = end - begin + len(new.points), most_leaves(leaf_end - leaf, len(new.points), broken.end - broken.first)
        # reserving may reallocate a column
        room = [column.reserve(most[0]) for column in tables.samples.values()]
        room += [column.reserve(most[1]) for column in tables.leaves.values()]
        first = tables.samples["points"].used, tables.leaves["values"].used
        old = tables.samples["points"].view[begin:end], tables.samples["numbers"].view[begin:end]
        pools = tables.roomy
        count, leaves = deal_samples((pools.mesh, pools.body, pools.fragment), old, broken, new, (*room, *first))
        for column in tables.samples.values():
            column.advance(count)
        for column in tables.leaves.values():
            column.advance(leaves)

    def _add_row(self, kind, box, shape, radius, samples, gap, mesh=-1, cells=None) -> int:
        values = dict(
            kind=kind, mesh=mesh, node_shift=NEVER_BROKEN, tet_shift=NEVER_BROKEN, edge_shift=NEVER_BROKEN, box=box,
            shape=shape, radius=radius, sample_begin=samples.begin, sample_end=samples.end,
            leaf_begin=samples.leaf_begin, leaf_end=samples.leaf_end, middle=samples.middle,
            seeds=np.zeros(2, np.int32),
            cells=np.zeros(7, np.int32) if cells is None else cells,
        )  # fmt: skip
        for name, value in values.items():
            self._tables.fragment[name].append(np.asarray(value)[None])
        self._moments.append(np.zeros((1, 10)))
        row = self._gaps.append(np.array([gap]))
        self._find_ridges(row, row + 1)
        if self.paper is not None and samples is NO_SAMPLES:
            self.paper.add_without_tree()
        return row

    def _find_ridges(self, first: int, end: int) -> None:
        if self._ridges is not None and self._shapes is not None:
            triangles, begin = triangles_of(self.pools, first, end)
            self._ridges.append(self.pools, first, triangles, begin)
            self._shapes.append(triangles, begin)

    def _mesh_rows(self, prepared: PreparedMesh) -> MeshRows:
        for known, rows in self._meshes:
            if known is prepared:
                return rows
        mesh, tables = prepared.mesh, self._tables
        index, node, tet, edge = tables.append_mesh(mesh)
        cells = np.zeros((1, 7), np.int32)
        grid, dims = (tables.mesh[name].view[index] for name in ("grid", "grid_dims"))
        words = cells_of_boxes(mesh.box[None], grid, dims, tables.occupancy.used, cells)
        tables.occupancy.fill(words, 0)
        mark_all(self.pools.mesh, index, cells[0], tables.occupancy.view)
        counts = len(mesh.nodes), len(mesh.tetrahedra), len(mesh.edges)
        on_surface = np.flatnonzero(mesh.on_surface)
        own = self._append_samples(mesh.nodes[on_surface], on_surface)
        rows = MeshRows(index, node, tet, edge, own, cells[0], counts)
        self._meshes.append((prepared, rows))
        return rows
