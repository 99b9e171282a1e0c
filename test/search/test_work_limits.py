"""Valid states of excessive cost: omissions by limits are bounded, and what is left out is deterministic."""

from __future__ import annotations

import numpy as np
import pytest
from truth.contact_truth import COARSE_SHAPES, ContactTruth, Poses, check_pair, pairs_of
from worlds.fractured_worlds import SETTINGS, fractured_world, with_settings
from worlds.gate_world import record_bytes
from worlds.hard_worlds import tetrahedral_body
from worlds.sampled_worlds import sampled_world

from benchmarks import random_pairs
from benchmarks.scaling.crowds import CLOSE, crowd, measure_crowds
from fracture_collision.geometry.generators import ball
from fracture_collision.records import (
    BOX,
    BUDGET_EXHAUSTED,
    SPHERE,
    CollisionBody,
    ContactConstraintArray,
    FragmentStates,
    SolidPrimitive,
)
from fracture_collision.world import CollisionWorld, InvalidMessage, PaperSettings, Settings


def size_of(answer: ContactConstraintArray) -> int:
    return sum(np.asarray(field).nbytes for field in answer)


@pytest.mark.parametrize(
    ("kind", "spread"), [("boxes", 0.0), ("boxes", 0.03), ("spheres", 0.03), ("tetrahedra", 0.0), ("mixed", 0.03)]
)
def test_a_hundred_bodies_in_one_place_are_answered(kind: str, spread: float) -> None:
    world, states = crowd(kind, 100, spread)
    answer = world.contacts(states)
    assert len(answer.gaps) <= world.settings.max_contacts
    assert size_of(answer) < 20e6
    # every pair has a contact or is listed for its bound
    assert kind == "tetrahedra" or len(answer.fragment_a) >= 4900
    assert answer.status == 0 or kind == "mixed"  # spheres touch balls at many places


@pytest.mark.slow
def test_a_thousand_bodies_in_one_place_are_rejected_with_an_explanation() -> None:
    world, states = crowd("boxes", 1000, 0.0)
    with pytest.raises(InvalidMessage, match=r"more than 100000 pairs .* \(max_pairs\)") as refused:
        world.contacts(states)
    assert refused.value.kind == "limit_exceeded"


@pytest.mark.slow
@pytest.mark.parametrize("count", [300, pytest.param(1000, marks=pytest.mark.slow)])
@pytest.mark.parametrize("kind", ["boxes", pytest.param("mixed", marks=pytest.mark.slow)])
def test_memory_for_a_crowd_is_limited(kind: str, count: int) -> None:
    """The whole process, including its answer, stays below 500 MB."""
    (row,) = measure_crowds([(kind, count, CLOSE)])
    assert row.peak < 500.0 and row.refused in ("", "limit_exceeded")
    assert row.refused or row.contacts > 1000


@pytest.mark.parametrize("kind", ["boxes", "tetrahedra", "mixed"])
def test_answers_within_limits_do_not_depend_on_threads_lists_or_earlier_steps(kind: str) -> None:
    answers = []
    for threads, forgets in ((1, False), (2, False), (5, True)):
        world, states = crowd(kind, 40, 0.4, threads=threads, max_work=5_000, max_contacts=1_500)
        moved = states._replace(positions=states.positions + 1e-5)
        half = states._replace(positions=np.append(moved.positions[:60], states.positions[60:]))
        told = []
        for step in (states, half, moved, states, half):
            if forgets:
                world.forget()
            answer = world.contacts(step)
            told.append(record_bytes(answer))
        answers.append(tuple(told))
    assert answer.status == BUDGET_EXHAUSTED and len(answer.gaps) > 700
    assert len(set(answers)) == 1


@pytest.mark.parametrize(
    ("kind", "spread", "lookahead"), [("boxes", 0.05, 0.0), ("mixed", 1.5, 0.05), ("tetrahedra", 1.5, 0.05)]
)
def test_pairs_that_exceed_their_buffer_are_searched_again(kind: str, spread: float, lookahead: float, monkeypatch):
    """More contacts, now or ahead, than rows in the first buffer: the same bytes as with enough rows."""
    world, states = crowd(kind, 40, spread, contacts_per_pair=30, threads=2, lookahead=lookahead)
    linear, angular = np.random.default_rng(7).uniform(-9.0, 9.0, (2, len(states.positions)))
    states = states._replace(linear_velocities=linear, angular_velocities=angular)
    expected = world.contacts(states)
    assert len(expected.gaps) > 500 and (expected.gaps > 0.1).sum() > (20 if lookahead else -1)
    monkeypatch.setattr("fracture_collision.core.search.passes.FIRST_ROOM", 0)
    for room in (1, 7, 30, 100):
        monkeypatch.setattr("fracture_collision.core.search.passes.LEAST_ROOM", room)
        for threads in (1, 2, 3):
            world.change_settings(world.settings._replace(threads=threads))
            world.forget()
            assert record_bytes(world.contacts(states)) == record_bytes(expected)


@pytest.mark.parametrize("kind", ["exact field", "averaged field", "ours"])
@pytest.mark.parametrize("limits", [{"max_contacts": 60}, {"max_contacts": 3}, {"max_work": 50}], ids=str)
def test_the_bound_covers_contacts_omitted_by_a_limit(limits: dict, kind: str) -> None:
    """Against every sample by brute force; the deepest contacts are kept."""
    case = fractured_world(COARSE_SHAPES["ball"](), seeds=5, generations=2, curved=True)
    states, truth = case.states(0.2, seed=2), ContactTruth(case)
    chosen = SETTINGS._replace(contacts_per_pair=2)
    if kind == "averaged field":
        chosen = chosen._replace(paper=PaperSettings())
    if kind == "ours":
        chosen = Settings(threads=1, contacts_per_pair=10)
    make = sampled_world if kind == "ours" else with_settings
    whole, limited = make(case, chosen), make(case, chosen._replace(**limits))
    everything, answer = whole.contacts(states), limited.contacts(states)
    assert answer.status == BUDGET_EXHAUSTED and everything.status == 0
    listed, poses = pairs_of(answer), Poses(states)
    for pair in pairs_of(everything):
        check = check_pair(truth, poses, answer, pair, listed, SETTINGS.penetration_tolerance)
        assert check.deepest_unlisted <= check.bound + 1e-9, (pair, check)
    assert len(answer.gaps) <= limits.get("max_contacts", len(everything.gaps))
    if kind == "exact field" and "max_work" not in limits:
        its = pairs_of(everything)
        for pair, (rows, _) in listed.items():
            deepest = np.sort(everything.gaps[its[pair][0]])[: len(answer.gaps[rows])]
            assert np.allclose(np.sort(answer.gaps[rows]), deepest)


@pytest.mark.parametrize("limits", [{"max_work": 1}, {"contacts_per_pair": 300}], ids=str)
def test_the_bound_covers_surfaces_that_are_not_tested_as_a_whole(limits: dict, monkeypatch) -> None:
    """By libigl's distances: coarse triangles of hooks, plates and rings are in each other with no sample there."""
    monkeypatch.setattr(random_pairs, "SETTINGS", Settings(threads=1, **limits))
    pairs = list(random_pairs.campaign("triangles", 60, 1))
    assert sum(pair.depth > pair.listed for pair in pairs) > 20
    assert not [pair for pair in pairs if "beyond" in pair.faults or "unlisted" in pair.faults]


def test_a_pair_with_a_plane_has_a_finite_bound_when_a_limit_cuts_its_search_short() -> None:
    """A few samples are queried: the bound is by the boxes, and no true contact is deeper."""
    for height in (0.3, 0.0, -0.3):
        answers = []
        for limits in ({"max_work": 1}, {}):
            world = CollisionWorld(SETTINGS._replace(**limits))
            world.add_body(tetrahedral_body(ball(0.5, 0.1)))
            world.add_body(CollisionBody(2, 2, plane=[0.0, 0.0, 1.0, 0.0], is_static=True))
            world.add_body(CollisionBody(3, 3, primitive=SolidPrimitive(BOX, (0.5, 0.5, 0.5))))
            world.add_body(CollisionBody(4, 4, primitive=SolidPrimitive(SPHERE, (0.5,))))
            places = np.array([[0.0, 0.0, height], [0.0, 0.0, 0.0], [5.0, 0.0, height], [10.0, 0.0, height]])
            turns = np.tile([0.0, 0.0, 0.0, 1.0], 4)
            answers.append(world.contacts(FragmentStates(1, 0, np.arange(1, 5), places.ravel(), turns)))
        limited, full = answers
        assert limited.status == BUDGET_EXHAUSTED and np.isfinite(limited.missed_depth_bound).all()
        depth, left = ({(a, b): (k, answer) for k, (a, b) in enumerate(
            zip(answer.fragment_a.tolist(), answer.fragment_b.tolist(), strict=True)
        )} for answer in (full, limited))  # fmt: skip
        for pair, (k, _) in depth.items():
            deepest = -full.gaps[full.pair_begin[k] : full.pair_begin[k + 1]].min(initial=0.0)
            its = left[pair][0]
            listed = -limited.gaps[limited.pair_begin[its] : limited.pair_begin[its + 1]].min(initial=0.0)
            assert deepest <= max(listed, limited.missed_depth_bound[its]), pair
