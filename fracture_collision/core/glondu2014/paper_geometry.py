"""What the paper's method keeps of each body and fragment: sphere trees and the averaged field."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fracture_collision.core.fracture.surface_rows import Broken
from fracture_collision.core.glondu2014.fragment_trees import TreeTable
from fracture_collision.core.glondu2014.front_propagation import update_averaged_field
from fracture_collision.core.glondu2014.interior_field import InteriorField, make_interior_field
from fracture_collision.core.glondu2014.paper_pools import (
    AVERAGED,
    GRID_POINT,
    QUEUE,
    REBUILT,
    TREE_ENTRY,
    FieldPool,
    PaperPools,
)
from fracture_collision.core.glondu2014.sphere_tree import SphereTree, build_sphere_tree
from fracture_collision.core.memory.pools import MESH, Pools
from fracture_collision.core.memory.tables import Moves, Table, moves_of_ranges
from fracture_collision.core.mesh.sample_numbers import NewSamples
from fracture_collision.core.mesh.tet_mesh import TetMesh


class Preprocess(NamedTuple):
    """What equal geometries share, made when the method is first used on one of them."""

    tree: SphereTree  # of the whole body (6.1)
    interior: list[InteriorField]  # empty until a body of this geometry breaks under the averaged field


class PaperGeometry:
    """Rows of fragments, meshes and nodes are those of the Pools.

    field, tree, traversal: constants of paper_pools.py.
    """

    def __init__(self, field: str, tree: str, traversal: str) -> None:
        self._field, self._tree, self._in_a_row = field, tree, traversal == QUEUE
        self._trees = TreeTable()
        self._whole: list[tuple[Preprocess, tuple[int, int]]] = []  # and the entries of its tree
        self._values = Table(FieldPool)
        self._pools: PaperPools | None = None

    @property
    def pools(self) -> PaperPools:
        """As kernels read it; the same until the next change."""
        trees, field = self._trees.view, self._values.view
        if self._pools is None or self._pools.trees is not trees or self._pools.field is not field:
            self._pools = PaperPools(trees, field, self._field == AVERAGED, self._in_a_row)
        return self._pools

    def sphere_tree(self, row: int) -> SphereTree:
        """A copy of a fragment's tree."""
        return self._trees.tree_of(row)

    def add_without_tree(self) -> None:
        """The next fragment is a plane or a sphere."""
        self._trees.of_next(0, 0)

    def add_body(self, points: np.ndarray, on_surface: np.ndarray, shared: list[Preprocess]) -> None:
        """The next fragment is a whole body; shared: empty, or what was made of an equal geometry."""
        if not shared:
            shared.append(Preprocess(build_sphere_tree(points, on_surface), []))
        rows = next((rows for made, rows in self._whole if made is shared[0]), None)
        if rows is None:
            rows = self._trees.append(shared[0].tree)
            self._whole.append((shared[0], rows))
        self._trees.of_next(*rows)

    def begin_body(self, mesh: TetMesh, number: int, made: Preprocess) -> None:
        """The body of mesh `number` breaks for the first time."""
        if self._field != AVERAGED:
            return
        if not made.interior:
            made.interior.append(make_interior_field(mesh))
        interior = made.interior[0]
        self._values["node_field"].append(interior.node_field)
        self._fill_up(number + 1)
        dims = self._values["grid_dims"].view
        if dims[number, 0] == 0:
            self._values["grid"].view[number] = np.append(interior.origin, interior.cell)
            dims[number] = np.append(interior.dims, self._values["grid_depth"].append(interior.depth))

    def break_fragment(
        self, pools: Pools, broken: Broken, new: NewSamples, tetrahedra: tuple[np.ndarray, int], made: Preprocess
    ) -> None:
        """Append the new fragments of a Broken, after their rows in `pools`.

        tetrahedra: rows (t,) of those that the cracks touch, and the first of their planes.
        """
        if self._tree == REBUILT:
            self._trees.rebuild(pools, broken)
        else:
            self._trees.split(pools, broken, new, self._tree)
        if self._field == AVERAGED:
            interior = made.interior[0]
            neighbours = interior.neighbours_begin, interior.neighbours
            update_averaged_field(pools, self._values["node_field"].view, neighbours, broken, *tetrahedra)

    def keep(self, moves: dict[str, Moves]) -> None:
        """Keep what belongs to rows that stay, by the moves of all of them."""
        self._trees.keep(moves)
        trees = moves[TREE_ENTRY]
        # a later body of an equal geometry appends its tree again
        self._whole = [
            (made, (int(trees.of(begin)), int(trees.of(end))))
            for made, (begin, end) in self._whole
            if trees.stays[begin:end].all()
        ]
        self._fill_up(len(moves[MESH].stays))
        dims = self._values["grid_dims"].view[moves[MESH].stays].astype(np.int64)
        ends = dims[:, 3] + dims[:, :3].prod(axis=1)
        moves[GRID_POINT] = moves_of_ranges(self._values["grid_depth"].used, dims[:, 3], ends)
        self._values.move(moves)

    def _fill_up(self, meshes: int) -> None:
        """Meshes of which no body is broken have a row, too."""
        for name in ("grid", "grid_dims"):
            self._values[name].fill(max(meshes - self._values[name].used, 0), 0)
