"""Acceleration of the contact solver's iterations: the minimum of f (`contact_sweeps`) on the face of the contacts.

The impulses that obey (2), (3) and (5) of `contact_solver` form a product of cones. On a face, where it is fixed which
contacts press and which of these stick, the problem is linear, and conjugate gradients solve it.

  [D] Dostal, Schoeberl, "Minimizing quadratic functions subject to bound constraints with the rate of convergence and
      finite termination", 2005: conjugate gradients on a face, projections to change it.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from fracture_collision.simulation.compiled import uncounted
from fracture_collision.simulation.solver.contact_rows import NORMAL_MASS, TANGENT_MASS, load, push, pushed, store, turn

# A direction with less than this share of the bodies' energy, 1e-10 of their speeds, counts as none. Drift correction
# starts at rest, without energy: there NO_WAY alone decides.
NO_ENERGY = 1.0e-20
# A direction with less than this share of the curvature of its single impulses only shifts load between contacts that
# hold the same; one whose squared sine to the other is less is a multiple of it. What is left of either is rounding.
NO_WAY = 1.0e-8


class Iterate(NamedTuple):
    """The impulses that the iterations have reached, and the velocities that they give; kernels change both."""

    impulses: np.ndarray  # (N, 3)
    rolling: np.ndarray  # (p, 3)
    u: np.ndarray  # (n + 1, 6)


class Way(NamedTuple):
    """A direction: impulses, or a change of them, and their effect on the bodies."""

    impulses: np.ndarray  # (N, 3)
    rolling: np.ndarray  # (p, 3)
    u: np.ndarray  # (n + 1, 6) W J^T of the above
    momenta: np.ndarray  # (n + 1, 6) M u


class Live(NamedTuple):
    """The contacts that have had an impulse since the sweeps began: a third of all; only they occur in a direction."""

    begin: np.ndarray  # (p + 1,) int64
    contacts: np.ndarray  # (N,) int64; of pair i contacts[begin[i] : begin[i + 1]], ascending; the rest is not used
    has_lived: np.ndarray  # (N,) bool


class Face(NamedTuple):
    """What the last visit of a contact found within its bounds.

    A tangent's bound moves with lambda: comparing them afterwards would let sliding contacts stick, and friction take
    part in finding lambda.
    """

    presses: np.ndarray  # (N,) bool, the normal impulse
    sticks: np.ndarray  # (N,) bool, the tangents
    holds: np.ndarray  # (p,) bool, the rolling resistance


@uncounted
def list_live(rows, live):
    """Update the list from `has_lived`."""
    used = 0
    for pair in range(rows.body_a.size):
        live.begin[pair] = used
        for c in range(rows.begin[pair], rows.begin[pair + 1]):
            if live.has_lived[c]:
                live.contacts[used] = c
                used += 1
    live.begin[rows.body_a.size] = used


@uncounted
def difference(iterate, before, live, way):
    """The direction from `before` to the present impulses; `keep_to_face` computes its effect on the bodies."""
    impulses, rolling = iterate.impulses, iterate.rolling
    for c in live.contacts[: live.begin[-1]]:
        for k in range(3):
            way.impulses[c, k] = impulses[c, k] - before.impulses[c, k]
    for pair in range(rolling.shape[0]):
        for k in range(3):
            way.rolling[pair, k] = rolling[pair, k] - before.rolling[pair, k]


@uncounted
def add_up(rows, live, start, iterate):
    """Recompute u from its value at `start` and the impulses since."""
    impulses, rolling, u = iterate
    for i in range(u.shape[0]):
        for k in range(6):
            u[i, k] = start.u[i, k]
    for pair in range(rows.body_a.size):
        for c in live.contacts[live.begin[pair] : live.begin[pair + 1]]:
            push(
                rows, pair, c, u, impulses[c, 0] - start.impulses[c, 0], impulses[c, 1] - start.impulses[c, 1],
                impulses[c, 2] - start.impulses[c, 2],
            )  # fmt: skip
        turn(
            rows, pair, u, rolling[pair, 0] - start.rolling[pair, 0], rolling[pair, 1] - start.rolling[pair, 1],
            rolling[pair, 2] - start.rolling[pair, 2],
        )  # fmt: skip


@uncounted
def keep_to_face(rows, live, face, way):
    """Remove from a direction what is not free on the face, and compute the effect of the rest on the bodies.

    The effect is summed from the impulses: a difference of velocities carries their rounding, which grows from one
    iteration to the next where a step is many times its direction.
    """
    impulses, u = way.impulses, way.u
    for i in range(u.shape[0]):
        for k in range(6):
            u[i, k] = 0.0
    for pair in range(rows.body_a.size):
        a, b = rows.body_a[pair], rows.body_b[pair]
        mass_a, mass_b = rows.inverse_masses[a], rows.inverse_masses[b]
        ua, ub = load(u, a), load(u, b)
        for c in live.contacts[live.begin[pair] : live.begin[pair + 1]]:
            if not face.presses[c]:
                impulses[c, 0] = 0.0
            if not face.sticks[c]:
                impulses[c, 1] = impulses[c, 2] = 0.0
            normal, x, y = impulses[c, 0], impulses[c, 1], impulses[c, 2]
            if normal != 0.0 or x != 0.0 or y != 0.0:
                ua, ub = pushed(rows.contacts[c], ua, ub, mass_a, mass_b, normal, x, y)
        store(u, a, ua)
        store(u, b, ub)
        if not face.holds[pair]:
            way.rolling[pair, 0] = way.rolling[pair, 1] = way.rolling[pair, 2] = 0.0
        x, y, z = way.rolling[pair, 0], way.rolling[pair, 1], way.rolling[pair, 2]
        if x != 0.0 or y != 0.0 or z != 0.0:
            turn(rows, pair, u, x, y, z)
    _find_momenta(rows, way)


@uncounted
def take_out(rows, live, face, way):
    """Remove from a direction what has left the face since `keep_to_face`."""
    impulses = way.impulses
    for pair in range(rows.body_a.size):
        for c in live.contacts[live.begin[pair] : live.begin[pair + 1]]:
            normal = x = y = 0.0
            if not face.presses[c]:
                normal = impulses[c, 0]
                impulses[c, 0] = 0.0
            if not face.sticks[c]:
                x, y = impulses[c, 1], impulses[c, 2]
                impulses[c, 1] = impulses[c, 2] = 0.0
            if normal != 0.0 or x != 0.0 or y != 0.0:
                push(rows, pair, c, way.u, -normal, -x, -y)
    _find_momenta(rows, way)


@uncounted
def lowest(rows, live, targets, u, step, path, scale):
    """Multiples of two directions that lead from here to the minimum of f. `scale`: u M u before the sweeps."""
    step_slope, step_curvature, step_leads = _slope_and_curvature(rows, live, targets, u, step, scale)
    path_slope, path_curvature, path_leads = _slope_and_curvature(rows, live, targets, u, path, scale)
    along_step, along_path = 0.0, 0.0
    if step_leads and path_leads:
        mixed = dot(step.momenta, path.u)
        determinant = step_curvature * path_curvature - mixed * mixed
        path_leads = determinant > NO_WAY * step_curvature * path_curvature
        if path_leads:
            along_step = (mixed * path_slope - path_curvature * step_slope) / determinant
            along_path = (mixed * step_slope - step_curvature * path_slope) / determinant
    if step_leads and not path_leads:
        along_step = -step_slope / step_curvature
    if path_leads and not step_leads:
        along_path = -path_slope / path_curvature
    return along_step, along_path


@uncounted
def _slope_and_curvature(rows, live, targets, u, way, scale):
    slope, curvature, apart = dot(way.momenta, u), dot(way.momenta, way.u), 0.0
    for c in live.contacts[: live.begin[-1]]:
        normal, x, y = way.impulses[c, 0], way.impulses[c, 1], way.impulses[c, 2]
        if normal == 0.0 and x == 0.0 and y == 0.0:
            continue
        slope -= normal * targets[c]
        apart += normal * normal / rows.contacts[c, NORMAL_MASS] + (x * x + y * y) / rows.contacts[c, TANGENT_MASS]
    return slope, curvature, curvature > max(NO_WAY * apart, NO_ENERGY * scale)


@uncounted
def leave_face(rows, live, surfaces, impulses, step, path, along, face):
    """Remove from the face what the multiples `along` of two directions would carry beyond its bounds.

    Returns whether anything left it, and the part of the step up to which every normal impulse stays within its bounds.
    """
    along_step, along_path = along
    left, part = False, 1.0
    for pair in range(rows.body_a.size):
        friction = surfaces.friction[pair]
        for c in live.contacts[live.begin[pair] : live.begin[pair + 1]]:
            move = along_step * step.impulses[c, 0] + along_path * path.impulses[c, 0]
            normal = impulses[c, 0] + move
            if face.presses[c] and not 0.0 <= normal <= surfaces.impulse_limits[c]:
                bound = 0.0 if normal < 0.0 else surfaces.impulse_limits[c]
                part = min(part, (bound - impulses[c, 0]) / move)
                face.presses[c] = face.sticks[c] = False
                left = True
            elif face.sticks[c]:
                x = impulses[c, 1] + along_step * step.impulses[c, 1] + along_path * path.impulses[c, 1]
                y = impulses[c, 2] + along_step * step.impulses[c, 2] + along_path * path.impulses[c, 2]
                if x * x + y * y > (friction * normal) ** 2:
                    face.sticks[c] = False
                    left = True
    return left, part


@uncounted
def take_step(rows, live, surfaces, targets, iterate, step, path, along):
    """Step by the multiples `along` of two directions, projected onto the cones; no step, and False, if f did not fall.

    The step as made is written into `step`.
    """
    impulses, rolling, u = iterate
    along_step, along_path = along
    work = 0.0
    for i in range(u.shape[0]):
        for k in range(6):
            step.u[i, k] = along_step * step.u[i, k] + along_path * path.u[i, k]
    for pair in range(rows.body_a.size):
        friction, total = surfaces.friction[pair], 0.0
        for c in live.contacts[live.begin[pair] : live.begin[pair + 1]]:
            move0 = along_step * step.impulses[c, 0] + along_path * path.impulses[c, 0]
            move1 = along_step * step.impulses[c, 1] + along_path * path.impulses[c, 1]
            move2 = along_step * step.impulses[c, 2] + along_path * path.impulses[c, 2]
            if move0 == 0.0 and move1 == 0.0 and move2 == 0.0 and impulses[c, 1] == 0.0 and impulses[c, 2] == 0.0:
                step.impulses[c, 0] = step.impulses[c, 1] = step.impulses[c, 2] = 0.0
                total += impulses[c, 0]
                continue
            normal = min(max(impulses[c, 0] + move0, 0.0), surfaces.impulse_limits[c])
            x, y = impulses[c, 1] + move1, impulses[c, 2] + move2
            square, limit = x * x + y * y, friction * normal
            excess = limit / math.sqrt(square) - 1.0 if square > limit * limit else 0.0
            over = normal - impulses[c, 0] - move0
            if excess != 0.0 or over != 0.0:
                push(rows, pair, c, step.u, over, excess * x, excess * y)
            step.impulses[c, 0] = normal - impulses[c, 0]
            step.impulses[c, 1] = move1 + excess * x
            step.impulses[c, 2] = move2 + excess * y
            work += step.impulses[c, 0] * targets[c]
            total += normal
        square = 0.0
        for k in range(3):
            step.rolling[pair, k] = along_step * step.rolling[pair, k] + along_path * path.rolling[pair, k]
            square += (rolling[pair, k] + step.rolling[pair, k]) ** 2
        limit = surfaces.rolling_arm[pair] * total
        if square > limit * limit:
            excess = limit / math.sqrt(square) - 1.0
            x = excess * (rolling[pair, 0] + step.rolling[pair, 0])
            y = excess * (rolling[pair, 1] + step.rolling[pair, 1])
            z = excess * (rolling[pair, 2] + step.rolling[pair, 2])
            turn(rows, pair, step.u, x, y, z)
            step.rolling[pair, 0] += x
            step.rolling[pair, 1] += y
            step.rolling[pair, 2] += z
    _find_momenta(rows, step)
    if dot(step.momenta, u) + 0.5 * dot(step.momenta, step.u) >= work:
        return False
    for i in range(u.shape[0]):
        for k in range(6):
            u[i, k] += step.u[i, k]
    for c in live.contacts[: live.begin[-1]]:
        for k in range(3):
            impulses[c, k] += step.impulses[c, k]
    for pair in range(rolling.shape[0]):
        for k in range(3):
            rolling[pair, k] += step.rolling[pair, k]
    return True


@uncounted
def doubled_energy(rows, way):
    """Twice the energy of a direction, u M u; also computes its momenta."""
    _find_momenta(rows, way)
    return dot(way.momenta, way.u)


@uncounted
def _find_momenta(rows, way):
    u, momenta = way.u, way.momenta
    for i in range(rows.masses.size):
        for k in range(3):
            momenta[i, k] = rows.masses[i] * u[i, k]
            momenta[i, 3 + k] = (
                rows.inertias[i, k, 0] * u[i, 3] + rows.inertias[i, k, 1] * u[i, 4] + rows.inertias[i, k, 2] * u[i, 5]
            )


@uncounted
def dot(x, y):
    """Sum of the products of x and y, both (n + 1, 6)."""
    result = 0.0
    for i in range(x.shape[0]):
        result += (x[i, 0] * y[i, 0] + x[i, 1] * y[i, 1] + x[i, 2] * y[i, 2]) + (
            x[i, 3] * y[i, 3] + x[i, 4] * y[i, 4] + x[i, 5] * y[i, 5]
        )
    return result
