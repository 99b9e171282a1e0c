"""What a budget may leave out of the contacts, and what does not change them. Truth itself: test_contacts_truth."""

from __future__ import annotations

import numpy as np
import pytest
from contact_truth import COARSE_SHAPES, ContactTruth, Poses, pairs_of, sample_ids
from fractured_worlds import FracturedWorld, fractured_world, with_settings

from fracture_collision.records import BUDGET_EXHAUSTED, ContactConstraintArray, FragmentStates
from fracture_collision.world import Settings

SHAPES = {name: COARSE_SHAPES[name] for name in ("ball", "brick", "shell", "bowl")}
CASES = [(s, c) for s in SHAPES for c in ("flat", "curved")]


@pytest.fixture(scope="module", params=CASES, ids=["-".join(c) for c in CASES])
def case(request) -> FracturedWorld:
    shape, cracks = request.param
    return fractured_world(SHAPES[shape](), seeds=5, generations=2, curved=cracks == "curved")


def test_a_budget_makes_the_bound_grow_instead_of_lie(case: FracturedWorld) -> None:
    states = case.states(0.05, seed=2)
    poses, truth = Poses(states), ContactTruth(case)
    for budget in (200, 1000, 4000):
        limited = with_settings(case, case.world.settings._replace(visit_budget=budget))
        answer = limited.contacts(states)
        listed = pairs_of(answer)
        if not answer.status & BUDGET_EXHAUSTED:
            continue
        for (a, b), (rows, bound) in listed.items():
            for own, other in ((a, b), (b, a)):
                depths = truth.depths(own, other, poses).true
                is_listed = np.isin(sample_ids(own, other, truth.samples[own][1]), answer.contact_ids[rows])
                assert depths[~is_listed].max(initial=0.0) <= bound
        return
    pytest.fail("no budget was small enough to cut a search short")


def _bytes(answer: ContactConstraintArray) -> bytes:
    return b"".join(np.asarray(field).tobytes() for field in answer)


def test_the_answer_is_the_same_bytes_for_any_number_of_threads(case: FracturedWorld) -> None:
    states = case.states(0.05, seed=4)
    reference = _bytes(case.world.contacts(states))
    for threads in (2, 3, 8):
        assert _bytes(with_settings(case, Settings(threads=threads)).contacts(states)) == reference


def test_the_answer_has_no_memory(case: FracturedWorld) -> None:
    """Other states, and states of earlier registries, in between change nothing."""
    states = case.states(0.05, seed=4)
    reference = _bytes(case.world.contacts(states))
    digest = case.world.fragments().digest
    whole = FragmentStates(1, 0, np.array([1]), np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0]))
    case.world.contacts(case.states(0.2, seed=9))
    assert len(case.world.contacts(whole).gaps) == 0
    assert case.world.fragments().fragment_ids.tolist() == [1]
    assert _bytes(case.world.contacts(states)) == reference
    assert case.world.fragments().digest == digest


def test_order_of_the_named_fragments_does_not_matter(case: FracturedWorld) -> None:
    states = case.states(0.05, seed=4)
    back = FragmentStates(
        states.step, states.fracture_sequence, states.fragment_ids[::-1],
        states.positions.reshape(-1, 3)[::-1].ravel(), states.orientations.reshape(-1, 4)[::-1].ravel(),
    )  # fmt: skip
    assert _bytes(case.world.contacts(back)) == _bytes(case.world.contacts(states))
