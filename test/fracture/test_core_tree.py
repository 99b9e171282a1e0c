"""Sphere trees: of a whole body, and its parts after fractures."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from oracles.corner_samples import corner_samples
from oracles.fragmented_body import FragmentedBody
from worlds.fractured_worlds import SETTINGS, fractured_world, tree_of

from fracture_collision.core.glondu2014.paper_pools import REBUILT
from fracture_collision.core.glondu2014.sphere_tree import build_sphere_tree, validate_sphere_tree
from fracture_collision.geometry.generators import ball, plate
from fracture_collision.geometry.tetrahedra import boundary_triangles
from fracture_collision.records import FragmentStates
from fracture_collision.world import PaperSettings
from fracture_collision.world.settings import CHOICES


@settings(max_examples=40, deadline=None)
@given(st.integers(1, 200), st.integers(0, 10_000))
def test_a_built_tree_is_a_sphere_tree(count: int, seed: int) -> None:
    points = np.random.default_rng(seed).uniform(-1, 1, (count, 3))
    tree = build_sphere_tree(points, np.ones(count, np.uint8))
    validate_sphere_tree(tree, np.arange(count))


def test_the_validator_rejects_a_broken_tree() -> None:
    points = np.random.default_rng(0).uniform(-1, 1, (50, 3))
    tree = build_sphere_tree(points, np.ones(50, np.uint8))
    short = tree.radius.copy()
    short[0] *= 0.9
    with pytest.raises(AssertionError, match="does not hold a descendant"):
        validate_sphere_tree(tree._replace(radius=short), np.arange(50))
    with pytest.raises(AssertionError, match="not the fragment's samples"):
        validate_sphere_tree(tree, np.arange(1, 51))


@pytest.mark.parametrize("kind", CHOICES["tree"])
@pytest.mark.parametrize("curved", [False, True], ids=["flat", "curved"])
@pytest.mark.parametrize("body", [ball(1.0, 0.3), plate(2.0, 0.2, 0.3, 0.1)], ids=["ball", "plate"])
def test_trees_are_sphere_trees_after_each_of_five_fractures(body, curved: bool, kind: str) -> None:
    settings = SETTINGS._replace(paper=PaperSettings("exact", kind))
    case = fractured_world(body, seeds=5, generations=5, curved=curved, settings=settings)
    oracle = FragmentedBody(body.vertices, body.tetrahedra)
    at_surface = np.zeros(len(body.vertices), bool)
    at_surface[boundary_triangles(body.tetrahedra)] = True
    edges = oracle.edges.tolist()
    corners: dict[int, dict[int, np.ndarray]] = {}
    for event in case.messages[1]:
        oracle.apply(event)
        # samples that a neighbour's later crack adds to a fragment's border lie in its spheres
        corners |= {int(new): corner_samples(oracle, int(new)) for new in event.new_fragment_ids}
        nobody = FragmentStates(1, event.sequence, np.zeros(0, int), np.zeros(0), np.zeros(0))
        case.world.contacts(nobody)  # activates the registry
        for fragment in oracle.fragment_ids:
            ends = [
                len(body.vertices) + 2 * e + side
                for e, edge in enumerate(edges)
                for side in range(2)
                if tuple(edge) in oracle.planes and oracle.labels[edge[side]] == fragment
            ]
            nodes = np.flatnonzero((oracle.labels == fragment) & (at_surface if kind == REBUILT else True))
            tree = tree_of(case.geometry, case.row(fragment))
            own = corners[fragment]
            validate_sphere_tree(tree, np.concatenate([nodes, ends, list(own)]).astype(np.int64))
            for number, point in own.items():
                assert np.abs(tree.center[tree.sample == number] - point).max() <= 1e-9
            is_node = tree.sample < len(body.vertices)
            assert np.array_equal(tree.center[is_node], body.vertices[tree.sample[is_node]])
            assert np.array_equal(tree.on_surface[is_node] == 1, at_surface[tree.sample[is_node]])
            assert tree.on_surface[~is_node].all()
