"""Kernels of the contact solver: constraint rows, and projected Gauss-Seidel sweeps over them.

Symbols and equation numbers are those of `contact_solver`. A row holds what one direction d of one contact needs:
d, r_a x d, r_b x d, I_a^-1 (r_a x d), I_b^-1 (r_b x d). Velocities are (n + 1, 6); row n never moves.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit

# Squared change of the impulses over their squared size: what comes after is rounding.
CONVERGED = 1.0e-20
# How often an iteration may change the face on which it goes on.
FACES = 3
# Impulses within this share of their bound are within it.
WITHIN = 1.0 - 1.0e-9
# Squared sine between directions below which they are one, but for rounding.
PARALLEL = 1.0e-12

DIRECTION, ARM_A, ARM_B, SPIN_A, SPIN_B = 0, 3, 6, 9, 12


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
            result[c] = _velocity(rows.rows[c, 0], _load(u, rows.body_a[pair]), _load(u, rows.body_b[pair]))
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


@njit(cache=True)
def apply_warm_start(rows, targets, u, impulses, rolling):
    """Add the carried impulses to u, scaled down where the whole of them overshoots.

    With lambda the vector of carried impulses, s lambda minimises the quadratic that Gauss-Seidel descends,
    s^2/2 lambda A lambda + s lambda (J u* - target), for s = -lambda (J u* - target) / lambda A lambda. Cut to [0, 1],
    a warm start can only take energy out.
    """
    change = np.zeros_like(u)
    slope = 0.0
    curvature = 0.0
    for sign in range(2):
        for pair in range(rows.body_a.size):
            a, b = rows.body_a[pair], rows.body_b[pair]
            for i in range(3):
                if sign == 0:
                    slope += rolling[pair, i] * (u[b, 3 + i] - u[a, 3 + i])
                else:
                    curvature += rolling[pair, i] * (change[b, 3 + i] - change[a, 3 + i])
            if sign == 0:
                _turn(rows, pair, change, rolling[pair])
            for c in range(rows.begin[pair], rows.begin[pair + 1]):
                for k in range(3):
                    if sign == 0:
                        target = targets[c] if k == 0 else 0.0
                        slope += impulses[c, k] * (_velocity(rows.rows[c, k], _load(u, a), _load(u, b)) - target)
                        masses = rows.inverse_masses
                        ua, ub = _load(change, a), _load(change, b)
                        ua, ub = _pushed(rows.rows[c, k], ua, ub, masses[a], masses[b], impulses[c, k])
                        _store(change, a, ua)
                        _store(change, b, ub)
                    else:
                        curvature += impulses[c, k] * _velocity(rows.rows[c, k], _load(change, a), _load(change, b))
    share = 0.0
    if curvature > 0.0:
        share = min(max(-slope / curvature, 0.0), 1.0)
    impulses *= share
    rolling *= share
    u += share * change


@njit(cache=True)
def sweep(rows, surfaces, targets, u, impulses, rolling, iterations):
    """Projected Gauss-Seidel on (2), (3), (5), accelerated. Changes u, impulses, rolling.

    One iteration visits all contacts forward, then backward. With x the impulses, t the targets and A = J W J^T this
    descends

        f(x) = x A x / 2 + x . (J u* - t) = (u M u - u* M u*) / 2 - x . t,      u = u* + W J^T x.

    From there it goes on to the minimum of f over the plane of this iteration's step and the last one's whole way, on
    the face of the contacts that press and stick: conjugate gradients, preconditioned by symmetric Gauss-Seidel [D].
    Products of A are sums over bodies, x A y = u_x M u_y. What would pull leaves the face and the plane is searched
    again; a way that for the cones' sake ends higher is not taken.
    """
    u_path, path, rolling_path = np.zeros_like(u), np.zeros_like(impulses), np.zeros_like(rolling)
    free, free_to_roll = np.empty(impulses.shape, dtype=np.bool_), np.empty(len(rolling), dtype=np.bool_)
    for iteration in range(iterations):
        u_before, before, rolling_before = u.copy(), impulses.copy(), rolling.copy()
        _sweep_once(rows, surfaces, targets, u, impulses, rolling, False)
        _sweep_once(rows, surfaces, targets, u, impulses, rolling, True)
        if iteration == iterations - 1:
            break
        u_step, step, rolling_step = u - u_before, impulses - before, rolling - rolling_before
        if np.sum(step * step) <= CONVERGED * np.sum(impulses * impulses):
            break
        _find_face(rows, surfaces, impulses, rolling, free, free_to_roll)
        u_move, move, rolling_move = np.zeros_like(u), np.zeros_like(impulses), np.zeros_like(rolling)
        share = 0.0
        for _ in range(FACES):
            _keep_to_face(rows, free, free_to_roll, u_step, step, rolling_step)
            _keep_to_face(rows, free, free_to_roll, u_path, path, rolling_path)
            along_step, along_path = _lowest(rows, targets, u, u_step, step, u_path, path)
            u_move = along_step * u_step + along_path * u_path
            move = along_step * step + along_path * path
            rolling_move = along_step * rolling_step + along_path * rolling_path
            left, share = _leave_face(rows, surfaces, impulses, move, free)
            if not left:
                break
        u_further, further = u + share * u_move, impulses + share * move
        rolling_further = rolling + share * rolling_move
        _project(rows, surfaces, u_further, further, rolling_further)
        height = 0.5 * _product(rows, u, u) - _work(impulses, targets)
        if 0.5 * _product(rows, u_further, u_further) - _work(further, targets) < height:
            u[:] = u_further
            impulses[:] = further
            rolling[:] = rolling_further
        u_path, path, rolling_path = u - u_before, impulses - before, rolling - rolling_before


@njit(cache=True)
def _find_face(rows, surfaces, impulses, rolling, free, free_to_roll):
    """Which impulses are strictly within their bounds: normal ones that press, tangents that stick."""
    for pair in range(rows.body_a.size):
        total = 0.0
        for c in range(rows.begin[pair], rows.begin[pair + 1]):
            normal = impulses[c, 0]
            total += normal
            free[c, 0] = 0.0 < normal < surfaces.impulse_limits[c]
            limit = WITHIN * surfaces.friction[pair] * normal
            free[c, 1] = free[c, 2] = impulses[c, 1] ** 2 + impulses[c, 2] ** 2 < limit * limit
        limit = WITHIN * surfaces.rolling_arm[pair] * total
        free_to_roll[pair] = np.sum(rolling[pair] * rolling[pair]) < limit * limit


@njit(cache=True)
def _keep_to_face(rows, free, free_to_roll, u, impulses, rolling):
    """Take what is not free out of a direction, and its share out of u."""
    for pair in range(rows.body_a.size):
        a, b = rows.body_a[pair], rows.body_b[pair]
        ua, ub = _load(u, a), _load(u, b)
        mass_a, mass_b = rows.inverse_masses[a], rows.inverse_masses[b]
        for c in range(rows.begin[pair], rows.begin[pair + 1]):
            for k in range(3):
                if not free[c, k] and impulses[c, k] != 0.0:
                    ua, ub = _pushed(rows.rows[c, k], ua, ub, mass_a, mass_b, -impulses[c, k])
                    impulses[c, k] = 0.0
        _store(u, a, ua)
        _store(u, b, ub)
        if not free_to_roll[pair]:
            _turn(rows, pair, u, -rolling[pair])
            rolling[pair] = 0.0


@njit(cache=True)
def _lowest(rows, targets, u, u_step, step, u_path, path):
    """Shares of two directions that lead to the minimum of f."""
    step_slope, step_curvature = _product(rows, u_step, u) - _work(step, targets), _product(rows, u_step, u_step)
    path_slope, path_curvature = _product(rows, u_path, u) - _work(path, targets), _product(rows, u_path, u_path)
    mixed = _product(rows, u_step, u_path)
    determinant = step_curvature * path_curvature - mixed * mixed
    if determinant > PARALLEL * step_curvature * path_curvature:
        return (
            (mixed * path_slope - path_curvature * step_slope) / determinant,
            (mixed * step_slope - step_curvature * path_slope) / determinant,
        )
    return (-step_slope / step_curvature if step_curvature > 0.0 else 0.0), 0.0


@njit(cache=True)
def _leave_face(rows, surfaces, impulses, move, free):
    """Take from the face what the move would carry beyond its bounds.

    Returns whether there was any, and the share of the way that no normal impulse leaves.
    """
    left, share = False, 1.0
    for pair in range(rows.body_a.size):
        for c in range(rows.begin[pair], rows.begin[pair + 1]):
            normal = impulses[c, 0] + move[c, 0]
            if free[c, 0] and not 0.0 <= normal <= surfaces.impulse_limits[c]:
                bound = 0.0 if normal < 0.0 else surfaces.impulse_limits[c]
                share = min(share, (bound - impulses[c, 0]) / move[c, 0])
                free[c] = False
                left = True
            elif free[c, 1]:
                limit = surfaces.friction[pair] * normal
                if (impulses[c, 1] + move[c, 1]) ** 2 + (impulses[c, 2] + move[c, 2]) ** 2 > limit * limit:
                    free[c, 1] = free[c, 2] = False
                    left = True
    return left, share


@njit(cache=True)
def _product(rows, u, other):
    """u M u'."""
    result = 0.0
    for i in range(rows.masses.size):
        linear, angular = 0.0, 0.0
        for k in range(3):
            linear += u[i, k] * other[i, k]
            for m in range(3):
                angular += u[i, 3 + k] * rows.inertias[i, k, m] * other[i, 3 + m]
        result += rows.masses[i] * linear + angular
    return result


@njit(cache=True)
def _work(impulses, targets):
    result = 0.0
    for c in range(targets.size):
        result += impulses[c, 0] * targets[c]
    return result


@njit(cache=True)
def _project(rows, surfaces, u, impulses, rolling):
    """Impulses back to where (2), (3) and (5) allow them, and u with them."""
    for pair in range(rows.body_a.size):
        a, b = rows.body_a[pair], rows.body_b[pair]
        ua, ub = _load(u, a), _load(u, b)
        mass_a, mass_b = rows.inverse_masses[a], rows.inverse_masses[b]
        total = 0.0
        for c in range(rows.begin[pair], rows.begin[pair + 1]):
            normal = min(max(impulses[c, 0], 0.0), surfaces.impulse_limits[c])
            if normal != impulses[c, 0]:
                ua, ub = _pushed(rows.rows[c, 0], ua, ub, mass_a, mass_b, normal - impulses[c, 0])
                impulses[c, 0] = normal
            total += normal
            limit, square = surfaces.friction[pair] * normal, impulses[c, 1] ** 2 + impulses[c, 2] ** 2
            if square > limit * limit:
                scale = limit / math.sqrt(square)
                for k in range(1, 3):
                    ua, ub = _pushed(rows.rows[c, k], ua, ub, mass_a, mass_b, (scale - 1.0) * impulses[c, k])
                    impulses[c, k] *= scale
        _store(u, a, ua)
        _store(u, b, ub)
        limit = surfaces.rolling_arm[pair] * total
        square = np.sum(rolling[pair] * rolling[pair])
        if square > limit * limit:
            change = (limit / math.sqrt(square) - 1.0) * rolling[pair]
            rolling[pair] += change
            _turn(rows, pair, u, change)


@njit(cache=True)
def _sweep_once(rows, surfaces, targets, u, impulses, rolling, backward):
    pair_count = rows.body_a.size
    for visit in range(pair_count):
        pair = pair_count - 1 - visit if backward else visit
        a, b = rows.body_a[pair], rows.body_b[pair]
        first, end = rows.begin[pair], rows.begin[pair + 1]
        mass_a, mass_b = rows.inverse_masses[a], rows.inverse_masses[b]
        friction = surfaces.friction[pair]
        ua, ub = _load(u, a), _load(u, b)
        total = 0.0
        for inner in range(end - first):
            c = end - 1 - inner if backward else first + inner
            normal, tangent1, tangent2 = rows.rows[c, 0], rows.rows[c, 1], rows.rows[c, 2]
            # Friction first, with the last sweep's lambda: not going through matters more and has the last word.
            s1, s2 = _velocity(tangent1, ua, ub), _velocity(tangent2, ua, ub)
            # One mass for both tangents: with the block's inverse, sliding friction would oppose not the slip but
            # its image under that inverse, and turn what slides straight.
            wanted1 = impulses[c, 1] - rows.tangent_masses[c] * s1
            wanted2 = impulses[c, 2] - rows.tangent_masses[c] * s2
            limit, square = friction * impulses[c, 0], wanted1 * wanted1 + wanted2 * wanted2
            if square > limit * limit:
                scale = limit / math.sqrt(square)
                wanted1 *= scale
                wanted2 *= scale
            ua, ub = _pushed(tangent1, ua, ub, mass_a, mass_b, wanted1 - impulses[c, 1])
            ua, ub = _pushed(tangent2, ua, ub, mass_a, mass_b, wanted2 - impulses[c, 2])
            impulses[c, 1] = wanted1
            impulses[c, 2] = wanted2
            wanted = impulses[c, 0] - rows.normal_masses[c] * (_velocity(normal, ua, ub) - targets[c])
            wanted = min(max(wanted, 0.0), surfaces.impulse_limits[c])
            ua, ub = _pushed(normal, ua, ub, mass_a, mass_b, wanted - impulses[c, 0])
            impulses[c, 0] = wanted
            total += wanted
        _store(u, a, ua)
        _store(u, b, ub)
        if surfaces.rolling_arm[pair] > 0.0:
            _roll(rows, pair, u, a, b, rolling, surfaces.rolling_arm[pair] * total)


@njit(cache=True)
def sweep_normals(rows, targets, u, impulses, iterations):
    """Projected Gauss-Seidel on normal rows alone, as (6) needs it. Changes u and impulses."""
    pair_count = rows.body_a.size
    for iteration in range(iterations):
        backward = iteration % 2 == 1
        for visit in range(pair_count):
            pair = pair_count - 1 - visit if backward else visit
            a, b = rows.body_a[pair], rows.body_b[pair]
            mass_a, mass_b = rows.inverse_masses[a], rows.inverse_masses[b]
            ua, ub = _load(u, a), _load(u, b)
            for c in range(rows.begin[pair], rows.begin[pair + 1]):
                normal = rows.rows[c, 0]
                wanted = impulses[c] - rows.normal_masses[c] * (_velocity(normal, ua, ub) - targets[c])
                wanted = max(wanted, 0.0)
                ua, ub = _pushed(normal, ua, ub, mass_a, mass_b, wanted - impulses[c])
                impulses[c] = wanted
            _store(u, a, ua)
            _store(u, b, ub)


@njit(cache=True)
def _roll(rows, pair, u, a, b, rolling, limit):
    wanted = np.empty(3)
    square = 0.0
    for i in range(3):
        wanted[i] = rolling[pair, i]
        for j in range(3):
            wanted[i] -= rows.rolling_masses[pair, i, j] * (u[b, 3 + j] - u[a, 3 + j])
        square += wanted[i] * wanted[i]
    scale = 1.0
    if square > limit * limit:
        scale = limit / math.sqrt(square)
    for i in range(3):
        wanted[i] = wanted[i] * scale - rolling[pair, i]
        rolling[pair, i] += wanted[i]
    _turn(rows, pair, u, wanted)


@njit(cache=True)
def _turn(rows, pair, u, impulse):
    """Angular impulse [N m s] on b, the opposite on a."""
    a, b = rows.body_a[pair], rows.body_b[pair]
    for i in range(3):
        for j in range(3):
            u[a, 3 + i] -= rows.inverse_inertias[a, i, j] * impulse[j]
            u[b, 3 + i] += rows.inverse_inertias[b, i, j] * impulse[j]


# The velocities of a pair travel as tuples, which stay in registers; the sums are short chains, which run side by side.


@njit(cache=True)
def _load(u, i):
    return u[i, 0], u[i, 1], u[i, 2], u[i, 3], u[i, 4], u[i, 5]


@njit(cache=True)
def _store(u, i, values):
    for k in range(6):
        u[i, k] = values[k]


@njit(cache=True)
def _velocity(r, ua, ub):
    linear = r[0] * (ub[0] - ua[0]) + r[1] * (ub[1] - ua[1]) + r[2] * (ub[2] - ua[2])
    angular_a = r[3] * ua[3] + r[4] * ua[4] + r[5] * ua[5]
    angular_b = r[6] * ub[3] + r[7] * ub[4] + r[8] * ub[5]
    return linear + (angular_b - angular_a)


@njit(cache=True)
def _pushed(r, ua, ub, inverse_mass_a, inverse_mass_b, impulse):
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
