"""All geometry of a world at one registry: bodies go in, fractures change it, `pools` is what the kernels read."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fracture_collision.core import fracture_update
from fracture_collision.core.crack_samples import crack_samples
from fracture_collision.core.fragment_trees import REBUILT, RESTRUCTURED, rebuilt_trees, split_trees
from fracture_collision.core.front_propagation import (
    OLD_SURFACE,
    SHORTER,
    measure_at_cracks,
    propagate_fronts,
    renew_certain_points,
)
from fracture_collision.core.interior_field import InteriorField, make_interior_field
from fracture_collision.core.kinds import BOX, PLANE, SPHERE, TETRAHEDRA, TRIANGLES
from fracture_collision.core.moments import (
    box_mass_properties,
    mass_properties,
    sphere_mass_properties,
    surface_moments,
)
from fracture_collision.core.occupancy import cells_of_box, fill_pyramid, mark_all, pyramid_bytes
from fracture_collision.core.pools import (
    ALTERNATING,
    AVERAGED,
    CRACK,
    EXACT,
    NEVER_BROKEN,
    OWN_SAMPLE,
    SAMPLE,
    SIZE,
    SURFACE,
    BodyPool,
    FragmentPool,
    GrowableArray,
    MeshPool,
    Pools,
    TreePool,
    TriangleMeshPool,
)
from fracture_collision.core.sphere_tree import SphereTree, build_sphere_tree, surface_marks
from fracture_collision.core.tet_mesh import TetMesh
from fracture_collision.core.triangle_field import TriangleMesh, append_triangle_mesh, build_triangle_mesh

# A box is sampled along its edges, where it pokes into faces of others; its faces answer in closed form. The spacing,
# as a share of the longest edge, keeps the tree of a long shelf small and a cube's edge well covered.
BOX_EDGE_SPACING = 1.0 / 64.0


class MassProperties(NamedTuple):
    mass: float  # [kg]
    center: np.ndarray  # (3,) [m], body frame
    inertia: np.ndarray  # (6,) [kg m2] about the centre, body axes: xx xy xz yy yz zz


class PreparedMesh(NamedTuple):
    """A tetrahedral mesh with the sphere tree of the whole body: the preprocess equal geometries share."""

    mesh: TetMesh
    tree: SphereTree
    interior: list[InteriorField]  # empty until a body of this geometry breaks under the averaged field


class PreparedSurface(NamedTuple):
    """A closed triangle mesh likewise, for a rigid body."""

    mesh: TriangleMesh
    tree: SphereTree
    moments: np.ndarray  # (10,), see moments.py
    sampling_gap: float  # [m]


class _MeshRows(NamedTuple):
    """Where a mesh begins in the pools."""

    index: int
    node: int
    tet: int
    edge: int
    tree: int
    cells: np.ndarray
    prepared: PreparedMesh


def prepare_mesh(mesh: TetMesh) -> PreparedMesh:
    """The tree over all nodes, surface and interior (section 6.1)."""
    return PreparedMesh(mesh, build_sphere_tree(mesh.nodes, mesh.on_surface), [])


def prepare_surface(vertices: np.ndarray, triangles: np.ndarray) -> PreparedSurface:
    """Preprocess a closed mesh (vertices (n, 3) [m], triangles (t, 3)); every vertex is a sample."""
    corners = vertices[triangles]
    longest = np.linalg.norm(corners - np.roll(corners, -1, axis=1), axis=2).max()
    return PreparedSurface(
        build_triangle_mesh(vertices, triangles),
        build_sphere_tree(vertices, np.ones(len(vertices), np.uint8)),
        surface_moments(corners),
        # the corners of a triangle with longest side L cover it with balls of radius L / sqrt(3)
        float(longest / np.sqrt(3.0)),
    )


def _table(**columns: tuple[int, type]) -> dict[str, GrowableArray]:
    return {name: GrowableArray(width, dtype) for name, (width, dtype) in columns.items()}


class CollisionGeometry:
    """Owner of the pools. Fragments are addressed by row, in the order in which they were made.

    tree: one of fragment_trees.TREES; traversal: one of pools.ALTERNATING, QUEUE; field: one of pools.EXACT, AVERAGED;
    normals: one of pools.NEAREST, CRACK.
    """

    def __init__(
        self, tree: str = RESTRUCTURED, traversal: int = ALTERNATING, field: int = EXACT, normals: int = CRACK
    ) -> None:
        self._tree_kind, self._traversal, self._field, self._normals = tree, traversal, field, normals
        f8, i4, u1 = np.float64, np.int32, np.uint8
        self._mesh = _table(
            nodes=(3, f8), tetrahedra=(4, i4), neighbours=(4, i4), tetrahedron_edges=(6, i4), edges=(2, i4),
            boxes=(6, f8), barycentric=(12, f8), moments=(10, f8), on_surface=(0, u1), node_tets_begin=(0, i4),
            node_tets=(0, i4), grid=(4, f8), grid_dims=(4, i4), cell_begin=(0, i4), cell_tets=(0, i4),
            tet_cells_begin=(0, i4), tet_cells=(0, i4), depth_grid=(4, f8), depth_grid_dims=(4, i4),
            grid_depth=(0, f8),
        )  # fmt: skip
        self._body = _table(
            node_fragment=(0, i4), edge_plane=(0, i4), edge_share=(2, f8), tet_fragment=(0, i4),
            cut_begin=(0, i4), cut_count=(0, i4), planes=(4, f8), triangles=(9, f8), faces=(4, f8),
            front=(0, i4), back=(0, i4), kind=(0, u1), node_field=(7, f8), node_certain_tet=(0, i4),
        )  # fmt: skip
        self._fragment = _table(
            kind=(0, i4), mesh=(0, i4), node_shift=(0, i4), tet_shift=(0, i4), edge_shift=(0, i4), box=(6, f8),
            shape=(4, f8), radius=(0, f8), tree_begin=(0, i4), tree_end=(0, i4), cells=(7, i4),
        )  # fmt: skip
        self._tree = _table(spheres=(4, f8), entries=(3, i4))
        self._triangles = _table(
            corners=(9, f8), features=(6, i4), pseudonormals=(3, f8), node_box=(6, f8), node_skip=(0, i4),
            node_first=(0, i4), node_count=(0, i4), node_range=(2, i4), triangle_range=(2, i4),
        )  # fmt: skip
        self._occupancy = GrowableArray(0, u1)
        self._moments = GrowableArray(10, f8)
        self._gaps = GrowableArray(0, f8)
        self._meshes: list[_MeshRows] = []
        self._surfaces: list[tuple[PreparedSurface, int, int]] = []  # with its rows in the pools: mesh, first of tree
        self._pools: Pools | None = None

    @property
    def pools(self) -> Pools:
        if self._pools is None:
            self._pools = Pools(
                MeshPool(**{k: a.view for k, a in self._mesh.items()}),
                BodyPool(**{k: a.view for k, a in self._body.items()}),
                FragmentPool(**{k: a.view for k, a in self._fragment.items()}),
                TreePool(**{k: a.view for k, a in self._tree.items()}),
                self._occupancy.view,
                TriangleMeshPool(**{k: a.view for k, a in self._triangles.items()}),
                self._traversal,
                self._field,
                self._normals,
            )
        return self._pools

    def sampling_gap(self, row: int) -> float:
        """[m] no point of the fragment's surface is farther from one of its samples."""
        return float(self._gaps.view[row])

    def tet_range(self, row: int) -> range:
        """Rows of the mesh of a tetrahedral fragment's body."""
        rows = self._meshes[self._fragment["mesh"].view[row]]
        return range(rows.tet, rows.tet + len(rows.prepared.mesh.tetrahedra))

    def rigid_triangles(self, row: int) -> np.ndarray:
        """Corners (t, 3, 3) [m] of a rigid body of triangles."""
        begin, end = self._triangles["triangle_range"].view[self._fragment["mesh"].view[row]]
        return self._triangles["corners"].view[begin:end].reshape(-1, 3, 3)

    def sphere_tree(self, row: int) -> SphereTree:
        """A copy of the fragment's tree."""
        part = slice(int(self._fragment["tree_begin"].view[row]), int(self._fragment["tree_end"].view[row]))
        spheres, entries = self._tree["spheres"].view[part], self._tree["entries"].view[part]
        return SphereTree(
            spheres[:, :3].copy(), spheres[:, 3].copy(), entries[:, SIZE].copy(), entries[:, SAMPLE].copy(),
            (entries[:, SURFACE] == OWN_SAMPLE).astype(np.uint8),
        )  # fmt: skip

    def tree_entries(self, row: int) -> int:
        return int(self._fragment["tree_end"].view[row] - self._fragment["tree_begin"].view[row])

    def mass_properties(self, row: int, density: float) -> MassProperties:
        kind, shape = self._fragment["kind"].view[row], self._fragment["shape"].view[row]
        if kind == PLANE:
            return MassProperties(0.0, np.zeros(3), np.zeros(6))
        if kind == SPHERE:
            return MassProperties(*sphere_mass_properties(float(shape[0]), density))
        if kind == BOX:
            return MassProperties(*box_mass_properties(shape[:3], density))
        return MassProperties(*mass_properties(self._moments.view[row], density))

    def add_plane(self, normal: np.ndarray, offset: float) -> int:
        """Half-space normal . x <= offset; `normal` unit."""
        box = np.array([-np.inf] * 3 + [np.inf] * 3)
        return self._add_row(PLANE, box, np.append(normal, offset), np.inf, 0, 0, 0.0)

    def add_sphere(self, radius: float) -> int:
        box = np.array([-radius] * 3 + [radius] * 3)
        return self._add_row(SPHERE, box, np.array([radius, 0.0, 0.0, 0.0]), radius, 0, 0, 0.0)

    def add_box(self, half: np.ndarray) -> int:
        """`half` (3,) [m] half edge lengths."""
        points = _box_edge_points(half)
        begin = self._append_tree(build_sphere_tree(points, np.ones(len(points), np.uint8)))
        # the point of a face farthest from its edges
        gap = float(np.sort(half)[1])
        return self._add_row(
            BOX,
            np.concatenate([-half, half]),
            np.append(half, 0.0),
            float(half.max()),
            begin,
            self._tree["entries"].used,
            gap,
        )

    def add_tetrahedra(self, prepared: PreparedMesh) -> int:
        """A whole body; equal `prepared` objects share their pool rows."""
        rows = self._mesh_rows(prepared)
        mesh = prepared.mesh
        row = self._add_row(
            TETRAHEDRA, mesh.box, np.zeros(4), 0.5 * float((mesh.box[3:] - mesh.box[:3]).max()),
            rows.tree, rows.tree + len(prepared.tree.size), mesh.sampling_gap, rows.index, rows.cells,
        )  # fmt: skip
        # summed one by one, as a fracture sums what is left, so that parts add up to the whole
        self._moments.view[row] = mesh.moments.sum(axis=0)
        return row

    def add_triangles(self, prepared: PreparedSurface) -> int:
        """A rigid body; equal `prepared` objects share their pool rows."""
        known = next((rows for rows in self._surfaces if rows[0] is prepared), None)
        if known is None:
            known = prepared, append_triangle_mesh(self._triangles, prepared.mesh), self._append_tree(prepared.tree)
            self._surfaces.append(known)
        _, mesh, tree = known
        box = prepared.mesh.node_box[0]
        row = self._add_row(
            TRIANGLES, box, np.zeros(4), 0.5 * float((box[3:] - box[:3]).max()), tree, tree + len(prepared.tree.size),
            prepared.sampling_gap, mesh,
        )  # fmt: skip
        self._moments.view[row] = prepared.moments
        return row

    def apply_fracture(
        self, row: int, nodes: np.ndarray, parts: np.ndarray, edges: np.ndarray, planes: np.ndarray, count: int
    ) -> int:
        """Break fragment `row` into `count` new rows; returns the first.

        nodes (n,): all its mesh nodes; parts (n,): the part of each, 0 .. count - 1; edges (k,): mesh edges it is cut
        at, ascending; planes (k, 4): unit normal from the edge's first node to its second, offset [m].
        """
        k = int(self._fragment["mesh"].view[row])
        rows = self._meshes[k]
        self._own_body_rows(row, rows)
        node_shift = int(self._fragment["node_shift"].view[row])
        tet_shift = int(self._fragment["tet_shift"].view[row])
        edge_shift = int(self._fragment["edge_shift"].view[row])
        first = self._fragment["kind"].used
        parent = {name: array.view[row].copy() for name, array in self._fragment.items()}
        for name, array in self._fragment.items():
            array.append(np.repeat(parent[name][None], count, axis=0))
        self._moments.append(np.zeros((count, 10)))
        self._gaps.append(np.zeros(count))
        first_plane = self._body["planes"].append(planes)
        self._pools = None
        pools, end = self.pools, first + count
        labels = pools.body.node_fragment
        visited = np.zeros(len(pools.mesh.tetrahedra), np.uint8)
        # node_tets_begin has one row more than nodes in each mesh before this one
        touched, own = fracture_update.tetrahedra_of_nodes(pools.mesh, rows.node + k, nodes, visited)
        tets = touched[:own]
        label_rows = nodes + (rows.node + node_shift)
        moments = self._moments.view
        labels[label_rows] = first + parts
        shared = fracture_update.tetrahedra_shared_by_three(pools.mesh, pools.body, node_shift, tets, first, end)
        labels[label_rows] = row
        if len(shared):
            fracture_update.external_moments(
                pools.mesh, pools.body, node_shift, edge_shift, shared, first, end, -1.0, moments
            )
        labels[label_rows] = first + parts
        pools.body.edge_plane[edges + (rows.edge + edge_shift)] = first_plane + np.arange(len(edges), dtype=np.int32)
        if len(shared):
            fracture_update.external_moments(
                pools.mesh, pools.body, node_shift, edge_shift, shared, first, end, 1.0, moments
            )
        crack_samples(pools.mesh, pools.body, node_shift, edge_shift, tets, first, end)
        empty = np.repeat([np.inf, -np.inf], 3)
        pools.fragment.box[first:end], reaches = empty, np.tile(empty, (count, 1))
        polygons = fracture_update.rebuild_surfaces(
            pools.mesh, pools.body, node_shift, tet_shift, edge_shift, touched, own, first, end,
            self._body["triangles"].used, moments, pools.fragment.box, reaches, self._gaps.view,
        )  # fmt: skip
        for name in polygons._fields:
            self._body[name].append(getattr(polygons, name))
        self._mark_cells(k, node_shift, tets, first, end, reaches)
        share = self._crack_shares(rows, node_shift, edge_shift, first, end)
        self._give_trees(row, rows.prepared.mesh, nodes, parts, edges, share, first, count)
        self._pools = None
        if self._field == AVERAGED:
            self._propagate(rows, node_shift, edge_shift, touched, tets, first, end, first_plane)
        return first

    def _propagate(self, rows, node_shift, edge_shift, touched, tets, first, end, first_plane) -> None:
        """Averaged field of fragments first .. end - 1, made by planes of row first_plane on (front_propagation.py)."""
        pools, interior = self.pools, rows.prepared.interior[0]
        n = len(interior.node_field)
        divided_anew = np.zeros(len(pools.mesh.tetrahedra), np.uint8)
        divided_anew[touched] = 1
        renew_certain_points(pools, divided_anew, rows.node, node_shift, interior.node_field)
        in_front, front = np.zeros(n, np.uint8), np.empty(n, np.int32)
        used = measure_at_cracks(
            pools, tets, rows.node, node_shift, edge_shift, first, end, first_plane, in_front, front
        )
        own = slice(rows.node + node_shift, rows.node + node_shift + n)
        propagate_fronts(
            rows.prepared.mesh.nodes, pools.body.node_fragment[own], pools.body.node_field[own],
            pools.body.node_certain_tet[own], interior.neighbours_begin, interior.neighbours, in_front, front, used,
            SHORTER * pools.fragment.radius[first],
        )  # fmt: skip

    def _give_trees(self, row, mesh, nodes, parts, edges, share, first, count) -> None:
        """Trees of fragments first .. first + count - 1, into which `row` broke."""
        part_of_node = np.full(len(mesh.nodes), -1, dtype=np.int32)
        part_of_node[nodes] = parts
        if self._tree_kind == REBUILT:
            trees = rebuilt_trees(mesh, part_of_node, share, count)
        else:
            ordered = self._tree_kind == RESTRUCTURED
            trees = split_trees(self.sphere_tree(row), mesh, part_of_node, edges, share, count, ordered)
        for i, tree in enumerate(trees):
            at = self._append_tree(tree)
            self._fragment["tree_begin"].view[first + i] = at
            self._fragment["tree_end"].view[first + i] = at + len(tree.size)

    def _crack_shares(self, rows, node_shift, edge_shift, first, end) -> np.ndarray:
        """edge_share (mesh edges, 2) at the cut edges of fragments first .. end - 1, infinity elsewhere."""
        mesh, body = rows.prepared.mesh, self.pools.body
        own = slice(rows.edge + edge_shift, rows.edge + edge_shift + len(mesh.edges))
        labels = body.node_fragment[mesh.edges + (rows.node + node_shift)]
        sampled = (body.edge_plane[own] >= 0)[:, None] & (labels >= first) & (labels < end)
        return np.where(sampled, body.edge_share[own], np.inf)

    def _mark_cells(self, k, node_shift, tets, first, end, reaches) -> None:
        grid, dims = self._mesh["grid"].view[k], self._mesh["grid_dims"].view[k, :3]
        cells = np.empty((end - first, 7), np.int32)
        for i, box in enumerate(reaches):
            cells[i] = cells_of_box(box, grid[:3], grid[3], dims, 0)
            cells[i, 6] = self._occupancy.append(np.zeros(pyramid_bytes(cells[i]), np.uint8))
        self._fragment["cells"].view[first:end] = cells
        occupancy = self._occupancy.view
        fracture_update.mark_cells(self.pools.mesh, k, self.pools.body, node_shift, tets, first, end, cells, occupancy)
        for row in cells:
            fill_pyramid(row, occupancy)

    def _own_body_rows(self, row: int, rows: _MeshRows) -> None:
        """A body that breaks for the first time gets labels, cuts and planes of its own."""
        if self._fragment["node_shift"].view[row] != NEVER_BROKEN:
            return
        mesh = rows.prepared.mesh
        if self._field == AVERAGED:
            interior = self._interior_field(row, rows)
            self._body["node_field"].append(interior.node_field)
            self._body["node_certain_tet"].append(np.full(len(mesh.nodes), OLD_SURFACE, np.int32))
        node = self._body["node_fragment"].append(np.full(len(mesh.nodes), row, np.int32))
        edge = self._body["edge_plane"].append(np.full(len(mesh.edges), -1, np.int32))
        self._body["edge_share"].append(np.ones((len(mesh.edges), 2)))
        tet = self._body["tet_fragment"].append(np.full(len(mesh.tetrahedra), row, np.int32))
        self._body["cut_begin"].append(np.zeros(len(mesh.tetrahedra), np.int32))
        self._body["cut_count"].append(np.zeros(len(mesh.tetrahedra), np.int32))
        self._fragment["node_shift"].view[row] = node - rows.node
        self._fragment["tet_shift"].view[row] = tet - rows.tet
        self._fragment["edge_shift"].view[row] = edge - rows.edge

    def _interior_field(self, row: int, rows: _MeshRows) -> InteriorField:
        """The averaged field of the whole body `row`; its grid goes into the pools with the first body of the mesh."""
        if not rows.prepared.interior:
            rows.prepared.interior.append(make_interior_field(self.pools, row, rows.node, rows.prepared.mesh))
        interior = rows.prepared.interior[0]
        if self._mesh["depth_grid_dims"].view[rows.index, 0] == 0:
            self._mesh["depth_grid"].view[rows.index] = np.append(interior.origin, interior.cell)
            first = self._mesh["grid_depth"].append(interior.depth)
            self._mesh["depth_grid_dims"].view[rows.index] = np.append(interior.dims, first)
            self._pools = None
        return interior

    def _append_tree(self, tree: SphereTree) -> int:
        begin = self._tree["entries"].used
        self._tree["spheres"].append(np.column_stack([tree.center, tree.radius]))
        marks = surface_marks(tree.size, tree.on_surface)
        self._tree["entries"].append(np.column_stack([tree.size, tree.sample, marks]))
        return begin

    def _add_row(self, kind, box, shape, radius, tree_begin, tree_end, gap, mesh=-1, cells=None) -> int:
        values = dict(
            kind=kind, mesh=mesh, node_shift=NEVER_BROKEN, tet_shift=NEVER_BROKEN, edge_shift=NEVER_BROKEN, box=box,
            shape=shape, radius=radius, tree_begin=tree_begin, tree_end=tree_end,
            cells=np.zeros(7, np.int32) if cells is None else cells,
        )  # fmt: skip
        for name, value in values.items():
            self._fragment[name].append(np.asarray(value)[None])
        self._moments.append(np.zeros((1, 10)))
        self._pools = None
        return self._gaps.append(np.array([gap]))

    def _mesh_rows(self, prepared: PreparedMesh) -> _MeshRows:
        for known in self._meshes:
            if known.prepared is prepared:
                return known
        mesh, table = prepared.mesh, self._mesh
        index, node, tet, edge = table["grid"].used, table["nodes"].used, table["tetrahedra"].used, table["edges"].used
        first_cell = table["cell_begin"].used
        table["nodes"].append(mesh.nodes)
        table["tetrahedra"].append(mesh.tetrahedra + node)
        table["neighbours"].append(np.where(mesh.neighbours < 0, -1, mesh.neighbours + tet))
        table["tetrahedron_edges"].append(mesh.tetrahedron_edges + edge)
        table["edges"].append(mesh.edges + node)
        for name in ("boxes", "barycentric", "moments", "on_surface"):
            table[name].append(getattr(mesh, name))
        table["node_tets_begin"].append(mesh.node_tets_begin + table["node_tets"].used)
        table["node_tets"].append(mesh.node_tets + tet)
        table["cell_begin"].append(mesh.cell_begin + table["cell_tets"].used)
        table["cell_tets"].append(mesh.cell_tets + tet)
        table["tet_cells_begin"].append(mesh.tet_cells_begin + table["tet_cells"].used)
        table["tet_cells"].append(mesh.tet_cells)
        table["grid"].append(np.append(mesh.grid_origin, mesh.grid_cell)[None])
        table["grid_dims"].append(np.append(mesh.grid_dims, first_cell)[None])
        table["depth_grid"].append(np.zeros((1, 4)))
        table["depth_grid_dims"].append(np.zeros((1, 4)))
        cells = cells_of_box(mesh.box, mesh.grid_origin, mesh.grid_cell, mesh.grid_dims, 0)
        cells[6] = self._occupancy.append(np.zeros(pyramid_bytes(cells), np.uint8))
        self._pools = None
        mark_all(self.pools.mesh, index, tet, tet + len(mesh.tetrahedra), cells, self._occupancy.view)
        fill_pyramid(cells, self._occupancy.view)
        rows = _MeshRows(index, node, tet, edge, self._append_tree(prepared.tree), cells, prepared)
        self._meshes.append(rows)
        self._pools = None
        return rows


def _box_edge_points(half: np.ndarray) -> np.ndarray:
    """Corners and evenly spaced points of the twelve edges, (n, 3) [m], no point twice."""
    step = 2.0 * float(half.max()) * BOX_EDGE_SPACING
    points = [np.array([x, y, z]) * half for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]
    for axis in range(3):
        pieces = max(int(np.ceil(2.0 * half[axis] / step - 1e-9)), 1)
        for t in np.linspace(-1.0, 1.0, pieces + 1)[1:-1]:
            for u in (-1, 1):
                for v in (-1, 1):
                    points.append(np.insert(np.array([u, v], float), axis, t) * half)
    return np.ascontiguousarray(points)
