"""Random pairs of fragments, piled up in any orientation: no unlisted sample may be deeper than the bound.

A pair counts if the two fragments' boxes overlap. Many fragments in one step give many pairs. The campaign cycles
through shapes, cracks, generations, settings and pile densities.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from itertools import combinations
from typing import NamedTuple

import numpy as np
from worlds.fractured_worlds import SETTINGS as PAPERS
from worlds.fractured_worlds import after_each_fracture, fractured_world, with_messages
from worlds.sampled_worlds import SampledWorld

from fracture_collision.geometry.generators import TetGeometry
from fracture_collision.records import BUDGET_EXHAUSTED
from fracture_collision.world import CollisionWorld, Settings
from truth.contact_truth import SHAPES, ContactTruth, PairCheck, Poses, check_pair, pairs_of, piled

OURS = Settings(threads=1)  # at samples alone: contacts of whole surfaces are no samples
SETTINGS = (
    PAPERS,
    PAPERS._replace(max_work=100),
    PAPERS._replace(contacts_per_pair=1, penetration_tolerance=0.02),
    PAPERS._replace(max_work=500, contacts_per_pair=4),
    PAPERS._replace(contacts_per_pair=32, penetration_tolerance=0.0, detection_tolerance=0.01),
    PAPERS._replace(max_work=2_500, penetration_tolerance=0.01),
    PAPERS._replace(contacts_per_pair=4, penetration_tolerance=0.0005, detection_tolerance=0.0),
    OURS,
    OURS._replace(max_work=500),
    OURS._replace(contacts_per_pair=3, penetration_tolerance=0.01),
)
SPREADS = (0.15, 0.3, 0.5)  # [R] standard deviation of the fragments' centres from a common point


class Violation(NamedTuple):
    shape: str
    curved: bool
    world_seed: int
    generation: int
    states_seed: int
    settings: int  # index into SETTINGS
    pair: tuple[int, int]
    depth: float  # [R] of the deepest unlisted sample
    bound: float  # [R]


class Tally(NamedTuple):
    """Results for one kind of settings: with a budget that cut searches short, or without."""

    pairs: int
    touching: int  # pairs with a sample of one inside the other
    looseness: np.ndarray  # [R] bound minus deepest unlisted sample, for listed pairs
    bounds: np.ndarray  # [R] of the same pairs


class Part(NamedTuple):
    """One shape with one kind of cracks."""

    shape: str
    curved: bool
    full: Tally
    budgeted: Tally
    violations: list[Violation]


def campaign(
    pairs: int, seed: int, shapes: Mapping[str, Callable[[], TetGeometry]] = SHAPES, generations: int = 3
) -> Iterator[Part]:
    """At least `pairs` random pairs, shared evenly by shapes and cracks; R is 1 [m] for all shapes."""
    for shape, make in shapes.items():
        for curved in (False, True):
            yield _part(shape, curved, make(), -(-pairs // (2 * len(shapes))), seed, generations)


def _part(shape: str, curved: bool, body: TetGeometry, wanted: int, seed: int, generations: int) -> Part:
    case = fractured_world(body, seeds=6, generations=generations, curved=curved, seed=seed)
    kinds = [CollisionWorld if settings.method == PAPERS.method else SampledWorld for settings in SETTINGS]
    worlds = [with_messages(kind(settings), case) for kind, settings in zip(kinds, SETTINGS, strict=True)]
    checks: dict[bool, list[PairCheck]] = {False: [], True: []}
    violations: list[Violation] = []
    turn = 0
    for stage in after_each_fracture(case):
        truth = ContactTruth(stage)
        done = 0
        while done < -(-wanted // generations):
            which, states_seed = turn % len(SETTINGS), seed * 1_000_000 + turn
            states = piled(truth, states_seed, SPREADS[turn // len(SETTINGS) % len(SPREADS)])
            poses, answer = Poses(states), worlds[which].contacts(states)
            listed, boxes = pairs_of(answer), truth.world_boxes(poses)
            cut_short = bool(answer.status & BUDGET_EXHAUSTED)
            for pair in combinations(sorted(truth.fragment_ids), 2):
                a, b = boxes[pair[0]], boxes[pair[1]]
                if pair not in listed and np.any((a[0] > b[1]) | (b[0] > a[1])):
                    continue
                done += 1
                check = check_pair(truth, poses, answer, pair, listed, SETTINGS[which].penetration_tolerance)
                checks[cut_short].append(check)
                if check.deepest_unlisted > check.bound:
                    violations.append(Violation(shape, curved, seed, stage.generations, states_seed, which, pair,
                                                check.deepest_unlisted, check.bound))  # fmt: skip
            turn += 1
    return Part(shape, curved, _tally(checks[False]), _tally(checks[True]), violations)


def _tally(checks: list[PairCheck]) -> Tally:
    return Tally(
        pairs=len(checks),
        touching=sum(c.deepest_unlisted > 0.0 or len(c.excess) > 0 for c in checks),
        looseness=np.array([c.bound - c.deepest_unlisted for c in checks if c.is_listed]),
        bounds=np.array([c.bound for c in checks if c.is_listed]),
    )
