"""Contacts that lie ahead: bodies go no farther within a step than to where they will touch.

A service that looks ahead lists contacts of bodies that are apart now and will touch before the step ends, by their
velocities (its parameter `lookahead`). Nothing is pushed through a gap: no impulse, no bounce, nothing breaks. The two
bodies move for that part of the step that ends with the touch, keep their velocities, and meet in the next step as they
would have met at its beginning (motion clamping, as in Bullet). What they lose is time, less than a step.

What touches is kept apart by its velocities, along straight lines. Of a body that turns far in a step the points go
round: it is held back likewise before one of its contacts has gone deeper by `ahead_gap`.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from fracture_collision import portable_math
from fracture_collision.portable_math import dots, lengths
from fracture_collision.records import ContactConstraintArray
from fracture_collision.simulation.compiled import uncounted
from fracture_collision.simulation.contact_solver import BodyPairs, SolverSettings
from fracture_collision.simulation.engine import BodyStates, rows_of

# [rad] A body that turns farther in a step has contacts that go round.
FAR_TURN = 0.1
# A path is looked at in so many parts, and so many more for each radian that bodies turn; where it comes too near it is
# halved so often.
PARTS, PARTS_A_RADIAN, MOST_PARTS, HALVINGS = 4, 8.0, 1000, 30

_sine_after = njit(cache=True)(portable_math.sine_after)


class TouchesAhead(NamedTuple):
    """N contacts that lie ahead."""

    fragment_a: np.ndarray  # (N,) uint32
    fragment_b: np.ndarray
    points_a: np.ndarray  # (N, 3) [m] where they are now, world
    points_b: np.ndarray  # (N, 3)
    normals: np.ndarray  # (N, 3) from a to b, as it will be


def split_by_gap(
    contacts: ContactConstraintArray, most: float
) -> tuple[ContactConstraintArray, TouchesAhead | None]:
    """Those with gaps of at most `most` [m], with their pairs, and those that lie ahead; None: there are none."""
    is_ahead = contacts.gaps > most
    if not is_ahead.any():
        return contacts, None
    counts = np.diff(contacts.pair_begin.astype(np.int64))
    pair = np.repeat(np.arange(len(counts)), counts)
    left = np.bincount(pair[~is_ahead], minlength=len(counts))
    # a pair that never had contacts stays, it says how much it may have missed
    stays = (left > 0) | (counts == 0)
    rows = np.repeat(~is_ahead, 3)
    now = contacts._replace(
        fragment_a=contacts.fragment_a[stays], fragment_b=contacts.fragment_b[stays],
        pair_begin=np.concatenate(([0], np.cumsum(left[stays]))).astype(contacts.pair_begin.dtype),
        missed_depth_bound=contacts.missed_depth_bound[stays], friction=contacts.friction[stays],
        restitution=contacts.restitution[stays], points_a=contacts.points_a[rows], points_b=contacts.points_b[rows],
        normals=contacts.normals[rows], gaps=contacts.gaps[~is_ahead], contact_ids=contacts.contact_ids[~is_ahead],
    )  # fmt: skip
    ahead = pair[is_ahead]
    return now, TouchesAhead(
        contacts.fragment_a[ahead], contacts.fragment_b[ahead],
        *(column.reshape(-1, 3)[is_ahead] for column in (contacts.points_a, contacts.points_b, contacts.normals)),
    )  # fmt: skip


def held_back(
    states: BodyStates, contacts: ContactConstraintArray, pairs: BodyPairs, ahead: TouchesAhead | None,
    velocities: np.ndarray, drift: np.ndarray, gravity: np.ndarray, settings: SolverSettings, time_step: float,
) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
    """Velocities and drift (n, 6) with which bodies go no farther than to where they touch. Gravity (3,) [m/s2] acts
    for as long as they move: what it gives beyond would be energy for a height that is not lost. To what touches
    something it gives at most what that falls by: what rests has its weight borne.

    contacts and their pairs: what was solved.
    """
    count = len(states.fragment_ids)
    moves, touching = velocities + drift, _of_fast_spins(contacts, pairs, velocities, settings, time_step)
    if ahead is None and touching is None:
        return velocities, drift
    parts = [] if touching is None else [touching]
    if ahead is not None:
        rows = [rows_of(fragments, states.fragment_ids) for fragments in (ahead.fragment_a, ahead.fragment_b)]
        parts.append((*rows, *ahead[2:], np.full(len(rows[0]), settings.rest_gap)))
    held = [np.concatenate(column) for column in zip(*parts, strict=True)]
    shares = shares_until_touch(*held, states.centers, moves, time_step)
    is_free = np.ones(count + 1, bool)
    is_free[pairs.body_a] = is_free[pairs.body_b] = False
    unspent, falls = (1.0 - shares) * time_step, np.maximum(dots(velocities[:, :3], gravity), 0.0)
    square = float((gravity * gravity).sum())
    if square > 0.0:
        unspent = np.where(is_free[:count], unspent, np.minimum(unspent, falls / square))
    velocities = velocities.copy()
    velocities[:, :3] -= unspent[:, None] * gravity
    return velocities, shares[:, None] * moves - velocities


def _of_fast_spins(
    contacts: ContactConstraintArray, pairs: BodyPairs, velocities: np.ndarray, settings: SolverSettings,
    time_step: float,
) -> tuple[np.ndarray, ...] | None:  # fmt: skip
    """The contacts of bodies that turn far in a step, as the columns of shares_until_touch; None: there are none."""
    turns = np.append(lengths(velocities[:, 3:]) * time_step > FAR_TURN, False)
    if not turns.any():
        return None
    repeat = np.diff(contacts.pair_begin.astype(np.int64))
    body_a, body_b = np.repeat(pairs.body_a, repeat), np.repeat(pairs.body_b, repeat)
    chosen = turns[body_a] | turns[body_b]
    columns = (contacts.points_a, contacts.points_b, contacts.normals)
    return (
        body_a[chosen], body_b[chosen], *(column.reshape(-1, 3)[chosen] for column in columns),
        np.minimum(contacts.gaps[chosen], settings.rest_gap) - settings.ahead_gap,
    )  # fmt: skip


@njit(cache=True)
def shares_until_touch(body_a, body_b, points_a, points_b, normals, least, centers, velocities, time_step):
    """Which share of a step of `time_step` [s] each body may move, (n,) in [0, 1], so that no contact's gap closes
    further than to the `least` (N,) [m].

    body_a, body_b (N,): rows of the bodies of the contacts, n: what cannot move; points_a, points_b, normals (N, 3);
    centers (n, 3) [m]; velocities (n, 6): v [m/s], w [rad/s] by which they move.
    """
    n, h = len(centers), time_step
    shares = np.ones(n + 1)
    for c in range(len(body_a)):
        a, b, contact = body_a[c], body_b[c], (points_a[c], points_b[c], normals[c])
        turns = h * (_spin(a, velocities) + _spin(b, velocities))
        before, parts = 0.0, PARTS + int(min(PARTS_A_RADIAN * turns, MOST_PARTS))
        for part in range(1, parts + 1):
            after = part / parts
            if _gap(a, b, contact, centers, velocities, h * after, h * after) < least[c]:
                for _ in range(HALVINGS):
                    middle = 0.5 * (before + after)
                    if _gap(a, b, contact, centers, velocities, h * middle, h * middle) < least[c]:
                        after = middle
                    else:
                        before = middle
                break
            before = after
        shares[a], shares[b] = min(shares[a], before), min(shares[b], before)
    shares[n] = 1.0
    # One that is held back by a third may be met where it waits: then neither goes farther than the other. Shares only
    # fall, to one of those that there are.
    changed = True
    while changed:
        changed = False
        for c in range(len(body_a)):
            a, b, contact = body_a[c], body_b[c], (points_a[c], points_b[c], normals[c])
            if shares[a] == shares[b] or a == n or b == n:
                continue
            if _gap(a, b, contact, centers, velocities, h * shares[a], h * shares[b]) < least[c]:
                shares[a] = shares[b] = min(shares[a], shares[b])
                changed = True
    return shares[:n]


@uncounted
def _gap(a, b, contact, centers, velocities, of_a, of_b):
    """The gap [m] of a contact (points, normal) once a has moved for `of_a` [s], b for `of_b`."""
    point_a, point_b, normal = contact
    xa = _moved(a, point_a, centers, velocities, of_a)
    xb = _moved(b, point_b, centers, velocities, of_b)
    return normal[0] * (xb[0] - xa[0]) + normal[1] * (xb[1] - xa[1]) + normal[2] * (xb[2] - xa[2])


@uncounted
def _spin(body, velocities):
    if body == len(velocities):
        return 0.0
    u = velocities[body]
    return math.sqrt(u[3] * u[3] + u[4] * u[4] + u[5] * u[5])


@uncounted
def _moved(body, point, centers, velocities, t):
    if body == len(centers):
        return point[0], point[1], point[2]
    c, u, spin = centers[body], velocities[body], _spin(body, velocities)
    x, y, z = point[0] - c[0], point[1] - c[1], point[2] - c[2]
    if spin * t > 0.0:
        # Rodrigues' formula
        kx, ky, kz = u[3] / spin, u[4] / spin, u[5] / spin
        sine, half = _sine_after(spin * t, 0.0), _sine_after(0.5 * spin * t, 0.0)
        versine = 2.0 * half * half
        cx, cy, cz = ky * z - kz * y, kz * x - kx * z, kx * y - ky * x
        x, y, z = (
            x + sine * cx + versine * (ky * cz - kz * cy),
            y + sine * cy + versine * (kz * cx - kx * cz),
            z + sine * cz + versine * (kx * cy - ky * cx),
        )
    return c[0] + t * u[0] + x, c[1] + t * u[1] + y, c[2] + t * u[2] + z
