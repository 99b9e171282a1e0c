"""Connected pieces: hand-made cases, in a mesh, and against scipy."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from fracture_collision.core.mesh.connected_pieces import connected_pieces, joined
from fracture_collision.geometry.generators import brick
from fracture_collision.geometry.tetrahedra import unique_edges


def test_pieces_of_one_label() -> None:
    edges = np.array([[0, 1], [1, 2], [2, 3], [3, 4], [4, 5], [0, 6]])
    labels = np.array([1, 1, 0, 1, 1, 0, 0, 0])
    assert connected_pieces(edges, labels).tolist() == [0, 0, 1, 2, 2, 3, 4, 5]
    # a slab cut from a mesh is one piece, the two sides of the slab are two
    mesh = brick((1.0, 0.2, 0.2), 0.1)
    middle = np.abs(mesh.vertices[:, 0]) < 0.15
    assert connected_pieces(unique_edges(mesh.tetrahedra), middle).max() + 1 == 3


@pytest.mark.parametrize("links", [0, 30, 300, 3000])
def test_pieces_are_those_that_scipy_finds(links: int) -> None:
    count, random = 500, np.random.default_rng(links)
    for _ in range(20):
        first, second = random.integers(0, count, (2, links))
        graph = coo_array((np.ones(links), (first, second)), shape=(count, count))
        found, expected = connected_components(graph, directed=False)
        pieces = joined(first, second, count)
        assert pieces.max() + 1 == found
        assert len(np.unique(np.column_stack((pieces, expected)), axis=0)) == found
        # numbered by their smallest members
        assert np.all(np.diff(np.unique(pieces, return_index=True)[1]) > 0)
