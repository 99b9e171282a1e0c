"""Islands: bodies that touch each other, directly or through others that can move. Each is solved separately.

No impulse of one acts on another, so each stops when it has converged, and conjugate gradients run on each alone.
What never moves belongs to all of them: it is the last row of every island.

Symbols and equation numbers are those of `contact_solver`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fracture_collision import grouping
from fracture_collision.kernel_sources import cached_njit
from fracture_collision.simulation.compiled import uncounted
from fracture_collision.simulation.solver.contact_face import Iterate
from fracture_collision.simulation.solver.contact_rows import RECORD, TANGENT1, TANGENT2, Rows, Surfaces, fill_record
from fracture_collision.simulation.solver.contact_step import Gaps, drift_velocities, find_velocities


@uncounted
def invert_symmetric(matrix, out):
    """The inverse of a symmetric (3, 3) matrix, by its cofactors, into `out` (3, 3)."""
    a, b, c = matrix[0, 0], matrix[0, 1], matrix[0, 2]
    d, e, f = matrix[1, 1], matrix[1, 2], matrix[2, 2]
    aa, bb, cc = d * f - e * e, c * e - b * f, b * e - c * d
    scale = 1.0 / (a * aa + b * bb + c * cc)
    out[0, 0] = scale * aa
    out[0, 1] = out[1, 0] = scale * bb
    out[0, 2] = out[2, 0] = scale * cc
    out[1, 1] = scale * (a * f - c * c)
    out[1, 2] = out[2, 1] = scale * (b * c - a * e)
    out[2, 2] = scale * (a * d - b * b)


_grouped = cached_njit(grouping.grouped)
_root_of = cached_njit(grouping.root_of)
# A contact at rest never penetrates by this many rest gaps.
DEEP = 5.0


class Bodies(NamedTuple):
    """As RigidBodies of `contact_solver`."""

    masses: np.ndarray  # (n,) [kg]
    inertias: np.ndarray  # (n, 3, 3) [kg m2]
    centers: np.ndarray  # (n, 3) [m]
    velocities: np.ndarray  # (n, 6) u(t)
    free_velocities: np.ndarray  # (n, 6) u*
    spans: np.ndarray  # (n,) h [s]
    asleep: np.ndarray  # (n,) bool


class Contacts(NamedTuple):
    """All contacts of a step, by pairs; bodies by their rows, n for what never moves."""

    begin: np.ndarray  # (p + 1,) int64
    body_a: np.ndarray  # (p,) int64
    body_b: np.ndarray  # (p,) int64
    friction: np.ndarray  # (p,)
    restitution: np.ndarray  # (p,)
    rolling_arm: np.ndarray  # (p,) [m]
    sizes: np.ndarray  # (p,) R [m]
    bounce_speeds: np.ndarray  # (p,) v_e [m/s]
    points: np.ndarray  # (N, 3) [m], midway between the witnesses
    normals: np.ndarray  # (N, 3)
    gaps: np.ndarray  # (N,) [m], negative inside
    rest_gaps: np.ndarray  # (N,) [m]
    impulse_limits: np.ndarray  # (N,) [N s]


class Islands(NamedTuple):
    """Island i has the pairs pairs[pair_begin[i] : pair_begin[i + 1]]; bodies likewise."""

    pairs: np.ndarray  # (q,) int64; within an island in input order; pairs that cannot move are in none
    pair_begin: np.ndarray  # (k + 1,) int64
    bodies: np.ndarray  # (m,) int64, ascending within an island; bodies without contacts are in none
    body_begin: np.ndarray  # (k + 1,) int64


class Result(NamedTuple):
    """The solved step."""

    velocities: np.ndarray  # (n, 6) u(t + h)
    drift: np.ndarray  # (n, 6) u_d
    normal_impulses: np.ndarray  # (N,) lambda [N s]
    pressing: np.ndarray  # (N,) without those of impacts
    impulses: np.ndarray  # (N, 3) on b, world axes; on input those of the last step
    rolling: np.ndarray  # (p, 3) likewise


class Kept(NamedTuple):
    """Impulses of an island's N contacts and p pairs."""

    impulses: np.ndarray  # (N, 3) along n, t1, t2 [N s]
    rolling: np.ndarray  # (p, 3) [N m s]
    pressing: np.ndarray  # (N,)


@cached_njit
def islands_of(begin, body_a, body_b, count):
    """Islands of `count` bodies, in the order of their first bodies; pairs without contacts are ignored."""
    root = np.arange(count)
    touches = np.zeros(count, np.bool_)
    for pair in range(body_a.size):
        a, b = body_a[pair], body_b[pair]
        if begin[pair] == begin[pair + 1]:
            continue
        if a < count:
            touches[a] = True
        if b < count:
            touches[b] = True
        if a < count and b < count:
            a, b = _root_of(root, a), _root_of(root, b)
            root[max(a, b)] = min(a, b)
    label = np.full(count, -1)
    island_count = 0
    for i in range(count):
        if touches[i]:
            r = _root_of(root, i)
            if r == i:
                label[i] = island_count
                island_count += 1
            else:
                label[i] = label[r]
    of_pair = np.empty(body_a.size, np.int64)
    for pair in range(body_a.size):
        a, b = body_a[pair], body_b[pair]
        if begin[pair] == begin[pair + 1]:
            of_pair[pair] = -1
        else:
            of_pair[pair] = label[a] if a < count else (label[b] if b < count else -1)
    pairs, pair_begin = _grouped(of_pair, island_count)
    bodies, body_begin = _grouped(label, island_count)
    return Islands(pairs, pair_begin, bodies, body_begin)


@cached_njit
def solve_islands(islands, bodies, contacts, settings, again, result):
    """Solve one step of all bodies in contact into `result`, which holds u* and no drift for all others.

    again (n,): solve only islands with such a body; `result` already holds the others, and every drift. Empty: all.
    """
    local = np.empty(bodies.masses.size, np.int64)
    for i in range(islands.pair_begin.size - 1):
        members = islands.bodies[islands.body_begin[i] : islands.body_begin[i + 1]]
        pairs = islands.pairs[islands.pair_begin[i] : islands.pair_begin[i + 1]]
        if bodies.asleep[members[0]]:
            result.velocities[members] = 0.0
            continue
        if again.size > 0 and not again[members].any():
            continue
        for k in range(members.size):
            local[members[k]] = k
        rows, surfaces, gaps, against = _rows_of_island(
            members, pairs, local, bodies, contacts, settings
        )
        impulses, rolling = _impulses_of_island(pairs, rows, contacts, result)
        before, u = np.zeros((2, members.size + 1, 6))
        for k in range(members.size):
            before[k], u[k] = bodies.velocities[members[k]], bodies.free_velocities[members[k]]
        pressing = find_velocities(rows, surfaces, gaps, before, Iterate(impulses, rolling, u), settings)
        for k in range(members.size):
            result.velocities[members[k]] = u[k]
        if again.size == 0:
            drift = drift_velocities(rows, gaps, before, u, against, settings)
            for k in range(members.size):
                result.drift[members[k]] = drift[k]
        _keep_impulses(pairs, rows, contacts, Kept(impulses, rolling, pressing), result)


@cached_njit
def _rows_of_island(members, pairs, local, bodies, contacts, settings):
    size, pair_count = members.size + 1, pairs.size
    masses, inverse_masses = np.zeros(size), np.zeros(size)
    inertias, inverse_inertias = np.zeros((size, 3, 3)), np.zeros((size, 3, 3))
    for k in range(members.size):
        masses[k] = bodies.masses[members[k]]
        inverse_masses[k] = 1.0 / masses[k]
        inertias[k] = bodies.inertias[members[k]]
        invert_symmetric(inertias[k], inverse_inertias[k])
    begin = np.zeros(pair_count + 1, np.int64)
    for k in range(pair_count):
        begin[k + 1] = begin[k] + contacts.begin[pairs[k] + 1] - contacts.begin[pairs[k]]
    count = begin[-1]
    body_a, body_b = np.empty(pair_count, np.int64), np.empty(pair_count, np.int64)
    records, rolling_masses, sum_of_both = np.empty((count, RECORD)), np.zeros((pair_count, 3, 3)), np.empty((3, 3))
    friction, rolling_arm = contacts.friction[pairs], contacts.rolling_arm[pairs]
    gaps = Gaps(np.empty(count), np.empty(count), np.empty(count), np.empty(count), np.empty(count))
    limits, against = np.empty(count), np.zeros(count, np.bool_)
    nowhere = np.zeros(3)
    for k in range(pair_count):
        pair = pairs[k]
        a, b = contacts.body_a[pair], contacts.body_b[pair]
        body_a[k] = local[a] if a < local.size else members.size
        body_b[k] = local[b] if b < local.size else members.size
        center_a = bodies.centers[a] if a < local.size else nowhere
        center_b = bodies.centers[b] if b < local.size else nowhere
        ia, ib = inverse_inertias[body_a[k]], inverse_inertias[body_b[k]]
        if rolling_arm[k] > 0.0:
            for x in range(3):
                for y in range(3):
                    sum_of_both[x, y] = ia[x, y] + ib[x, y]
            invert_symmetric(sum_of_both, rolling_masses[k])
        inverse_mass = inverse_masses[body_a[k]] + inverse_masses[body_b[k]]
        # A gap closes while either moves, so that it never closes further.
        span = max(bodies.spans[a] if a < local.size else 0.0, bodies.spans[b] if b < local.size else 0.0)
        first = contacts.begin[pair]
        for c in range(begin[k], begin[k + 1]):
            source = first + c - begin[k]
            fill_record(
                records[c], contacts.points[source], contacts.normals[source], center_a, center_b, inverse_mass, ia, ib
            )
            gaps.beyond[c], gaps.sizes[c] = contacts.gaps[source] - contacts.rest_gaps[source], contacts.sizes[pair]
            gaps.restitution[c], gaps.bounce_speeds[c] = contacts.restitution[pair], contacts.bounce_speeds[pair]
            gaps.spans[c], limits[c] = span, contacts.impulse_limits[source]
        both_move = a < local.size and b < local.size
        _mark_against_parting(
            records[begin[k] : begin[k + 1]], contacts.gaps[first : contacts.begin[pair + 1]], both_move, center_a,
            center_b, DEEP * settings.rest_gap * contacts.sizes[pair], against[begin[k] : begin[k + 1]],
        )  # fmt: skip
    rows = Rows(
        begin, body_a, body_b, masses, inertias, inverse_masses, inverse_inertias, records, rolling_masses
    )
    return rows, Surfaces(friction, rolling_arm, limits), gaps, against


@uncounted
def _mark_against_parting(records, gaps, both_move, center_a, center_b, deep, against):
    """Mark the contacts of a pair that drift correction leaves out.

    Two interpenetrating shards have contacts on both sides of the overlap, with contradicting normals: obeyed together
    they lock the two for ever. Such a pair is separated along the line between its centres of mass or, where one body
    cannot move and may have any shape, along the sum of the normals weighted by depth.
    """
    x, y, z = center_b[0] - center_a[0], center_b[1] - center_a[1], center_b[2] - center_a[2]
    if not both_move:
        x = y = z = 0.0
        for c in range(gaps.size):
            depth = max(-gaps[c], 0.0)
            x, y, z = x + depth * records[c, 0], y + depth * records[c, 1], z + depth * records[c, 2]
    deep_and_parting, deep_and_not = False, False
    for c in range(gaps.size):
        parts = x * records[c, 0] + y * records[c, 1] + z * records[c, 2] > 0.0
        deep_and_parting |= parts and gaps[c] < -deep
        deep_and_not |= not parts and gaps[c] < 0.0
        against[c] = not parts
    if not (deep_and_parting and deep_and_not):
        for c in range(gaps.size):
            against[c] = False


@cached_njit
def _impulses_of_island(pairs, rows, contacts, result):
    """The last step's impulses along n, t1, t2: projected again, since the normal may have turned."""
    impulses, rolling = np.empty((rows.contacts.shape[0], 3)), np.empty((pairs.size, 3))
    for k in range(pairs.size):
        rolling[k] = result.rolling[pairs[k]]
        shift = contacts.begin[pairs[k]] - rows.begin[k]
        for c in range(rows.begin[k], rows.begin[k + 1]):
            r, old = rows.contacts[c], result.impulses[c + shift]
            impulses[c, 0] = max(r[0] * old[0] + r[1] * old[1] + r[2] * old[2], 0.0)
            impulses[c, 0] = min(impulses[c, 0], contacts.impulse_limits[c + shift])
            impulses[c, 1] = impulses[c, 2] = 0.0
            if contacts.friction[pairs[k]] > 0.0:  # without it, no sweep looks at them again
                impulses[c, 1] = r[TANGENT1] * old[0] + r[TANGENT1 + 1] * old[1] + r[TANGENT1 + 2] * old[2]
                impulses[c, 2] = r[TANGENT2] * old[0] + r[TANGENT2 + 1] * old[1] + r[TANGENT2 + 2] * old[2]
    return impulses, rolling


@uncounted
def _keep_impulses(pairs, rows, contacts, kept, result):
    impulses, rolling, pressing = kept
    for k in range(pairs.size):
        for i in range(3):
            result.rolling[pairs[k], i] = rolling[k, i]
        shift = contacts.begin[pairs[k]] - rows.begin[k]
        for c in range(rows.begin[k], rows.begin[k + 1]):
            r = rows.contacts[c]
            result.normal_impulses[c + shift], result.pressing[c + shift] = impulses[c, 0], pressing[c]
            for i in range(3):
                result.impulses[c + shift, i] = (
                    impulses[c, 0] * r[i] + impulses[c, 1] * r[TANGENT1 + i] + impulses[c, 2] * r[TANGENT2 + i]
                )
