"""Contacts against brute force on concave bodies: none missed, none false, none too shallow."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from truth.contact_truth import (
    BORDER,
    COARSE_SHAPES,
    SHAPES,
    ContactTruth,
    PairCheck,
    assert_true,
    check_all_pairs,
    piled,
)
from worlds.fractured_worlds import FracturedWorld, fractured_world

from fracture_collision.records import FragmentStates

NOT_CONVEX = ("torus", "bowl", "l_block", "shell", "bunny")


def moved(case: FracturedWorld, seed: int, distance: float, degrees: float) -> FragmentStates:
    """All fragments in place, moved by up to `distance` [m] and turned by up to `degrees` about a random axis."""
    random = np.random.default_rng(seed)
    ids = np.array(case.oracle.fragment_ids)
    turns = random.normal(size=(len(ids), 3))
    turns *= np.radians(random.uniform(0, degrees, (len(ids), 1))) / np.linalg.norm(turns, axis=1)[:, None]
    shifts = random.normal(size=(len(ids), 3))
    shifts *= random.uniform(0, distance, (len(ids), 1)) / np.linalg.norm(shifts, axis=1)[:, None]
    return FragmentStates(1, case.generations, ids, shifts.ravel(), Rotation.from_rotvec(turns).as_quat().ravel())


FRAMES: dict[str, Callable[[ContactTruth, int], FragmentStates]] = {
    "touching": lambda truth, seed: truth.case.states(),
    "jittered": lambda truth, seed: moved(truth.case, seed, 0.01, 1.0),
    "deep": lambda truth, seed: moved(truth.case, seed, 0.2, 10.0),
    "piled": lambda truth, seed: piled(truth, seed, 0.25),
}


def excess_of(checks: list[PairCheck]) -> str:
    """For samples inside the other fragment: how many are reported deeper than the nearest surface, and by how much."""
    excess = np.concatenate([check.excess for check in checks])
    more = excess > BORDER
    largest, mean = excess.max(initial=0.0), excess[more].mean() if more.any() else 0.0
    return f"{len(excess)} contacts inside, {more.sum()} deeper than nearest, by {mean:.5f} R, at most {largest:.5f} R"


@pytest.fixture(
    scope="module",
    params=[(s, c) for s in NOT_CONVEX if s in COARSE_SHAPES for c in ("flat", "curved")],
    ids="-".join,
)
def truth(request) -> ContactTruth:
    shape, cracks = request.param
    return ContactTruth(fractured_world(COARSE_SHAPES[shape](), seeds=5, generations=2, curved=cracks == "curved"))


@pytest.mark.parametrize("frame", FRAMES)
def test_contacts_are_true_and_none_is_missed(truth: ContactTruth, frame: str) -> None:
    checks = check_all_pairs(truth, FRAMES[frame](truth, 1))
    assert sum(check.contacts for check in checks) > 0
    assert_true(checks, truth.case.world.settings.penetration_tolerance)


@pytest.mark.slow
@pytest.mark.timeout(1200)
@pytest.mark.parametrize(("shape", "cracks"), [(s, c) for s in NOT_CONVEX for c in ("flat", "curved")])
def test_contacts_are_true_in_many_frames(shape: str, cracks: str) -> None:
    truth = ContactTruth(fractured_world(SHAPES[shape](), seeds=6, generations=3, curved=cracks == "curved"))
    epsilon = truth.case.world.settings.penetration_tolerance
    frames = {
        name: [check_all_pairs(truth, frame(truth, seed)) for seed in range(1 if name == "touching" else 20)]
        for name, frame in FRAMES.items()
    }
    for name, runs in frames.items():
        checks = [check for run in runs for check in run]
        print(f"{shape} {cracks} {name}: {len(checks)} pairs, {excess_of(checks)}")
    for runs in frames.values():
        for run in runs:
            assert_true(run, epsilon)
