"""Contacts ahead: within a step, bodies move no farther than to where they will touch (motion clamping, as in Bullet).

With its parameter `lookahead` the service also lists contacts of bodies that are apart now and, at their velocities,
touch before the step ends. Such a contact gets no impulse across the gap: it does not bounce and breaks nothing. The
two bodies move for the part of the step before the touch, keep their velocities, and meet in the next step as they
would have met at its beginning. They make up for the rest of the step in later ones (`catching_up`).

The solved velocities keep touching bodies apart along straight lines, as long as both move. A body is held back before
it runs into one that it touches and that waits. The points of a body that turns far in a step move along arcs: it is
held back likewise, before one of its contacts deepens by `ahead_gap`.

The service looks ahead with the velocities before a blow that was not expected. After the blow, bodies move where no
contact was searched. In that step, no point of two touching bodies deviates from its searched path by more than a fifth
of the thinner body's thickness, clamped to between one and two `ahead_gap`. The next request has the new velocities.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fracture_collision.grouping import begins_of
from fracture_collision.kernel_sources import cached_njit
from fracture_collision.portable_math import dots, lengths
from fracture_collision.records import ContactConstraintArray
from fracture_collision.simulation.compiled import uncounted
from fracture_collision.simulation.engine import BodyStates
from fracture_collision.simulation.solver.contact_solver import BodyPairs, SolverSettings
from fracture_collision.simulation.solver.side_by_side import Motion, boxes_of, length, shares_side_by_side, turned

# [rad] A body that turns farther in a step moves its contact points along arcs.
FAR_TURN = 0.1
# A body may deviate by this share of the shortest side of its inertia box, but by no more than MOST_SPARE `ahead_gap`:
# parts of it, such as ears, may be thinner.
SPARE, MOST_SPARE = 0.2, 2.0
# Of this, where the path was an expected one: a body that it does not touch may deviate as well, and come to meet it.
EXPECTED = 0.75
# A contact deeper than `ahead_gap` deepens by no more than this share of it in a step, or it would go deep in time.
DEEPER = 0.05
# A path is checked in PARTS parts and PARTS_A_RADIAN more for each radian that the bodies turn, these at most
# MOST_PARTS; the first part that comes too near is bisected HALVINGS times.
PARTS, PARTS_A_RADIAN, MOST_PARTS, HALVINGS = 4, 8.0, 1000, 30


class Forms(NamedTuple):
    """Of n bodies; the last of each is for what cannot move."""

    is_round: np.ndarray  # (n + 1,) bool: spheres; the last, False
    sizes: np.ndarray  # (n + 1,) R [m] of the bodies that they came from; the last, inf


class StepContacts(NamedTuple):
    """All contacts of a step."""

    now: ContactConstraintArray  # those solved
    pairs: BodyPairs  # of these
    ahead: ContactConstraintArray | None
    pairs_ahead: BodyPairs | None


class Touches(NamedTuple):
    """N contacts that end the motion of their bodies."""

    body_a: np.ndarray  # (N,) int64 rows of the bodies, n for what cannot move
    body_b: np.ndarray  # (N,) int64
    points_a: np.ndarray  # (N, 3) [m] present positions, world
    points_b: np.ndarray  # (N, 3) [m]
    normals: np.ndarray  # (N, 3) from a to b
    least: np.ndarray  # (N,) [m] the gap at which the motion ends


class Course(NamedTuple):
    """How n bodies would move in a step: velocities (n, 6) [m/s, rad/s] that bring them there in one time step.

    A body that makes up for lost time moves for longer than a step: its velocities are so many times its own.
    """

    moves: np.ndarray  # (n, 6)
    searched: np.ndarray | None  # (n, 6) with which the service looked ahead; None: it does not look ahead
    falls: np.ndarray  # (n, 3) by which gravity changes `moves`
    is_expected: np.ndarray  # (n,) bool: the service looked ahead with the velocities expected after contacts


def split_by_gap(
    contacts: ContactConstraintArray, sizes: np.ndarray, most: float
) -> tuple[ContactConstraintArray, ContactConstraintArray | None]:
    """The contacts with gaps of at most `most` R, with their pairs, and the contacts ahead, None without any.

    sizes (p,): R [m] of the pairs.
    """
    counts: np.ndarray = np.diff(contacts.pair_begin.astype(np.int64))
    is_ahead = contacts.gaps > most * np.repeat(sizes, counts)
    if not is_ahead.any():
        return contacts, None
    # A pair listed without contacts stays, for its missed_depth_bound.
    is_empty = counts == 0
    return chosen_contacts(contacts, ~is_ahead, is_empty), chosen_contacts(contacts, is_ahead, np.zeros_like(is_empty))


def chosen_contacts(contacts: ContactConstraintArray, chosen: np.ndarray, stays: np.ndarray) -> ContactConstraintArray:
    """The `chosen` (N,) contacts, and the pairs that have any or `stays` (p,)."""
    counts: np.ndarray = np.diff(contacts.pair_begin.astype(np.int64))
    left = np.bincount(np.repeat(np.arange(len(counts)), counts)[chosen], minlength=len(counts))
    stays = stays | (left > 0)
    return contacts._replace(
        fragment_a=contacts.fragment_a[stays], fragment_b=contacts.fragment_b[stays],
        pair_begin=begins_of(left[stays]).astype(contacts.pair_begin.dtype),
        missed_depth_bound=contacts.missed_depth_bound[stays], friction=contacts.friction[stays],
        restitution=contacts.restitution[stays], points_a=contacts.points_a[chosen], points_b=contacts.points_b[chosen],
        normals=contacts.normals[chosen], gaps=contacts.gaps[chosen], contact_ids=contacts.contact_ids[chosen],
    )  # fmt: skip


def shares_of_step(
    states: BodyStates, contacts: StepContacts, course: Course, forms: Forms, settings: SolverSettings,
    time_step: float,
) -> np.ndarray:  # fmt: skip
    """(n,) share of their course for which bodies move: no farther than to where they touch."""
    (now, pairs, ahead, pairs_ahead), (moves, searched, *_), is_round = contacts, course, forms.is_round
    count = len(states.fragment_ids)
    shares = np.ones(count)
    if searched is None:
        is_chosen = _turns_far(pairs, moves, time_step)
    else:
        boxes, least = boxes_of(states.masses, states.inertias), settings.ahead_gap * forms.sizes[:-1]
        spare = np.clip(SPARE * boxes.thickness(), least, MOST_SPARE * least)
        reach = np.where(is_round[:-1], 0.0, boxes.reach())  # turning does not move a sphere's surface
        near = settings.ahead_gap * pairs.sizes
        is_chosen = _goes_astray(pairs, moves, reach, near, time_step)
        of_bodies = np.append(spare, np.inf)
        spare_of_pairs = np.minimum(of_bodies[pairs.body_a], of_bodies[pairs.body_b])
        # What cannot move may be smaller than what touches it.
        spare_of_pairs = np.minimum(spare_of_pairs, MOST_SPARE * near)
        shares = _shares_as_searched(pairs, course, reach, spare, spare_of_pairs, time_step)
        if ahead is not None or is_chosen.any() or shares.min(initial=1.0) < 1.0:
            # Two that touch are kept apart while both move: one that moves on alone would run into the other.
            is_chosen = is_chosen | ((pairs.body_a < count) & (pairs.body_b < count))
    touching = _touching(now, pairs, is_chosen, settings, DEEPER if searched is not None else 1.0)
    parts = [] if touching is None else [touching]
    if ahead is not None and pairs_ahead is not None:
        repeat: np.ndarray = np.diff(ahead.pair_begin.astype(np.int64))
        a, b = np.repeat(pairs_ahead.body_a, repeat), np.repeat(pairs_ahead.body_b, repeat)
        parts.append(Touches(a, b, ahead.points_a, ahead.points_b, ahead.normals, pairs_ahead.rest_gaps))
    motion = Motion(states.centers, moves, time_step)
    if parts:
        touches = Touches._make(np.concatenate(column) for column in zip(*parts, strict=True))
        if searched is not None:
            touches = _by_middles_of_spheres(touches, states.centers, is_round)
        shares = shares_until_touch(touches, motion, shares, searched is not None, is_round)
    if searched is not None:
        shares = shares_side_by_side(shares, motion, searched, boxes, spare)
    return shares


def _shares_as_searched(
    pairs: BodyPairs, course: Course, reach: np.ndarray, spare: np.ndarray, spare_of_pairs: np.ndarray,
    time_step: float,
) -> np.ndarray:  # fmt: skip
    """(n,) share of their course for which bodies may move along another path than the searched one.

    No point of two touching bodies deviates from that path by more than `spare_of_pairs` (p,) [m], and none of a body
    whose path was an expected one by more than EXPECTED of its `spare` (n,) [m]. Other paths are those of free fall:
    what contacts bear of a weight counts as no deviation, or bodies at rest on another that slide along it would be
    held back.
    """
    change, falls = course.moves - course.searched, course.falls
    # A surface with normal n bears -(n . f) n of a weight f, a vector in the ball whose diameter is -f.
    linear = np.maximum(lengths(change[:, :3] + 0.5 * falls) - 0.5 * lengths(falls), 0.0)
    astray = np.append(time_step * (linear + reach * lengths(change[:, 3:])), 0.0)
    share = spare_of_pairs / np.maximum(astray[pairs.body_a] + astray[pairs.body_b], spare_of_pairs)
    most = np.where(course.is_expected, EXPECTED * spare, np.inf)
    shares = np.append(1.0 / np.maximum(astray[:-1] / most, 1.0), 1.0)
    np.minimum.at(shares, pairs.body_a, share)
    np.minimum.at(shares, pairs.body_b, share)
    return shares[:-1]


def _turns_far(pairs: BodyPairs, velocities: np.ndarray, time_step: float) -> np.ndarray:
    """(p,) pairs in which a body turns far in a step."""
    turns = np.append(lengths(velocities[:, 3:]) * time_step > FAR_TURN, False)
    return turns[pairs.body_a] | turns[pairs.body_b]


def _goes_astray(
    pairs: BodyPairs, velocities: np.ndarray, reach: np.ndarray, most: np.ndarray, time_step: float
) -> np.ndarray:
    """(p,) pairs in which turning or sliding may carry a point more than `most` (p,) [m] off its straight path."""
    v = np.vstack((velocities, np.zeros(6)))
    turns = time_step * lengths(v[:, 3:])
    turning = turns * np.append(reach, 0.0)
    a, b = pairs.body_a, pairs.body_b
    ways = time_step * lengths(v[a, :3] - v[b, :3]) + turning[a] + turning[b]
    return (turns[a] + turns[b]) * ways > most


def _touching(
    contacts: ContactConstraintArray, pairs: BodyPairs, chosen: np.ndarray, settings: SolverSettings, deeper: float
) -> Touches | None:
    """The contacts of the `chosen` (p,) pairs; None without any.

    deeper: a contact as deep as `ahead_gap` deepens by no more than this share of it.
    """
    if not chosen.any():
        return None
    repeat: np.ndarray = np.diff(contacts.pair_begin.astype(np.int64))
    body_a, body_b, sizes, chosen = (
        np.repeat(column, repeat) for column in (pairs.body_a, pairs.body_b, pairs.sizes, chosen)
    )
    columns = (contacts.points_a, contacts.points_b, contacts.normals)
    points_a, points_b, normals = (column[chosen] for column in columns)
    rest_gap, ahead_gap = settings.rest_gap * sizes[chosen], settings.ahead_gap * sizes[chosen]
    gaps = np.minimum(contacts.gaps[chosen], rest_gap)
    most = np.maximum(ahead_gap + (gaps - rest_gap), deeper * ahead_gap)
    return Touches(body_a[chosen], body_b[chosen], points_a, points_b, normals, gaps - most)


def _by_middles_of_spheres(touches: Touches, centers: np.ndarray, is_round: np.ndarray) -> Touches:
    """The touches with each contact point of a sphere replaced by its centre.

    The centre stays a radius away from what the sphere touches, whichever point touches.
    """
    points, least = [], touches.least
    for body, at, sign in ((touches.body_a, touches.points_a, 1.0), (touches.body_b, touches.points_b, -1.0)):
        middles = np.where(is_round[body, None], np.vstack((centers, np.zeros(3)))[body], at)
        least = least + sign * dots(touches.normals, at - middles)
        points.append(middles)
    return touches._replace(points_a=points[0], points_b=points[1], least=least)


@cached_njit
def shares_until_touch(touches, motion, most, is_turning, is_round):
    """(n,) share of the step for which each body may move, at most `most` (n,).

    No gap of `touches` falls below its `least`. motion: Motion of n bodies. is_turning: normals turn with one of the
    two bodies; is_round (n + 1,): spheres.
    """
    body_a, body_b, points_a, points_b, normals, least = touches
    velocities, h = motion.velocities, motion.time_step
    n = len(motion.centers)
    shares = np.ones(n + 1)
    shares[:n] = most
    for c in range(len(body_a)):
        a, b, contact = body_a[c], body_b[c], (points_a[c], points_b[c], normals[c])
        of, other = _bodies_of_plane(a, b, is_round) if is_turning else (n, n)
        turns = h * (_spin(a, velocities) + _spin(b, velocities))
        before, parts = 0.0, PARTS + int(min(PARTS_A_RADIAN * turns, MOST_PARTS))
        for part in range(1, parts + 1):
            after = part / parts
            if _gap(a, b, contact, of, other, motion, h * after, h * after) < least[c]:
                for _ in range(HALVINGS):
                    middle = 0.5 * (before + after)
                    if _gap(a, b, contact, of, other, motion, h * middle, h * middle) < least[c]:
                        after = middle
                    else:
                        before = middle
                break
            before = after
        shares[a], shares[b] = min(shares[a], before), min(shares[b], before)
    shares[n] = 1.0
    # A body that a third one holds back may be hit while it waits: then both get the smaller share. Shares only fall,
    # and only to existing values, so this ends.
    changed = True
    while changed:
        changed = False
        for c in range(len(body_a)):
            a, b, contact = body_a[c], body_b[c], (points_a[c], points_b[c], normals[c])
            if shares[a] == shares[b] or a == n or b == n:
                continue
            of, other = _bodies_of_plane(a, b, is_round) if is_turning else (n, n)
            if _gap(a, b, contact, of, other, motion, h * shares[a], h * shares[b]) < least[c]:
                shares[a] = shares[b] = min(shares[a], shares[b])
                changed = True
    return shares[:n]


@uncounted
def _bodies_of_plane(a, b, is_round):
    """Bodies that a contact's plane may turn with: either of the two, but no sphere, which turns without it."""
    if is_round[a] and is_round[b]:
        return len(is_round) - 1, len(is_round) - 1
    if is_round[a] or is_round[b]:
        return (b, b) if is_round[a] else (a, a)
    return a, b


@uncounted
def _gap(a, b, contact, of, other, motion, time_a, time_b):
    """Gap [m] of a contact (points, normal) after a has moved for `time_a` [s] and b for `time_b`.

    Its plane turns with the body `of` or `other`, whichever gives the smaller gap.
    """
    point_a, point_b, normal = contact
    centers, velocities = motion.centers, motion.velocities
    xa = _moved(a, point_a, centers, velocities, time_a)
    xb = _moved(b, point_b, centers, velocities, time_b)
    way = xb[0] - xa[0], xb[1] - xa[1], xb[2] - xa[2]
    least = _along(normal, of, time_a if of == a else time_b, velocities, way)
    if other != of:
        least = min(least, _along(normal, other, time_a if other == a else time_b, velocities, way))
    return least


@uncounted
def _along(normal, body, t, velocities, way):
    """`way` along a normal that has turned with a body for `t` [s]."""
    x, y, z = normal[0], normal[1], normal[2]
    if body < len(velocities):
        x, y, z = turned(velocities[body], t, x, y, z)
    return x * way[0] + y * way[1] + z * way[2]


@uncounted
def _spin(body, velocities):
    if body == len(velocities):
        return 0.0
    u = velocities[body]
    return length(u[3], u[4], u[5])


@uncounted
def _moved(body, point, centers, velocities, t):
    if body == len(centers):
        return point[0], point[1], point[2]
    c, u = centers[body], velocities[body]
    x, y, z = turned(u, t, point[0] - c[0], point[1] - c[1], point[2] - c[2])
    return c[0] + t * u[0] + x, c[1] + t * u[1] + y, c[2] + t * u[2] + z
