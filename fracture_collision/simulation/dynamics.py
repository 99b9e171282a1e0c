"""The protocol between a simulation and the engine that moves its bodies.

The simulation has the scene's cast, breaks bodies, remembers contacts and sets rest gaps (`simulation`). An engine has
the bodies in motion; it solves their contacts and moves them. One step:

    begin      the states for the service, with the velocities of the coming step before contacts
    solve      the answer's contacts: impulses, and which bodies break
    move       the bodies, for one time step
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple, Protocol

import numpy as np

from fracture_collision.portable_math import rotation_vectors
from fracture_collision.simulation.actors.robot import Robot
from fracture_collision.simulation.cast import Traits
from fracture_collision.simulation.engine import (
    BodyStates,
    ByFragment,
    FrameState,
    MassProperties,
    Planned,
    RigidBodyWorld,
    free_velocities,
    mean_spins,
)
from fracture_collision.simulation.robot_contacts import RobotStep, robot_rows
from fracture_collision.simulation.rotations import INVERSE, quaternion_products, rotation_matrices, turned
from fracture_collision.simulation.solver import sleep
from fracture_collision.simulation.solver.contact_solver import (
    BodyPairs,
    RigidBodies,
    Solution,
    SolverSettings,
    flight_drift,
)
from fracture_collision.simulation.solver.touch_ahead import Course, StepContacts, chosen_contacts
from fracture_collision.simulation.solver.warm_start import WarmStart


class Given(NamedTuple):
    """What an engine solves in a step. Rows of n bodies are those of `states`, n is what cannot move."""

    states: BodyStates  # before the step
    contacts: StepContacts  # those now, with remembered ones and rest gaps, and those ahead
    traits: Traits  # of the bodies
    pushes: np.ndarray  # (n, 6) [m/s, rad/s] that hand and hammer add
    planned: Planned | None  # as given to `begin`


class Solved(NamedTuple):
    """The solved contacts of a step, before the bodies move."""

    normal_impulses: np.ndarray  # (N,) [N s] of the contacts now; of what breaks, those that break it
    overloaded: np.ndarray  # (k,) rows of the bodies that break
    taken: np.ndarray  # (n, 6) [m/s, rad/s] by which contacts change velocities


class Moved(NamedTuple):
    """What bodies gained in a step, beside what contacts and gravity do to them."""

    drift_energy: float  # [J] by corrections of poses
    robot_energy: float = 0.0  # [J] by contacts with what the engine moves itself: robots, links


class Dynamics(Protocol):
    """An engine. Equal calls have equal results, to the last bit, on one machine at least."""

    def add(self, fragment_id: int, properties: MassProperties, frame: FrameState) -> None:
        """Add a body; ValueError if its id is taken, or its mass or inertia is not positive."""

    def remove(self, fragment_id: int) -> None:
        """Remove a body; KeyError if there is none of this id."""

    def states(self) -> BodyStates:
        """Present states of all bodies, ascending by id; the same object until one changes."""

    def links(self) -> Mapping[int, FrameState]:
        """Present poses and velocities of moving parts of the engine's own, by fragment id; static for the service."""

    def carry(self, robot: Robot) -> None:
        """Let a robot move its bodies from now on. ValueError if the engine has no robots."""

    def begin(self, planned: Planned | None) -> BodyStates:
        """The states with the velocities that the service looks ahead with. May be called again before `solve`.

        planned: pushes of this step, if they are known already.
        """

    def solve(self, given: Given) -> Solved:
        """Impulses of the contacts, with friction, restitution, and no more than materials bear."""

    def move(self) -> Moved:
        """Move all bodies one time step on, as solved."""

    def is_asleep(self) -> bool:
        """Whether nothing moved in the last step, and nothing will with the same contacts and without pushes."""

    def close(self) -> None:
        """Release resources."""


class SleepingWorld(RigidBodyWorld):
    """Rigid bodies under gravity (3,) [m/s2], whose islands fall asleep: what the engines have in common."""

    def __init__(self, time_step: float, gravity: np.ndarray, settings: SolverSettings) -> None:
        super().__init__(time_step)
        self._gravity, self._settings = gravity, settings
        self._rest = sleep.NOBODY
        self._touched = np.zeros(0, np.uint32), np.zeros(0, np.uint32)  # pairs of the last step
        self._robot: Robot | None = None
        self._placed: FrameState | None = None  # where its bodies were put last

    def carry(self, robot: Robot) -> None:
        """As in Dynamics."""
        self._robot = robot

    def links(self) -> Mapping[int, FrameState]:
        """As in Dynamics: none."""
        return {}

    def is_asleep(self) -> bool:
        """As in Dynamics: robots and links never sleep."""
        return self._robot is None and not self.links() and bool(self._rest.asleep.all())

    def _never_at_rest(self, given: Given) -> np.ndarray:
        """(n,) bool: bodies that do not sleep, nor what they touch: a motor may move the robot at any time."""
        return self._is_robot(given.states)

    def _settle(self, given: Given) -> None:
        """Wake and lull islands, by the contacts of a step."""
        contacts, pairs, *_ = given.contacts
        is_pushed = np.any(given.pushes, axis=1) | self._never_at_rest(given)
        rest = sleep.roused(self._rest, given.states.fragment_ids, self._touched, is_pushed)
        time = self._settings.sleep_time
        self._rest = sleep.settled(rest, contacts.pair_begin, pairs.body_a, pairs.body_b, time)
        self._touched = contacts.fragment_a, contacts.fragment_b

    def _rest_after(self, given: Given, moves: np.ndarray) -> None:
        """`moves` (n, 6) [m/s, rad/s]: velocities that moved the poses in a step."""
        states, sizes = given.states, given.traits.forms.sizes[:-1]
        farthest = sleep.farthest_at_rest(self._settings, sizes, self._gravity)
        self._rest = sleep.after_step(
            self._rest, states.masses, states.inertias, moves, farthest, self._settings.sleep_time, self._time_step
        )

    def _before_contacts(self, states: BodyStates, planned: Planned | None, spans: np.ndarray) -> BodyStates:
        """`states` with the velocities of a step of `spans` (n,) [s] before contacts.

        Otherwise the look-ahead would miss what a hand adds, the gyroscopic torque, which turns the axis of a fast
        shard by a radian, and gravity, by which a body at rest beside a seam would fall into it. Bodies asleep do not
        fall.
        """
        velocities, ids = states.velocities(), states.fragment_ids
        if planned is not None:
            velocities = velocities + planned.expected.of(ids)
        free = free_velocities(velocities, states.inertias, self._gravity, spans)
        asleep = ByFragment(self._rest.fragment_ids, self._rest.asleep).of(ids)
        linear = np.where(asleep[:, None], velocities[:, :3], free[:, :3])
        angular = mean_spins(velocities, free, states.inertias, spans)
        if self._robot is not None and (rows := self._robot_rows(states)).size:
            # As it will move, if no contact changes that.
            linear[rows], angular[rows] = np.hsplit(self._robot_moves(states, rows, self._robot.trial([])), 2)
        return states._replace(linear=linear, angular=angular)

    def _rigid_bodies(
        self, states: BodyStates, pushes: np.ndarray, spans: np.ndarray, asleep: np.ndarray
    ) -> RigidBodies:
        velocities = states.velocities() + pushes
        free = free_velocities(velocities, states.inertias, self._gravity, spans)
        return RigidBodies(states.masses, states.inertias, states.centers, velocities, free, spans, asleep)

    def _robot_rows(self, states: BodyStates) -> np.ndarray:
        """Rows (m,) of the robot's bodies; none before they have entered, all at once."""
        if self._robot is None:
            return np.zeros(0, np.int64)
        rows = robot_rows(self._robot, states)
        return rows[rows < len(states.masses)]

    def _is_robot(self, states: BodyStates) -> np.ndarray:
        """(n,) bool."""
        found = np.zeros(len(states.masses), bool)
        found[self._robot_rows(states)] = True
        return found

    def _follow_robot(self) -> None:
        """Put the robot's bodies where the robot is."""
        if self._robot is None:
            return
        states, frames = self.states(), self._robot.frames()
        rows = self._robot_rows(states)
        if not len(rows):
            return
        placed = self._placed
        if placed is None or not all(map(np.array_equal, placed, frames)):
            self.place(rows, frames)
            self._placed = frames

    def _robot_moves(self, states: BodyStates, rows: np.ndarray, after: FrameState) -> np.ndarray:
        """Constant velocities (m, 6) [m/s, rad/s] that bring the robot's bodies to the frames `after` in a step."""
        turns = quaternion_products(after.orientation, states.frame_orientations[rows] * INVERSE)
        arms = states.centers[rows] - states.frame_positions[rows]
        centers = after.position + turned(rotation_matrices(turns), arms)
        return np.hstack((centers - states.centers[rows], rotation_vectors(turns))) / self._time_step

    def _commit(self, step: RobotStep, warm_start: WarmStart) -> None:
        """Move the robot as solved."""
        assert self._robot is not None
        self._robot.commit(step.pushes(warm_start.impulses))
        self._placed = None  # not where the engine moved them
        self._follow_robot()

    def _beside_robot(
        self, given: Given, step: RobotStep, warm_start: WarmStart, course: Course
    ) -> tuple[Course, StepContacts]:
        """The course with the robot's own moves, and the contacts by which bodies wait for each other: none beside it.

        There nothing was searched along the course after a blow; but what waited, the robot would enter.
        """
        assert self._robot is not None
        states, (now, pairs, *_), moves = given.states, given.contacts, course.moves.copy()
        rows, beside = self._robot_rows(states), step.beside
        moves[rows] = self._robot_moves(states, rows, self._robot.trial(step.pushes(warm_start.impulses)))
        searched = course.searched
        if searched is not None:
            searched = np.where(beside[:-1, None], moves, searched)
        waits = ~(beside[pairs.body_a] | beside[pairs.body_b])
        each = np.repeat(waits, np.diff(now.pair_begin))
        its = BodyPairs._make([*(column[waits] for column in pairs[:-1]), pairs.rest_gaps[each]])
        contacts = given.contacts._replace(now=chosen_contacts(now, each, waits), pairs=its)
        return course._replace(moves=moves, searched=searched), contacts

    def _flight(self, given: Given, bodies: RigidBodies, solution: Solution) -> np.ndarray:
        """flight_drift (n, 6) of what is awake and not pushed."""
        contacts, pairs, *_ = given.contacts
        free = bodies.free_velocities
        turned = mean_spins(bodies.velocities, free, bodies.inertias, bodies.spans) - free[:, 3:]
        return flight_drift(
            bodies, turned, self._gravity, (solution.velocities, solution.normal_impulses),
            bodies.asleep | np.any(given.pushes, axis=1),
            (solution.pressing, contacts.pair_begin, pairs.body_a, pairs.body_b),
        )  # fmt: skip
