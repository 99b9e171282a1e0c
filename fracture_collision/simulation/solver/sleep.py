"""Sleeping: islands of bodies that have hardly moved for a while are not solved.

With an accurate solver a heap creeps by nanometres for ever, so caches that rely on unmoved bodies would never hit. An
island (`contact_islands`) falls asleep once each of its bodies has moved, for `sleep_time`, no farther than
`sleep_speed` would have taken it. Displacement counts, as in Jolt, not speed: a shard that trembles between two normals
of a sharp corner would keep a heap awake. It counts by windows of `sleep_time`: a body that creeps stays quiet, or the
bodies of a large heap, each with a pause of its own, would hardly ever be quiet at once. Sleeping bodies keep their
poses to the last bit and are not solved; their impulses are kept. An island wakes as a whole when an awake body touches
one of its bodies, when a hand, a hammer or an arm pushes one, or when a fragment that one of them touched is gone: it
broke, or left the scene.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fracture_collision.kernel_sources import cached_njit
from fracture_collision.portable_math import lengths
from fracture_collision.simulation.solver.contact_islands import islands_of
from fracture_collision.simulation.solver.contact_solver import SolverSettings

# Share of gravity: a body that it accelerates by more than this for `sleep_time` is not at rest. A large one that
# begins to topple takes seconds to move by a visible share of its size.
FALL = 1.0e-3


class Rest(NamedTuple):
    """Of n bodies, in the engine's order."""

    fragment_ids: np.ndarray  # (n,) uint32
    quiet: np.ndarray  # (n,) float64 [s]: how long each has hardly moved
    asleep: np.ndarray  # (n,) bool
    gone: np.ndarray  # (n, 6) float64 [m], [rad]: displacement since the last multiple of `sleep_time` of that time


NOBODY = Rest(np.zeros(0, np.uint32), np.zeros(0), np.zeros(0, bool), np.zeros((0, 6)))


def roused(
    before: Rest, fragment_ids: np.ndarray, touched: tuple[np.ndarray, np.ndarray], is_pushed: np.ndarray
) -> Rest:
    """Rest of the bodies `fragment_ids` (n,), ascending, in a step.

    New bodies are awake, and so are those pushed (n,) and those that touched a fragment that is gone. `touched`:
    fragments of the last step's pairs, two columns (p,).
    """
    if not len(fragment_ids):
        return NOBODY
    if fragment_ids is before.fragment_ids and not is_pushed.any():
        return before
    at = np.minimum(np.searchsorted(before.fragment_ids, fragment_ids), max(len(before.fragment_ids) - 1, 0))
    known = before.fragment_ids[at] == fragment_ids if len(before.fragment_ids) else np.zeros(len(fragment_ids), bool)
    quiet, asleep, moved = np.zeros(len(fragment_ids)), np.zeros(len(fragment_ids), bool), np.zeros((len(at), 6))
    quiet[known], asleep[known], moved[known] = (
        column[at[known]] for column in (before.quiet, before.asleep, before.gone)
    )
    gone = np.setdiff1d(before.fragment_ids, fragment_ids, assume_unique=True)
    rouse = is_pushed.copy()
    for one, other in (touched, touched[::-1]) if len(gone) else ():
        rouse |= np.isin(fragment_ids, one[np.isin(other, gone)])
    quiet[rouse], asleep[rouse], moved[rouse] = 0.0, False, 0.0
    return Rest(fragment_ids, quiet, asleep, moved)


def settled(rest: Rest, begin: np.ndarray, body_a: np.ndarray, body_b: np.ndarray, sleep_time: float) -> Rest:
    """Rest with `asleep` for this step: islands with no body awake, and those quiet for `sleep_time` [s]; none if 0.

    begin (p + 1,), body_a, body_b (p,): the step's contacts by pairs of rows, n for what cannot move.
    """
    if not sleep_time > 0.0:
        return rest._replace(asleep=np.zeros(len(rest.asleep), bool))
    quiet, asleep = rest.quiet.copy(), np.zeros(len(rest.asleep), bool)
    islands = islands_of(begin, body_a, body_b, len(rest.asleep))
    _settle(islands.bodies, islands.body_begin, rest.asleep, sleep_time, quiet, asleep)
    return rest._replace(quiet=quiet, asleep=asleep, gone=np.where(asleep[:, None], 0.0, rest.gone))


@cached_njit
def _settle(bodies, body_begin, was_asleep, sleep_time, quiet, asleep):
    """Bodies without contacts are in no island and stay awake."""
    for i in range(len(body_begin) - 1):
        members = bodies[body_begin[i] : body_begin[i + 1]]
        all_asleep, all_quiet, some_asleep = True, True, False
        for k in members:
            all_asleep &= was_asleep[k]
            some_asleep |= was_asleep[k]
            all_quiet &= quiet[k] >= sleep_time
        for k in members:
            asleep[k] = all_asleep or all_quiet
            if some_asleep and not asleep[k]:
                quiet[k] = 0.0


def farthest_at_rest(settings: SolverSettings, sizes: np.ndarray, gravity: np.ndarray) -> np.ndarray:
    """(n,) [m] as far as bodies of R `sizes` (n,) [m] may move within `sleep_time` under `gravity` (3,) [m/s2]."""
    farthest = settings.sleep_speed * settings.sleep_time * sizes
    strength = float(lengths(gravity))
    if strength > 0.0:
        fall = 0.5 * strength * settings.sleep_time * settings.sleep_time
        farthest = np.minimum(farthest, FALL * fall)
    return farthest


def after_step(
    rest: Rest,
    masses: np.ndarray,
    inertias: np.ndarray,
    moves: np.ndarray,
    farthest: np.ndarray,
    sleep_time: float,
    time_step: float,
) -> Rest:
    """Rest after a step that moved the poses with velocities `moves` (n, 6) [m/s, rad/s], drift correction included.

    farthest (n,) [m]: as far as a body may move within `sleep_time` [s] that is to fall asleep.
    """
    window = max(sleep_time, time_step)
    quiet, gone = _stay(rest.quiet, rest.gone, masses, inertias, moves, farthest, window, time_step)
    return rest._replace(quiet=quiet, gone=gone)


@cached_njit
def _stay(quiet, gone, masses, inertias, moves, farthest, window, time_step):
    """A rotation counts as the RMS displacement of the body's points, by the inertia tensor as in kinetic energy."""
    after, way = np.zeros(len(quiet)), gone + time_step * moves
    for i in range(len(quiet)):
        square = 0.0
        for k in range(3):
            square += masses[i] * way[i, k] * way[i, k]
            for l in range(3):  # noqa: E741
                square += way[i, 3 + k] * inertias[i, k, l] * way[i, 3 + l]
        if square < masses[i] * farthest[i] * farthest[i]:
            after[i] = quiet[i] + time_step
            if np.floor(after[i] / window) > np.floor(quiet[i] / window):
                way[i] = 0.0
        else:
            way[i] = 0.0
    return after, way
