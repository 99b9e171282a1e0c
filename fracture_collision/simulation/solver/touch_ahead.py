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

from fracture_collision.kernel_sources import cached_njit
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
    ahead: ContactConstraintArray
    pairs_ahead: BodyPairs


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


class Split(NamedTuple):
    """Contacts of p pairs in two: those now, and those ahead; each with the pairs (p,) bool that it keeps."""

    now: ContactConstraintArray
    pairs: np.ndarray
    ahead: ContactConstraintArray
    pairs_ahead: np.ndarray


def split_by_gap(contacts: ContactConstraintArray, sizes: np.ndarray, most: float) -> Split:
    """The contacts with gaps of at most `most` R, with their pairs, and the contacts ahead.

    sizes (p,): R [m] of the pairs.
    """
    is_ahead, is_empty, has_now, has_ahead = _split(contacts.pair_begin, contacts.gaps, most * sizes)
    none_ahead = not has_ahead.any()
    # A pair listed without contacts stays, for its missed_depth_bound.
    now = contacts if none_ahead else chosen_contacts(contacts, ~is_ahead, is_empty)
    return Split(now, has_now | is_empty, chosen_contacts(contacts, is_ahead, has_ahead), has_ahead)


@cached_njit
def _split(begin, gaps, most):
    """(N,) bool: contacts ahead; (p,) bool each: pairs without contacts, with contacts now, with contacts ahead."""
    count = len(begin) - 1
    is_ahead = np.zeros(len(gaps), np.bool_)
    is_empty, has_now, has_ahead = np.zeros(count, np.bool_), np.zeros(count, np.bool_), np.zeros(count, np.bool_)
    for pair in range(count):
        is_empty[pair] = begin[pair] == begin[pair + 1]
        for c in range(begin[pair], begin[pair + 1]):
            is_ahead[c] = gaps[c] > most[pair]
            has_now[pair] |= not is_ahead[c]
            has_ahead[pair] |= is_ahead[c]
    return is_ahead, is_empty, has_now, has_ahead


def chosen_contacts(contacts: ContactConstraintArray, chosen: np.ndarray, stays: np.ndarray) -> ContactConstraintArray:
    """The `chosen` (N,) contacts, and the pairs that have any or `stays` (p,)."""
    of_pairs = (
        contacts.fragment_a, contacts.fragment_b, contacts.missed_depth_bound, contacts.friction, contacts.restitution
    )  # fmt: skip
    of_contacts = contacts.points_a, contacts.points_b, contacts.normals, contacts.gaps, contacts.contact_ids
    begin, (fragment_a, fragment_b, bounds, friction, restitution), (points_a, points_b, normals, gaps, ids) = (
        _chosen(contacts.pair_begin, chosen, stays, of_pairs, of_contacts)
    )  # fmt: skip
    return contacts._replace(
        fragment_a=fragment_a, fragment_b=fragment_b, pair_begin=begin, missed_depth_bound=bounds, friction=friction,
        restitution=restitution, points_a=points_a, points_b=points_b, normals=normals, gaps=gaps, contact_ids=ids,
    )  # fmt: skip


@cached_njit
def _chosen(begin, chosen, stays, of_pairs, of_contacts):
    count, kept = 0, np.empty(len(stays), np.bool_)
    for pair in range(len(stays)):
        kept[pair] = stays[pair]
        for c in range(begin[pair], begin[pair + 1]):
            kept[pair] |= chosen[c]
        count += kept[pair]
    begins, at, used = np.zeros(count + 1, begin.dtype), 0, 0
    for pair in range(len(stays)):
        for c in range(begin[pair], begin[pair + 1]):
            used += chosen[c]
        if kept[pair]:
            at += 1
            begins[at] = used
    fragment_a, fragment_b, bounds, friction, restitution = of_pairs
    points_a, points_b, normals, gaps, ids = of_contacts
    return (
        begins,
        (fragment_a[kept], fragment_b[kept], bounds[kept], friction[kept], restitution[kept]),
        (points_a[chosen], points_b[chosen], normals[chosen], gaps[chosen], ids[chosen]),
    )


def shares_of_step(
    states: BodyStates, contacts: StepContacts, course: Course, forms: Forms, settings: SolverSettings,
    time_step: float,
) -> np.ndarray:  # fmt: skip
    """(n,) share of their course for which bodies move: no farther than to where they touch."""
    (now, pairs, ahead, pairs_ahead), (moves, searched, *_) = contacts, course
    is_round, motion = forms.is_round, Motion(states.centers, moves, time_step)
    near = settings.ahead_gap * pairs.sizes
    if searched is None:
        is_chosen = _turns_far(pairs.body_a, pairs.body_b, moves, time_step)
        shares = np.ones(len(moves))
    else:
        boxes, least = boxes_of(states.masses, states.inertias), settings.ahead_gap * forms.sizes[:-1]
        spare = np.clip(SPARE * boxes.thickness(), least, MOST_SPARE * least)
        reach = np.where(is_round[:-1], 0.0, boxes.reach())  # turning does not move a sphere's surface
        is_chosen = _goes_astray(pairs.body_a, pairs.body_b, moves, reach, near, time_step)
        shares = _shares_as_searched(pairs.body_a, pairs.body_b, near, course, reach, spare, time_step)
        if len(ahead.gaps) or is_chosen.any() or shares.min(initial=1.0) < 1.0:
            # Two that touch are kept apart while both move: one that moves on alone would run into the other.
            is_chosen |= (pairs.body_a < len(moves)) & (pairs.body_b < len(moves))
    if is_chosen.any() or len(ahead.gaps):
        deeper = 1.0 if searched is None else DEEPER
        ends = _least_gaps(now.pair_begin, now.gaps, settings.rest_gap * pairs.sizes, near, deeper)
        touching = _Listed(
            now.pair_begin, pairs.body_a, pairs.body_b, now.points_a, now.points_b, now.normals, ends
        )
        coming = _Listed(
            ahead.pair_begin, pairs_ahead.body_a, pairs_ahead.body_b, ahead.points_a, ahead.points_b, ahead.normals,
            pairs_ahead.rest_gaps,
        )  # fmt: skip
        touches = _touches(touching, is_chosen, coming, states.centers, is_round, searched is not None)
        shares = shares_until_touch(touches, motion, shares, searched is not None, is_round)
    if searched is not None:
        shares = shares_side_by_side(shares, motion, searched, boxes, spare)
    return shares


@cached_njit
def _shares_as_searched(body_a, body_b, near, course, reach, spare, time_step):
    """(n,) share of their course for which bodies may move along another path than the searched one.

    No point of two touching bodies deviates from that path by more than what the two may, near (p,) [m] being the
    `ahead_gap` of each pair, and none of a body whose path was an expected one by more than EXPECTED of its `spare`.
    Other paths are those of free fall: what contacts bear of a weight counts as no deviation, or bodies at rest on
    another that slide along it would be held back.
    """
    moves, searched, falls, is_expected = course
    n = len(searched)
    astray, shares = np.zeros(n + 1), np.ones(n + 1)
    for i in range(n):
        u, v, fall = moves[i], searched[i], falls[i]
        # A surface with normal n bears -(n . f) n of a weight f, a vector in the ball whose diameter is -f.
        half = 0.5 * length(fall[0], fall[1], fall[2])
        change = length(u[0] - v[0] + 0.5 * fall[0], u[1] - v[1] + 0.5 * fall[1], u[2] - v[2] + 0.5 * fall[2])
        turn = length(u[3] - v[3], u[4] - v[4], u[5] - v[5])
        astray[i] = time_step * (max(change - half, 0.0) + reach[i] * turn)
        if is_expected[i]:
            shares[i] = 1.0 / max(astray[i] / (EXPECTED * spare[i]), 1.0)
    for pair in range(len(body_a)):
        a, b = body_a[pair], body_b[pair]
        # What cannot move may be smaller than what touches it.
        least = MOST_SPARE * near[pair]
        for body in (a, b):
            if body < n:
                least = min(least, spare[body])
        share = least / max(astray[a] + astray[b], least)
        shares[a], shares[b] = min(shares[a], share), min(shares[b], share)
    return shares[:n]


@cached_njit
def _turns_far(body_a, body_b, velocities, time_step):
    """(p,) bool: pairs in which a body turns far in a step."""
    far = np.zeros(len(body_a), np.bool_)
    for pair in range(len(body_a)):
        for body in (body_a[pair], body_b[pair]):
            far[pair] |= _spin(body, velocities) * time_step > FAR_TURN
    return far


@cached_njit
def _goes_astray(body_a, body_b, velocities, reach, most, time_step):
    """(p,) bool: where turning or sliding may carry a point more than `most` (p,) [m] off its straight path."""
    astray = np.zeros(len(body_a), np.bool_)
    for pair in range(len(body_a)):
        a, b = body_a[pair], body_b[pair]
        p, q = _linear(a, velocities), _linear(b, velocities)
        turn_a, turn_b = time_step * _spin(a, velocities), time_step * _spin(b, velocities)
        way = time_step * length(p[0] - q[0], p[1] - q[1], p[2] - q[2])
        if a < len(velocities):
            way += turn_a * reach[a]
        if b < len(velocities):
            way += turn_b * reach[b]
        astray[pair] = (turn_a + turn_b) * way > most[pair]
    return astray


class _Listed(NamedTuple):
    """Contacts (N,) of p pairs, which end the motion of their bodies at the gaps `least` (N,) [m]."""

    begin: np.ndarray  # (p + 1,)
    body_a: np.ndarray  # (p,) int64
    body_b: np.ndarray
    points_a: np.ndarray  # (N, 3) [m]
    points_b: np.ndarray
    normals: np.ndarray
    least: np.ndarray


@cached_njit
def _least_gaps(begin, gaps, rest_gaps, ahead_gaps, deeper):
    """(N,) [m] the gaps at which contacts of touching bodies end the motion; rest_gaps, ahead_gaps (p,) [m].

    deeper: a contact as deep as `ahead_gap` deepens by no more than this share of it.
    """
    least = np.empty(len(gaps))
    for pair in range(len(begin) - 1):
        for c in range(begin[pair], begin[pair + 1]):
            gap = min(gaps[c], rest_gaps[pair])
            least[c] = gap - max(ahead_gaps[pair] + (gap - rest_gaps[pair]), deeper * ahead_gaps[pair])
    return least


@cached_njit
def _touches(now, chosen, ahead, centers, is_round, has_middles):
    """The contacts of the `chosen` (p,) pairs of `now`, and all `ahead`, as Touches.

    has_middles: the contact point of a sphere is replaced by its centre, which stays a radius away from what the sphere
    touches, whichever point touches.
    """
    count = len(ahead.least)
    for pair in range(len(chosen)):
        if chosen[pair]:
            count += now.begin[pair + 1] - now.begin[pair]
    touches = Touches(
        np.empty(count, np.int64), np.empty(count, np.int64), np.empty((count, 3)), np.empty((count, 3)),
        np.empty((count, 3)), np.empty(count),
    )  # fmt: skip
    end = 0
    for pair in range(len(chosen)):
        if chosen[pair]:
            end = _append(now, pair, centers, is_round, has_middles, touches, end)
    for pair in range(len(ahead.body_a)):
        end = _append(ahead, pair, centers, is_round, has_middles, touches, end)
    return touches


@cached_njit
def _append(listed, pair, centers, is_round, has_middles, touches, end):
    for c in range(listed.begin[pair], listed.begin[pair + 1]):
        touches.body_a[end], touches.body_b[end] = listed.body_a[pair], listed.body_b[pair]
        least, normal = listed.least[c], listed.normals[c]
        touches.points_a[end], touches.points_b[end], touches.normals[end] = (
            listed.points_a[c], listed.points_b[c], normal
        )  # fmt: skip
        for body, points, sign in (
            (listed.body_a[pair], touches.points_a, 1.0), (listed.body_b[pair], touches.points_b, -1.0)
        ):  # fmt: skip
            if has_middles and is_round[body]:
                at, middle = points[end], centers[body]
                least += sign * (
                    normal[0] * (at[0] - middle[0]) + normal[1] * (at[1] - middle[1]) + normal[2] * (at[2] - middle[2])
                )
                points[end] = middle
        touches.least[end] = least
        end += 1
    return end


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
def _linear(body, velocities):
    if body == len(velocities):
        return 0.0, 0.0, 0.0
    return velocities[body, 0], velocities[body, 1], velocities[body, 2]


@uncounted
def _moved(body, point, centers, velocities, t):
    if body == len(centers):
        return point[0], point[1], point[2]
    c, u = centers[body], velocities[body]
    x, y, z = turned(u, t, point[0] - c[0], point[1] - c[1], point[2] - c[2])
    return c[0] + t * u[0] + x, c[1] + t * u[1] + y, c[2] + t * u[2] + z
