"""Contacts of nearly coincident pairs come from seeds: they are valid contacts, spread, and bounded."""

from __future__ import annotations

import numpy as np
import pytest
from worlds.fractured_worlds import FracturedWorld, fractured_world
from worlds.sampled_worlds import EVERY, sampled_world

from fracture_collision.geometry.generators import ball, shell
from fracture_collision.records import ContactConstraintArray
from fracture_collision.world import CollisionWorld, Settings

EPSILON = 0.05  # [R]
SEEDED = Settings(threads=1, penetration_tolerance=EPSILON)
EVERYTHING = SEEDED._replace(contacts_per_pair=EVERY)
Contact = tuple[float, ...]


@pytest.fixture(scope="module", params=["ball", "shell, curved, twice"])
def case(request) -> FracturedWorld:
    if request.param == "ball":
        return fractured_world(ball(1.0, 0.2), 7)
    return fractured_world(shell(1.0, 0.8, 0.25), 7, generations=2, curved=True)


def contacts_by_pair(answer: ContactConstraintArray) -> dict[tuple[int, int], dict[int, Contact]]:
    """Contacts by pair and id: witnesses, normal, gap."""
    points = zip(answer.points_a.reshape(-1, 3), answer.points_b.reshape(-1, 3), strict=True)
    rows = [(*a, *b) for a, b in points]
    rows = [(*row, *n, g) for row, n, g in zip(rows, answer.normals.reshape(-1, 3), answer.gaps, strict=True)]
    found = {}
    for k, pair in enumerate(zip(answer.fragment_a.tolist(), answer.fragment_b.tolist(), strict=True)):
        part = slice(int(answer.pair_begin[k]), int(answer.pair_begin[k + 1]))
        found[pair] = dict(zip(answer.contact_ids[part].tolist(), rows[part], strict=True))
    return found


def visits_and_answer(world: CollisionWorld, states) -> tuple[int, ContactConstraintArray]:
    world.forget()
    answer = world.contacts(states)
    return world.last_visits, answer


@pytest.mark.parametrize("jitter", [0.0, 0.004, 0.01])
def test_seeds_are_among_all_contacts(case: FracturedWorld, jitter: float) -> None:
    """The slow twin is the search for all contacts, which uses no seeds: no pair has that many."""
    states = case.states(jitter)
    visits, answer = visits_and_answer(sampled_world(case, SEEDED), states)
    all_visits, everything = visits_and_answer(sampled_world(case, EVERYTHING), states)
    seeded, known = contacts_by_pair(answer), contacts_by_pair(everything)
    wanted = SEEDED.contacts_per_pair
    assert {pair for pair, own in known.items() if own} == {pair for pair, own in seeded.items() if own}
    for pair, own in seeded.items():
        assert len(own) >= min(wanted, len(known[pair])), f"{pair}: {len(own)} of {len(known[pair])}"
        for name, contact in own.items():
            assert contact == known[pair][name], f"{pair}: another contact"
    assert sum(len(own) >= wanted for own in seeded.values()) > 5 and visits < all_visits


def test_pairs_in_place_are_answered_by_their_seeds(case: FracturedWorld) -> None:
    """A pair that shares a crack costs eight visits, regardless of the crack's size."""
    world, states = sampled_world(case, SEEDED), case.states(0.0)
    pairs = [pair for pair in contacts_by_pair(world.contacts(states)) if len(_seeds_of(world, pair)) >= 8]
    assert len(pairs) > 5
    for a, b in pairs:
        chosen = np.isin(states.fragment_ids, (a, b))
        two = states._replace(
            fragment_ids=states.fragment_ids[chosen], positions=states.positions.reshape(-1, 3)[chosen].ravel(),
            orientations=states.orientations.reshape(-1, 4)[chosen].ravel(),
        )  # fmt: skip
        visits, answer = visits_and_answer(world, two)
        assert visits == 8 and answer.pair_begin.tolist() == [0, 8]
        assert np.abs(answer.gaps).max() < 1e-12 and answer.missed_depth_bound[0] < 1e-11


def test_contacts_of_seeds_are_spread_over_the_crack(case: FracturedWorld) -> None:
    """Farthest first: every seed of a pair is as near to one of its eight contacts as those are to each other."""
    world = sampled_world(case, SEEDED)
    answer = world.contacts(case.states(0.0))
    checked = 0
    for pair, own in contacts_by_pair(answer).items():
        crossings = _seeds_of(world, pair)
        if len(crossings) < SEEDED.contacts_per_pair:
            continue
        points = np.array([contact[:3] for contact in own.values()])
        apart = np.linalg.norm(points[:, None] - points[None], axis=2)[np.triu_indices(len(points), 1)].min()
        off = np.linalg.norm(crossings[:, None] - points[None], axis=2).min(axis=1).max()
        assert off <= apart * (1.0 + 1e-9)
        checked += 1
    assert checked > 5


def _seeds_of(world: CollisionWorld, pair: tuple[int, int]) -> np.ndarray:
    """Crossings (n, 3) [m] of a pair's seeds; pairs that meet only at a corner have none."""
    pools, registry = world._registry.geometry.pools, world._registry
    a, b = sorted(registry.row_of(f) for f in pair)
    begin, end = pools.fragment.seeds[a]
    at = begin + np.searchsorted(pools.seeds.keys[begin:end], a << 32 | b)
    if at == end or pools.seeds.keys[at] != a << 32 | b:
        return np.empty((0, 3))
    edges = pools.seeds.edges[slice(*pools.seeds.ranges[at])]
    ends = pools.mesh.nodes[pools.mesh.edges[edges]]
    share = pools.body.edge_share[edges + pools.fragment.edge_shift[a]]
    return ends[:, 0] + share[:, None] * (ends[:, 1] - ends[:, 0])
