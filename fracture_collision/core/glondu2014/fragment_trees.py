"""The sphere trees of new fragments, in the three variants that Glondu 2014, section 7.3 compares.

RESTRUCTURED: split, restructured and extended (6.2, 6.3). PLAIN: split without regard to the maximum-distance order, as
in the paper's earlier version, its reference [27]. REBUILT: built from scratch on the samples of the new surface. The
body before its first fracture has the same tree in all three. Sample numbers: sample_numbers.py.
"""

from __future__ import annotations

import numpy as np

from fracture_collision.core.fracture.surface_rows import Broken
from fracture_collision.core.glondu2014.paper_pools import PLAIN, SAMPLE, TREE_ENTRY, TreePool
from fracture_collision.core.glondu2014.sphere_tree import SphereTree, build_sphere_tree, surface_marks
from fracture_collision.core.glondu2014.sphere_tree_split import TreeArrays, rows_of_split, split_sphere_tree
from fracture_collision.core.memory.pools import FRAGMENT, Pools
from fracture_collision.core.memory.tables import Moves, Table, moves_of_ranges
from fracture_collision.core.mesh.sample_numbers import NewSamples
from fracture_collision.core.samples.fragment_samples import parts_of


class TreeTable:
    """Owns the trees of all fragments."""

    def __init__(self) -> None:
        self._rows = Table(TreePool)

    @property
    def view(self) -> TreePool:
        """The trees of all fragments, as kernels read them."""
        return self._rows.view

    def append(self, tree: SphereTree) -> tuple[int, int]:
        """Append a tree; returns its first entry and the end."""
        marks = surface_marks(tree.size, tree.on_surface)
        begin = self._rows["entries"].append(np.column_stack([tree.size, tree.sample, marks]))
        return self._rows["spheres"].append(np.column_stack([tree.center, tree.radius])), begin + len(tree.size)

    def of_next(self, begin: int, end: int) -> None:
        """Give the next fragment these entries."""
        self._rows["ranges"].append(np.array([[begin, end]], np.int32))

    def split(self, pools: Pools, broken: Broken, new: NewSamples, variant: str) -> None:
        """Append the RESTRUCTURED or PLAIN trees of the new fragments of a Broken; `new` without old corners' parts."""
        begin, end = self._rows["ranges"].view[broken.parent]
        entries = self._rows["entries"].view[begin:end]
        room = rows_of_split(entries, len(new.points))
        out = TreeArrays(self._rows["spheres"].reserve(room), self._rows["entries"].reserve(room))
        old = TreeArrays(self._rows["spheres"].view[begin:end], self._rows["entries"].view[begin:end])
        parts = parts_of(pools, broken, np.ascontiguousarray(entries[:, SAMPLE]))
        ends = split_sphere_tree(old, parts, broken.end - broken.first, new, variant != PLAIN, out)
        first = self._rows["spheres"].advance(int(ends[-1]))
        self._rows["entries"].advance(int(ends[-1]))
        for f in range(broken.end - broken.first):
            self.of_next(first + int(ends[f]), first + int(ends[f + 1]))

    def rebuild(self, pools: Pools, broken: Broken) -> None:
        """Append the REBUILT trees of the new fragments, from their samples."""
        for f in range(broken.first, broken.end):
            own = slice(pools.fragment.sample_begin[f], pools.fragment.sample_end[f])
            points, numbers = pools.samples.points[own], pools.samples.numbers[own]
            tree = build_sphere_tree(points, np.ones(len(points), np.uint8))
            self.of_next(*self.append(tree._replace(sample=numbers[tree.sample])))

    def keep(self, moves: dict[str, Moves]) -> None:
        """Keep the trees of the fragments that stay, by the moves of all rows, to which those of entries are added."""
        ranges = self._rows["ranges"].view[moves[FRAGMENT].stays]
        moves[TREE_ENTRY] = moves_of_ranges(self._rows["entries"].used, ranges[:, 0], ranges[:, 1])
        self._rows.move(moves)

    def tree_of(self, row: int) -> SphereTree:
        """A copy of the tree of a fragment, by its row."""
        own = slice(*self._rows["ranges"].view[row])
        return tree_of_rows(self._rows["spheres"].view[own], self._rows["entries"].view[own])


def tree_of_rows(spheres: np.ndarray, entries: np.ndarray) -> SphereTree:
    """A copy of a tree in rows of TreePool."""
    size, sample, surface = (np.ascontiguousarray(entries[:, c]) for c in range(3))
    return SphereTree(spheres[:, :3].copy(), spheres[:, 3].copy(), size, sample, (surface == 1).astype(np.uint8))
