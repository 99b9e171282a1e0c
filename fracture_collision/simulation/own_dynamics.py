"""The package's own engine: contact solver, sleeping, and touches within a step. The same bytes on every processor.

One step: contacts are solved for the velocities at its end, gravity included (`solver/contact_solver`). Bodies move as
far as they touch nothing ahead (`solver/touch_ahead`), and make up for lost time later (`catching_up`). A robot has an
engine of its own (`robot_contacts`); its bodies are rows like others, which it moves.
"""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import numpy as np

from fracture_collision.portable_math import dots
from fracture_collision.records import ContactConstraintArray
from fracture_collision.simulation.catching_up import (
    MOST_LOST,
    NOTHING,
    ROUGHLY,
    Expected,
    Touching,
    Waited,
    carried_contacts,
    extra_times,
)
from fracture_collision.simulation.dynamics import Given, Moved, SleepingWorld, Solved
from fracture_collision.simulation.engine import BodyStates, ByFragment, Planned, free_velocities
from fracture_collision.simulation.robot_contacts import RobotStep, solve_with_robot
from fracture_collision.simulation.solver.contact_solver import (
    Again,
    BodyPairs,
    RigidBodies,
    Solution,
    SolverSettings,
    solve_contacts,
    solve_with_strengths,
)
from fracture_collision.simulation.solver.touch_ahead import Course, shares_of_step
from fracture_collision.simulation.solver.warm_start import NO_WARM_START

# [kg], [kg m2] of a robot that no contact moves.
STEADY = 1.0e9


class _Step(NamedTuple):
    """The step between `solve` and `move`."""

    given: Given
    bodies: RigidBodies  # with gravity for the time in which they move if nothing holds them back
    searched: np.ndarray | None  # (n, 6) velocities that the service looked ahead with; None: it does not
    solution: Solution
    limits: np.ndarray  # (N,) [N s] of the contacts' impulses: what materials bear
    flight: np.ndarray  # (n, 6) drift of bodies in free flight
    solved: tuple[ContactConstraintArray, BodyPairs]  # as the solver had them
    robot: RobotStep | None


class OwnDynamics(SleepingWorld):
    """A Dynamics. looks_ahead: the contacts come from a service that looks a step ahead, see touch_ahead.

    gravity (3,) [m/s2]; time_step [s].
    """

    def __init__(
        self, time_step: float, gravity: np.ndarray, settings: SolverSettings, looks_ahead: bool = False
    ) -> None:
        super().__init__(time_step, gravity, settings)
        self._looks_ahead = looks_ahead
        self._warm_start = NO_WARM_START
        self._searched: tuple[BodyStates, BodyStates] | None = None  # as they are, and as they are searched
        self._step: _Step | None = None
        self.shares = np.ones(0)  # of their courses in the last step, for which bodies moved: see touch_ahead
        self._waited: Waited | None = None  # the last step, if the next one has to make up for it
        self._lost = NOTHING.extra  # (n,) [s] that bodies are behind
        self._expected = NOTHING  # of this step
        self._carried: Touching | None = None  # to this step, from the last one that had to be made up for

    def begin(self, planned: Planned | None) -> BodyStates:
        """As in Dynamics."""
        self._follow_robot()
        states = self.states()
        if self._waited is not None:
            # of nothing, if all bodies have left or broken
            self._expected = self._expect(states, self._waited, planned) if len(states.masses) else NOTHING
            self._waited = None
        searched = self._to_search(states, planned)
        self._searched = states, searched
        return searched

    def solve(self, given: Given) -> Solved:
        """As in Dynamics."""
        states, settings, (contacts, pairs, *_) = given.states, self._settings, given.contacts
        searched = None
        if self._looks_ahead:  # with the bodies of the request, or with more that had waited for the registry
            if self._searched is None or self._searched[0] is not states:
                self._searched = states, self._to_search(states, given.planned)
            searched = self._searched[1].velocities()
        self._settle(given)
        bodies = self._rigid_bodies(states, given.pushes, self._spans(states), self._rest.asleep)
        solve = partial(solve_with_strengths, settings=settings, strengths=given.traits.strengths)
        with_robot = None
        if self._robot is None:
            solution, overloaded, limits = solve(bodies, contacts, pairs, self._warm_start)
        else:
            with_robot = solve_with_robot(
                self._robot, bodies, contacts, pairs, self._warm_start, solve, self._robot_rows(states)
            )
            bodies, contacts, pairs, *_ = with_robot
            solution, overloaded, limits = with_robot.solution, with_robot.overloaded, with_robot.limits
        flight = self._flight(given, bodies, solution)
        solved = contacts, pairs
        self._step = _Step(given, bodies, searched, solution, limits, flight, solved, with_robot)
        return Solved(solution.normal_impulses, overloaded, solution.velocities - bodies.free_velocities)

    def move(self) -> Moved:
        """As in Dynamics: drift correction adds energy where it lifts bodies."""
        assert self._step is not None
        step, self._step = self._step, None
        given, bodies, searched, solution, limits, flight, *_ = step
        states, forms, settings, time_step = given.states, given.traits.forms, self._settings, self._time_step
        rates = (bodies.spans / time_step)[:, None]
        moves = rates * (solution.velocities + solution.drift + flight)
        falls = rates * (bodies.free_velocities - bodies.velocities)[:, :3]
        is_expected = self._expected.velocities.have(states.fragment_ids)
        course, contacts = Course(moves, searched, falls, is_expected), given.contacts
        if step.robot is not None:
            course, contacts = self._beside_robot(given, step.robot, solution.warm_start, course)
            moves = course.moves
        self.shares = shares_of_step(states, contacts, course, forms, settings, time_step)
        if step.robot is not None:
            self.shares[step.robot.beside[:-1]] = 1.0
        moved, drifting = self.shares * bodies.spans, solution.drift
        if (self.shares < 1.0).any():
            solution = self._solved_until(moved, step)
        self._warm_start, v = solution.warm_start, solution.velocities
        drift = self.shares[:, None] * moves - v
        self.advance(v[:, :3], v[:, 3:], drift[:, :3], drift[:, 3:])
        work = 0.0
        if self._robot is not None and step.robot is not None:
            work = step.robot.work(self._is_robot(states), solution)
            self._commit(step.robot, solution.warm_start)
            drifting = np.where(self._is_robot(states)[:, None], 0.0, drifting)
        self._rest_after(given, v + drift)
        if self._looks_ahead:
            self._remember_waiting(given, moved)
        return Moved(-float((states.masses * moved * dots(drifting[:, :3], self._gravity)).sum()), work)

    def is_asleep(self) -> bool:
        """As in Dynamics."""
        return self._waited is None and super().is_asleep()

    def _remember_waiting(self, given: Given, moved: np.ndarray) -> None:
        """Keep what the next step needs to make up for this one, in which bodies moved for `moved` (n,) [s]."""
        states, time_step = given.states, self._time_step
        is_held = self.shares < 1.0
        is_at_rest = (self._rest.quiet > 0.0) & ~is_held
        lost = np.clip(self._lost.of(states.fragment_ids) + time_step - moved, 0.0, None)
        lost = np.where(is_at_rest, 0.0, np.minimum(lost, MOST_LOST * time_step))
        carried, self._carried = self._carried, None
        self._lost, self._expected = ByFragment(states.fragment_ids, lost), NOTHING
        if is_held.any() or lost.any():
            is_round = given.traits.forms.is_round[:-1]
            self._waited = Waited(states, given.contacts, carried, is_round, is_held, is_at_rest, lost)

    def _solved_until(self, moved: np.ndarray, step: _Step) -> Solution:
        """The solution with gravity for the times `moved` (n,) [s] only: bodies that waited gain no energy by it."""
        (given, bodies, _, solution, limits, *_), (now, pairs) = step, step.solved
        held = moved < bodies.spans
        free = free_velocities(bodies.velocities, bodies.inertias, self._gravity, moved)
        if self._robot is not None:
            rows = self._robot_rows(given.states)
            free[rows] = bodies.free_velocities[rows]
        alone = np.where(held[:, None], free, solution.velocities)
        again = Again(held, limits, solution._replace(velocities=alone))
        until = bodies._replace(free_velocities=free)
        return solve_contacts(until, now, pairs, solution.warm_start, self._settings, again)

    def _expect(self, states: BodyStates, waited: Waited, planned: Planned | None) -> Expected:
        """What is known of the coming step, after one in which bodies waited; see catching_up."""
        settings, ids, time_step = self._settings, states.fragment_ids, self._time_step
        contacts, pairs = self._carried = carried_contacts(waited, states, settings)
        pushes = np.zeros((len(ids), 6)) if planned is None else planned.pushes.of(ids)
        is_pushed = np.any(pushes, axis=1) | self._is_robot(states)
        extra, is_expected = extra_times(waited, states, is_pushed, self._carried, time_step)
        bodies = self._rigid_bodies(states, pushes, time_step + extra, np.zeros(len(ids), bool))
        if self._robot is not None:
            bodies = self._with_steady_robot(states, bodies)
        still, zeros = np.zeros((len(ids), 6)), np.zeros(len(contacts.gaps))
        nothing = Solution(bodies.free_velocities, still, zeros, zeros, self._warm_start)
        again = Again(is_expected, np.full(len(zeros), np.inf), nothing)
        roughly = settings._replace(accuracy=ROUGHLY, rounds=1)
        solution = solve_contacts(bodies, contacts, pairs, self._warm_start, roughly, again)
        return Expected(ByFragment(ids, extra), ByFragment(ids[is_expected], solution.velocities[is_expected]))

    def _to_search(self, states: BodyStates, planned: Planned | None) -> BodyStates:
        """_before_contacts. After a step in which bodies waited, the contacts of some are expected too."""
        spans, ids, known = self._spans(states), states.fragment_ids, self._expected.velocities
        states = self._before_contacts(states, planned, spans)
        linear, angular = states.linear, states.angular
        if len(known.fragment_ids):
            moves, is_known = known.of(ids), known.have(ids)[:, None]
            linear, angular = np.where(is_known, moves[:, :3], linear), np.where(is_known, moves[:, 3:], angular)
        rates = (spans / self._time_step)[:, None]
        return states._replace(linear=rates * linear, angular=rates * angular)

    def _spans(self, states: BodyStates) -> np.ndarray:
        """(n,) [s] for which bodies move in this step, if nothing holds them back."""
        return self._time_step + self._expected.extra.of(states.fragment_ids)

    def _with_steady_robot(self, states: BodyStates, bodies: RigidBodies) -> RigidBodies:
        """`bodies` with a robot that no contact changes: an estimate for a search."""
        rows = self._robot_rows(states)
        masses, inertias, free = bodies.masses.copy(), bodies.inertias.copy(), bodies.free_velocities.copy()
        masses[rows], inertias[rows], free[rows] = STEADY, STEADY * np.eye(3), bodies.velocities[rows]
        return bodies._replace(masses=masses, inertias=inertias, free_velocities=free)
