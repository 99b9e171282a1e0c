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
from fracture_collision.simulation.solver import sleep
from fracture_collision.simulation.solver.contact_solver import RigidBodies, Solution, SolverSettings, flight_drift
from fracture_collision.simulation.solver.touch_ahead import StepContacts


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

    def close(self) -> None:
        """Release resources."""


class SleepingWorld(RigidBodyWorld):
    """Rigid bodies under gravity (3,) [m/s2], whose islands fall asleep: what the engines have in common."""

    def __init__(self, time_step: float, gravity: np.ndarray, settings: SolverSettings) -> None:
        super().__init__(time_step)
        self._gravity, self._settings = gravity, settings
        self._rest = sleep.NOBODY
        self._touched = np.zeros(0, np.uint32), np.zeros(0, np.uint32)  # pairs of the last step

    def links(self) -> Mapping[int, FrameState]:
        """As in Dynamics: none."""
        return {}

    def _never_at_rest(self, given: Given) -> np.ndarray:
        """(n,) bool: bodies that do not sleep, nor what they touch."""
        return np.zeros(len(given.states.masses), bool)

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
        self._rest = sleep.after_step(self._rest, states.masses, states.inertias, moves, farthest, self._time_step)

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
        return states._replace(linear=linear, angular=mean_spins(velocities, free, states.inertias, spans))

    def _rigid_bodies(
        self, states: BodyStates, pushes: np.ndarray, spans: np.ndarray, asleep: np.ndarray
    ) -> RigidBodies:
        velocities = states.velocities() + pushes
        free = free_velocities(velocities, states.inertias, self._gravity, spans)
        return RigidBodies(states.masses, states.inertias, states.centers, velocities, free, spans, asleep)

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
