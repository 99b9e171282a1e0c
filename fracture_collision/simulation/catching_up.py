"""Bodies that waited within a step: the time that they lost, and the velocities that they will have after a touch.

A body that a touch holds back (`touch_ahead`) keeps its velocity; the blow comes with the next step's contacts. Two
things are found before that step's request.

- How long bodies move. They make up for lost time, a quarter of a step in each step. Bodies near each other do so
  together, or they would run into each other: for as long as the one that lost least. One at rest is at any time.
  Pushed bodies do not: a hand knows where they are.
- With which velocities. The contacts of the last step, carried to its end, are solved for those after the blow, and the
  service looks ahead with these. Otherwise bodies would leave for where nothing was searched, and wait again.

A service of another step length is not needed: a body that moves for h + d [s] in a step of h has (h + d) / h times
its velocity in the states, which takes it along the same path.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fracture_collision.portable_math import dots, lengths
from fracture_collision.records import ContactConstraintArray
from fracture_collision.simulation.engine import BodyStates, ByFragment, rows_of
from fracture_collision.simulation.rotations import INVERSE, quaternion_products, rotation_matrices, turned
from fracture_collision.simulation.solver.contact_islands import islands_of
from fracture_collision.simulation.solver.contact_solver import BodyPairs, SolverSettings
from fracture_collision.simulation.solver.touch_ahead import StepContacts, chosen_contacts

# In time steps: so much a body makes up for in a step, and so much it may still have to make up for.
CATCH_UP, MOST_LOST = 0.25, 2.0
# [rad] A body does not move for longer than a step if it would turn farther: its contact points move along arcs.
MOST_TURN = 0.05
# The service lists a contact that is open by more than its detection tolerance only if the bodies will move into each
# other by another. So such contacts, of those carried, may close by as many tolerances more.
CLOSER = 3.0
# Of the expected velocities, see SolverSettings: a search does not need them exactly.
ROUGHLY = 1.0e-3

# Contacts and their pairs.
Touching = tuple[ContactConstraintArray, BodyPairs]


class Waited(NamedTuple):
    """A step in which some of n bodies waited, or after which they are still behind."""

    states: BodyStates  # before it
    contacts: StepContacts
    earlier: Touching | None  # of the step before, carried to its beginning
    is_round: np.ndarray  # (n,) bool: spheres
    is_held: np.ndarray  # (n,) bool: those that waited
    is_at_rest: np.ndarray  # (n,) bool
    lost: np.ndarray  # (n,) [s] by which they are behind


class Expected(NamedTuple):
    """What is known of a step before its contacts."""

    extra: ByFragment  # (n,) [s] for which bodies move beyond a time step
    velocities: ByFragment  # (m, 6) of some bodies, at the end of the step


NOTHING = Expected(
    ByFragment(np.zeros(0, np.uint32), np.zeros(0)), ByFragment(np.zeros(0, np.uint32), np.zeros((0, 6)))
)


def carried_contacts(waited: Waited, after: BodyStates, settings: SolverSettings) -> Touching:
    """The contacts of a step at its end, where bodies are as in `after`: those that are open by `ahead_gap` at most."""
    before = waited.states
    contacts, pairs = _all_of(waited)
    counts: np.ndarray = np.diff(contacts.pair_begin.astype(np.int64))
    none = len(after.masses)
    rows = np.append(rows_of(before.fragment_ids, after.fragment_ids), none)
    at = np.where(rows[:-1] < none, rows[:-1], 0)
    turns = quaternion_products(after.frame_orientations[at], before.frame_orientations * INVERSE)
    turns[waited.is_round] = 0.0, 0.0, 0.0, 1.0  # another point of a sphere comes to where it touches
    rotations = np.concatenate((rotation_matrices(turns), np.eye(3)[None]))
    was, place = (np.vstack((centers, np.zeros(3))) for centers in (before.centers, after.centers[at]))
    points = []
    for body, known in ((pairs.body_a, contacts.points_a), (pairs.body_b, contacts.points_b)):
        own = np.repeat(body, counts)
        points.append(place[own] + turned(rotations[own], known - was[own]))
    gaps, sizes = dots(contacts.normals, points[1] - points[0]), np.repeat(pairs.sizes, counts)
    # Rows of what cannot move are the last; a fragment that broke has the same row, but has no contacts any more.
    stays = np.append(rows[:-1] < none, True)
    kept = (gaps <= settings.ahead_gap * sizes) & np.repeat(stays[pairs.body_a] & stays[pairs.body_b], counts)
    tolerance = settings.memory_reach * sizes
    gaps = gaps + np.where(gaps > tolerance, CLOSER * tolerance, 0.0)
    moved = contacts._replace(points_a=points[0], points_b=points[1], gaps=gaps)
    moved = chosen_contacts(moved, kept, np.ones(len(counts), bool))
    return moved, pairs._replace(
        body_a=rows[pairs.body_a], body_b=rows[pairs.body_b], rest_gaps=pairs.rest_gaps[kept]
    )


def extra_times(
    waited: Waited, after: BodyStates, is_pushed: np.ndarray, pairs: BodyPairs, time_step: float
) -> tuple[np.ndarray, np.ndarray]:
    """(n,) [s] for which the bodies of `after` move beyond a time step; (n,) bool: those to expect velocities of.

    is_pushed (n,) bool. pairs: of the bodies that are near each other.
    """

    def of(values: np.ndarray) -> np.ndarray:
        return ByFragment(waited.states.fragment_ids, values).of(after.fragment_ids)

    turns, lost = time_step * lengths(after.angular), of(waited.lost)
    room = np.where(of(waited.is_round), np.inf, MOST_TURN / np.maximum(turns, 1e-9) - 1.0) * time_step
    extra = np.clip(np.minimum(lost, CATCH_UP * time_step), 0.0, np.maximum(room, 0.0))
    extra = np.where(is_pushed, 0.0, np.where(of(waited.is_at_rest), np.inf, extra))
    is_expected = of(waited.is_held) | (lost > 0.0)
    islands = islands_of(np.arange(len(pairs.body_a) + 1), pairs.body_a, pairs.body_b, len(extra))
    if len(islands.bodies):
        its, begin, counts = islands.bodies, islands.body_begin[:-1], np.diff(islands.body_begin)
        extra[its] = np.repeat(np.minimum.reduceat(extra[its], begin), counts)
        is_expected[its] = np.repeat(np.logical_or.reduceat(is_expected[its], begin), counts)
    return np.where(np.isinf(extra), 0.0, extra), is_expected


def _all_of(waited: Waited) -> Touching:
    """The contacts of a step, those ahead, and those of the step before between pairs that have none now.

    Bodies that open a little while they turn touch again in the next step, or the one after.
    """
    now, pairs, ahead, pairs_ahead = waited.contacts
    found = now, pairs
    if ahead is not None and pairs_ahead is not None:
        found = _joined(found, (ahead, pairs_ahead))
    if waited.earlier is None:
        return found
    contacts, pairs = waited.earlier
    counts: np.ndarray = np.diff(contacts.pair_begin.astype(np.int64))
    codes, known = ((its.fragment_a.astype(np.uint64) << 32) | its.fragment_b for its in (contacts, found[0]))
    stays = (counts > 0) & ~np.isin(codes, known)
    kept = np.repeat(stays, counts)
    contacts = chosen_contacts(contacts, kept, stays)
    ids = waited.states.fragment_ids  # there may be new ones since
    left = BodyPairs(
        rows_of(contacts.fragment_a, ids), rows_of(contacts.fragment_b, ids), pairs.rolling_arm[stays],
        pairs.sizes[stays], pairs.bounce_speeds[stays], pairs.rest_gaps[kept],
    )  # fmt: skip
    return _joined(found, (contacts, left))


def _joined(first: Touching, second: Touching) -> Touching:
    (one, pairs), (other, more) = first, second

    def both(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        return np.concatenate((x, y))

    contacts = one._replace(
        fragment_a=both(one.fragment_a, other.fragment_a), fragment_b=both(one.fragment_b, other.fragment_b),
        pair_begin=both(one.pair_begin, other.pair_begin[1:] + one.pair_begin[-1]),
        missed_depth_bound=both(one.missed_depth_bound, other.missed_depth_bound),
        friction=both(one.friction, other.friction), restitution=both(one.restitution, other.restitution),
        points_a=both(one.points_a, other.points_a), points_b=both(one.points_b, other.points_b),
        normals=both(one.normals, other.normals), gaps=both(one.gaps, other.gaps),
        contact_ids=both(one.contact_ids, other.contact_ids),
    )  # fmt: skip
    return contacts, BodyPairs._make(map(both, pairs, more))
