"""Simulator and service in one process: a scene, step by step, without ROS and without a clock.

The nodes do the same with topics in between: bodies and events first, then states one way and contacts the other, each
waiting for the other's answer to this very step.
"""

from __future__ import annotations

from collections.abc import Iterator
from types import TracebackType
from typing import NamedTuple

from fracture_collision.records import ContactConstraintArray, FragmentRegistry, FragmentStates
from fracture_collision.simulation.engine import Engine
from fracture_collision.simulation.scene import Scene
from fracture_collision.simulation.simulation import Simulation, StepReport
from fracture_collision.world import CollisionWorld, Settings


class Exchange(NamedTuple):
    """What went to and fro in one step."""

    states: FragmentStates  # at its beginning
    contacts: ContactConstraintArray
    registry: FragmentRegistry
    report: StepReport


class Lockstep:
    """A run of one scene: an iterator over its steps. Use as a context manager, or `close` it.

    `simulation` and `world` are there to be looked at between steps. Equal arguments give equal bytes.
    """

    def __init__(
        self, scene: Scene, settings: Settings | None = None, seed: int | None = None, engine: Engine | None = None
    ) -> None:
        self.world = CollisionWorld(Settings() if settings is None else settings)
        self.simulation = Simulation(scene, seed, engine)
        self._told = 0  # events that the service knows
        for body in self.simulation.start_bodies():
            self.world.add_body(body)

    def __enter__(self) -> Lockstep:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def __iter__(self) -> Iterator[Exchange]:
        """The steps that are left."""
        while not self.simulation.finished:
            yield self.step()

    def step(self) -> Exchange:
        """One time step, also beyond the scene's duration."""
        states = self.states()
        contacts, registry = self.world.contacts(states), self.world.fragments()
        return Exchange(states, contacts, registry, self.simulation.finish_step(contacts, registry))

    def states(self) -> FragmentStates:
        """Where everything is now; the service knows the events that led there."""
        request = self.simulation.begin_step()
        for event in request.events:
            if event.sequence > self._told:
                self.world.add_fracture(event)
                self._told = event.sequence
        return request.states

    def close(self) -> None:
        self.simulation.close()
