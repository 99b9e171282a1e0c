"""Scores answers against the ground truth; lengths in R, which is 1 m."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from benchmarks.peers.judging.moved_pairs import Way
from benchmarks.peers.judging.solver_error import solver_errors, translations
from benchmarks.peers.judging.truth import PairTruth, Solids
from benchmarks.peers.method import Contacts
from benchmarks.peers.worlds import Frame

TOLERANCE = 0.002  # the paper's delta: penetrations up to this need not be reported and do not count as false
WITNESSES = 1000  # per frame; more are thinned evenly
# Pairs near each other, over all frames, for which solver errors are computed; of more, a random sample, the same for
# every method. The limit holds all pairs of 20 fragments; those of 60 would take a quarter of a minute per method.
SOLVER_PAIRS, SEED = 1000, 1
WRONG_WAY = 30.0  # [degrees]


class Score(NamedTuple):
    """All frames of one kind. nan: there was nothing to judge."""

    contacts: float  # per frame
    deepest: float  # [R] reported
    penetrating: int  # pairs deeper than TOLERANCE, all frames together
    missed: int  # of these, without a contact of positive depth
    missed_deepest: float  # [R] true depth of the worst missed pair
    samples_penetrating: int  # pairs with a sample of the service deeper than TOLERANCE; 0 for meshes, which have none
    samples_missed: int  # of these, without a contact of positive depth
    samples_error_mean: float  # [R] like error_mean below, against the deepest sample
    samples_error_max: float
    apart: int  # pairs with overlapping boxes that do not overlap themselves
    false: int  # pairs that do not overlap and are reported deeper than TOLERANCE
    error_mean: float  # [R] absolute error of the deepest contact's depth, over penetrating pairs found
    error_max: float
    nearest_median: float  # [degrees] between the deepest contact's normal and the truth's `nearest`
    nearest_wrong: float  # share off by more than WRONG_WAY
    parting_median: float  # the same for the truth's `parting`
    parting_wrong: float
    witness_mean: float  # [R] distance of witnesses to the surface that they are reported on
    witness_max: float
    # [R] absolute error of the depth, over all pairs near each other, overlapping or reported; a missed pair counts
    # with its true depth, a false one with the reported depth. Left out: false pairs whose edges cross.
    pair_error_mean: float
    pair_error_max: float
    # [R] of the same pairs, or SOLVER_PAIRS of them, as in `solver_error`: after the least translation that satisfies
    # the reported contacts
    remaining_mean: float
    remaining_max: float
    unnecessary_mean: float
    unnecessary_max: float
    solver_error_mean: float  # sum of both
    solver_error_max: float


class FrameTruth(NamedTuple):
    frame: Frame
    pairs: dict[tuple[int, int], PairTruth]
    near: set[tuple[int, int]]  # pairs whose boxes overlap
    crossing: dict[tuple[int, int], bool]  # cache, by pair: whether edges cross, which is slow to compute


class JudgedPair(NamedTuple):
    """A pair that overlaps, is reported, or has overlapping boxes."""

    pair: tuple[int, int]
    true: PairTruth | None  # None: neither has a vertex in the other
    contact: int | None  # row of its deepest contact
    depth: float  # [m] of that, negative: a gap; 0 if none is reported
    crosses: bool  # reported, no vertex of either is in the other, but edges cross: the truth is unknown
    way: Way  # the translation a solver would apply


def judged_pairs(solids: Solids, truth: FrameTruth, answer: Contacts) -> Iterator[JudgedPair]:
    deepest, shifts = deepest_contacts(answer), translations(answer)
    for pair in sorted(truth.near | set(truth.pairs) | set(deepest)):
        true, contact = truth.pairs.get(pair), deepest.get(pair)
        depth = float(answer.depths[contact]) if contact is not None else 0.0
        crosses = true is None and depth > 0.0 and _edges_cross(solids, truth, pair)
        way = Way(truth.frame, *pair, shifts.get(pair, np.zeros(3)), true.depth if true else 0.0)
        yield JudgedPair(pair, true, contact, depth, crosses, way)


def score(solids: Solids, truths: list[FrameTruth], answers: list[Contacts]) -> Score:
    """`truths` and `answers`, by frame."""
    penetrating = missed = samples_penetrating = samples_missed = apart = false = 0
    missed_deepest = 0.0
    errors, sample_errors, pair_errors, nearest, parting, witness = [], [], [], [], [], [np.zeros(0)]
    ways, chosen = [], _solver_pairs(truths)
    for k, (truth, answer) in enumerate(zip(truths, answers, strict=True)):
        for pair, true, contact, depth, crosses, way in judged_pairs(solids, truth, answer):
            if not crosses:
                pair_errors.append(abs(max(depth, 0.0) - way.depth))
                if chosen is None or (k, *pair) in chosen:
                    ways.append(way)
            if true is None:
                claimed = depth > TOLERANCE
                if not (claimed and crosses):
                    apart, false = apart + 1, false + claimed
                continue
            if true.sample_depth > TOLERANCE:
                samples_penetrating += 1
                if depth > 0.0:
                    sample_errors.append(abs(depth - true.sample_depth))
                else:
                    samples_missed += 1
            if true.depth > TOLERANCE:
                penetrating += 1
                if depth <= 0.0:
                    missed += 1
                    missed_deepest = max(missed_deepest, true.depth)
                    continue
                errors.append(abs(depth - true.depth))
                normal = answer.normals[contact] * (1.0 if answer.first[contact] == pair[0] else -1.0)
                nearest.append(_degrees(normal, true.nearest))
                parting.append(_degrees(normal, true.parting))
        witness.append(_off_surface(solids, truth.frame, answer))
    off = np.concatenate(witness)
    remaining, unnecessary = solver_errors(solids, ways)
    return Score(
        float(np.mean([len(a.depths) for a in answers])),
        max((float(a.depths.max()) for a in answers if len(a.depths)), default=0.0),
        penetrating, missed, missed_deepest, samples_penetrating, samples_missed, *mean_max(sample_errors),
        apart, false,
        *mean_max(errors), *_median_wrong(nearest), *_median_wrong(parting), *mean_max(off),
        *mean_max(pair_errors), *mean_max(remaining), *mean_max(unnecessary), *mean_max(remaining + unnecessary),
    )  # fmt: skip


def _solver_pairs(truths: list[FrameTruth]) -> set[tuple[int, int, int]] | None:
    """Frame, first and second of pairs whose solver error is computed; None: all pairs."""
    near = [(k, *pair) for k, truth in enumerate(truths) for pair in sorted(truth.near)]
    if len(near) <= SOLVER_PAIRS:
        return None
    return {near[i] for i in np.random.default_rng(SEED).choice(len(near), SOLVER_PAIRS, replace=False)}


def _edges_cross(solids: Solids, truth: FrameTruth, pair: tuple[int, int]) -> bool:
    if pair not in truth.crossing:
        truth.crossing[pair] = solids.edges_cross(*pair, truth.frame)
    return truth.crossing[pair]


def deepest_contacts(answer: Contacts) -> dict[tuple[int, int], int]:
    """(smaller, larger fragment) to the row of the pair's deepest contact."""
    low, high = np.minimum(answer.first, answer.second), np.maximum(answer.first, answer.second)
    order = np.argsort(answer.depths, kind="stable")  # a later contact replaces an earlier one of its pair
    return {(int(low[i]), int(high[i])): int(i) for i in order}


def _degrees(a: np.ndarray, b: np.ndarray) -> float:
    lengths = np.linalg.norm(a) * np.linalg.norm(b)
    return float(np.degrees(np.arccos(np.clip(a @ b / lengths, -1.0, 1.0)))) if lengths > 0.0 else np.nan


def _off_surface(solids: Solids, frame: Frame, answer: Contacts) -> np.ndarray:
    rows = np.unique(np.linspace(0, max(len(answer.depths) - 1, 0), min(len(answer.depths), WITNESSES)).astype(int))
    distances = [np.zeros(0)]
    for owner, points in ((answer.first, answer.points_first), (answer.second, answer.points_second)):
        for f in np.unique(owner[rows]).tolist():
            own = rows[owner[rows] == f]
            local = (points[own] - frame.positions[f]) @ frame.rotations[f]
            distances.append(solids.nearest(f, np.ascontiguousarray(local))[0])
    return np.concatenate(distances)


def mean_max(values) -> tuple[float, float]:
    """Mean and maximum, nan if empty."""
    return (float(np.mean(values)), float(np.max(values))) if len(values) else (np.nan, np.nan)


def _median_wrong(angles: list[float]) -> tuple[float, float]:
    known = np.array([a for a in angles if np.isfinite(a)])
    return (float(np.median(known)), float(np.mean(known > WRONG_WAY))) if len(known) else (np.nan, np.nan)
