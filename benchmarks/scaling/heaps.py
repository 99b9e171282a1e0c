"""A step of a heap of fragments: at rest, and moving slowly, when a step can reuse most of the last one's work."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import count, islice
from statistics import median
from time import perf_counter
from typing import NamedTuple

import numpy as np

from benchmarks.peers.worlds import World
from benchmarks.scaling.growth import Progress, silent
from benchmarks.scaling.piles import make_pile, world_of
from fracture_collision.records import FragmentStates
from fracture_collision.world import CollisionWorld, Settings

SLOW, MODERATE, FAST = 0.01, 0.1, 0.3  # [% R] per step
# All fragments take three steps along a line of their own and three back: none ever stays in place, which would be
# answered from the last step, and they remain a heap.
TO_AND_FRO = np.array([0, 1, 2, 3, 2, 1]) - 1.5
WARM_STEPS = len(TO_AND_FRO)  # neighbour lists reach as far as a pair moves, which takes some steps to adapt


class HeapRow(NamedTuple):
    """One heap, one thread; times are medians over the steps, in ms."""

    fragments: int
    moving: int  # fragments that move in a step
    step: float  # [% R] distance per step
    close_pairs: int  # found by the broad phase
    contacts: int
    broad_phase: float
    whole: float  # the call, from Python
    microseconds_a_pair: float  # whole / close pairs


def measure_heaps(
    source: World, sizes: Sequence[int], steps: int = 2 * len(TO_AND_FRO), progress: Progress = silent
) -> list[HeapRow]:
    """Five rows per size, with the service's default settings.

    Nothing moves: the same poses under a new step number; the answer is a comparison with the last poses and a copy of
    the last answer. One fragment moves, another in each step: the broad phase runs, and all pairs but its own reuse the
    last answer. All move, each in a direction of its own.
    """
    rows = []
    for size in sizes:
        progress(f"a heap of {size}")
        pile = make_pile(source, size)
        world = world_of(pile, Settings(threads=1))
        for moving, step in ((0, 0.0), (1, MODERATE), (size, SLOW), (size, MODERATE), (size, FAST)):
            progress(f"a heap of {size}, {moving} move by {step} % R")
            world.contacts(pile.states)
            rows.append(_row(world, _moved(pile.states, moving, step), moving, step, steps))
    return rows


def _row(world: CollisionWorld, moves: Iterator[FragmentStates], moving: int, step: float, steps: int) -> HeapRow:
    for states in islice(moves, WARM_STEPS):
        world.contacts(states)
    broad, whole, over_pairs = [], [], []
    for states in islice(moves, steps):
        began = perf_counter()
        answer = world.contacts(states)
        whole.append(perf_counter() - began)
        broad.append(world.last_timings["broad_phase"])
        over_pairs.append(whole[-1] / world.last_pairs)
    return HeapRow(
        len(states.fragment_ids), moving, step, world.last_pairs, len(answer.gaps), 1e3 * median(broad),
        1e3 * median(whole), 1e6 * median(over_pairs),
    )  # fmt: skip


def _moved(states: FragmentStates, moving: int, step: float) -> Iterator[FragmentStates]:
    """Successive steps of fragments that move by `step` [% R]; R is 1 m."""
    random = np.random.default_rng(1)
    lying = states.positions.reshape(-1, 3)
    ways = random.normal(size=lying.shape)
    ways *= 0.01 * step / np.linalg.norm(ways, axis=1)[:, None]
    turns = random.permutation(len(lying))
    positions = lying
    for k in count():
        if moving == 1:
            positions = positions.copy()
            mover = turns[k % len(turns)]
            positions[mover] += ways[mover]
        elif moving:
            positions = lying + TO_AND_FRO[k % len(TO_AND_FRO)] * ways
        yield states._replace(step=k, positions=positions.ravel())
