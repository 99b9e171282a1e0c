"""Impacts that break.

To a contact solver bodies are infinitely strong: a ball would bounce off a plate that breaks in that instant. A real
plate transmits no more than its strength, so where the normal impulses on a fragment sum up to more than that, all its
contacts are capped in proportion and the step is solved again: the ball loses the capped impulse, keeps the rest of its
momentum and meets the pieces in the next step.
"""

from __future__ import annotations

import numpy as np

from fracture_collision.records import ContactConstraintArray
from fracture_collision.simulation.solver.contact_solver import (
    Again,
    BodyPairs,
    RigidBodies,
    Solution,
    SolverSettings,
    WarmStart,
    solve_contacts,
    sums_of_bodies,
)


def solve_with_strengths(
    bodies: RigidBodies, contacts: ContactConstraintArray, pairs: BodyPairs, warm_start: WarmStart,
    settings: SolverSettings, strengths: np.ndarray,
) -> tuple[Solution, np.ndarray, np.ndarray]:  # fmt: skip
    """Solution, the rows of the bodies that break, and limits (N,) [N s] of the impulses of contacts, inf: none.

    strengths (n,) [N s] of the bodies.
    """
    solution = solve_contacts(bodies, contacts, pairs, warm_start, settings)
    count, limits = len(bodies.masses), np.full(len(contacts.gaps), np.inf)
    loads = sums_of_bodies(solution.normal_impulses, contacts, pairs, count)
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
    row: int, contacts: ContactConstraintArray, pairs: BodyPairs, solution: Solution
) -> tuple[np.ndarray, float]:
    """Impact point (world, [m]) and impulse [N s] of the neighbour that hit a body hardest."""
    begin = contacts.pair_begin.astype(np.int64)
    impulses = solution.normal_impulses
    best, best_load = -1, -1.0
    for pair in np.flatnonzero((pairs.body_a == row) | (pairs.body_b == row)).tolist():
        load = float(impulses[begin[pair] : begin[pair + 1]].sum())
        if load > best_load:
            best, best_load = pair, load
    those = slice(begin[best], begin[best + 1])
    points = (contacts.points_a if pairs.body_a[best] == row else contacts.points_b).reshape(-1, 3)
    return (impulses[those, None] * points[those]).sum(axis=0) / best_load, best_load
