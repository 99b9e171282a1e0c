"""The sphere trees of new fragments, in the three variants that Glondu 2014, section 7.3 compares.

RESTRUCTURED: split, restructured and extended (6.2, 6.3). PLAIN: split without regard to the maximum-distance order, as
in the paper's earlier version, its reference [27]. REBUILT: built from scratch on the samples of the new surface. The
body before its first fracture has the same tree in all three. Sample numbers: sample_numbers.py.
"""

from __future__ import annotations

import numpy as np

from fracture_collision.core.fracture.surface_rows import Broken
from fracture_collision.core.glondu2014.paper_pools import PLAIN, SAMPLE, TreePool
from fracture_collision.core.glondu2014.sphere_tree import SphereTree, build_sphere_tree, surface_marks
from fracture_collision.core.glondu2014.sphere_tree_split import TreeArrays, rows_of_split, split_sphere_tree
from fracture_collision.core.memory.moves import Moves, moves_of_ranges
from fracture_collision.core.memory.pools import GrowableArray, Pools
from fracture_collision.core.mesh.sample_numbers import NewSamples
from fracture_collision.core.samples.fragment_samples import parts_of


class TreeTable:
    """Owns the arrays of a TreePool."""

    def __init__(self) -> None:
        self._spheres, self._entries = GrowableArray(4, np.float64), GrowableArray(3, np.int32)
        self._ranges = GrowableArray(2, np.int32)

    @property
    def view(self) -> TreePool:
        """The trees of all fragments, as kernels read them."""
        return TreePool(self._spheres.view, self._entries.view, self._ranges.view)

    def append(self, tree: SphereTree) -> tuple[int, int]:
        """Append a tree; returns its first entry and the end."""
        begin = self._entries.append(
            np.column_stack([tree.size, tree.sample, surface_marks(tree.size, tree.on_surface)])
        )
        return self._spheres.append(np.column_stack([tree.center, tree.radius])), begin + len(tree.size)

    def of_next(self, begin: int, end: int) -> None:
        """Give the next fragment these entries."""
        self._ranges.append(np.array([[begin, end]], np.int32))

    def split(self, pools: Pools, broken: Broken, new: NewSamples, variant: str) -> None:
        """Append the RESTRUCTURED or PLAIN trees of the new fragments of a Broken; `new` without old corners' parts."""
        begin, end = self._ranges.view[broken.parent]
        entries = self._entries.view[begin:end]
        room = rows_of_split(entries, len(new.points))
        out = TreeArrays(self._spheres.reserve(room), self._entries.reserve(room))
        old = TreeArrays(self._spheres.view[begin:end], self._entries.view[begin:end])
        parts = parts_of((pools.mesh, pools.body), broken, np.ascontiguousarray(entries[:, SAMPLE]))
        ends = split_sphere_tree(old, parts, broken.end - broken.first, new, variant != PLAIN, out)
        first = self._spheres.advance(int(ends[-1]))
        self._entries.advance(int(ends[-1]))
        for f in range(broken.end - broken.first):
            self.of_next(first + int(ends[f]), first + int(ends[f + 1]))

    def rebuild(self, pools: Pools, broken: Broken) -> None:
        """Append the REBUILT trees of the new fragments, from their samples."""
        for f in range(broken.first, broken.end):
            own = slice(pools.fragment.sample_begin[f], pools.fragment.sample_end[f])
            points, numbers = pools.samples.points[own], pools.samples.numbers[own]
            tree = build_sphere_tree(points, np.ones(len(points), np.uint8))
            self.of_next(*self.append(tree._replace(sample=numbers[tree.sample])))

    def keep(self, stays: np.ndarray) -> Moves:
        """Drop the trees of fragments where the mask `stays` (F,) is false; returns the moves of the entries."""
        ranges = self._ranges.view[stays]
        moves = moves_of_ranges(self._entries.used, ranges[:, 0], ranges[:, 1])
        self._spheres.keep(moves.stays)
        self._entries.keep(moves.stays)
        self._ranges.replace(moves.of(ranges))
        return moves

    def tree_of(self, row: int) -> SphereTree:
        """A copy of the tree of a fragment, by its row."""
        own = slice(*self._ranges.view[row])
        return tree_of_rows(self._spheres.view[own], self._entries.view[own])


def tree_of_rows(spheres: np.ndarray, entries: np.ndarray) -> SphereTree:
    """A copy of a tree in rows of TreePool."""
    size, sample, surface = (np.ascontiguousarray(entries[:, c]) for c in range(3))
    return SphereTree(spheres[:, :3].copy(), spheres[:, 3].copy(), size, sample, (surface == 1).astype(np.uint8))
