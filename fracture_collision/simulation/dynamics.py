"""The protocol between a simulation and the engine that moves its bodies.

The simulation has the scene's cast, breaks bodies, remembers contacts and sets rest gaps (`simulation`). An engine has
the bodies in motion; it solves their contacts and moves them. One step:

    begin      the states for the service, with the velocities of the coming step before contacts
    solve      the answer's contacts: impulses, and which bodies break
    move       the bodies, for one time step
"""

from __future__ import annotations

from typing import NamedTuple, Protocol

import numpy as np

from fracture_collision.simulation.cast import Traits
from fracture_collision.simulation.engine import BodyStates, FrameState, MassProperties, Planned
from fracture_collision.simulation.solver.touch_ahead import StepContacts


class Given(NamedTuple):
    """What an engine solves in a step. Rows of n bodies are those of `states`, n is what cannot move."""

    states: BodyStates  # before the step
    contacts: StepContacts  # those now, with remembered ones and rest gaps, and those ahead
    traits: Traits  # of the bodies
    pushes: np.ndarray  # (n, 6) [m/s, rad/s] that hand, hammer and arm add
    planned: Planned | None  # as given to `begin`


class Solved(NamedTuple):
    """The solved contacts of a step, before the bodies move."""

    normal_impulses: np.ndarray  # (N,) [N s] of the contacts now; of what breaks, those that break it
    overloaded: np.ndarray  # (k,) rows of the bodies that break
    taken: np.ndarray  # (n, 6) [m/s, rad/s] by which contacts change velocities


class Dynamics(Protocol):
    """An engine. Equal calls have equal results, to the last bit, on one machine at least."""

    def add(self, fragment_id: int, properties: MassProperties, frame: FrameState) -> None:
        """Add a body; ValueError if its id is taken, or its mass or inertia is not positive."""

    def remove(self, fragment_id: int) -> None:
        """Remove a body; KeyError if there is none of this id."""

    def states(self) -> BodyStates:
        """Present states of all bodies, ascending by id; the same object until one changes."""

    def begin(self, planned: Planned | None) -> BodyStates:
        """The states with the velocities that the service looks ahead with. May be called again before `solve`.

        planned: pushes of this step, if they are known already.
        """

    def solve(self, given: Given) -> Solved:
        """Impulses of the contacts, with friction, restitution, and no more than materials bear."""

    def move(self) -> float:
        """Move all bodies one time step on, as solved; returns the energy [J] that corrections of poses add."""

    def close(self) -> None:
        """Release resources."""
