"""Tetrahedra cut by one plane, and by planes of cells, have quick ways of their own: here against the general one."""

from __future__ import annotations

from collections import defaultdict

import numpy as np
import pytest
from fractured_worlds import SETTINGS, FracturedWorld, fractured_world, with_settings
from hypothesis import given, settings
from hypothesis import strategies as st

from fracture_collision.core import touched_tetrahedra
from fracture_collision.core.cut_tetrahedron import INTERFACE
from fracture_collision.core.plain_cut import CELLS, LONE, MIXED, PLAIN
from fracture_collision.geometry.generators import ball, brick, plate, shell
from fracture_collision.geometry.tetrahedra import connected_pieces
from fracture_collision.records import ContactConstraintArray, FragmentStates
from fracture_collision.world.fracture_match import first_split

SHAPES = {
    "ball": ball(1.0, 0.35),
    "shell": shell(1.0, 0.8, 0.5),
    "brick": brick((2.0, 1.0, 0.8), 0.4),  # planes along its faces: ties
    "plate": plate(2.0, 0.2, 0.3, 0.2),
}


@pytest.fixture(params=[(name, curved) for name in SHAPES for curved in (False, True)], ids=str)
def pair(request, monkeypatch) -> tuple[FracturedWorld, FracturedWorld, np.ndarray]:
    """A world, the same one with every cut made the general way, and how many tetrahedra of each kind it has."""
    name, curved = request.param
    seen = np.zeros(MIXED + 1, np.int64)
    classify = touched_tetrahedra.classify

    def classify_and_count(mesh, body, node_shift, edge_shift, touched, scratch):
        mixed = classify(mesh, body, node_shift, edge_shift, touched, scratch)
        seen[:] += np.bincount(touched.kinds, minlength=MIXED + 1)
        return mixed

    def all_mixed(mesh, body, node_shift, edge_shift, touched, scratch):
        classify(mesh, body, node_shift, edge_shift, touched, scratch)
        touched.kinds[touched.kinds > LONE] = MIXED
        touched.unclear[:] = 0b1111
        return True

    monkeypatch.setattr(touched_tetrahedra, "classify", classify_and_count)
    quick = fractured_world(SHAPES[name], 7, generations=3, curved=curved)
    monkeypatch.setattr(touched_tetrahedra, "classify", all_mixed)
    world = with_settings(quick, SETTINGS)
    world.contacts(quick.states())
    return quick, quick._replace(world=world), seen


def test_the_quick_ways_are_taken_and_agree_with_the_general_one(pair) -> None:
    quick, general, seen = pair
    if not quick.curved:
        assert seen[PLAIN] > 0 and seen[CELLS] > 0
    rows = [quick.row(f) for f in quick.oracle.fragment_ids]
    assert rows == [general.row(f) for f in quick.oracle.fragment_ids]
    told = [case.world.fragments()._replace(sampling_gaps=None) for case in (quick, general)]  # bounds, of other fans
    for own, other in zip(*told, strict=True):
        if isinstance(own, np.ndarray) and own.dtype == np.float64:
            np.testing.assert_allclose(own, other, rtol=1e-9, atol=1e-9 * np.abs(own).max(initial=0.0))
        else:
            assert np.array_equal(own, other)
    a, b = quick.geometry.pools, general.geometry.pools
    assert np.array_equal(a.body.tet_fragment, b.body.tet_fragment)
    np.testing.assert_allclose(a.body.edge_share, b.body.edge_share, rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(a.fragment.box[rows], b.fragment.box[rows], rtol=0.0, atol=1e-12)
    assert np.array_equal(a.fragment.cells[rows], b.fragment.cells[rows])
    assert np.array_equal(a.occupancy, b.occupancy)
    own, other = _areas(quick, rows), _areas(general, rows)
    scale = sum(own.values())
    for key in own.keys() | other.keys():
        assert abs(own.get(key, 0.0) - other.get(key, 0.0)) < 1e-9 * scale, key


def _areas(case: FracturedWorld, rows: list[int]) -> dict[tuple[int, int, int, int], float]:
    """Area [m2] by (tetrahedron, kind, front, back); which side of an interface is in front does not matter."""
    body, shift = case.geometry.pools.body, case.geometry.pools.fragment.tet_shift[rows[0]]
    areas: dict[tuple[int, int, int, int], float] = defaultdict(float)
    for t in case.geometry.tet_range(rows[0]):
        begin = body.cut_begin[t + shift]
        for i in range(begin, begin + body.cut_count[t + shift]):
            p, q, r = body.triangles[i].reshape(3, 3)
            kind, sides = int(body.kind[i]), (int(body.front[i]), int(body.back[i]))
            sides = tuple(sorted(sides)) if kind == INTERFACE else sides
            areas[(t, kind, *sides)] += 0.5 * float(np.linalg.norm(np.cross(q - p, r - p)))
    return areas


@settings(max_examples=200, deadline=None)
@given(st.integers(1, 40), st.integers(0, 90), st.integers(1, 5), st.integers(0, 2**32 - 1))
def test_split_parts_are_those_that_scipy_finds(nodes: int, edges: int, count: int, seed: int) -> None:
    random = np.random.default_rng(seed)
    ends = np.sort(random.integers(0, nodes, (edges, 2)), axis=1).astype(np.int32)
    labels = random.integers(-1, count, nodes).astype(np.int32)
    pieces = connected_pieces(ends, labels)
    split = [p for p in range(count) if len(np.unique(pieces[labels == p])) > 1]
    assert first_split(ends, labels, count) == (split[0] if split else -1)


EVERY = SETTINGS._replace(penetration_tolerance=0.0, contacts_per_pair=10**6, normals="nearest")


@pytest.mark.parametrize("curved", [False, True], ids=["flat", "curved"])
def test_no_sample_is_deeper_than_it_has_moved(curved: bool) -> None:
    """Fragments hardly moved: with epsilon above the way they went no search is needed, and the bound says how far."""
    case = fractured_world(ball(1.0, 0.25), 8, generations=2, curved=curved)
    assert np.isfinite(case.geometry.pools.fragment.overlap).any()
    coarse = SETTINGS._replace(penetration_tolerance=0.05)
    quick, slow, every = (with_settings(case, kind) for kind in (coarse, coarse, EVERY))
    slow.contacts(case.states())
    slow._registry.geometry.pools.fragment.overlap[:] = np.inf  # as if nothing were known
    visits = np.zeros(2)
    for seed in range(5):
        states = case.states(0.01, seed)
        answer, searched, full = quick.contacts(states), slow.contacts(states), every.contacts(states)
        visits += quick.last_visits, slow.last_visits
        for name in ("pair_begin", "gaps", "points_a", "points_b", "normals", "contact_ids"):
            own, other = getattr(_touching(answer), name), getattr(_touching(searched), name)
            assert np.array_equal(own, other), name
        told = {pair: i for i, pair in enumerate(_pairs(answer))}
        for i, pair in enumerate(_pairs(full)):
            deepest = -full.gaps[full.pair_begin[i] : full.pair_begin[i + 1]].min(initial=0.0)
            bound, listed = coarse.penetration_tolerance, 0.0
            if pair in told:
                k = told[pair]
                bound = answer.missed_depth_bound[k]
                listed = -answer.gaps[answer.pair_begin[k] : answer.pair_begin[k + 1]].min(initial=0.0)
            assert deepest <= max(bound, listed) + 1e-12
    assert visits[0] < visits[1]


def _pairs(answer: ContactConstraintArray) -> list[tuple[int, int]]:
    return list(zip(answer.fragment_a.tolist(), answer.fragment_b.tolist(), strict=True))


def _touching(answer: ContactConstraintArray) -> ContactConstraintArray:
    """Without the pairs that are listed for their bound alone."""
    return answer._replace(pair_begin=np.unique(answer.pair_begin))


def test_in_place_nothing_is_deeper_than_the_overlap() -> None:
    case = fractured_world(ball(1.0, 0.4), 8, generations=3, curved=True)
    ids = np.array(case.oracle.fragment_ids)
    still = np.tile([0.0, 0.0, 0.0, 1.0], len(ids))
    states = FragmentStates(1, case.generations, ids, np.zeros(3 * len(ids)), still)
    answer = with_settings(case, EVERY).contacts(states)
    overlap = case.geometry.pools.fragment.overlap
    for i, (a, b) in enumerate(_pairs(answer)):
        depths = -answer.gaps[answer.pair_begin[i] : answer.pair_begin[i + 1]]
        assert depths.max(initial=0.0) <= max(overlap[case.row(a)], overlap[case.row(b)]) + 1e-12
