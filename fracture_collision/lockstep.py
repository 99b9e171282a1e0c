"""Simulator and service in one process: a scene, step by step, without ROS and without a clock.

The nodes do the same over topics: bodies and events first, then states one way and contacts the other, each waiting for
the other's answer to the same step.
"""

from __future__ import annotations

from collections.abc import Iterator
from time import perf_counter
from types import TracebackType
from typing import NamedTuple

from fracture_collision.records import ContactConstraintArray, FragmentRegistry, FragmentStates
from fracture_collision.simulation.dynamics import Dynamics
from fracture_collision.simulation.scene.scene import Scene
from fracture_collision.simulation.simulation import Simulation, StepReport, StepRequest
from fracture_collision.world import CollisionWorld, Settings
from fracture_collision.world.inspection import every_contact


class StepTimes(NamedTuple):
    """Wall times of one step [s], as in Glondu et al. 2014, Table 3."""

    total: float
    collision: float  # the service's answer: gate, broad and narrow phase
    update: float  # events in, registry ready to answer, masses included; 0 in a step without events
    physics: float  # the simulator's part, less `fracture`: contact solver, integration, bookkeeping
    fracture: float  # making the patterns of what breaks at the step's end


class Exchange(NamedTuple):
    """The messages of one step, its report and times."""

    states: FragmentStates  # at its beginning
    contacts: ContactConstraintArray
    registry: FragmentRegistry
    report: StepReport
    times: StepTimes


class Lockstep:
    """A run of one scene: an iterator over its steps. Use as a context manager, or `close` it.

    `simulation` and `world` may be inspected between steps. Equal arguments give equal bytes.

    Without `settings` it has the defaults, with `lookahead` the scene's time step.
    """

    def __init__(
        self, scene: Scene, settings: Settings | None = None, seed: int | None = None,
        dynamics: Dynamics | None = None,
    ) -> None:  # fmt: skip
        settings = Settings(lookahead=scene.time_step) if settings is None else settings
        self.world = CollisionWorld(settings)
        self.simulation = Simulation(scene, seed, dynamics, settings.lookahead > 0.0)
        self._told = 0  # events that the service has
        for body in self.simulation.start_bodies():
            self.world.add_body(body)
        self._registry: FragmentRegistry | None = self.world.fragments()  # with those

    def __enter__(self) -> Lockstep:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def __iter__(self) -> Iterator[Exchange]:
        """The remaining steps."""
        while not self.simulation.finished:
            yield self.step()

    def step(self) -> Exchange:
        """One time step, also beyond the scene's duration."""
        started = perf_counter()
        request = self.simulation.begin_step()
        begun = perf_counter()
        has_news = self._tell(request)
        told = perf_counter()
        contacts = self.world.contacts(request.states)
        answered = perf_counter()
        if has_news or self._registry is None:
            self._registry = self.world.fragments()
        known = perf_counter()
        report = self.simulation.finish_step(contacts, self._registry)
        ended = perf_counter()
        update = self.world.last_timings["update"] + (told - begun) + (known - answered) if has_news else 0.0
        times = StepTimes(
            total=ended - started,
            collision=known - begun - update,
            update=update,
            physics=(begun - started) + (ended - known) - report.fracture_seconds,
            fracture=report.fracture_seconds,
        )
        return Exchange(request.states, contacts, self._registry, report, times)

    def states(self) -> FragmentStates:
        """The current states; the service has the events that led to them."""
        request = self.simulation.begin_step()
        if self._tell(request):
            self._registry = None
        return request.states

    def every_contact(self, states: FragmentStates) -> ContactConstraintArray:
        """The contacts at `states` without a limit per pair: those from which self-adapting selection (5.2) chooses."""
        return every_contact(self.world, states)

    def _tell(self, request: StepRequest) -> bool:
        """Passes the service the bodies and events that it does not have; returns whether there were any."""
        news = [event for event in request.events if event.sequence > self._told]
        for body in request.bodies:
            self.world.add_body(body)
        for event in news:
            self.world.add_fracture(event)
            self._told = event.sequence
        return bool(news or request.bodies)

    def close(self) -> None:
        """Frees the physics engine."""
        self.simulation.close()
