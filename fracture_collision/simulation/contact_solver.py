"""Velocity-level contact solver with Coulomb friction, and drift correction on poses.

Sources
  [A] Anitescu, Potra, "Formulating dynamic multi-rigid-body contact problems with friction as solvable linear
      complementarity problems", 1997: the time-stepping problem solved here.
  [C] Catto, "Iterative dynamics with temporal coherence", 2005: projected Gauss-Seidel on impulses, warm starting.
  [G] Guendelman, Bridson, Fedkiw, "Nonconvex rigid bodies with stacking", 2003: positions are corrected by velocities
      of their own, which never become kinetic energy ("split impulse" in Bullet).
  [D] Dostal, Schoeberl, "Minimizing quadratic functions subject to bound constraints with the rate of convergence and
      finite termination", 2005: conjugate gradients between the sweeps of [C] (`contact_face`); heavy bodies on light
      ones are where it counts.
  Glondu 2014, section 5.2 asks for just this pair: a velocity-level solver plus drift correction.

Symbols, for contact c between bodies a and b
  n, t1, t2   unit normal from a to b, and two tangents
  r_a, r_b    arms from the centres of mass to the contact point (one point for both, midway between the witnesses:
              equal and opposite impulses at one point keep angular momentum exactly)
  u           velocities (v, w), 6 a body; u* = u(t) with gravity and gyroscopic terms of this step
  J_d         row of direction d: J_d u = d . (v_b + w_b x r_b - v_a - w_a x r_a)
  M           masses and inertias; W = M^-1
  lambda      impulse along n [N s], >= 0;  beta the two friction impulses
  g           gap [m], negative inside; h the time step [s]; mu Coulomb's coefficient; e restitution

  (1) u = u* + W sum_c (J_n^T lambda + J_t^T beta)                               [A, 2.11]
  (2) 0 <= lambda  _|_  J_n u + max(g, 0) / h >= 0      an open gap may close within the step, no further
  (3) |beta| <= mu lambda, opposing J_t u               the round cone: beta is projected as a vector
  (4) where J_n u(t) < -v_e and lambda > 0:  J_n u >= -e J_n u(t)                 Newton's restitution, after (1)-(3)
  (5) |tau| <= rho sum(lambda) of the pair, opposing w_b - w_a                    rolling and spinning resistance
  (6) drift:  J_n (u + u_d) >= max(min(f d / h, v_max), min(d / h, -J_n u(t))) with d = -g - slop, where d > 0;
      elsewhere >= d / h
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fracture_collision.records import ContactConstraintArray
from fracture_collision.simulation import contact_rows as kernels
from fracture_collision.simulation import contact_sweeps

# Of the energy that gravity gives a body at rest in one step: what a stack at rest gains and loses by rounding.
ROUNDING = 1.0e-7
# A penetration of this many slops is more than a contact at rest ever has.
DEEP = 5.0


class SolverSettings(NamedTuple):
    """Numbers of the method; the scene file says why each has its value."""

    iterations: int = 20  # of (2), (3), (5): each visits every contact twice
    rounds: int = 5  # of these iterations, at most: there is another where the step would still gain energy
    restitution_iterations: int = 8  # further ones with (4)
    drift_iterations: int = 8  # of (6), likewise
    restitution_speed: float = 0.2  # v_e [m/s]
    penetration_slop: float = 1.0e-4  # [m]
    drift_fraction: float = 0.2  # f, the share of the penetration taken out in one step
    drift_speed: float = 0.3  # v_max [m/s]
    memory_reach: float = 2.5e-4  # [m] see contact_memory


class RigidBodies(NamedTuple):
    """World frame. A contact names a body by its row; row n, one past the last, is everything that cannot move."""

    masses: np.ndarray  # (n,) [kg]
    inertias: np.ndarray  # (n, 3, 3) [kg m2], about the centre of mass
    centers: np.ndarray  # (n, 3) [m]
    velocities: np.ndarray  # (n, 6) u(t): v [m/s] of the centre of mass, w [rad/s]
    free_velocities: np.ndarray  # (n, 6) u*


class BodyPairs(NamedTuple):
    """Beside a ContactConstraintArray, for each of its pairs: rows of the bodies, and rolling resistance."""

    body_a: np.ndarray  # (p,) int64
    body_b: np.ndarray  # (p,) int64
    rolling_arm: np.ndarray  # (p,) rho [m]


class WarmStart(NamedTuple):
    """Impulses of one step, for the next: found again by (fragment_a, fragment_b, contact id)."""

    fragment_a: np.ndarray  # (p,) uint32, ascending by (a, b)
    fragment_b: np.ndarray
    pair_begin: np.ndarray  # (p + 1,)
    contact_ids: np.ndarray  # (N,) uint64
    impulses: np.ndarray  # (N, 3) on b, world axes [N s]
    rolling: np.ndarray  # (p, 3) angular, on b, world axes [N m s]


class Solution(NamedTuple):
    velocities: np.ndarray  # (n, 6) u(t + h)
    drift: np.ndarray  # (n, 6) u_d, for the poses of this step only
    normal_impulses: np.ndarray  # (N,) lambda [N s]
    warm_start: WarmStart


NO_WARM_START = WarmStart(
    np.zeros(0, np.uint32), np.zeros(0, np.uint32), np.zeros(1, np.int64),
    np.zeros(0, np.uint64), np.zeros((0, 3)), np.zeros((0, 3)),
)  # fmt: skip


def solve_contacts(
    bodies: RigidBodies,
    contacts: ContactConstraintArray,
    pairs: BodyPairs,
    warm_start: WarmStart,
    settings: SolverSettings,
    time_step: float,
    impulse_limits: np.ndarray | None = None,
) -> Solution:
    """Velocities after one step of `time_step` [s] that respect the contacts.

    Contacts are visited in the order they come in, so equal input gives equal bytes. `impulse_limits` (N,) [N s] caps
    lambda of each contact: what a material can transmit before it breaks; such contacts do not bounce.
    """
    gaps, begin = contacts.gaps, contacts.pair_begin.astype(np.int64)
    count = len(gaps)
    velocities, free = _with_immovable(bodies.velocities), _with_immovable(bodies.free_velocities)
    inertias, inverse_inertias = np.zeros((2, len(bodies.masses) + 1, 3, 3))
    inertias[:-1], inverse_inertias[:-1] = bodies.inertias, np.linalg.inv(bodies.inertias)
    points = 0.5 * (contacts.points_a + contacts.points_b).reshape(-1, 3)
    rows = kernels.contact_rows(
        points, contacts.normals.reshape(-1, 3), begin, pairs.body_a, pairs.body_b,
        _with_immovable(bodies.centers), np.append(bodies.masses, 0.0), inertias,
        np.append(1.0 / bodies.masses, 0.0), inverse_inertias,
    )  # fmt: skip
    unlimited = np.full(count, np.inf)
    limits = unlimited if impulse_limits is None else impulse_limits
    surfaces = kernels.Surfaces(contacts.friction, pairs.rolling_arm, limits)

    impulses, rolling = kernels.carried_impulses(
        contacts.fragment_a, contacts.fragment_b, begin, contacts.contact_ids,
        warm_start.fragment_a, warm_start.fragment_b, warm_start.pair_begin, warm_start.contact_ids,
        warm_start.impulses, warm_start.rolling, rows.directions,
    )  # fmt: skip
    np.minimum(impulses[:, 0], limits, out=impulses[:, 0])
    targets = -np.maximum(gaps, 0.0) / time_step
    u = free.copy()
    contact_sweeps.apply_warm_start(rows, targets, u, impulses, rolling)
    for _ in range(settings.rounds):
        contact_sweeps.sweep(rows, surfaces, targets, u, impulses, rolling, settings.iterations)
        if _energy_gain(bodies, u) <= ROUNDING * _inner(bodies, _gravity(bodies), _gravity(bodies)):
            break

    approach = kernels.normal_velocities(rows, velocities)
    restitution = np.repeat(contacts.restitution, np.diff(begin))
    bounces = (approach < -settings.restitution_speed) & (impulses[:, 0] > 0.0) & (restitution > 0.0)
    bounces &= limits == np.inf
    if np.any(bounces):
        targets = np.where(bounces, -restitution * approach, targets)
        plastic, plastic_impulses, plastic_rolling = u.copy(), impulses.copy(), rolling.copy()
        contact_sweeps.sweep(rows, surfaces, targets, u, impulses, rolling, settings.restitution_iterations)
        share = _share_without_energy_gain(bodies, plastic, u)
        u = plastic + share * (u - plastic)
        impulses = plastic_impulses + share * (impulses - plastic_impulses)
        rolling = plastic_rolling + share * (rolling - plastic_rolling)

    against = _against_parting(contacts, pairs, bodies.centers, DEEP * settings.penetration_slop)
    drift = _drift(rows, gaps, approach, kernels.normal_velocities(rows, u), against, settings, time_step)
    world_impulses = np.einsum("cd,cdk->ck", impulses, rows.directions)
    carried = WarmStart(
        contacts.fragment_a, contacts.fragment_b, begin, contacts.contact_ids, world_impulses, rolling
    )
    return Solution(u[:-1], drift, impulses[:, 0], carried)


def normal_impulse_sums(
    solution: Solution, contacts: ContactConstraintArray, pairs: BodyPairs, body_count: int
) -> np.ndarray:
    """Sum of lambda over the contacts of each body: (n,) [N s]. A body squeezed between two counts both sides."""
    repeat = np.diff(contacts.pair_begin.astype(np.int64))
    sums = np.zeros(body_count + 1)
    for body in (pairs.body_a, pairs.body_b):
        np.add.at(sums, np.repeat(body, repeat), solution.normal_impulses)
    return sums[:-1]


def kinetic_energy(masses: np.ndarray, inertias: np.ndarray, velocities: np.ndarray) -> float:
    """Of n bodies with velocities (n, 6) [J]."""
    v, w = velocities[:, :3], velocities[:, 3:]
    return float(0.5 * (masses @ np.einsum("ni,ni->n", v, v) + np.einsum("ni,nij,nj->", w, inertias, w)))


def _with_immovable(values: np.ndarray) -> np.ndarray:
    return np.concatenate((values, np.zeros((1, values.shape[1]))))


def _drift(
    rows: kernels.Rows,
    gaps: np.ndarray,
    before: np.ndarray,
    after: np.ndarray,
    against: np.ndarray,
    settings: SolverSettings,
    time_step: float,
) -> np.ndarray:
    depth = -gaps - settings.penetration_slop
    u = np.zeros((len(rows.inverse_masses), 6))
    if np.any(depth > 0.0):
        push = np.minimum(settings.drift_fraction * depth / time_step, settings.drift_speed)
        # What came in with the last step leaves with the next: when a plate breaks, the ball is at its surface.
        push = np.maximum(push, np.minimum(depth / time_step, -before))
        # What the velocities do to a gap counts; one that is not too deep may still close, up to the slop.
        targets = np.where(depth > 0.0, push, depth / time_step) - after
        pair_count = len(rows.body_a)
        smooth = kernels.Surfaces(np.zeros(pair_count), np.zeros(pair_count), np.where(against, 0.0, np.inf))
        impulses, rolling = np.zeros((len(gaps), 3)), np.zeros((pair_count, 3))
        contact_sweeps.sweep(rows, smooth, targets, u, impulses, rolling, settings.drift_iterations)
    return u[:-1]


def _against_parting(
    contacts: ContactConstraintArray, pairs: BodyPairs, centers: np.ndarray, deep: float
) -> np.ndarray:
    """Contacts that drift correction leaves out, (N,) bool.

    Two shards that have got into each other have contacts on either side of the overlap, whose normals contradict
    each other: obeyed together they lock the two for ever. Such a pair is parted the way its centres of mass lie, or,
    where one cannot move and may be of any shape, the way most of the depth points.
    """
    pair = np.repeat(np.arange(len(pairs.body_a)), np.diff(contacts.pair_begin.astype(np.int64)))
    normals = contacts.normals.reshape(-1, 3)
    way = np.zeros((len(pairs.body_a), 3))
    np.add.at(way, pair, np.maximum(-contacts.gaps, 0.0)[:, None] * normals)
    movable = (pairs.body_a < len(centers)) & (pairs.body_b < len(centers))
    way[movable] = centers[pairs.body_b[movable]] - centers[pairs.body_a[movable]]
    parts = np.einsum("ck,ck->c", normals, way[pair]) > 0.0
    is_deep = contacts.gaps < -deep
    deep_and_parting = np.bincount(pair[parts & is_deep], minlength=len(way)) > 0
    deep_and_not = np.bincount(pair[~parts & (contacts.gaps < 0.0)], minlength=len(way)) > 0
    return ~parts & (deep_and_parting & deep_and_not)[pair]


def _energy_gain(bodies: RigidBodies, u: np.ndarray) -> float:
    """What the step adds to the bodies' mechanical energy [J], if they move with u (n + 1, 6).

    Kinetic energy, less the work of the impulse of gravity, M (u* - u(t)). Solved exactly, (1)-(3) gain nothing:
    -|u - u(t)|^2_M / 2 at most. So where there is gain, they are not solved far enough.
    """
    return 0.5 * (_inner(bodies, u, u) - _inner(bodies, _before(bodies), _before(bodies))) - _inner(
        bodies, _gravity(bodies), u
    )


def _share_without_energy_gain(bodies: RigidBodies, plastic: np.ndarray, bounced: np.ndarray) -> float:
    """The largest s in [0, 1] for which plastic + s (bounced - plastic) gains no energy, or no more than plastic does.

    Newton's restitution (4) together with friction can create energy in a body with several contacts (Stronge 1990).
    (2) and (3) are convex, so any mixture of the two solutions obeys them as well.
    """
    excess = _energy_gain(bodies, bounced) - max(_energy_gain(bodies, plastic), 0.0)
    if excess <= 0.0:
        return 1.0
    change = bounced - plastic
    a = _inner(bodies, change, change)
    b = _inner(bodies, plastic, change) - _inner(bodies, _gravity(bodies), change)
    c = 2.0 * min(_energy_gain(bodies, plastic), 0.0)
    return float((-b + np.sqrt(max(b * b - a * c, 0.0))) / a)


def _before(bodies: RigidBodies) -> np.ndarray:
    return _with_immovable(bodies.velocities)


def _gravity(bodies: RigidBodies) -> np.ndarray:
    """M^-1 times the impulse of gravity; the gyroscopic torque does no work."""
    change = _with_immovable(bodies.free_velocities - bodies.velocities)
    change[:, 3:] = 0.0
    return change


def _inner(bodies: RigidBodies, x: np.ndarray, y: np.ndarray) -> float:
    """x M y."""
    v = bodies.masses @ np.einsum("ni,ni->n", x[:-1, :3], y[:-1, :3])
    return float(v + np.einsum("ni,nij,nj->", x[:-1, 3:], bodies.inertias, y[:-1, 3:]))
