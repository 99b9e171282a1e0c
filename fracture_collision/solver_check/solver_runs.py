"""Runs a case's scene with a solver in this process, and keeps what it published and solved."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Mapping
from time import perf_counter
from typing import Any, NamedTuple

import numpy as np

from fracture_collision.extras import MissingExtra
from fracture_collision.lockstep import Lockstep
from fracture_collision.near_names import did_you_mean
from fracture_collision.records import ContactConstraintArray, FractureEvent, FragmentRegistry, FragmentStates
from fracture_collision.simulation.actors.robot import Robot
from fracture_collision.simulation.dynamics import Dynamics, Given, Moved, Solved
from fracture_collision.simulation.engine import BodyStates, FrameState, MassProperties, Planned
from fracture_collision.simulation.engines import dynamics_of
from fracture_collision.simulation.scene.scene import ENGINES, Scene
from fracture_collision.solver_check.recorded import Impulses, Recorded
from fracture_collision.world import CollisionWorld, Settings

Factory = Callable[[Scene, bool], Dynamics]

# Pairs with no more contacts are not thinned: fewer hold no body.
KEPT_OF_A_PAIR = 4
# Steps with whole lists before: half of a face lets a body tilt that the solver has not seen at rest.
UNTOUCHED = 20
# Pairs of fragments that the case `lists` names without contacts: some that never touch.
BARE = (1, 3), (2, 4), (3, 4)
METHODS = ("add", "remove", "states", "links", "begin", "solve", "move", "close")  # of Dynamics

Change = Callable[[ContactConstraintArray], ContactConstraintArray]


class Strike(NamedTuple):
    """A blow without an impulse, which breaks a body between two steps."""

    step: int
    body: str  # its name
    point: tuple[float, float, float]  # [m], body frame
    overload: float  # impulse over strength


class LeftOut(Exception):
    """A run that this solver, or this installation, cannot have; the text has the reason."""


class UnknownSolver(ValueError):
    """A solver that cannot be found or made; the text has the reason."""


def factory_of(name: str) -> Factory:
    """The factory of solvers of this name: own, mujoco, or package.module:function. Raises UnknownSolver.

    The function takes a Scene and whether the service looks ahead, and returns a Dynamics without bodies.
    """
    if name in ENGINES:
        return lambda scene, looks_ahead: dynamics_of(scene._replace(engine=name), looks_ahead)
    path, colon, function = name.partition(":")
    if not colon:
        hint = did_you_mean(name, ENGINES)
        raise UnknownSolver(f"no solver {name!r}{hint or ';'} pass {', '.join(ENGINES)}, or package.module:function")
    try:
        module = importlib.import_module(path)
    except ModuleNotFoundError as error:
        raise UnknownSolver(f"{name}: no module {error.name!r}; is its folder on PYTHONPATH?") from error
    except Exception as error:
        raise UnknownSolver(f"{name}: importing {path} raised {type(error).__name__}: {error}") from error
    factory = getattr(module, function, None)
    if not callable(factory):
        hint = did_you_mean(function, [each for each in vars(module) if callable(getattr(module, each))])
        raise UnknownSolver(f"{name}: {path} has no function {function!r}{hint}")
    return factory


def run_in_lockstep(
    factory: Factory, scene: Scene, change: Change | None = None, strike: Strike | None = None,
    check: Callable[[], None] = lambda: None,
) -> Recorded:  # fmt: skip
    """The whole run of a scene. Raises UnknownSolver if the factory makes no Dynamics, and what the solver raises.

    LeftOut if the scene has a robot and the solver, or this installation, has none.

    change: of the service's answers, before the solver gets them. check: called every step, may raise to stop.
    """
    spy = _Spy(_made(factory, scene))
    settings = Settings(threads=1, lookahead=scene.time_step)
    states, contacts, reports, torques = [], [], [], []
    registries: dict[int, FragmentRegistry] = {}
    with _begun(scene, settings, spy) as running:
        running.world = service = _Service(running.world, change)
        bodies = running.simulation.start_bodies()
        ids = {body.name: body.fragment_id for body in bodies}
        for k in range(scene.step_count):
            check()
            if strike is not None and k == strike.step:
                running.simulation.strike(ids[strike.body], np.array(strike.point), strike.overload)
            exchange = running.step()
            states.append(exchange.states)
            contacts.append(exchange.contacts)
            registries[exchange.registry.fracture_sequence] = exchange.registry
            reports.append(exchange.report)
            if running.simulation.robot is not None:
                torques.append(running.simulation.robot.joints().torques)
    return Recorded(
        scene.time_step, bodies, states, contacts, service.events, registries, spy.impulses, reports, torques or None
    )


def _begun(scene: Scene, settings: Settings, dynamics: _Spy) -> Lockstep:
    try:
        return Lockstep(scene, settings, dynamics=dynamics)
    except MissingExtra as error:
        if scene.robot is None:
            raise
        raise LeftOut(str(error)) from error


def _made(factory: Factory, scene: Scene) -> Dynamics:
    try:
        dynamics = factory(scene, True)
    except MissingExtra:
        raise
    except Exception as error:
        raise UnknownSolver(f"the factory raised {type(error).__name__}: {error}") from error
    if missing := [each for each in METHODS if not callable(getattr(dynamics, each, None))]:
        raise UnknownSolver(f"the factory returned a {type(dynamics).__name__}, without {', '.join(missing)}")
    return dynamics


class _Spy:
    """A Dynamics that passes all calls on, and keeps what was solved."""

    def __init__(self, dynamics: Dynamics) -> None:
        self._dynamics = dynamics
        self.impulses: list[Impulses] = []

    def add(self, fragment_id: int, properties: MassProperties, frame: FrameState) -> None:
        """As in Dynamics, as all the following."""
        self._dynamics.add(fragment_id, properties, frame)

    def remove(self, fragment_id: int) -> None:
        self._dynamics.remove(fragment_id)

    def states(self) -> BodyStates:
        return self._dynamics.states()

    def links(self) -> Mapping[int, FrameState]:
        return self._dynamics.links()

    def carry(self, robot: Robot) -> None:
        try:
            self._dynamics.carry(robot)
        except (AttributeError, ValueError) as error:
            raise LeftOut(f"the solver has no robots (Dynamics.carry): {error}") from error

    def begin(self, planned: Planned | None) -> BodyStates:
        return self._dynamics.begin(planned)

    def solve(self, given: Given) -> Solved:
        started = perf_counter()
        solved = self._dynamics.solve(given)
        seconds = perf_counter() - started
        self.impulses.append(Impulses(given.contacts.now, np.array(solved.normal_impulses), seconds))
        return solved

    def move(self) -> Moved:
        started = perf_counter()
        moved = self._dynamics.move()
        last = self.impulses[-1]
        self.impulses[-1] = last._replace(seconds=last.seconds + perf_counter() - started)
        return moved

    def is_asleep(self) -> bool:
        return False  # each step is solved, so that it can be judged

    def close(self) -> None:
        self._dynamics.close()


class _Service(CollisionWorld):
    """A service that keeps the events it gets, and may change its answers."""

    def __init__(self, world: CollisionWorld, change: Change | None) -> None:
        vars(self).update(vars(world))
        self._change = change
        self.events: list[FractureEvent] = []

    def add_fracture(self, event: FractureEvent) -> None:
        """As in CollisionWorld."""
        super().add_fracture(event)
        self.events.append(event)

    def contacts(self, states: FragmentStates, *rest: Any, **more: Any) -> ContactConstraintArray:
        """As in CollisionWorld."""
        answer = super().contacts(states, *rest, **more)
        return answer if self._change is None else self._change(answer)


def shuffled(contacts: ContactConstraintArray) -> ContactConstraintArray:
    """With the contacts of each pair in another order in every step."""
    generator = np.random.default_rng(contacts.step)
    begin = contacts.pair_begin.astype(np.int64)
    parts = [first + generator.permutation(end - first) for first, end in zip(begin[:-1], begin[1:], strict=True)]
    return _with_rows(contacts, parts)


def thinned(contacts: ContactConstraintArray) -> ContactConstraintArray:
    """With every second contact of pairs of more than KEPT_OF_A_PAIR, by turns the one half and the other.

    The first UNTOUCHED steps stay as they are.
    """
    if contacts.step < UNTOUCHED:
        return contacts
    begin, parts = contacts.pair_begin.astype(np.int64), []
    for first, end in zip(begin[:-1], begin[1:], strict=True):
        rows = np.arange(first, end)
        parts.append(rows[contacts.step % 2 :: 2] if len(rows) > KEPT_OF_A_PAIR else rows)
    return _with_rows(contacts, parts)


def with_bare_pairs(contacts: ContactConstraintArray) -> ContactConstraintArray:
    """With the pairs BARE without contacts but with a bound of 1 mm, where they are not listed."""
    pairs = list(zip(contacts.fragment_a.tolist(), contacts.fragment_b.tolist(), strict=True))
    bare = [pair for pair in BARE if pair not in pairs]
    both = pairs + bare
    order = sorted(range(len(both)), key=lambda k: both[k])
    counts = np.append(np.diff(contacts.pair_begin.astype(np.int64)), np.zeros(len(bare), np.int64))[order]

    def joined(column: np.ndarray, filler: float) -> np.ndarray:
        return np.append(column, np.full(len(bare), filler, column.dtype))[order]

    return contacts._replace(
        fragment_a=np.array([both[k][0] for k in order], np.uint32),
        fragment_b=np.array([both[k][1] for k in order], np.uint32),
        pair_begin=np.concatenate(([0], np.cumsum(counts))).astype(np.uint32),
        missed_depth_bound=joined(contacts.missed_depth_bound, 1e-3), friction=joined(contacts.friction, 0.5),
        restitution=joined(contacts.restitution, 0.0),
    )  # fmt: skip


def _with_rows(contacts: ContactConstraintArray, parts: list[np.ndarray]) -> ContactConstraintArray:
    """The contacts of these rows, one array for each pair."""
    rows = np.concatenate(parts) if parts else np.zeros(0, np.int64)
    counts = [len(part) for part in parts]
    return contacts._replace(
        pair_begin=np.concatenate(([0], np.cumsum(counts))).astype(np.uint32), points_a=contacts.points_a[rows],
        points_b=contacts.points_b[rows], normals=contacts.normals[rows], gaps=contacts.gaps[rows],
        contact_ids=contacts.contact_ids[rows],
    )  # fmt: skip
