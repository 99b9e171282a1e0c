"""Random pairs of fragments, jittered, deep and piled: whether the deepest point of either surface is listed."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from itertools import combinations
from typing import NamedTuple

import numpy as np
from worlds.fractured_worlds import after_each_fracture, fractured_world, with_messages

from fracture_collision.geometry.generators import TetGeometry
from fracture_collision.records import FragmentStates
from fracture_collision.world import CollisionWorld, Settings
from truth.contact_truth import ContactTruth, Poses, pairs_of, piled
from truth.surface_truth import Solid

EPSILON = Settings().penetration_tolerance  # [R]; R is 1 m
JITTERS = (0.003, 0.01, 0.03)  # [R]
SPREADS = (0.3, 0.6)  # [R], of piles
FINEST = 2e-3  # [R] between dense points
LEAST = 0.9  # [epsilon] beyond the deepest contact; less deep points are not searched
# libigl's winding number and distances do not match ours to the last bit.
ROUNDING = 1e-6  # [R]


class PairDepth(NamedTuple):
    """Lengths in R."""

    shape: str
    curved: bool
    states: str
    pair: tuple[int, int]
    truth: float  # depth of the deepest dense point, if it is LEAST epsilon deeper than the deepest contact
    listed: float  # of the deepest contact; 0: none penetrates
    contacts: int

    @property
    def is_missed(self) -> bool:
        return self.truth > EPSILON + ROUNDING and self.contacts == 0

    @property
    def is_too_shallow(self) -> bool:
        return self.truth > self.listed + EPSILON + ROUNDING


def campaign(
    pairs: int, seed: int, shapes: Mapping[str, Callable[[], TetGeometry]], kind: type[CollisionWorld]
) -> Iterator[PairDepth]:
    """At least `pairs` pairs whose boxes overlap, shared evenly by shapes and cracks: curved or not."""
    share = -(-pairs // (2 * len(shapes)))
    for shape, make in shapes.items():
        for curved in (False, True):
            case = fractured_world(make(), seeds=6, generations=1, curved=curved, seed=seed)
            world = with_messages(kind(Settings(threads=1)), case)
            for stage in after_each_fracture(case):
                truth = ContactTruth(stage)
                solids = {f: Solid(truth.surface(f)) for f in truth.fragment_ids}
                done, turn = 0, 0
                while done < share:
                    for name, states in _states(stage, truth, seed * 1000 + turn):
                        judged = list(judge(world, truth, solids, states))
                        done += len(judged)
                        yield from (it._replace(shape=shape, curved=curved, states=name) for it in judged)
                        if done >= share:
                            break
                    turn += 1


def _states(stage, truth: ContactTruth, seed: int) -> Iterator[tuple[str, FragmentStates]]:
    for jitter in JITTERS:
        yield f"jitter {jitter:g}", stage.states(jitter, seed)
    for spread in SPREADS:
        yield f"pile {spread:g}", piled(truth, seed, spread)


def judge(
    world: CollisionWorld, truth: ContactTruth, solids: Mapping[int, Solid], states: FragmentStates
) -> Iterator[PairDepth]:
    poses, answer = Poses(states), world.contacts(states)
    listed, boxes = pairs_of(answer), truth.world_boxes(poses)
    for pair in combinations(sorted(truth.fragment_ids), 2):
        a, b = boxes[pair[0]], boxes[pair[1]]
        if pair not in listed and np.any((a[0] > b[1]) | (b[0] > a[1])):
            continue
        rows, _ = listed.get(pair, (slice(0, 0), EPSILON))
        deepest = max(-answer.gaps[rows].min(initial=0.0), 0.0)
        depth = 0.0
        for own, other in (pair, pair[::-1]):
            moved = poses.to_body(other, poses.to_world(own, solids[own].triangles.reshape(-1, 3))).reshape(-1, 3, 3)
            depth = max(depth, solids[other].deepest_of(moved, max(depth, deepest + LEAST * EPSILON), FINEST).depth)
        yield PairDepth("", False, "", pair, depth, deepest, rows.stop - rows.start)
