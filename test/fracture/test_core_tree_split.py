"""Fragments' trees: splitting, restructuring and extending against the nested twin; and agreement of the trees."""

from __future__ import annotations

import itertools

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from oracles.sphere_tree_split import flat, fragment_tree, nested
from worlds.fractured_worlds import SETTINGS, fractured_world, samples_of, tree_of

from fracture_collision.core.glondu2014.fragment_trees import TreeTable, tree_of_rows
from fracture_collision.core.glondu2014.sphere_tree import SphereTree, build_sphere_tree, validate_sphere_tree
from fracture_collision.core.glondu2014.sphere_tree_deal import BATCH
from fracture_collision.core.glondu2014.sphere_tree_split import TreeArrays, rows_of_split, split_sphere_tree
from fracture_collision.core.mesh.sample_numbers import NewSamples
from fracture_collision.geometry.generators import brick
from fracture_collision.world import PaperSettings
from fracture_collision.world.settings import CHOICES


def pooled(tree: SphereTree) -> tuple[np.ndarray, np.ndarray]:
    """The tree as rows of TreePool."""
    table = TreeTable()
    table.append(tree)
    return table.view.spheres, table.view.entries


def unpooled(spheres: np.ndarray, entries: np.ndarray) -> SphereTree:
    """The inverse of `pooled`; checks that the marks match the tree."""
    tree = tree_of_rows(spheres, entries)
    assert np.array_equal(entries, pooled(tree)[1])
    return tree


class Fracture:
    """A random label for each sample of a tree, and new surface points beside samples drawn at random."""

    def __init__(self, tree: SphereTree, pieces: int, first_new: int, random: np.random.Generator, lattice: bool):
        samples = tree.sample[tree.size == 1]
        labels = np.unique(random.integers(0, pieces, len(samples)), return_inverse=True)[1].astype(np.int32)
        self.count = int(labels.max()) + 1
        self.fragment_of = dict(zip(samples.tolist(), labels.tolist(), strict=True))
        self.of_entry = np.array([self.fragment_of[s] for s in tree.sample.tolist()], np.int32)
        chosen = np.flatnonzero(tree.size == 1)[random.integers(0, len(samples), random.integers(0, 2 * len(samples)))]
        self.parents = tree.sample[chosen]
        self.fragments = self.of_entry[chosen]
        self.points = tree.center[chosen] + random.normal(size=(len(chosen), 3)) * random.choice([0.0, 0.02, 0.3])
        if lattice:
            self.points = np.round(self.points * 3) / 3
        self.samples = np.arange(first_new, first_new + len(chosen), dtype=np.int32)

    def split(self, tree: SphereTree, ordered: bool) -> list[SphereTree]:
        spheres, entries = pooled(tree)
        room = rows_of_split(entries, len(self.points))
        out_spheres, out_entries = np.full((room, 4), np.nan), np.full((room, 3), 99, np.int32)
        added = NewSamples(self.points, self.samples, self.parents, self.fragments)
        begin = split_sphere_tree(
            TreeArrays(spheres, entries), self.of_entry, self.count, added, ordered,
            TreeArrays(out_spheres, out_entries),
        )  # fmt: skip
        return [unpooled(out_spheres[a:b], out_entries[a:b]) for a, b in itertools.pairwise(begin)]

    def new_of(self, fragment: int) -> list[tuple[int, tuple, int]]:
        own = np.flatnonzero(self.fragments == fragment)
        return [(int(self.samples[q]), tuple(self.points[q].tolist()), int(self.parents[q])) for q in own]

    def samples_of(self, fragment: int) -> np.ndarray:
        kept = [s for s, f in self.fragment_of.items() if f == fragment]
        return np.concatenate([kept, self.samples[self.fragments == fragment]])


@settings(max_examples=150, deadline=None)
@given(st.integers(1, 60), st.integers(1, 6), st.integers(0, 10**6), st.booleans(), st.booleans())
def test_three_fractures_of_random_points_equal_the_slow_twin(
    count: int, pieces: int, seed: int, lattice: bool, ordered: bool
) -> None:
    random = np.random.default_rng(seed)
    points = random.uniform(-1, 1, (count, 3))
    if lattice:  # ties and duplicates
        points = np.round(points * 2) / 2
    tree = build_sphere_tree(points, random.integers(0, 2, count))
    next_sample = count
    for _ in range(3):
        leaves = tree.size == 1
        fracture = Fracture(tree, pieces, next_sample, random, lattice)
        next_sample += len(fracture.samples)
        old = nested(tree)
        trees = fracture.split(tree, ordered)
        assert sum((t.size == 1).sum() for t in trees) == leaves.sum() + len(fracture.samples)
        for fragment, own in enumerate(trees):
            validate_sphere_tree(own, fracture.samples_of(fragment))
            expected = flat(fragment_tree(old, fracture.fragment_of, fragment, fracture.new_of(fragment), ordered))
            for name in SphereTree._fields:
                assert np.array_equal(getattr(own, name), getattr(expected, name)), name
        tree = max(trees, key=lambda t: len(t.size))


def test_more_fragments_than_bits_of_a_mask() -> None:
    random = np.random.default_rng(2)
    tree = build_sphere_tree(random.uniform(-1, 1, (400, 3)), random.integers(0, 2, 400))
    fracture = Fracture(tree, 200, 400, random, False)
    assert fracture.count > 2 * BATCH
    old = nested(tree)
    for fragment, own in enumerate(fracture.split(tree, True)):
        expected = flat(fragment_tree(old, fracture.fragment_of, fragment, fracture.new_of(fragment), True))
        for name in SphereTree._fields:
            assert np.array_equal(getattr(own, name), getattr(expected, name)), name


def test_all_three_trees_sample_the_surface_at_the_same_points() -> None:
    body = brick((2.0, 1.0, 0.8), 0.3)
    cases = [
        fractured_world(body, 6, 3, True, SETTINGS._replace(paper=PaperSettings("exact", kind)))
        for kind in CHOICES["tree"]
    ]
    for fragment in cases[0].oracle.fragment_ids:
        found = []
        for case in cases:
            tree = tree_of(case.geometry, case.row(fragment))
            own = np.flatnonzero((tree.size == 1) & (tree.on_surface == 1))
            own = own[np.argsort(tree.sample[own])]
            found.append((tree.sample[own].tolist(), tree.center[own].tolist()))
        # and our own method has these samples without any tree
        points, numbers = samples_of(cases[0].geometry, cases[0].row(fragment))
        own = np.argsort(numbers)
        found.append((numbers[own].tolist(), points[own].tolist()))
        assert found[0] == found[1] == found[2] == found[3]
