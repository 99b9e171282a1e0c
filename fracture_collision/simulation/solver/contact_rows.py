"""Constraint rows of the contact solver: the data of a contact, and the effect of impulses at it.

Symbols and equation numbers are those of `contact_solver`. All that an iteration reads of a contact is contiguous in
one record: its three directions d, the arms r_a and r_b, I_a^-1 (r_a x d) and I_b^-1 (r_b x d) of each direction, and
the masses below. Velocities are those of an island's bodies (`contact_islands`); the last row of an island never moves.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from fracture_collision.simulation.compiled import uncounted

# Offsets in a contact's record: n, t1, t2; the arms; the change of spin by each direction.
NORMAL, TANGENT1, TANGENT2, ARM_A, ARM_B, SPIN_A, SPIN_B = 0, 3, 6, 9, 12, 15, 24
# 1 / (J_n W J_n^T), 0 where both cannot move; 1 / the larger eigenvalue of the block J_t W J_t^T; J_n W J_t^T of both.
NORMAL_MASS, TANGENT_MASS, COUPLING1, COUPLING2 = 33, 34, 35, 36
RECORD = 37


class Rows(NamedTuple):
    """Constraint rows of an island of m - 1 bodies and p pairs with N contacts."""

    begin: np.ndarray  # (p + 1,) int64, contacts of pair i: begin[i] .. begin[i + 1] - 1
    body_a: np.ndarray  # (p,) int64
    body_b: np.ndarray  # (p,) int64
    masses: np.ndarray  # (m,) [kg]; 0 of what never moves
    inertias: np.ndarray  # (m, 3, 3) [kg m2]
    inverse_masses: np.ndarray  # (m,)
    inverse_inertias: np.ndarray  # (m, 3, 3)
    contacts: np.ndarray  # (N, RECORD)
    rolling_masses: np.ndarray  # (p, 3, 3) (I_a^-1 + I_b^-1)^-1


class Surfaces(NamedTuple):
    """Bounds of the impulses of p pairs with N contacts."""

    friction: np.ndarray  # (p,) mu
    rolling_arm: np.ndarray  # (p,) rho [m]
    impulse_limits: np.ndarray  # (N,) [N s], inf: none


@uncounted
def fill_record(record, point, normal, center_a, center_b, inverse_mass, inverse_inertia_a, inverse_inertia_b):
    """The record of one contact; the tangents follow from the normal alone, so that they are steady between steps."""
    _basis(normal, record)
    for i in range(3):
        record[ARM_A + i], record[ARM_B + i] = point[i] - center_a[i], point[i] - center_b[i]
    for k in range(3):
        for arm, spin, inverse in ((ARM_A, SPIN_A, inverse_inertia_a), (ARM_B, SPIN_B, inverse_inertia_b)):
            x, y, z = _crossed(record, arm, 3 * k)
            for i in range(3):
                record[spin + 3 * k + i] = inverse[i, 0] * x + inverse[i, 1] * y + inverse[i, 2] * z
    record[NORMAL_MASS] = 1.0 / (inverse_mass + _angular_coupling(record, 0, 0))
    k11 = inverse_mass + _angular_coupling(record, 1, 1)
    k22 = inverse_mass + _angular_coupling(record, 2, 2)
    k12 = _angular_coupling(record, 1, 2)
    record[TANGENT_MASS] = 1.0 / (0.5 * (k11 + k22) + math.sqrt(0.25 * (k11 - k22) ** 2 + k12 * k12))
    record[COUPLING1], record[COUPLING2] = _angular_coupling(record, 0, 1), _angular_coupling(record, 0, 2)


@uncounted
def normal_velocities(rows, u, result):
    """J_n u of each contact into `result` (N,) [m/s]."""
    for pair in range(rows.body_a.size):
        ua, ub = load(u, rows.body_a[pair]), load(u, rows.body_b[pair])
        for c in range(rows.begin[pair], rows.begin[pair + 1]):
            result[c] = normal_velocity(rows.contacts[c], ua, ub)


@uncounted
def turn(rows, pair, u, x, y, z):
    """Angular impulse (x, y, z) [N m s] on b, the opposite on a."""
    a, b = rows.body_a[pair], rows.body_b[pair]
    ia, ib = rows.inverse_inertias[a], rows.inverse_inertias[b]
    for i in range(3):
        u[a, 3 + i] -= ia[i, 0] * x + ia[i, 1] * y + ia[i, 2] * z
        u[b, 3 + i] += ib[i, 0] * x + ib[i, 1] * y + ib[i, 2] * z


@uncounted
def push(rows, pair, c, u, normal, x, y):
    """Impulses along n, t1, t2 [N s] on b, the opposite on a."""
    a, b = rows.body_a[pair], rows.body_b[pair]
    ua, ub = pushed(
        rows.contacts[c], load(u, a), load(u, b), rows.inverse_masses[a], rows.inverse_masses[b], normal, x, y
    )
    store(u, a, ua)
    store(u, b, ub)


# The velocities of a pair travel as tuples, which stay in registers; the sums are short chains, which run side by side.


@uncounted
def load(u, i):
    """Velocities of body i as a tuple of six."""
    return u[i, 0], u[i, 1], u[i, 2], u[i, 3], u[i, 4], u[i, 5]


@uncounted
def store(u, i, values):
    """Write the velocities of body i from a tuple of six."""
    for k in range(6):
        u[i, k] = values[k]


@uncounted
def velocities(r, ua, ub):
    """J_n u, J_t1 u, J_t2 u of a contact."""
    x, y, z = _parting(r, ua, ub)
    return r[0] * x + r[1] * y + r[2] * z, r[3] * x + r[4] * y + r[5] * z, r[6] * x + r[7] * y + r[8] * z


@uncounted
def normal_velocity(r, ua, ub):
    """J_n u of a contact with record r, from the velocities of its two bodies."""
    x, y, z = _parting(r, ua, ub)
    return r[0] * x + r[1] * y + r[2] * z


@uncounted
def _parting(r, ua, ub):
    x = (ub[0] - ua[0]) + ((ub[4] * r[14] - ub[5] * r[13]) - (ua[4] * r[11] - ua[5] * r[10]))
    y = (ub[1] - ua[1]) + ((ub[5] * r[12] - ub[3] * r[14]) - (ua[5] * r[9] - ua[3] * r[11]))
    z = (ub[2] - ua[2]) + ((ub[3] * r[13] - ub[4] * r[12]) - (ua[3] * r[10] - ua[4] * r[9]))
    return x, y, z


@uncounted
def pushed(r, ua, ub, inverse_mass_a, inverse_mass_b, normal, x, y):
    """Velocities after impulses along n, t1, t2."""
    p0 = r[0] * normal + (r[3] * x + r[6] * y)
    p1 = r[1] * normal + (r[4] * x + r[7] * y)
    p2 = r[2] * normal + (r[5] * x + r[8] * y)
    after_a = (
        ua[0] - inverse_mass_a * p0, ua[1] - inverse_mass_a * p1, ua[2] - inverse_mass_a * p2,
        ua[3] - (r[15] * normal + (r[18] * x + r[21] * y)),
        ua[4] - (r[16] * normal + (r[19] * x + r[22] * y)),
        ua[5] - (r[17] * normal + (r[20] * x + r[23] * y)),
    )  # fmt: skip
    after_b = (
        ub[0] + inverse_mass_b * p0, ub[1] + inverse_mass_b * p1, ub[2] + inverse_mass_b * p2,
        ub[3] + (r[24] * normal + (r[27] * x + r[30] * y)),
        ub[4] + (r[25] * normal + (r[28] * x + r[31] * y)),
        ub[5] + (r[26] * normal + (r[29] * x + r[32] * y)),
    )  # fmt: skip
    return after_a, after_b


@uncounted
def pushed_apart(r, ua, ub, inverse_mass_a, inverse_mass_b, normal):
    """Velocities after an impulse along n alone."""
    a, b = inverse_mass_a * normal, inverse_mass_b * normal
    after_a = (
        ua[0] - a * r[0], ua[1] - a * r[1], ua[2] - a * r[2],
        ua[3] - normal * r[15], ua[4] - normal * r[16], ua[5] - normal * r[17],
    )  # fmt: skip
    after_b = (
        ub[0] + b * r[0], ub[1] + b * r[1], ub[2] + b * r[2],
        ub[3] + normal * r[24], ub[4] + normal * r[25], ub[5] + normal * r[26],
    )  # fmt: skip
    return after_a, after_b


@uncounted
def _angular_coupling(record, k, m):
    result = 0.0
    for arm, spin in ((ARM_A, SPIN_A), (ARM_B, SPIN_B)):
        x, y, z = _crossed(record, arm, 3 * k)
        result += x * record[spin + 3 * m] + y * record[spin + 3 * m + 1] + z * record[spin + 3 * m + 2]
    return result


@uncounted
def _crossed(r, i, j):
    return (
        r[i + 1] * r[j + 2] - r[i + 2] * r[j + 1],
        r[i + 2] * r[j] - r[i] * r[j + 2],
        r[i] * r[j + 1] - r[i + 1] * r[j],
    )  # fmt: skip


@uncounted
def _basis(n, record):
    """Write n and two tangents; the first is perpendicular to n and to the axis that n is farthest from."""
    axis = 0
    for i in range(1, 3):
        if abs(n[i]) < abs(n[axis]):
            axis = i
    for i in range(3):
        record[NORMAL + i] = n[i]
        record[TANGENT2 + i] = 1.0 if i == axis else 0.0
    x, y, z = _crossed(record, NORMAL, TANGENT2)
    length = math.sqrt(x * x + y * y + z * z)
    record[TANGENT1], record[TANGENT1 + 1], record[TANGENT1 + 2] = x / length, y / length, z / length
    x, y, z = _crossed(record, NORMAL, TANGENT1)
    record[TANGENT2], record[TANGENT2 + 1], record[TANGENT2 + 2] = x, y, z
