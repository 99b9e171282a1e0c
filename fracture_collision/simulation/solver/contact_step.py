"""One step of one island: new velocities with contacts, friction and restitution, and drift correction.

Symbols and equation numbers are those of `contact_solver`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fracture_collision.kernel_sources import cached_njit
from fracture_collision.simulation.compiled import uncounted
from fracture_collision.simulation.solver.contact_face import Iterate
from fracture_collision.simulation.solver.contact_rows import Surfaces, normal_velocities
from fracture_collision.simulation.solver.contact_sweeps import apply_warm_start, sweep

# Share of the energy that gravity gives a body at rest in one step: a stack at rest gains and loses it by rounding.
ROUNDING = 1.0e-7
# Impacts one after the other in a step, at most: a blow passes along so many touching bodies.
MOST_IMPACTS = 64
# Factor on `accuracy` from one round to the next.
SHARPER = 0.1


class Gaps(NamedTuple):
    """Of N contacts: what decides how their bodies close up, bounce and are pushed apart."""

    beyond: np.ndarray  # (N,) g [m]
    sizes: np.ndarray  # (N,) R [m]
    restitution: np.ndarray  # (N,)
    bounce_speeds: np.ndarray  # (N,) v_e [m/s]
    spans: np.ndarray  # (N,) h [s]


@cached_njit
def find_velocities(rows, surfaces, gaps, before, iterate, settings):
    """Solve (1)-(5): the Iterate has u* and a first guess of the impulses, and gets u(t + h) and the impulses.

    gaps: Gaps; before: u(t). Returns the normal impulses (N,) without those of (4).
    """
    open_by = np.maximum(gaps.beyond, 0.0) / gaps.spans
    impulses, rolling, u = iterate
    gravity = _gravity(before, u)
    begin = Iterate(np.zeros_like(impulses), np.zeros_like(rolling), before.copy())
    _impacts(rows, surfaces, gaps, open_by, gravity, begin, settings)
    u += begin.u - before
    free, targets = u.copy(), -open_by
    apply_warm_start(rows, targets, iterate)
    if _are_struck(rows, targets, gaps, u):
        # While the impulses are far too small, everything slides, and friction moves light bodies under heavy ones.
        still = np.zeros_like(surfaces.friction)
        smooth = Surfaces(still, still, surfaces.impulse_limits)
        sweep(rows, smooth, targets, free, iterate, settings.rounds * settings.iterations, settings.accuracy)
    enough, accuracy = ROUNDING * _inner(rows, gravity, gravity), settings.accuracy
    for _ in range(settings.rounds):
        sweep(rows, surfaces, targets, free, iterate, settings.iterations, accuracy)
        if _energy_gain(rows, begin.u, gravity, u) <= enough:
            break
        accuracy *= SHARPER
    pressing = impulses[:, 0].copy()
    impulses += begin.impulses
    rolling += begin.rolling
    return pressing


@cached_njit
def _are_struck(rows, targets, gaps, u):
    """Whether the velocities u violate (2) at a contact by more than its v_e."""
    approach = np.empty(len(targets))
    normal_velocities(rows, u, approach)
    return (approach < targets - gaps.bounce_speeds).any()


@cached_njit
def _impacts(rows, surfaces, gaps, open_by, gravity, iterate, settings):
    """Bounce what approaches and closes up in this step, (4): the Iterate has u(t), and gets what it is after impacts.

    All contacts that approach bounce together, until none does: a row of touching balls passes a blow on from one to
    the next, and a box that lands flat stays flat (generalized reflections: Smith, Kaufman, Vouga, Tamstorf, Grinspun,
    "Reflections on Simultaneous Impact", 2012). Others transmit nothing meanwhile. open_by (N,) [m/s]: by which a
    contact closes up in the step; gravity: see _gravity.
    """
    if not (gaps.restitution > 0.0).any():
        return
    count, u = len(open_by), iterate.u
    approach, falls = np.empty(count), np.empty(count)
    normal_velocities(rows, gravity, falls)
    nothing = np.zeros_like(u)
    for _ in range(MOST_IMPACTS):
        normal_velocities(rows, u, approach)
        limits, targets, bounces = np.zeros(count), np.zeros(count), False
        for c in range(count):
            if (
                gaps.restitution[c] > 0.0
                and surfaces.impulse_limits[c] == np.inf
                and approach[c] < -gaps.bounce_speeds[c]
                and approach[c] + falls[c] + open_by[c] < 0.0
            ):
                limits[c], bounces = np.inf, True
        if not bounces:
            return
        now = u.copy()
        plastic = Iterate(np.zeros_like(iterate.impulses), np.zeros_like(iterate.rolling), u.copy())
        its = Surfaces(surfaces.friction, surfaces.rolling_arm, limits)
        sweep(rows, its, targets, now, plastic, settings.iterations, settings.accuracy)
        bounced = Iterate(plastic.impulses.copy(), plastic.rolling.copy(), plastic.u.copy())
        for c in range(count):
            if limits[c] > 0.0:
                targets[c] = -gaps.restitution[c] * approach[c]
        sweep(rows, its, targets, now, bounced, settings.restitution_iterations, settings.accuracy)
        share = _share_without_energy_gain(rows, now, nothing, plastic.u, bounced.u)
        u[:] = plastic.u + share * (bounced.u - plastic.u)
        iterate.impulses[:] += plastic.impulses + share * (bounced.impulses - plastic.impulses)
        iterate.rolling[:] += plastic.rolling + share * (bounced.rolling - plastic.rolling)


@cached_njit
def drift_velocities(rows, gaps, before, after, against, settings):
    """u_d by (6), with u(t) and u(t + h); contacts in `against` are left out."""
    u = np.zeros_like(before)
    depths = -gaps.beyond - settings.rest_slop * gaps.sizes
    if depths.max() <= 0.0:
        return u
    count = depths.size
    approach, targets = np.empty(count), np.empty(count)
    normal_velocities(rows, before, approach)
    normal_velocities(rows, after, targets)
    limits = np.full(count, np.inf)
    for c in range(count):
        depth, span = depths[c], gaps.spans[c]
        # The new velocities count towards the correction; a gap that is not too small may still close up to the slop.
        if depth > 0.0:
            push = min(settings.drift_fraction * depth / span, settings.drift_speed * gaps.sizes[c])
            # Penetration of the last step is removed in the next: when a plate breaks, the ball is at its surface.
            targets[c] = max(push, min(depth / span, -approach[c])) - targets[c]
        else:
            targets[c] = depth / span - targets[c]
        if against[c]:
            limits[c] = 0.0
    still = np.zeros(rows.body_a.size)
    iterate = Iterate(np.zeros((count, 3)), np.zeros((rows.body_a.size, 3)), u)
    smooth, nothing = Surfaces(still, still, limits), np.zeros_like(u)
    sweep(rows, smooth, targets, nothing, iterate, settings.drift_iterations, settings.accuracy)
    return u


@cached_njit
def _share_without_energy_gain(rows, before, gravity, plastic, bounced):
    """The largest s in [0, 1] for which plastic + s (bounced - plastic) gains no energy, or no more than plastic does.

    Newton's restitution (4) together with friction can create energy in a body with several contacts (Stronge 1990).
    (2) and (3) are convex, so any mixture of the two solutions obeys them as well.
    """
    gain = _energy_gain(rows, before, gravity, plastic)
    if _energy_gain(rows, before, gravity, bounced) <= max(gain, 0.0):
        return 1.0
    change = bounced - plastic
    a = _inner(rows, change, change)
    b = _inner(rows, plastic, change) - _inner(rows, gravity, change)
    c = 2.0 * min(gain, 0.0)
    return (-b + np.sqrt(max(b * b - a * c, 0.0))) / a


@cached_njit
def _energy_gain(rows, before, gravity, u):
    """Gain of mechanical energy [J] in a step in which the bodies move with u.

    Kinetic energy, less the work of the impulse of gravity, M (u* - u(t)). Solved exactly, (1)-(3) gain nothing:
    -|u - u(t)|^2_M / 2 at most. A gain therefore means that they have not converged far enough.
    """
    return 0.5 * (_inner(rows, u, u) - _inner(rows, before, before)) - _inner(rows, gravity, u)


@cached_njit
def _gravity(before, free):
    """M^-1 times the impulse of gravity; the gyroscopic torque does no work."""
    change = free - before
    change[:, 3:] = 0.0
    return change


@uncounted
def _inner(rows, x, y):
    """Inner product x M y of velocities (n + 1, 6)."""
    result = 0.0
    for i in range(x.shape[0]):
        inertia = rows.inertias[i]
        result += rows.masses[i] * (x[i, 0] * y[i, 0] + x[i, 1] * y[i, 1] + x[i, 2] * y[i, 2])
        for k in range(3):
            result += x[i, 3 + k] * (inertia[k, 0] * y[i, 3] + inertia[k, 1] * y[i, 4] + inertia[k, 2] * y[i, 5])
    return result
