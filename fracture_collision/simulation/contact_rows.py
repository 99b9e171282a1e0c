"""Constraint rows of the contact solver: what one direction of one contact needs, and how an impulse along it acts.

Symbols and equation numbers are those of `contact_solver`. A row holds what one direction d of one contact needs:
d, r_a x d, r_b x d, I_a^-1 (r_a x d), I_b^-1 (r_b x d). Velocities are (n + 1, 6); row n never moves.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit

DIRECTION, ARM_A, ARM_B, SPIN_A, SPIN_B = 0, 3, 6, 9, 12

# Kernels that allocate nothing count no references: counting costs more than the arithmetic of a row.
uncounted = njit(cache=True, error_model="numpy", _nrt=False)


class Rows(NamedTuple):
    begin: np.ndarray  # (p + 1,) int64, contacts of pair i: begin[i] .. begin[i + 1] - 1
    body_a: np.ndarray  # (p,) int64
    body_b: np.ndarray  # (p,) int64
    masses: np.ndarray  # (n + 1,) [kg]; 0 of what never moves
    inertias: np.ndarray  # (n + 1, 3, 3) [kg m2]
    inverse_masses: np.ndarray  # (n + 1,)
    inverse_inertias: np.ndarray  # (n + 1, 3, 3)
    directions: np.ndarray  # (N, 3, 3) n, t1, t2
    rows: np.ndarray  # (N, 3, 15)
    normal_masses: np.ndarray  # (N,) 1 / (J_n W J_n^T); 0 where both cannot move
    tangent_masses: np.ndarray  # (N,) 1 / the larger eigenvalue of the 2 x 2 block J_t W J_t^T
    rolling_masses: np.ndarray  # (p, 3, 3) (I_a^-1 + I_b^-1)^-1


class Surfaces(NamedTuple):
    friction: np.ndarray  # (p,) mu
    rolling_arm: np.ndarray  # (p,) rho [m]
    impulse_limits: np.ndarray  # (N,) [N s], inf: none


@njit(cache=True)
def contact_rows(
    points, normals, begin, body_a, body_b, centers, masses, inertias, inverse_masses, inverse_inertias
):
    """Rows of all contacts; the tangents follow from the normal alone, so that they are steady from step to step."""
    count, pair_count = points.shape[0], body_a.size
    directions = np.zeros((count, 3, 3))
    rows = np.zeros((count, 3, 15))
    normal_masses = np.zeros(count)
    tangent_masses = np.zeros(count)
    rolling_masses = np.zeros((pair_count, 3, 3))
    for pair in range(pair_count):
        a, b = body_a[pair], body_b[pair]
        ia, ib = inverse_inertias[a], inverse_inertias[b]
        inverse_mass = inverse_masses[a] + inverse_masses[b]
        if inverse_mass == 0.0:
            continue
        rolling_masses[pair] = np.linalg.inv(ia + ib)
        for c in range(begin[pair], begin[pair + 1]):
            _basis(normals[c], directions[c])
            for k in range(3):
                d = directions[c, k]
                row = rows[c, k]
                row[DIRECTION : DIRECTION + 3] = d
                _cross(points[c] - centers[a], d, row[ARM_A : ARM_A + 3])
                _cross(points[c] - centers[b], d, row[ARM_B : ARM_B + 3])
                for i in range(3):
                    for j in range(3):
                        row[SPIN_A + i] += ia[i, j] * row[ARM_A + j]
                        row[SPIN_B + i] += ib[i, j] * row[ARM_B + j]
            normal_masses[c] = 1.0 / (inverse_mass + _angular_coupling(rows, c, 0, 0))
            k11 = inverse_mass + _angular_coupling(rows, c, 1, 1)
            k22 = inverse_mass + _angular_coupling(rows, c, 2, 2)
            k12 = _angular_coupling(rows, c, 1, 2)
            largest = 0.5 * (k11 + k22) + math.sqrt(0.25 * (k11 - k22) ** 2 + k12 * k12)
            tangent_masses[c] = 1.0 / largest
    return Rows(
        begin, body_a, body_b, masses, inertias, inverse_masses, inverse_inertias, directions, rows, normal_masses,
        tangent_masses, rolling_masses,
    )  # fmt: skip


@njit(cache=True)
def normal_velocities(rows, u):
    """J_n u of each contact: (N,) [m/s]."""
    result = np.zeros(rows.normal_masses.size)
    for pair in range(rows.body_a.size):
        for c in range(rows.begin[pair], rows.begin[pair + 1]):
            result[c] = velocity(rows.rows[c, 0], load(u, rows.body_a[pair]), load(u, rows.body_b[pair]))
    return result


@njit(cache=True)
def carried_impulses(
    fragment_a, fragment_b, begin, contact_ids,
    old_a, old_b, old_begin, old_ids, old_impulses, old_rolling, directions,
):  # fmt: skip
    """Impulses (N, 3) along n, t1, t2 and rolling (p, 3) of those contacts that the last step had as well; else zero.

    Pairs are merged in their common order; within a pair there are few contacts, which are simply compared. The normal
    may have turned since, so the old impulse is split anew.
    """
    impulses = np.zeros((contact_ids.size, 3))
    rolling = np.zeros((fragment_a.size, 3))
    old = 0
    for pair in range(fragment_a.size):
        a, b = fragment_a[pair], fragment_b[pair]
        while old < old_a.size and (old_a[old] < a or (old_a[old] == a and old_b[old] < b)):
            old += 1
        if old == old_a.size:
            break
        if old_a[old] != a or old_b[old] != b:
            continue
        rolling[pair] = old_rolling[old]
        for c in range(begin[pair], begin[pair + 1]):
            for o in range(old_begin[old], old_begin[old + 1]):
                if old_ids[o] == contact_ids[c]:
                    for k in range(3):
                        for i in range(3):
                            impulses[c, k] += directions[c, k, i] * old_impulses[o, i]
                    impulses[c, 0] = max(impulses[c, 0], 0.0)
                    break
    return impulses, rolling


@uncounted
def turn(rows, pair, u, x, y, z):
    """Angular impulse (x, y, z) [N m s] on b, the opposite on a."""
    a, b = rows.body_a[pair], rows.body_b[pair]
    ia, ib = rows.inverse_inertias[a], rows.inverse_inertias[b]
    for i in range(3):
        u[a, 3 + i] -= ia[i, 0] * x + ia[i, 1] * y + ia[i, 2] * z
        u[b, 3 + i] += ib[i, 0] * x + ib[i, 1] * y + ib[i, 2] * z


# The velocities of a pair travel as tuples, which stay in registers; the sums are short chains, which run side by side.


@uncounted
def load(u, i):
    return u[i, 0], u[i, 1], u[i, 2], u[i, 3], u[i, 4], u[i, 5]


@uncounted
def store(u, i, values):
    for k in range(6):
        u[i, k] = values[k]


@uncounted
def velocity(r, ua, ub):
    linear = r[0] * (ub[0] - ua[0]) + r[1] * (ub[1] - ua[1]) + r[2] * (ub[2] - ua[2])
    angular_a = r[3] * ua[3] + r[4] * ua[4] + r[5] * ua[5]
    angular_b = r[6] * ub[3] + r[7] * ub[4] + r[8] * ub[5]
    return linear + (angular_b - angular_a)


@uncounted
def pushed(r, ua, ub, inverse_mass_a, inverse_mass_b, impulse):
    a, b = inverse_mass_a * impulse, inverse_mass_b * impulse
    after_a = (
        ua[0] - a * r[0], ua[1] - a * r[1], ua[2] - a * r[2],
        ua[3] - impulse * r[9], ua[4] - impulse * r[10], ua[5] - impulse * r[11],
    )  # fmt: skip
    after_b = (
        ub[0] + b * r[0], ub[1] + b * r[1], ub[2] + b * r[2],
        ub[3] + impulse * r[12], ub[4] + impulse * r[13], ub[5] + impulse * r[14],
    )  # fmt: skip
    return after_a, after_b


@njit(cache=True)
def _angular_coupling(rows, c, k, m):
    result = 0.0
    for i in range(3):
        result += rows[c, k, ARM_A + i] * rows[c, m, SPIN_A + i] + rows[c, k, ARM_B + i] * rows[c, m, SPIN_B + i]
    return result


@njit(cache=True)
def _cross(x, y, out):
    out[0] = x[1] * y[2] - x[2] * y[1]
    out[1] = x[2] * y[0] - x[0] * y[2]
    out[2] = x[0] * y[1] - x[1] * y[0]


@njit(cache=True)
def _basis(n, out):
    """n and two tangents; the first lies across n and the axis that n is farthest from."""
    axis = 0
    for i in range(1, 3):
        if abs(n[i]) < abs(n[axis]):
            axis = i
    other = np.zeros(3)
    other[axis] = 1.0
    out[0] = n
    _cross(n, other, out[1])
    out[1] /= math.sqrt(out[1, 0] ** 2 + out[1, 1] ** 2 + out[1, 2] ** 2)
    _cross(n, out[1], out[2])
