"""One step of one island: new velocities with contacts, friction and restitution, and drift correction.

It iterates projected Gauss-Seidel over the contact rows of an island, warm-started and accelerated.

Symbols and equation numbers are those of `contact_solver`.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from fracture_collision.kernel_sources import cached_njit
from fracture_collision.simulation.compiled import uncounted
from fracture_collision.simulation.solver.contact_face import (
    Face,
    Iterate,
    Live,
    Way,
    add_up,
    difference,
    dot,
    doubled_energy,
    keep_to_face,
    leave_face,
    list_live,
    lowest,
    take_out,
    take_step,
)
from fracture_collision.simulation.solver.contact_rows import (
    COUPLING1,
    COUPLING2,
    NORMAL_MASS,
    TANGENT_MASS,
    Rows,
    Surfaces,
    load,
    normal_velocities,
    normal_velocity,
    pushed,
    pushed_apart,
    store,
    turn,
    velocities,
)

# How often an iteration may change its face.
FACES = 3


@cached_njit
def apply_warm_start(rows, targets, iterate):
    """Add the carried impulses of an Iterate to its u, scaled down where they overshoot.

    With lambda the vector of carried impulses, s lambda minimises the quadratic that Gauss-Seidel descends,
    s^2/2 lambda A lambda + s lambda (J u* - target), for s = -lambda (J u* - target) / lambda A lambda. With s clamped
    to [0, 1], a warm start can only remove energy.
    """
    impulses, rolling, u = iterate
    carried = Way(impulses, rolling, np.zeros_like(u), np.zeros_like(u))
    slope = 0.0
    for pair in range(rows.body_a.size):
        a, b = rows.body_a[pair], rows.body_b[pair]
        mass_a, mass_b = rows.inverse_masses[a], rows.inverse_masses[b]
        turn(rows, pair, carried.u, rolling[pair, 0], rolling[pair, 1], rolling[pair, 2])
        change_a, change_b = load(carried.u, a), load(carried.u, b)
        for c in range(rows.begin[pair], rows.begin[pair + 1]):
            slope -= impulses[c, 0] * targets[c]
            change_a, change_b = pushed(
                rows.contacts[c], change_a, change_b, mass_a, mass_b, impulses[c, 0], impulses[c, 1], impulses[c, 2]
            )
        store(carried.u, a, change_a)
        store(carried.u, b, change_b)
    curvature = doubled_energy(rows, carried)
    slope += dot(carried.momenta, u)
    share = 0.0
    if curvature > 0.0:
        share = min(max(-slope / curvature, 0.0), 1.0)
    impulses *= share
    rolling *= share
    u += share * carried.u


@cached_njit
def sweep(rows, surfaces, targets, free, iterate, iterations, accuracy):
    """Projected Gauss-Seidel on (2), (3), (5), accelerated. Changes the Iterate.

    One iteration visits all contacts forward, then backward. With x the impulses, t the targets and A = J W J^T this
    descends

        f(x) = x A x / 2 + x . (J u* - t) = (u M u - u* M u*) / 2 - x . t,      u = u* + W J^T x.

    It then moves to the minimum of f over the plane of this sweep's step and the last iteration's total change, on the
    face of the contacts that press and stick: conjugate gradients, preconditioned by symmetric Gauss-Seidel [D].
    Products of A are sums over bodies, x A y = u_x M u_y. Contacts that would pull or slip leave the face and the plane
    is searched again; a step that, projected onto the cones, does not lower f is rejected.

    It ends when no body's velocity changes by more than `accuracy` times the largest change that contacts have made to
    any of them, u - u* (`free`).
    """
    impulses, rolling, u = iterate
    step, path, before, start = _no_way(iterate), _no_way(iterate), _no_way(iterate), _no_way(iterate)
    count = len(impulses)
    face = Face(np.zeros(count, np.bool_), np.zeros(count, np.bool_), np.zeros(len(rolling), np.bool_))
    live = Live(np.zeros(len(rolling) + 1, np.int64), np.empty(count, np.int64), np.zeros(count, np.bool_))
    for c in range(count):
        if impulses[c, 0] != 0.0 or impulses[c, 1] != 0.0 or impulses[c, 2] != 0.0:
            live.has_lived[c] = True
    list_live(rows, live)
    _keep(start, iterate, live)
    scale = doubled_energy(rows, start)
    has_gone = False
    for iteration in range(iterations):
        is_last = iteration == iterations - 1
        if is_last and has_gone:
            # Long accelerated steps leave more than rounding in u: the last sweep starts from u by the impulses.
            add_up(rows, live, start, iterate)
        _keep(before, iterate, live)
        _sweep_once(rows, surfaces, targets, iterate, live, face, False)
        _sweep_once(rows, surfaces, targets, iterate, live, face, True)
        list_live(rows, live)
        if is_last:
            break
        if _squared_change(rows, u, before.u) <= accuracy * accuracy * _squared_change(rows, u, free):
            if has_gone:
                add_up(rows, live, start, iterate)
            break
        difference(iterate, before, live, step)
        along, part = (0.0, 0.0), 0.0
        keep_to_face(rows, live, face, step)
        keep_to_face(rows, live, face, path)
        for search in range(FACES):
            if search > 0:
                take_out(rows, live, face, step)
                take_out(rows, live, face, path)
            along = lowest(rows, live, targets, u, step, path, scale)
            left, part = leave_face(rows, live, surfaces, impulses, step, path, along, face)
            if not left:
                break
        if take_step(rows, live, surfaces, targets, iterate, step, path, (part * along[0], part * along[1])):
            has_gone = True
        difference(iterate, before, live, path)


@uncounted
def _squared_change(rows, u, before):
    """The largest change of any body, [m2/s2]: twice its energy over its mass."""
    largest = 0.0
    for i in range(u.shape[0]):
        if rows.masses[i] > 0.0:
            inertia = rows.inertias[i]
            x, y, z = u[i, 3] - before[i, 3], u[i, 4] - before[i, 4], u[i, 5] - before[i, 5]
            spin = (
                x * (inertia[0, 0] * x + inertia[0, 1] * y + inertia[0, 2] * z)
                + y * (inertia[1, 0] * x + inertia[1, 1] * y + inertia[1, 2] * z)
                + z * (inertia[2, 0] * x + inertia[2, 1] * y + inertia[2, 2] * z)
            )
            x, y, z = u[i, 0] - before[i, 0], u[i, 1] - before[i, 1], u[i, 2] - before[i, 2]
            largest = max(largest, x * x + y * y + z * z + spin / rows.masses[i])
    return largest


@uncounted
def _keep(way, iterate, live):
    impulses, rolling, u = iterate
    for i in range(u.shape[0]):
        for k in range(6):
            way.u[i, k] = u[i, k]
    for c in live.contacts[: live.begin[-1]]:
        for k in range(3):
            way.impulses[c, k] = impulses[c, k]
    for pair in range(rolling.shape[0]):
        for k in range(3):
            way.rolling[pair, k] = rolling[pair, k]


@cached_njit
def _no_way(iterate):
    impulses, rolling, u = iterate
    return Way(np.zeros_like(impulses), np.zeros_like(rolling), np.zeros_like(u), np.zeros_like(u))


@uncounted
def _sweep_once(rows, surfaces, targets, iterate, live, face, backward):
    impulses, rolling, u = iterate
    pair_count = rows.body_a.size
    for visit in range(pair_count):
        pair = pair_count - 1 - visit if backward else visit
        a, b = rows.body_a[pair], rows.body_b[pair]
        first, end = rows.begin[pair], rows.begin[pair + 1]
        mass_a, mass_b = rows.inverse_masses[a], rows.inverse_masses[b]
        friction = surfaces.friction[pair]
        ua, ub = load(u, a), load(u, b)
        total = 0.0
        for inner in range(end - first):
            c = end - 1 - inner if backward else first + inner
            r, carried = rows.contacts[c], impulses[c, 0]
            if friction > 0.0 and (carried > 0.0 or impulses[c, 1] != 0.0 or impulses[c, 2] != 0.0):
                # Friction first, with the last sweep's lambda: non-penetration matters more, so it is solved last.
                s, s1, s2 = velocities(r, ua, ub)
                # One mass for both tangents: with the block's inverse, sliding friction would oppose not the slip but
                # its image under that inverse, and deflect a body that slides straight.
                wanted1 = impulses[c, 1] - r[TANGENT_MASS] * s1
                wanted2 = impulses[c, 2] - r[TANGENT_MASS] * s2
                limit, square = friction * carried, wanted1 * wanted1 + wanted2 * wanted2
                face.sticks[c] = square < limit * limit
                if square > limit * limit:
                    scale = limit / math.sqrt(square)
                    wanted1 *= scale
                    wanted2 *= scale
                change1, change2 = wanted1 - impulses[c, 1], wanted2 - impulses[c, 2]
                s += r[COUPLING1] * change1 + r[COUPLING2] * change2
                wanted = min(max(carried - r[NORMAL_MASS] * (s - targets[c]), 0.0), surfaces.impulse_limits[c])
                ua, ub = pushed(r, ua, ub, mass_a, mass_b, wanted - carried, change1, change2)
                impulses[c, 1] = wanted1
                impulses[c, 2] = wanted2
            else:
                s = normal_velocity(r, ua, ub)
                wanted = min(max(carried - r[NORMAL_MASS] * (s - targets[c]), 0.0), surfaces.impulse_limits[c])
                if wanted != carried:
                    live.has_lived[c] = True
                    ua, ub = pushed_apart(r, ua, ub, mass_a, mass_b, wanted - carried)
                face.sticks[c] = False
            impulses[c, 0] = wanted
            face.presses[c] = 0.0 < wanted < surfaces.impulse_limits[c]
            total += wanted
        store(u, a, ua)
        store(u, b, ub)
        face.holds[pair] = False
        if surfaces.rolling_arm[pair] > 0.0 and (total > 0.0 or _is_any(rolling[pair])):
            face.holds[pair] = _roll(rows, pair, u, a, b, rolling, surfaces.rolling_arm[pair] * total)


@uncounted
def _roll(rows, pair, u, a, b, rolling, limit):
    x, y, z = u[b, 3] - u[a, 3], u[b, 4] - u[a, 4], u[b, 5] - u[a, 5]
    masses = rows.rolling_masses[pair]
    wanted_x = rolling[pair, 0] - (masses[0, 0] * x + masses[0, 1] * y + masses[0, 2] * z)
    wanted_y = rolling[pair, 1] - (masses[1, 0] * x + masses[1, 1] * y + masses[1, 2] * z)
    wanted_z = rolling[pair, 2] - (masses[2, 0] * x + masses[2, 1] * y + masses[2, 2] * z)
    square = wanted_x * wanted_x + wanted_y * wanted_y + wanted_z * wanted_z
    scale = limit / math.sqrt(square) if square > limit * limit else 1.0
    wanted_x, wanted_y, wanted_z = scale * wanted_x, scale * wanted_y, scale * wanted_z
    turn(rows, pair, u, wanted_x - rolling[pair, 0], wanted_y - rolling[pair, 1], wanted_z - rolling[pair, 2])
    rolling[pair, 0], rolling[pair, 1], rolling[pair, 2] = wanted_x, wanted_y, wanted_z
    return square < limit * limit


@uncounted
def _is_any(x):
    return x[0] != 0.0 or x[1] != 0.0 or x[2] != 0.0


# Share of the energy that gravity gives a body at rest in one step: a stack at rest gains and loses it by rounding.
ROUNDING = 1.0e-7
# Impacts one after the other in a step, at most: a blow passes along so many touching bodies.
MOST_IMPACTS = 64
# A contact bounces again within a step while the product of its restitutions so far exceeds this. Pieces that are
# struck among others bounce to and fro, each time with a share of the speed; what is left then does not bounce.
LEAST_BOUNCE = 0.02
# `accuracy` of impulses that others start from.
FIRST_GUESS = 1.0e-3
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
        sweep(rows, smooth, targets, free, iterate, settings.iterations, FIRST_GUESS)
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

    All contacts that approach bounce together, until none does that may (LEAST_BOUNCE): a row of touching balls passes
    a blow on from one to the next, and a box that lands flat stays flat (generalized reflections: Smith, Kaufman,
    Vouga, Tamstorf, Grinspun, "Reflections on Simultaneous Impact", 2012). Others transmit nothing meanwhile. open_by
    (N,) [m/s]: by which a contact closes up in the step; gravity: see _gravity.
    """
    if not (gaps.restitution > 0.0).any():
        return
    count, u = len(open_by), iterate.u
    approach, falls, left = np.empty(count), np.empty(count), np.ones(count)
    normal_velocities(rows, gravity, falls)
    nothing = np.zeros_like(u)
    for _ in range(MOST_IMPACTS):
        normal_velocities(rows, u, approach)
        bouncing = np.flatnonzero(
            (gaps.restitution > 0.0) & (surfaces.impulse_limits == np.inf) & (approach < -gaps.bounce_speeds)
            & (approach + falls + open_by < 0.0) & (left > LEAST_BOUNCE)
        )  # fmt: skip
        if not len(bouncing):
            return
        left[bouncing] *= gaps.restitution[bouncing]
        own, its, pairs = _those(rows, surfaces, bouncing)
        targets, now = np.zeros(len(bouncing)), u.copy()
        plastic = Iterate(np.zeros((len(bouncing), 3)), np.zeros((len(pairs), 3)), u.copy())
        sweep(own, its, targets, now, plastic, settings.iterations, settings.accuracy)
        bounced = Iterate(plastic.impulses.copy(), plastic.rolling.copy(), plastic.u.copy())
        targets = -gaps.restitution[bouncing] * approach[bouncing]
        sweep(own, its, targets, now, bounced, settings.restitution_iterations, settings.accuracy)
        share = _share_without_energy_gain(rows, now, nothing, plastic.u, bounced.u)
        u[:] = plastic.u + share * (bounced.u - plastic.u)
        iterate.impulses[bouncing] += plastic.impulses + share * (bounced.impulses - plastic.impulses)
        iterate.rolling[pairs] += plastic.rolling + share * (bounced.rolling - plastic.rolling)


@cached_njit
def _those(rows, surfaces, chosen):
    """Rows and Surfaces of the `chosen` (k,) contacts alone, ascending, without limits; and their pairs (q,)."""
    pairs, begin, used = np.empty(len(chosen), np.int64), np.zeros(len(chosen) + 1, np.int64), 0
    pair = 0
    for k in range(len(chosen)):
        while rows.begin[pair + 1] <= chosen[k]:
            pair += 1
        if used == 0 or pairs[used - 1] != pair:
            pairs[used] = pair
            used += 1
        begin[used] = k + 1
    pairs = pairs[:used]
    own = Rows(
        begin[: used + 1], rows.body_a[pairs], rows.body_b[pairs], rows.masses, rows.inertias, rows.inverse_masses,
        rows.inverse_inertias, rows.contacts[chosen], rows.rolling_masses[pairs],
    )  # fmt: skip
    its = Surfaces(surfaces.friction[pairs], surfaces.rolling_arm[pairs], np.full(len(chosen), np.inf))
    return own, its, pairs


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
