"""Contacts between the package's own bodies and a robot, whose motion another engine computes (`actors/robot`).

The robot's engine takes impulses and answers with velocities; its solver never sees the contacts. To the contact solver
a touched link is a mass at one point, that its own engine behaves like in this step: motors, gears, joint limits
and torque limits included. With p the centroid of the link's contacts, and n the mean of their normals, trial steps of
the robot measure

    G       mobility: the change of n . v_p per impulse along n at p (NUDGE) [1/kg]
    v*      v_p after the step with the impulses J known so far, less G J: what it is without contacts

and the link is a row with the mass 1 / G at p, the free velocity v*, and the spin that the link has with J. The solved
impulses replace J. This is repeated until the impulse on no link changes by more than SAME of it: at once where the
robot is linear and J is that of the last step (`warm_start`), and in a blow after some passes, as motors saturate.

What a robot does is not only its links' own: where two are touched at once, one learns of the other's contacts by the
passes alone; so it is with torques about p, by which a pass turns the row as if it were large (GYRATION).

A robot waits for no touch within a step, as bodies do (`touch_ahead`), and it would enter bodies that wait. So whatever
contacts connect with it does not wait either (`beside_robot`). There, contacts that lie ahead are solved with the
others: a slow one may close within the step, no further; a blow comes at once, as a whole.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from fracture_collision.portable_math import dots, lengths
from fracture_collision.records import ContactConstraintArray
from fracture_collision.simulation.actors.robot import Push, Robot
from fracture_collision.simulation.engine import BodyStates, FrameState, rows_of
from fracture_collision.simulation.rotations import crossed
from fracture_collision.simulation.solver.contact_islands import islands_of
from fracture_collision.simulation.solver.contact_solver import (
    BodyPairs,
    RigidBodies,
    Solution,
    relative_velocities,
    work_of_impulses,
)
from fracture_collision.simulation.solver.warm_start import WarmStart, carried_impulses

NUDGE = 0.01  # [N s]
# Share of an impulse by which it may differ from that of the pass before, and passes at most.
SAME, PASSES = 1.0e-3, 4
# [N s] Impulses on a link that are as small as this are not repeated for.
NEGLIGIBLE = 1.0e-6
LEAST_MOBILITY = 1.0e-5  # [1/kg] of a link that is as good as fixed; MuJoCo does not converge with far less
# [m] Radius of gyration of a row: it hardly turns, and MuJoCo still converges (with 10 m it does not).
GYRATION = 1.0
# Below this share of the sum of their lengths, the sum of normals is no direction.
OPPOSED = 0.1


# As solve_with_strengths, of one engine.
Solve = Callable[
    [RigidBodies, ContactConstraintArray, BodyPairs, WarmStart], tuple[Solution, np.ndarray, np.ndarray]
]


class Touched(NamedTuple):
    """The contacts of one link."""

    link: int
    row: int  # of the body that stands for the link
    contacts: np.ndarray  # (k,) int64 rows of the contacts
    signs: np.ndarray  # (k,) 1 where the link is b, else -1
    center: np.ndarray  # (3,) [m] centroid p
    normal: np.ndarray  # (3,) mean normal n, towards the link


class RobotStep(NamedTuple):
    """The contacts of a step with a robot, solved."""

    bodies: RigidBodies  # the robot's as the solver has them
    contacts: ContactConstraintArray  # with the gaps of blows closed
    pairs: BodyPairs  # all shapes of a link as one body
    beside: np.ndarray  # (n + 1,) bool: bodies that contacts connect with the robot, and its own
    touched: tuple[Touched, ...]
    points: np.ndarray  # (N, 3) [m] where contacts act
    solution: Solution
    overloaded: np.ndarray  # (k,) rows of the bodies that break
    limits: np.ndarray  # (N,) [N s] of the contacts' impulses
    passes: int

    def pushes(self, impulses: np.ndarray) -> list[Push]:
        """What `impulses` (N, 3) [N s] on b are on the links."""
        return _pushes(self.touched, self.points, impulses)

    def work(self, is_robot: np.ndarray, solution: Solution) -> float:
        """Energy [J] that the robot adds to the other bodies. is_robot: (n,) bool."""
        bodies, pairs, (*_, impulses, rolling) = self.bodies, self.pairs, solution.warm_start
        found, counts = np.append(is_robot, False), np.diff(self.contacts.pair_begin)
        signs = found[pairs.body_a].astype(float) - found[pairs.body_b]  # 1: acts on b, -1: on a
        others, touching = np.where(signs > 0.0, pairs.body_b, pairs.body_a), signs != 0.0
        before, after = bodies.velocities, solution.velocities
        spins = 0.5 * (before + after)[others[touching], 3:]
        spun = dots(signs[touching, None] * rolling[touching], spins).sum()
        each = np.flatnonzero(np.repeat(touching, counts))
        rows, pushes = np.repeat(others, counts)[each], np.repeat(signs, counts)[each, None] * impulses[each]
        return float(spun) + work_of_impulses(rows, pushes, self.points[each] - bodies.centers[rows], before, after)


def robot_rows(robot: Robot, states: BodyStates) -> np.ndarray:
    """(m,) int64 rows of the robot's bodies in `states`, n of those that are not there."""
    return rows_of(robot.fragment_ids, states.fragment_ids)


def beside_robot(
    rows: np.ndarray, begin: np.ndarray, body_a: np.ndarray, body_b: np.ndarray, count: int
) -> np.ndarray:
    """(count + 1,) bool: which of `count` bodies contacts connect with the robot's, whose rows (m,) are these.

    begin (p + 1,), body_a, body_b (p,): contacts by pairs of rows, `count` for what cannot move.
    """
    found = np.zeros(count + 1, bool)
    found[rows] = True
    islands = islands_of(begin, body_a, body_b, count)
    its = np.repeat(np.arange(len(islands.body_begin) - 1), np.diff(islands.body_begin))
    found[islands.bodies[np.isin(its, its[found[islands.bodies]])]] = True
    return found


def solve_with_robot(
    robot: Robot, bodies: RigidBodies, contacts: ContactConstraintArray, pairs: BodyPairs, warm_start: WarmStart,
    solve: Solve, rows: np.ndarray,
) -> RobotStep:  # fmt: skip
    """Contacts solved by `solve`, with the robot's part. rows (m,): of the robot's bodies, all in `bodies`.

    No contacts between two bodies of the robot, or with what cannot move.
    """
    pairs = _one_row_per_link(pairs, robot.links, rows, len(bodies.masses))
    points = 0.5 * (contacts.points_a + contacts.points_b)
    touched = _touched(robot.links, rows, contacts, pairs, points)
    begin = contacts.pair_begin.astype(np.int64)
    beside = beside_robot(rows, begin, pairs.body_a, pairs.body_b, len(bodies.masses))
    frames, now = robot.frames(), bodies
    free = robot.trial([])
    bodies = _as_links(now, rows, _at_centers(frames, now.centers[rows]), _after(frames, free, now.centers[rows]))
    contacts = contacts._replace(gaps=_with_blows_closed(contacts, pairs, points, bodies, beside))
    impulses, rolling = carried_impulses(
        contacts.fragment_a, contacts.fragment_b, begin, contacts.contact_ids, warm_start
    )
    start = WarmStart(contacts.fragment_a, contacts.fragment_b, begin, contacts.contact_ids, impulses, rolling)
    passes = 0
    while True:
        bodies = _measured(robot, bodies, frames, touched, points, impulses)
        solution, overloaded, limits = solve(bodies, contacts, pairs, start)
        before, start = impulses, solution.warm_start
        impulses, passes = start.impulses, passes + 1
        if passes == PASSES or _is_settled(touched, before, impulses):
            return RobotStep(
                bodies, contacts, pairs, beside, tuple(touched), points, solution, overloaded, limits, passes
            )


def _one_row_per_link(pairs: BodyPairs, links: np.ndarray, rows: np.ndarray, count: int) -> BodyPairs:
    stands_for: np.ndarray = np.arange(count + 1)
    first = {link: int(rows[i]) for i, link in reversed(list(enumerate(links.tolist())))}
    stands_for[rows] = [first[link] for link in links.tolist()]
    return pairs._replace(body_a=stands_for[pairs.body_a], body_b=stands_for[pairs.body_b])


def _touched(
    links: np.ndarray, rows: np.ndarray, contacts: ContactConstraintArray, pairs: BodyPairs, points: np.ndarray
) -> list[Touched]:
    counts: np.ndarray = np.diff(contacts.pair_begin)
    body_a, body_b = np.repeat(pairs.body_a, counts), np.repeat(pairs.body_b, counts)
    found = []
    for link in np.unique(links).tolist():
        row = int(rows[np.flatnonzero(links == link)[0]])
        its = np.flatnonzero((body_a == row) | (body_b == row))
        if not len(its):
            continue
        signs = np.where(body_b[its] == row, 1.0, -1.0)
        normals = signs[:, None] * contacts.normals[its]
        total = normals.sum(axis=0)
        size = float(lengths(total))
        normal = total / size if size > OPPOSED * len(its) else normals[0]
        found.append(Touched(link, row, its, signs, points[its].mean(axis=0), normal))
    return found


def _measured(
    robot: Robot, bodies: RigidBodies, frames: FrameState, touched: Sequence[Touched], points: np.ndarray,
    impulses: np.ndarray,
) -> RigidBodies:  # fmt: skip
    """`bodies` with touched links as the robot's engine has them, given the impulses (N, 3) [N s] so far."""
    if not touched:
        return bodies
    pushes = _pushes(touched, points, impulses)
    after = robot.trial(pushes)
    masses, inertias, centers, velocities, free, *_ = (column.copy() for column in bodies)
    for link, row, its, signs, center, normal in touched:
        i = int(np.flatnonzero(robot.links == link)[0])
        more = robot.trial([*pushes, Push(link, NUDGE * normal, center)])
        v, v_more = (_velocity(motion, frames, i, center) for motion in (after, more))
        mobility = max(float(dots(normal, v_more[:3] - v[:3])) / NUDGE, LEAST_MOBILITY)
        known, inertia = signs[:, None] * impulses[its], GYRATION * GYRATION / mobility
        masses[row], inertias[row], centers[row] = 1.0 / mobility, inertia * np.eye(3), center
        velocities[row] = _velocity(frames, frames, i, center)
        torque = crossed(points[its] - center, known).sum(axis=0)
        free[row] = v - np.append(mobility * known.sum(axis=0), torque / inertia)
    return bodies._replace(
        masses=masses, inertias=inertias, centers=centers, velocities=velocities, free_velocities=free
    )


def _velocity(motion: FrameState, frames: FrameState, i: int, point: np.ndarray) -> np.ndarray:
    """(6,) [m/s, rad/s] of what is at `point` (3,) [m] on the i-th body, with the velocities of `motion`.

    The arm is that in `frames`, at the beginning of the step, as in the contact solver.
    """
    arm = point - frames.position[i]
    spin = motion.angular_velocity[i]
    return np.append(motion.linear_velocity[i] + crossed(spin[None], arm[None])[0], spin)


def _pushes(touched: Sequence[Touched], points: np.ndarray, impulses: np.ndarray) -> list[Push]:
    return [
        Push(each.link, sign * impulses[c], points[c])
        for each in touched for sign, c in zip(each.signs, each.contacts.tolist(), strict=True)
        if impulses[c].any()
    ]  # fmt: skip


def _is_settled(touched: Sequence[Touched], before: np.ndarray, after: np.ndarray) -> bool:
    return all(
        float(lengths((each.signs[:, None] * (after - before)[each.contacts]).sum(axis=0)))
        <= max(SAME * float(lengths(after[each.contacts]).sum()), NEGLIGIBLE)
        for each in touched
    )


def _at_centers(frames: FrameState, centers: np.ndarray) -> np.ndarray:
    """Velocities (m, 6) of bodies with these frames and centres of mass (m, 3) [m]."""
    spins = frames.angular_velocity
    return np.hstack((frames.linear_velocity + crossed(spins, centers - frames.position), spins))


def _after(before: FrameState, after: FrameState, centers: np.ndarray) -> np.ndarray:
    """The same with the velocities of `after`, and the arms of `before`."""
    return _at_centers(after._replace(position=before.position), centers)


def _as_links(bodies: RigidBodies, rows: np.ndarray, velocities: np.ndarray, free: np.ndarray) -> RigidBodies:
    """`bodies` with these velocities (m, 6) of the robot's, without gravity."""
    u, u_free = bodies.velocities.copy(), bodies.free_velocities.copy()
    u[rows], u_free[rows] = velocities, free
    return bodies._replace(velocities=u, free_velocities=u_free)


def _with_blows_closed(
    contacts: ContactConstraintArray, pairs: BodyPairs, points: np.ndarray, bodies: RigidBodies, beside: np.ndarray
) -> np.ndarray:
    """Gaps (N,) [m] of the contacts; none of those `beside` the robot that close up within the step, faster than v_e.

    Or an impact without restitution would be shared among two steps, and break nothing in either.
    """
    counts: np.ndarray = np.diff(contacts.pair_begin)
    a, b = np.repeat(pairs.body_a, counts), np.repeat(pairs.body_b, counts)
    velocities = relative_velocities(a, b, points, bodies.centers, bodies.free_velocities)
    approach = -dots(contacts.normals, velocities)
    beyond = contacts.gaps - pairs.rest_gaps
    span = np.append(bodies.spans, np.inf)
    closing = np.minimum(span[a], span[b]) * approach
    is_fast = approach > np.repeat(pairs.bounce_speeds, counts)
    is_blow = (beside[a] | beside[b]) & (beyond > 0.0) & is_fast & (closing > beyond)
    return np.where(is_blow, pairs.rest_gaps, contacts.gaps)
