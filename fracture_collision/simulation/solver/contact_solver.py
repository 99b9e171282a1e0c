"""Velocity-level contact solver with Coulomb friction, and drift correction on poses.

Sources
  [A] Anitescu, Potra, "Formulating dynamic multi-rigid-body contact problems with friction as solvable linear
      complementarity problems", 1997: the time-stepping problem solved here.
  [C] Catto, "Iterative dynamics with temporal coherence", 2005: projected Gauss-Seidel on impulses, warm starting.
  [G] Guendelman, Bridson, Fedkiw, "Nonconvex rigid bodies with stacking", 2003: positions are corrected by separate
      velocities, which never become kinetic energy ("split impulse" in Bullet).
  [D] Dostal, Schoeberl, "Minimizing quadratic functions subject to bound constraints with the rate of convergence and
      finite termination", 2005: conjugate gradients between the sweeps of [C] (`contact_face`), which pay off with
      heavy bodies on light ones.
  Glondu 2014, section 5.2 calls for this combination: a velocity-level solver plus drift correction.

Bodies connected by no chain of contacts are solved separately (`contact_islands`, `contact_step`).

Symbols, for contact c between bodies a and b
  n, t1, t2   unit normal from a to b, and two tangents
  r_a, r_b    arms from the centres of mass to the contact point (one point for both, midway between the witnesses:
              equal and opposite impulses at one point keep angular momentum exactly)
  u           velocities (v, w), 6 a body; u* = u(t) with gravity and gyroscopic terms of this step
  J_d         row of direction d: J_d u = d . (v_b + w_b x r_b - v_a - w_a x r_a)
  M           masses and inertias; W = M^-1
  lambda      impulse along n [N s], >= 0;  beta the two friction impulses
  g           gap beyond the rest gap [m] (`rest_gaps_of`); h the time step [s]; mu Coulomb's coefficient; e restitution

  (1) u = u* + W sum_c (J_n^T lambda + J_t^T beta)                               [A, 2.11]
  (2) 0 <= lambda  _|_  J_n u + max(g, 0) / h >= 0      an open gap may close within the step, no further
  (3) |beta| <= mu lambda, opposing J_t u               the round cone: beta is projected as a vector
  (4) where J_n u(t) < -v_e and it closes up:  J_n u >= -e J_n u(t)               Newton's restitution, before (1)-(3):
      u(t) becomes what it is after all impacts, and u* changes with it; see contact_step
  (5) |tau| <= rho sum(lambda) of the pair, opposing w_b - w_a                    rolling and spinning resistance
  (6) drift:  J_n (u + u_d) >= max(min(f d / h, v_max), min(d / h, -J_n u(t))) with d = -g - slop, where d > 0;
      elsewhere >= d / h
  R           of a pair, half the longest side of the box about the smaller of its two bodies; fragments keep the R of
              the body that they came from; planes are infinite [m]

To this solver bodies are infinitely strong: a ball would bounce off a plate that breaks in that instant. A real plate
transmits no more than its strength, so where the normal impulses on a fragment sum up to more than that, all its
contacts are capped in proportion and the step is solved again (`solve_with_strengths`): the ball loses the capped
impulse, keeps the rest of its momentum and meets the pieces in the next step.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fracture_collision.kernel_sources import cached_njit
from fracture_collision.portable_math import dots, lengths
from fracture_collision.records import ContactConstraintArray, documented
from fracture_collision.simulation.compiled import uncounted
from fracture_collision.simulation.rotations import crossed
from fracture_collision.simulation.solver.contact_islands import Bodies, Contacts, Result, islands_of, solve_islands
from fracture_collision.simulation.solver.warm_start import WarmStart, carried_impulses


@documented
class SolverSettings(NamedTuple):
    """Parameters of the method; plates.yaml gives the reason for each value.

    Lengths are shares of R, as the service's tolerances are: bodies of any size rest where it looks for contacts, and
    a scaled scene takes the same course. The service lists contacts up to a gap of detection_tolerance, 0.002 R. Bodies
    rest in the middle of that, so that neither a step too far nor rounding loses their contacts.

    Fields:
      iterations: of (2), (3) and (5) at most; each visits every contact twice
      accuracy: iterations end when no velocity changes by more than this share of what contacts change
      rounds: of these iterations at most; another follows where the step would still gain energy
      restitution_iterations: further ones with (4) at most
      drift_iterations: of (6) at most
      restitution_height: [share of R] impacts slower than after a fall from this height, v_e, do not bounce
      rest_gap: [share of R] distance at which bodies rest, see rest_gaps; less than the service's detection_tolerance
      rest_slop: [share of R] by which a gap may fall short of the rest gap without correction
      drift_fraction: f, the share of a penetration taken out in one step
      drift_speed: [R/s] v_max, limit of that correction
      memory_reach: [share of R] remembered contacts are kept up to this gap, the service's
        detection_tolerance, see contact_memory
      ahead_gap: [share of R] contacts with larger gaps lie ahead: they hold bodies back and transmit no impulse, see
        touch_ahead
      sleep_speed: [R/s] bodies fall asleep that moved, for sleep_time, no farther than this speed would take them, see
        sleep
      sleep_time: [s] likewise; 0: no sleeping
    """

    iterations: int = 40
    accuracy: float = 1.0e-12
    rounds: int = 5
    restitution_iterations: int = 8
    drift_iterations: int = 8
    restitution_height: float = 0.02
    rest_gap: float = 0.001
    rest_slop: float = 0.0008
    drift_fraction: float = 0.2
    drift_speed: float = 3.0
    memory_reach: float = 0.002
    ahead_gap: float = 0.005
    sleep_speed: float = 0.01
    sleep_time: float = 0.25


class RigidBodies(NamedTuple):
    """World frame. A contact names a body by its row; row n, one past the last, is everything that cannot move."""

    masses: np.ndarray  # (n,) [kg]
    inertias: np.ndarray  # (n, 3, 3) [kg m2], about the centre of mass
    centers: np.ndarray  # (n, 3) [m]
    velocities: np.ndarray  # (n, 6) u(t): v [m/s] of the centre of mass, w [rad/s]
    free_velocities: np.ndarray  # (n, 6) u*
    spans: np.ndarray  # (n,) h [s], the time in which each moves
    asleep: np.ndarray  # (n,) bool: none or all of an island; they stay in place


class BodyPairs(NamedTuple):
    """For each pair of a ContactConstraintArray: rows of the bodies, and rolling resistance."""

    body_a: np.ndarray  # (p,) int64
    body_b: np.ndarray  # (p,) int64
    rolling_arm: np.ndarray  # (p,) rho [m]
    sizes: np.ndarray  # (p,) R [m]
    bounce_speeds: np.ndarray  # (p,) v_e [m/s]
    rest_gaps: np.ndarray  # (N,) [m] of each contact: the zero of g


class Solution(NamedTuple):
    """Velocities and impulses of one step."""

    velocities: np.ndarray  # (n, 6) u(t + h)
    drift: np.ndarray  # (n, 6) u_d, for the poses of this step only
    normal_impulses: np.ndarray  # (N,) lambda [N s]
    pressing: np.ndarray  # (N,) of these, without those of impacts (4): bodies that only bounce off are in free flight
    warm_start: WarmStart


class Again(NamedTuple):
    """What is solved a second time."""

    bodies: np.ndarray  # (n,) bool: islands with such a body are solved, the others keep `before`
    impulse_limits: np.ndarray  # (N,) [N s] of lambda, that materials transmit before they break; inf: none
    before: Solution  # of the same contacts; its drift stays


def solve_contacts(
    bodies: RigidBodies,
    contacts: ContactConstraintArray,
    pairs: BodyPairs,
    warm_start: WarmStart,
    settings: SolverSettings,
    again: Again | None = None,
) -> Solution:
    """Velocities after one step that respect the contacts.

    Contacts are visited in input order, so equal input gives equal bytes. Contacts with a limit in `again` do not
    bounce. The warm start keeps the impulses of contacts between bodies that are asleep.
    """
    count, body_count = len(contacts.gaps), len(bodies.masses)
    begin = contacts.pair_begin.astype(np.int64)
    impulses, rolling = carried_impulses(
        contacts.fragment_a, contacts.fragment_b, begin, contacts.contact_ids, warm_start
    )
    listed = Contacts(
        begin, pairs.body_a, pairs.body_b, contacts.friction, contacts.restitution, pairs.rolling_arm,
        pairs.sizes, pairs.bounce_speeds,
        0.5 * (contacts.points_a + contacts.points_b), contacts.normals, contacts.gaps,
        pairs.rest_gaps, np.full(count, np.inf) if again is None else again.impulse_limits,
    )  # fmt: skip
    if again is None:
        drift, nothing = np.zeros((body_count, 6)), np.zeros(count)
        result = Result(bodies.free_velocities.copy(), drift, nothing, nothing.copy(), impulses, rolling)
    else:
        before = again.before
        result = Result(
            before.velocities.copy(), before.drift.copy(), before.normal_impulses.copy(), before.pressing.copy(),
            impulses, rolling,
        )  # fmt: skip
    islands = islands_of(begin, pairs.body_a, pairs.body_b, body_count)
    chosen = np.zeros(0, bool) if again is None else again.bodies
    solve_islands(islands, Bodies(*bodies), listed, settings, chosen, result)
    carried = WarmStart(contacts.fragment_a, contacts.fragment_b, begin, contacts.contact_ids, impulses, rolling)
    return Solution(result.velocities, result.drift, result.normal_impulses, result.pressing, carried)


def bounce_speeds(settings: SolverSettings, sizes: np.ndarray, gravity: np.ndarray) -> np.ndarray:
    """v_e (p,) [m/s] of pairs of R `sizes` (p,) [m]: at the end of a fall from `restitution_height`.

    gravity (3,) [m/s2]. Without it nothing rests on anything, and all impacts bounce.
    """
    return np.sqrt(2.0 * float(lengths(gravity)) * settings.restitution_height * sizes)


@cached_njit
def sums_of_bodies(impulses, begin, body_a, body_b, count):
    """Sum of `impulses` (N,) over the contacts of each of `count` bodies. One squeezed between two counts both sides.

    begin (p + 1,): contacts by pairs; body_a, body_b (p,): their bodies.
    """
    sums = np.zeros(count + 1)
    for body in (body_a, body_b):
        for pair in range(len(body)):
            for c in range(begin[pair], begin[pair + 1]):
                sums[body[pair]] += impulses[c]
    return sums[:-1]


def kinetic_energy(masses: np.ndarray, inertias: np.ndarray, velocities: np.ndarray) -> float:
    """Kinetic energy [J] of n bodies with velocities (n, 6), all together."""
    moving, turning = _doubled_energies(masses, inertias, velocities)
    return float(0.5 * (moving.sum() + turning.sum()))


def relative_velocities(
    body_a: np.ndarray, body_b: np.ndarray, points: np.ndarray, centers: np.ndarray, velocities: np.ndarray
) -> np.ndarray:
    """Velocities (N, 3) [m/s] of b against a at `points` (N, 3) [m], by rows (N,) of n bodies; n cannot move."""
    still = np.zeros((1, 6))
    u, x = np.vstack((velocities, still)), np.vstack((centers, still[:, :3]))
    a, b = (u[rows, :3] + crossed(u[rows, 3:], points - x[rows]) for rows in (body_a, body_b))
    return b - a


def work_of_impulses(
    rows: np.ndarray, impulses: np.ndarray, arms: np.ndarray, before: np.ndarray, after: np.ndarray
) -> float:
    """Kinetic energy [J] by impulses (k, 3) [N s] on the bodies `rows` (k,), at `arms` (k, 3) [m] from their centres.

    before, after: (n, 6) velocities of all bodies. An impulse J adds J (v + v') / 2, with the velocities of the point
    where it acts, whatever else acts at the same time.
    """
    means = 0.5 * (before + after)[rows]
    return float(dots(impulses, means[:, :3] + crossed(means[:, 3:], arms)).sum())


@cached_njit
def _doubled_energies(masses, inertias, velocities):
    """Twice the kinetic energies [J] of n bodies by their motion, and by their spin: (n,) each."""
    moving, turning = np.empty(len(masses)), np.empty(len(masses))
    for i in range(len(masses)):
        moving[i], turning[i] = _doubled_energy(masses[i], inertias[i], velocities[i])
    return moving, turning


@uncounted
def _doubled_energy(mass, inertia, u):
    x = inertia[0, 0] * u[3] + inertia[0, 1] * u[4] + inertia[0, 2] * u[5]
    y = inertia[1, 0] * u[3] + inertia[1, 1] * u[4] + inertia[1, 2] * u[5]
    z = inertia[2, 0] * u[3] + inertia[2, 1] * u[4] + inertia[2, 2] * u[5]
    return mass * (u[0] * u[0] + u[1] * u[1] + u[2] * u[2]), u[3] * x + u[4] * y + u[5] * z


@cached_njit
def flight_drift(bodies, turned, gravity, result, is_other, pressed_by):
    """Drift (n, 6) by which the poses of RigidBodies in free flight follow the parabola, and keep angular momentum.

    turned (n, 3): the spins that keep it; result: velocities (n, 6) after the step, and the contacts' impulses (N,);
    is_other (n,) bool: are not in free flight; pressed_by: impulses (N,) without those of impacts, and contacts by
    pairs, see sums_of_bodies. Bodies that only bounce off fall, as far as they lost enough energy, and keep their turn.
    """
    (velocities, impulses), (pressing, begin, body_a, body_b) = result, pressed_by
    drift, count = np.zeros((len(bodies.masses), 6)), len(bodies.masses)
    hit, pressed = (
        sums_of_bodies(impulses, begin, body_a, body_b, count) > 0.0,
        sums_of_bodies(pressing, begin, body_a, body_b, count) > 0.0,
    )
    square = gravity[0] * gravity[0] + gravity[1] * gravity[1] + gravity[2] * gravity[2]
    for i in range(count):
        if is_other[i] or pressed[i]:
            continue
        mass, span, u, share = bodies.masses[i], bodies.spans[i], velocities[i], 1.0
        if hit[i]:
            had, had_turning = _doubled_energy(mass, bodies.inertias[i], bodies.velocities[i])
            have, have_turning = _doubled_energy(mass, bodies.inertias[i], u)
            work = 0.5 * mass * span * span * square  # [J] by which it rises
            falls = u[0] * gravity[0] + u[1] * gravity[1] + u[2] * gravity[2]
            lost = 0.5 * (had + had_turning) - 0.5 * (have + have_turning) + mass * span * falls
            if work > 0.0:
                share = min(max(lost / work, 0.0), 1.0)
        for k in range(3):
            drift[i, k] = -0.5 * span * gravity[k] * share
            drift[i, 3 + k] = 0.0 if hit[i] else turned[i, k]
    return drift


def solve_with_strengths(
    bodies: RigidBodies, contacts: ContactConstraintArray, pairs: BodyPairs, warm_start: WarmStart,
    settings: SolverSettings, strengths: np.ndarray,
) -> tuple[Solution, np.ndarray, np.ndarray]:  # fmt: skip
    """Solution, the rows of the bodies that break, and limits (N,) [N s] of the impulses of contacts, inf: none.

    strengths (n,) [N s] of the bodies.
    """
    solution = solve_contacts(bodies, contacts, pairs, warm_start, settings)
    count, limits = len(bodies.masses), np.full(len(contacts.gaps), np.inf)
    loads = sums_of_bodies(solution.normal_impulses, contacts.pair_begin, pairs.body_a, pairs.body_b, count)
    overloaded = np.flatnonzero(loads > strengths)
    if len(overloaded):
        share = np.ones(count + 1)
        share[overloaded] = strengths[overloaded] / loads[overloaded]
        counts: np.ndarray = np.diff(contacts.pair_begin)
        share = np.repeat(np.minimum(share[pairs.body_a], share[pairs.body_b]), counts)
        limits = np.where(share < 1.0, share * solution.normal_impulses, np.inf)
        breaks = loads > strengths
        capped = solve_contacts(
            bodies, contacts, pairs, solution.warm_start, settings, Again(breaks, limits, solution)
        )
        # No body enters a fragment before it has broken: in this step poses move as if it held. And the impact
        # point follows from the uncapped impulses that broke it.
        solution = capped._replace(
            drift=solution.drift + solution.velocities - capped.velocities, normal_impulses=solution.normal_impulses
        )
    return solution, overloaded, limits


def hardest_hit(
    row: int, contacts: ContactConstraintArray, pairs: BodyPairs, impulses: np.ndarray
) -> tuple[np.ndarray, float]:
    """Impact point (world, [m]) and impulse [N s] of the neighbour that hit a body hardest; impulses (N,) [N s]."""
    begin = contacts.pair_begin.astype(np.int64)
    best, best_load = -1, -1.0
    for pair in np.flatnonzero((pairs.body_a == row) | (pairs.body_b == row)).tolist():
        load = float(impulses[begin[pair] : begin[pair + 1]].sum())
        if load > best_load:
            best, best_load = pair, load
    those = slice(begin[best], begin[best + 1])
    points = contacts.points_a if pairs.body_a[best] == row else contacts.points_b
    return (impulses[those, None] * points[those]).sum(axis=0) / best_load, best_load
