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

from fracture_collision.kernel_sources import cached_njit
from fracture_collision.portable_math import lengths
from fracture_collision.records import ContactConstraintArray
from fracture_collision.simulation.compiled import uncounted
from fracture_collision.simulation.engine import BodyStates, ByFragment, rows_of
from fracture_collision.simulation.rotations import INVERSE, quaternion_products, rotation_matrices
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
    contacts, pairs = _all_of(waited, settings)
    none = len(after.masses)
    # Rows of what cannot move are the last; a fragment that broke has the same row, but has no contacts any more.
    rows = np.append(rows_of(before.fragment_ids, after.fragment_ids), none)
    at = np.where(rows[:-1] < none, rows[:-1], 0)
    turns = quaternion_products(after.frame_orientations[at], before.frame_orientations * INVERSE)
    turns[waited.is_round] = 0.0, 0.0, 0.0, 1.0  # another point of a sphere comes to where it touches
    course = _Course(before.centers, after.centers[at], rotation_matrices(turns), rows[:-1] < none)
    points_a, points_b, gaps, kept = _carried(
        (contacts.pair_begin, pairs.body_a, pairs.body_b), (contacts.points_a, contacts.points_b, contacts.normals),
        course, settings.ahead_gap * pairs.sizes, settings.memory_reach * pairs.sizes,
    )  # fmt: skip
    moved = contacts._replace(points_a=points_a, points_b=points_b, gaps=gaps)
    moved = chosen_contacts(moved, kept, np.ones(len(pairs.sizes), bool))
    return moved, pairs._replace(
        body_a=rows[pairs.body_a], body_b=rows[pairs.body_b], rest_gaps=pairs.rest_gaps[kept]
    )


class _Course(NamedTuple):
    """How n bodies moved in a step."""

    before: np.ndarray  # (n, 3) [m], centres
    after: np.ndarray  # (n, 3) [m]
    rotations: np.ndarray  # (n, 3, 3)
    stays: np.ndarray  # (n,) bool: has not broken


@cached_njit
def _carried(pairs, contacts, course, ahead_gaps, tolerances):
    """Points (N, 3) [m] of contacts carried along with their bodies, their gaps (N,) [m], and which are kept (N,) bool.

    pairs: where the contacts of each begin (p + 1,), rows of its bodies (p,) each; contacts: points on both and normals
    (N, 3) each; ahead_gaps, tolerances (p,) [m]: gaps beyond the tolerance are enlarged, see CLOSER.
    """
    (begin, body_a, body_b), (points_a, points_b, normals) = pairs, contacts
    to_a, to_b = np.empty_like(points_a), np.empty_like(points_b)
    gaps, kept = np.empty(len(points_a)), np.zeros(len(points_a), np.bool_)
    for pair in range(len(body_a)):
        a, b, tolerance = body_a[pair], body_b[pair], tolerances[pair]
        stays = _stays(a, course) and _stays(b, course)
        for c in range(begin[pair], begin[pair + 1]):
            _carry(a, points_a[c], course, to_a[c])
            _carry(b, points_b[c], course, to_b[c])
            n, p, q = normals[c], to_a[c], to_b[c]
            gap = n[0] * (q[0] - p[0]) + n[1] * (q[1] - p[1]) + n[2] * (q[2] - p[2])
            kept[c] = stays and gap <= ahead_gaps[pair]
            gaps[c] = gap + CLOSER * tolerance if gap > tolerance else gap
    return to_a, to_b, gaps, kept


@uncounted
def _stays(body, course):
    return body >= len(course.stays) or course.stays[body]


@uncounted
def _carry(body, point, course, to):
    if body >= len(course.stays):
        to[0], to[1], to[2] = point[0], point[1], point[2]
        return
    was, now, r = course.before[body], course.after[body], course.rotations[body]
    x, y, z = point[0] - was[0], point[1] - was[1], point[2] - was[2]
    for k in range(3):
        to[k] = now[k] + (r[k, 0] * x + r[k, 1] * y + r[k, 2] * z)


def extra_times(
    waited: Waited, after: BodyStates, is_pushed: np.ndarray, carried: Touching, time_step: float
) -> tuple[np.ndarray, np.ndarray]:
    """(n,) [s] for which the bodies of `after` move beyond a time step; (n,) bool: those to expect velocities of.

    is_pushed (n,) bool. carried: contacts of the bodies that are near each other. What has none flies on as it is.
    """
    contacts, pairs = carried

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
    touch, has_contacts = np.zeros(len(extra) + 1, bool), np.diff(contacts.pair_begin) > 0
    touch[pairs.body_a[has_contacts]] = touch[pairs.body_b[has_contacts]] = True
    return np.where(np.isinf(extra), 0.0, extra), is_expected & touch[:-1]


def _all_of(waited: Waited, settings: SolverSettings) -> Touching:
    """The contacts of a step, those ahead, and those of the step before between pairs that have none now.

    Bodies that open a little while they turn touch again in the next step, or the one after. Where the points have slid
    apart by more than `ahead_gap`, the bodies have left each other.
    """
    now, pairs, ahead, pairs_ahead = waited.contacts
    found = _joined((now, pairs), (ahead, pairs_ahead)) if len(ahead.gaps) else (now, pairs)
    if waited.earlier is None:
        return found
    contacts, pairs = waited.earlier
    codes, known = ((its.fragment_a.astype(np.uint64) << 32) | its.fragment_b for its in (contacts, found[0]))
    stays = rows_of(codes, np.sort(known)) == len(known)
    kept, stays = _not_slid(
        contacts.pair_begin, stays, (contacts.points_a, contacts.points_b, contacts.normals),
        settings.ahead_gap * pairs.sizes,
    )  # fmt: skip
    contacts = chosen_contacts(contacts, kept, stays)
    ids = waited.states.fragment_ids  # there may be new ones since
    left = BodyPairs(
        rows_of(contacts.fragment_a, ids), rows_of(contacts.fragment_b, ids), pairs.rolling_arm[stays],
        pairs.sizes[stays], pairs.bounce_speeds[stays], pairs.rest_gaps[kept],
    )  # fmt: skip
    return _joined(found, (contacts, left))


@cached_njit
def _not_slid(begin, is_wanted, contacts, reach):
    """(N,) bool: contacts of the wanted (p,) pairs whose points are within `reach` (p,) [m] along the surface.

    And (p,) bool: pairs that have such contacts.
    """
    points_a, points_b, normals = contacts
    kept, stays = np.zeros(len(points_a), np.bool_), np.zeros(len(is_wanted), np.bool_)
    for pair in range(len(is_wanted)):
        if not is_wanted[pair]:
            continue
        for c in range(begin[pair], begin[pair + 1]):
            gap, square = 0.0, 0.0
            for i in range(3):
                apart = points_b[c, i] - points_a[c, i]
                gap += apart * normals[c, i]
                square += apart * apart
            kept[c] = square - gap * gap <= reach[pair] * reach[pair]
            stays[pair] |= kept[c]
    return kept, stays


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
