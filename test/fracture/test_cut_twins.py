"""Fast paths of a fracture update against the general path; connected pieces against scipy."""

from __future__ import annotations

from collections import defaultdict

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from worlds.fractured_worlds import SETTINGS, FracturedWorld, fractured_world, with_settings

from fracture_collision.core.fracture import touched_tetrahedra
from fracture_collision.core.memory.pools import BACK_SIDE, FANNED, FRONT_SIDE, KIND, OLD_FACE, OWNER, PARTED, ROW
from fracture_collision.core.mesh.connected_pieces import connected_pieces, joined
from fracture_collision.core.mesh.cut_tetrahedron import CUT, DIVIDED
from fracture_collision.geometry.generators import ball, brick, plate, shell
from fracture_collision.geometry.tetrahedra import unique_edges
from fracture_collision.world.gates.fracture_match import first_split

SHAPES = {
    "ball": ball(1.0, 0.35),
    "shell": shell(1.0, 0.8, 0.5),
    "brick": brick((2.0, 1.0, 0.8), 0.4),  # planes along its faces: ties
    "plate": plate(2.0, 0.2, 0.3, 0.2),
}


@pytest.fixture(params=[(name, curved) for name in SHAPES for curved in (False, True)], ids=str)
def pair(request, monkeypatch) -> tuple[FracturedWorld, FracturedWorld]:
    """A world, and the same world with every cut made about a hub."""
    name, curved = request.param
    find_touched = touched_tetrahedra.find_touched

    def all_divided(*arguments):
        touched = find_touched(*arguments)
        touched.kinds[touched.kinds == CUT] = DIVIDED
        return touched

    quick = fractured_world(SHAPES[name], 7, generations=3, curved=curved)
    monkeypatch.setattr(touched_tetrahedra, "find_touched", all_divided)
    world = with_settings(quick, SETTINGS)
    world.contacts(quick.states())
    return quick, quick._replace(world=world)


def test_cuts_by_one_plane_equal_cuts_about_a_hub(pair) -> None:
    quick, general = pair
    rows = [quick.row(f) for f in quick.oracle.fragment_ids]
    assert rows == [general.row(f) for f in quick.oracle.fragment_ids]
    told = [case.world.fragments()._replace(sampling_gaps=None) for case in (quick, general)]  # these depend on fans
    for own, other in zip(*told, strict=True):
        if isinstance(own, np.ndarray) and own.dtype == np.float64:
            np.testing.assert_allclose(own, other, rtol=1e-9, atol=1e-9 * np.abs(own).max(initial=0.0))
        else:
            assert np.array_equal(own, other)
    a, b = quick.geometry.pools, general.geometry.pools
    assert (a.body.regions[:, OWNER] == PARTED).any() and (a.body.regions[:, OWNER] == FANNED).any()
    assert not (b.body.regions[:, OWNER] == PARTED).any()
    np.testing.assert_allclose(a.fragment.box[rows], b.fragment.box[rows], rtol=0.0, atol=1e-12)
    assert np.array_equal(a.fragment.cells[rows], b.fragment.cells[rows])
    assert np.array_equal(a.occupancy, b.occupancy)
    own, other = _areas(quick, rows), _areas(general, rows)
    scale = sum(own.values())
    for key in own.keys() | other.keys():
        assert abs(own.get(key, 0.0) - other.get(key, 0.0)) < 1e-9 * scale, key


def _areas(case: FracturedWorld, rows: list[int]) -> dict[tuple[int, int, int, int], float]:
    """Area [m2] by (tetrahedron, old face or -1, front, back); which side of a crack is in front does not matter."""
    body, shift = case.geometry.pools.body, case.geometry.pools.fragment.tet_shift[rows[0]]
    areas: dict[tuple[int, int, int, int], float] = defaultdict(float)
    for t in case.geometry.tet_range(rows[0]):
        begin = body.regions[t + shift, ROW]
        for i in range(begin, begin + body.cut_count[t + shift]):
            p, q, r = body.triangles[i].reshape(3, 3)
            face = max(int(body.sides[i, KIND]) - OLD_FACE, -1)
            sides = sorted((int(body.sides[i, FRONT_SIDE]), int(body.sides[i, BACK_SIDE])))
            areas[(t, face, sides[0], sides[1])] += 0.5 * float(np.linalg.norm(np.cross(q - p, r - p)))
    return areas


@settings(max_examples=200, deadline=None)
@given(st.integers(1, 40), st.integers(0, 90), st.integers(1, 5), st.integers(0, 2**32 - 1))
def test_split_parts_are_those_that_scipy_finds(nodes: int, edges: int, count: int, seed: int) -> None:
    random = np.random.default_rng(seed)
    ends = np.sort(random.integers(0, nodes, (edges, 2)), axis=1).astype(np.int32)
    ends = ends[np.argsort(ends[:, 0], kind="stable")]
    begin = np.searchsorted(ends[:, 0], np.arange(nodes + 1))
    labels = random.integers(-1, count, nodes).astype(np.int32)
    pieces = connected_pieces(ends, labels)
    split = [p for p in range(count) if len(np.unique(pieces[labels == p])) > 1]
    of_ends = labels[ends]
    between = int(((of_ends >= 0).all(axis=1) & (of_ends[:, 0] != of_ends[:, 1])).sum())
    assert first_split(ends, begin, labels, count) == (split[0] if split else -1, between)


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
