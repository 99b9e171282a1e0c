"""The leaf search: the contacts of Algorithm 1; and which of many are listed."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pytest
from worlds.fractured_worlds import SETTINGS, fractured_world, with_settings
from worlds.hard_worlds import tetrahedral_body
from worlds.sampled_worlds import EVERY, SampledWorld, in_order, sampled_world

from fracture_collision.core.bodies.body_validator import validate_body
from fracture_collision.core.memory.pools import LEAF, LEAF_VALUES
from fracture_collision.core.search.passes import within_limit
from fracture_collision.geometry.generators import ball, brick, shell
from fracture_collision.records import BOX, CollisionBody, FragmentStates, SolidPrimitive
from fracture_collision.world import CollisionWorld, Settings, collision_world

SHAPES = {
    "ball": (ball(1.0, 0.35), False),
    "curved ball": (ball(1.0, 0.3), True),
    "shell": (shell(1.0, 0.8, 0.5), True),
    "brick": (brick((1.0, 0.8, 0.5), 0.2), False),
}
EPSILON = NEAR = 0.002


class Found(NamedTuple):
    """The result of query_pairs for one pair."""

    samples: np.ndarray  # (n, 2) side, sample
    points: np.ndarray  # (n, 3) [m] of the samples, in the world
    gaps: np.ndarray  # (n,) [m]
    bound: float  # [m]


def found_by(world: CollisionWorld, states: FragmentStates, monkeypatch: pytest.MonkeyPatch) -> dict[tuple, Found]:
    """Results by pair of ids."""
    caught = []

    def listen(pools, step, found, most, scratch):
        caught[:] = found, step.pairs
        return within_limit(pools, step, found, most, scratch)

    with monkeypatch.context() as patch:
        patch.setattr(collision_world, "within_limit", listen)
        world.forget()
        world.contacts(states)
    ids = world.present(states).ids
    contacts, pairs = caught
    begin, found = np.concatenate([[0], np.cumsum(contacts.counts)]), {}
    for p, (i, j) in enumerate(pairs.tolist()):
        own = slice(int(begin[p]), int(begin[p + 1]))
        points = np.where(contacts.samples[own, :1] == 0, contacts.points_a[own], contacts.points_b[own])
        found[int(ids[i]), int(ids[j])] = Found(
            contacts.samples[own], points, contacts.gaps[own], float(contacts.bounds[p])
        )
    return found


def by_the_rule(every: Found, wanted: int, most: int, epsilon: float, near: float) -> set[tuple[int, int]]:
    """The slow twin of contact_choice.choose: sides and samples of the listed ones of `every`."""
    order = np.lexsort((every.samples[:, 1], every.samples[:, 0]))
    samples, points, gaps = every.samples[order], every.points[order], every.gaps[order]
    deep = gaps < -epsilon
    if len(gaps) <= wanted:
        chosen = list(range(len(gaps)))
    elif deep.sum() > wanted:
        chosen = [int(np.argmin(gaps))]
        _spread(chosen, points, near + np.minimum(-gaps, epsilon), np.flatnonzero(deep), min(int(deep.sum()), most))
    else:
        first = int(np.flatnonzero(gaps <= gaps.min() + 0.5 * epsilon)[0])
        chosen = np.flatnonzero(deep).tolist() or [first]
        _spread(chosen, points, near + np.minimum(-gaps, epsilon), np.arange(len(gaps)), wanted)
    return {tuple(samples[k].tolist()) for k in chosen}


def place_of_each(every: Found) -> dict[tuple[int, int], int]:
    """By side and sample: the first of `every` at the same place, up to rounding."""
    same = ((every.points[:, None] - every.points[None]) ** 2).sum(axis=2) < 1e-24
    firsts = [int(np.flatnonzero(row)[0]) for row in same]
    return dict(zip(map(tuple, every.samples.tolist()), firsts, strict=True))


def _spread(chosen: list[int], points: np.ndarray, within: np.ndarray, pool: np.ndarray, aim: int) -> None:
    while len(chosen) < aim:
        rest = np.setdiff1d(pool, chosen)
        far = ((points[rest][:, None] - points[chosen][None]) ** 2).sum(axis=2).min(axis=1)
        worth = far * within[rest] ** 2
        chosen.append(int(rest[np.flatnonzero(worth >= (1.0 - 1e-3) * worth.max())[0]]))


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("jitter", [0.0, 0.001, 0.01, 0.2])
def test_the_search_finds_the_contacts_of_the_tree(shape, jitter) -> None:
    body, curved = SHAPES[shape]
    case = fractured_world(body, 9, generations=2, curved=curved)
    quick = sampled_world(case, Settings(threads=1, contacts_per_pair=EVERY))
    slow = with_settings(case, SETTINGS._replace(contacts_per_pair=EVERY))
    for world in (quick, slow):
        world.add_body(tetrahedral_body(brick((1.0, 1.0, 0.5), 0.25), 2000))
        world.add_body(CollisionBody(2001, 2001, primitive=SolidPrimitive(BOX, (0.8, 0.8, 0.4))))
        world.add_body(CollisionBody(2002, 2002, plane=np.array([0.0, 0.0, 1.0, 0.98]), is_static=True))
    for seed in range(3):
        states = case.states(jitter, seed)
        more = FragmentStates(
            states.step, states.fracture_sequence, np.append(states.fragment_ids, [2000, 2001]),
            np.append(states.positions, [0.0, 0.0, 1.24, 1.38, 0.0, 0.0]),
            np.append(states.orientations, [0.1, 0.2, 0.0, 0.9746794, 0.0, 0.3, 0.1, 0.9486833]),
        )  # fmt: skip
        found, right = (in_order(world.contacts(more)) for world in (quick, slow))
        for name in ("fragment_a", "fragment_b", "pair_begin", "contact_ids"):
            assert np.array_equal(getattr(found, name), getattr(right, name)), name
        # the search turns some contacts to the surface that faces them; the others are the same
        same = (found.normals == right.normals).reshape(-1, 3).all(axis=1)
        assert np.allclose(found.gaps[same], right.gaps[same], rtol=0.0, atol=1e-12)
        assert same.sum() > 50


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("jitter", [0.003, 0.01, 0.05])
@pytest.mark.parametrize("wanted", [8, 3])
def test_listed_contacts_follow_the_selection_rule(shape, jitter, wanted, monkeypatch) -> None:
    body, curved = SHAPES[shape]
    case = fractured_world(body, 7, curved=curved)
    settings, most = Settings(threads=1), 2 * wanted
    radius = float(case.geometry.pools.fragment.radius[0])
    some = sampled_world(case, settings._replace(contacts_per_pair=wanted))
    all_of_them = with_settings(case, SETTINGS._replace(contacts_per_pair=EVERY))
    chosen_of_many = 0
    for seed in range(3):
        states = case.states(jitter, seed)
        listed, every = (found_by(world, states, monkeypatch) for world in (some, all_of_them))
        assert listed.keys() == every.keys()
        for pair, own in listed.items():
            all_near = every[pair]
            right = by_the_rule(all_near, wanted, most, EPSILON * radius, NEAR * radius)
            # among samples at one place, where cracks meet, rounding decides which is listed if only such are left
            places = place_of_each(all_near)
            assert len(own.samples) == len(right)
            assert {places[tuple(s)] for s in own.samples.tolist()} == {places[s] for s in right}
            is_listed = (all_near.samples[:, None] == own.samples[None]).all(axis=2).any(axis=1)
            left_out = max(-all_near.gaps[~is_listed].min(initial=0.0), 0.0)
            # of many deep samples, only the listed ones are known, and whether any other is deeper than epsilon
            known = left_out
            if (all_near.gaps < -EPSILON * radius).sum() > wanted:
                # along a turned normal, a contact is deeper than its sample
                known = -own.gaps.min() if left_out > EPSILON * radius else EPSILON * radius
            assert left_out <= own.bound <= known + 1e-9 * radius
            chosen_of_many += len(all_near.gaps) > wanted
    assert chosen_of_many > 10


@pytest.mark.parametrize(("kind", "count"), [(SampledWorld, 8), (CollisionWorld, 4)])
def test_bodies_at_rest_keep_their_contacts(kind: type[CollisionWorld], count: int) -> None:
    """A brick on a brick touches with a hundred samples, equally deep up to rounding: always the same are listed.

    Or with the four corners of where they overlap.
    """
    lower, upper = (tetrahedral_body(brick((1.0, 1.0, 0.5), 0.1), i) for i in (1, 2))
    world, ids = kind(Settings(threads=1)), []
    world.add_body(lower)
    world.add_body(upper)
    random = np.random.default_rng(1)
    for step in range(20):
        small = random.uniform(-1e-9, 1e-9, 6)
        states = FragmentStates(
            step, 0, np.array([1, 2]), np.array([0.0, 0.0, 0.0, 0.03, 0.02, 0.4999]) + small, np.tile([0, 0, 0, 1.0], 2)
        )
        ids.append(world.contacts(states).contact_ids.tolist())
    assert len(ids[0]) == count and all(later == ids[0] for later in ids)


def test_leaves_contain_every_sample_once() -> None:
    case = fractured_world(*SHAPES["shell"][:1], 9, generations=2, curved=True)
    rows = [case.row(fragment_id) for fragment_id in case.oracle.fragment_ids]
    validate_body(case.geometry, rows)
    pools = case.geometry.pools
    leaf = int(pools.fragment.leaf_begin[rows[-1]])
    for values, at, words in (
        (pools.samples.entries, LEAF * leaf, "every sample once"), (pools.samples.values, LEAF_VALUES * leaf, "box"),
    ):  # fmt: skip
        kept = values[at]
        values[at] = pools.samples.entries[at + 1] if values is pools.samples.entries else 1.0
        with pytest.raises(AssertionError, match=words):
            validate_body(case.geometry, rows)
        values[at] = kept
