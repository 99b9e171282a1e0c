"""The simulator without transport: its requests to the collision service, and its use of the answers.

One step, from t_n to t_n+1:

    begin_step     bodies, fracture events and the states at t_n, for the service
    finish_step    its contacts at t_n and the fragments' masses; new fragments enter the engine with their parent's
                   velocity field; contacts are solved for the velocities at t_n+1, gravity included; the engine moves
                   all poses; overloaded fragments break (`solve_with_strengths`), and their events go out with the next
                   states
"""

from __future__ import annotations

import time
import warnings
from typing import Any, NamedTuple

import numpy as np

from fracture_collision.portable_math import dots, lengths
from fracture_collision.records import (
    CollisionBody,
    ContactConstraintArray,
    FractureEvent,
    FragmentRegistry,
    FragmentStates,
)
from fracture_collision.simulation.actors.hand import Drag
from fracture_collision.simulation.actors.robot import Robot
from fracture_collision.simulation.cast import Cast, SharedTraits, Traits, shared_traits, traits_of
from fracture_collision.simulation.dynamics import Dynamics, Given, Solved
from fracture_collision.simulation.engine import (
    NO_CHANGES,
    BodyStates,
    ByFragment,
    FrameState,
    Planned,
    Pusher,
    Pushes,
    planned,
    pushes_of,
)
from fracture_collision.simulation.engines import dynamics_of
from fracture_collision.simulation.robot_contacts import beside_robot, robot_rows
from fracture_collision.simulation.rotations import turned_back
from fracture_collision.simulation.scene.scene import Fracture, Scene, SceneBody
from fracture_collision.simulation.solver import contact_memory
from fracture_collision.simulation.solver.contact_memory import rest_gaps_of, with_remembered
from fracture_collision.simulation.solver.contact_solver import (
    BodyPairs,
    bounce_speeds,
    hardest_hit,
    kinetic_energy,
)
from fracture_collision.simulation.solver.touch_ahead import StepContacts, chosen_contacts, split_by_gap
from fracture_collision.simulation.step_records import LookaheadCheck, StepReport, StepRequest, fragment_states


class _Still(NamedTuple):
    """A step through which all bodies slept: without pushes, the next one is the same if its contacts are."""

    states: BodyStates  # after it
    contacts: ContactConstraintArray
    report: StepReport

    def goes_on(self, states: BodyStates, contacts: ContactConstraintArray) -> bool:
        """Whether a step with `states` and `contacts` is the same. A scene at rest takes a quarter of the time so."""
        before: tuple[Any, ...] = self.contacts._replace(step=contacts.step)
        now: tuple[Any, ...] = contacts
        return states is self.states and all(np.array_equal(x, y) for x, y in zip(before, now, strict=True))


class Simulation:
    """A run of one scene. The same scene, seed and answers give the same states, byte for byte.

    `seed`, if given, replaces the scene's, `dynamics` its engine. looks_ahead: the contacts come from a
    service that looks a step ahead (its parameter `lookahead`), see touch_ahead.
    """

    def __init__(
        self, scene: Scene, seed: int | None = None, dynamics: Dynamics | None = None, looks_ahead: bool = False
    ) -> None:
        self._scene = scene
        self._seed = scene.seed if seed is None else seed
        self._looks_ahead = looks_ahead
        self._lookahead_check = LookaheadCheck(scene.time_step if looks_ahead else None)
        self.dynamics = dynamics_of(scene, looks_ahead) if dynamics is None else dynamics
        self._step = 0
        self._sequence = 0
        self._cast = Cast(scene.bodies)
        self._events: list[FractureEvent] = []
        self._held_together: set[int] = set()  # fragments hit hard enough, but with no pattern to break by
        self._known_traits: Traits | None = None
        self._memory = contact_memory.NOTHING
        self._requested: FragmentStates | None = None
        self._planned: Planned | None = None  # of this step, where the service gets the pushes in advance
        self._taken = NO_CHANGES  # by contacts in the last step
        self._still: _Still | None = None  # the last step, if all bodies slept through it
        names = {i: body.name for i, body in self._cast.body_of.items()}
        self.drag = Drag(scene.hand, names, self._cast.body_id_of, self._cast.breakable)
        self._pushers: list[Pusher] = [self.drag]
        self.robot: Robot | None = None  # the scene's
        self._not_pushed_by_robot = np.zeros(0, np.uint32)
        if scene.robot is not None:
            from fracture_collision.simulation.actors.bullet_robot import BulletRobot  # late: needs an extra

            ids = {name: i for i, name in names.items()}
            self.robot = BulletRobot(scene.robot, ids, scene.time_step, scene.gravity)
            static = [i for i, body in self._cast.body_of.items() if body.is_static]
            self._not_pushed_by_robot = np.append(self.robot.fragment_ids, np.array(static, np.uint32))
            self.dynamics.carry(self.robot)

    @property
    def time_step(self) -> float:
        """Simulated time of a step [s]."""
        return self._scene.time_step

    @property
    def time(self) -> float:
        """Simulated [s]."""
        return self._step * self._scene.time_step

    @property
    def finished(self) -> bool:
        """Whether all steps of the scene are done."""
        return self._step >= self._scene.step_count

    def close(self) -> None:
        """Release the engine's resources."""
        self.dynamics.close()
        if self.robot is not None:
            self.robot.close()

    def grab(self, name: str, position: np.ndarray) -> bool:
        """`drag.grab` among the bodies in motion; `drag` moves the hand and lets go."""
        return self.drag.grab(name, position, self.dynamics.states())

    def hold(self, fragment_id: int, point: np.ndarray, position: np.ndarray) -> bool:
        """`drag.hold` among the bodies in motion."""
        return self.drag.hold(fragment_id, point, position, self.dynamics.states())

    def add_pusher(self, pusher: Pusher) -> None:
        """Add a pusher, beside the hand, from the next step on."""
        self._pushers.append(pusher)

    def throw(self, body: SceneBody) -> int:
        """Add a body to the scene with the next step, whatever its `start_time`. ValueError for a static body.

        Returns its id, which is also that of its one fragment.
        """
        return self._cast.throw(body)

    def take_out(self, body_id: int) -> None:
        """Remove a body with all its fragments. KeyError if no movable body has this id."""
        if self.drag.held in self._cast.take_out(body_id, self.dynamics):
            self.drag.release()

    def start_bodies(self) -> list[CollisionBody]:
        """All bodies of the scene, to be published before the first states; returns the same if called again."""
        return self._cast.announce()

    def begin_step(self) -> StepRequest:
        """Request the contacts at the present time. Repeated before the answer, it has the same states and events."""
        self._cast.enter_until(self.time + 1e-9 * self._scene.time_step)
        if self.robot is not None:
            self._cast.move_waiting(self.robot.fragment_ids, self.robot.frames())
        # A fragment that waits for the registry may be the one to push: then pushes are not planned.
        if self._looks_ahead and self._planned is None and not self._cast.waiting:
            states = self.dynamics.states()
            self._planned = planned(states.fragment_ids, self._pushes(states), self._taken)
        searched = self.dynamics.begin(self._planned)
        waiting = {i: self._falling(frame) for i, frame in self._cast.waiting.items()}
        others = self._cast.static_frames | waiting | dict(self.dynamics.links())
        requested = fragment_states(self._step, self._sequence, searched, others)
        self._requested = requested._replace(body_sequence=self._cast.body_sequence)
        return StepRequest(self._requested, self._cast.take_news(), list(self._events))

    def finish_step(self, contacts: ContactConstraintArray, registry: FragmentRegistry) -> StepReport:
        """Advance one time step with the answer. ValueError if it answers another request.

        Warns, once per change, if the service does not look ahead as this simulation counts on.
        """
        requested = self._require_answer(contacts, registry)
        if words := self.unexpected(contacts):
            warnings.warn(words, stacklevel=2)
        self._events.clear()
        self._cast.admit_waiting(registry, self.dynamics)
        states = self.dynamics.states()
        plan, self._planned = self._planned, None
        pushes = self._pushes(states) if plan is None else Pushes(plan.pushes.of(states.fragment_ids), plan.energy)
        is_pushed = bool(pushes.velocities.any())
        if self._still is not None and self._still.goes_on(states, contacts) and not is_pushed:
            self._step += 1
            return self._still.report._replace(step=requested.step, time=self.time)
        started = time.perf_counter()
        given, deepest_gap = self._given(states, contacts, requested, pushes.velocities, plan)
        solved = self.dynamics.solve(given)
        if self._looks_ahead:
            self._taken = ByFragment(states.fragment_ids, solved.taken)
        gained = self.dynamics.move()
        solver_seconds = time.perf_counter() - started
        self._step += 1

        moved = self.dynamics.states()
        kinetic, potential = self._energies(moved)
        started = time.perf_counter()
        self._break_overloaded(given, moved, solved)
        report = StepReport(
            step=requested.step,
            time=self.time,
            contacts=len(contacts.gaps),
            fragments=len(moved.fragment_ids),
            solver_seconds=solver_seconds,
            fracture_seconds=time.perf_counter() - started if len(solved.overloaded) else 0.0,
            kinetic_energy=kinetic,
            potential_energy=potential,
            drift_energy=gained.drift_energy,
            max_speed=float(lengths(moved.linear).max(initial=0.0)),
            deepest_gap=deepest_gap,
            events=list(self._events),
            hand_energy=pushes.energy + gained.robot_energy,
        )
        self._still = None
        if self.dynamics.is_asleep() and not is_pushed:
            self._still = _Still(moved, contacts, report._replace(solver_seconds=0.0))
        return report

    def _energies(self, states: BodyStates) -> tuple[float, float]:
        """Kinetic and potential energy [J] of all bodies but a robot's, whose masses its own engine has."""
        masses, inertias = states.masses, states.inertias
        if self.robot is not None:
            counted = ~np.isin(states.fragment_ids, self.robot.fragment_ids)
            masses, inertias = counted * masses, counted[:, None, None] * inertias
        kinetic = kinetic_energy(masses, inertias, states.velocities())
        return kinetic, -float((masses * dots(states.centers, self._scene.gravity)).sum())

    def unexpected(self, contacts: ContactConstraintArray) -> str:
        """What of the service's settings this simulation does not expect, and what to do; "": nothing, or nothing new.

        Whoever asks tells the user: `finish_step` then does not warn of it again.
        """
        return self._lookahead_check.unexpected(contacts.lookahead)

    def strike(self, fragment_id: int, point: np.ndarray, overload: float) -> bool:
        """Break a fragment between two steps, as a blow at `point` (3,) [m] of its body frame would, without a push.

        `overload` is the blow's impulse over the material's strength. Returns False if the fragment holds together.
        ValueError if no such fragment is in motion, or its body does not break.
        """
        states = self.dynamics.states()
        rows = np.flatnonzero(states.fragment_ids == fragment_id)
        if not len(rows):
            raise ValueError(f"fragment {fragment_id} is not in motion")
        self._fracture_of(fragment_id)
        return self._break(fragment_id, states.frame(rows[0]), np.asarray(point, dtype=np.float64), overload)

    def _require_answer(self, contacts: ContactConstraintArray, registry: FragmentRegistry) -> FragmentStates:
        """The requested states; ValueError if contacts and registry belong to others."""
        requested = (self._step, self._sequence)
        if self._requested is None or self._requested.step != self._step:
            raise ValueError(f"step {self._step} has not begun: call begin_step first")
        if (contacts.step, contacts.fracture_sequence) != requested or registry.fracture_sequence != self._sequence:
            raise ValueError(
                f"needs the answer to (step, fracture_sequence) {requested}, got contacts of"
                f" {(contacts.step, contacts.fracture_sequence)} and the registry of {registry.fracture_sequence}"
            )
        return self._requested

    def _given(
        self, states: BodyStates, contacts: ContactConstraintArray, requested: FragmentStates, pushes: np.ndarray,
        plan: Planned | None,
    ) -> tuple[Given, float]:  # fmt: skip
        """The contacts of `requested` as the engine gets them, with pushes (n, 6), and their smallest gap [m]."""
        if self.robot is not None:
            contacts = self._without_robots_own(contacts)
        deepest_gap = float(contacts.gaps.min(initial=0.0))
        settings, traits = self._scene.solver, self._traits(states)
        shared = shared_traits(contacts, traits, self._cast)
        split = split_by_gap(contacts, self._sizes_of_waiting(contacts, shared, states), settings.ahead_gap)
        ahead, of_ahead, counts = split.ahead, shared.of(split.pairs_ahead), np.diff(split.ahead.pair_begin)
        pairs_ahead = self._body_pairs(of_ahead, np.repeat(settings.rest_gap * of_ahead.sizes, counts))
        contacts, shared = split.now, shared.of(split.pairs)
        reach = settings.memory_reach * shared.sizes
        contacts, self._memory = with_remembered(contacts, requested, self._memory, reach)
        gaps = rest_gaps_of(self._memory, shared.is_one_body, settings.rest_gap * shared.sizes)
        pairs = self._body_pairs(shared, gaps)
        return Given(states, StepContacts(contacts, pairs, ahead, pairs_ahead), traits, pushes, plan), deepest_gap

    def _break_overloaded(self, given: Given, moved: BodyStates, solved: Solved) -> None:
        """Break the overloaded fragments, those of the `given` states before the step; `moved`: after it."""
        states, (contacts, pairs, *_) = given.states, given.contacts
        for i in solved.overloaded:
            impact, load = hardest_hit(i, contacts, pairs, solved.normal_impulses)
            fragment_id = int(states.fragment_ids[i])
            # The impact point in the pose before the step.
            impact = turned_back(states.frame_orientations[i], impact - states.frame_positions[i])
            overload = load / self._fracture_of(fragment_id).strength
            if not self._break(fragment_id, moved.frame(i), impact, overload):
                self._held_together.add(fragment_id)
                self._known_traits = None

    def _fracture_of(self, fragment_id: int) -> Fracture:
        body = self._cast.scene_body(fragment_id)
        if body.material.fracture is None or self._cast.body_id_of[fragment_id] not in self._cast.breakable:
            raise ValueError(f"fragment {fragment_id} of {body.name!r} cannot break")
        return body.material.fracture

    def _pushes(self, states: BodyStates) -> Pushes:
        return pushes_of(self._pushers, states, self.time, self._scene.time_step, self._scene.gravity)

    def _without_robots_own(self, contacts: ContactConstraintArray) -> ContactConstraintArray:
        """Contacts without those between two bodies of the robot, and between it and what cannot move."""
        a, b = (np.isin(of, self._not_pushed_by_robot) for of in (contacts.fragment_a, contacts.fragment_b))
        others = ~(a & b)
        return chosen_contacts(contacts, np.repeat(others, np.diff(contacts.pair_begin)), others)

    def _sizes_of_waiting(
        self, contacts: ContactConstraintArray, shared: SharedTraits, states: BodyStates
    ) -> np.ndarray:
        """R (p,) [m] of the pairs; inf where nothing waits for a touch, as beside a robot: see robot_contacts."""
        if self.robot is None:
            return shared.sizes
        rows, begin = robot_rows(self.robot, states), contacts.pair_begin.astype(np.int64)
        beside = beside_robot(rows, begin, shared.body_a, shared.body_b, len(states.masses))
        return np.where(beside[shared.body_a] | beside[shared.body_b], np.inf, shared.sizes)

    def _falling(self, frame: FrameState) -> FrameState:
        """The frame with the velocity that it will have: as _to_search, without the torque that needs its inertia."""
        return frame._replace(linear_velocity=frame.linear_velocity + self._scene.time_step * self._scene.gravity)

    def _body_pairs(self, shared: SharedTraits, rest_gaps: np.ndarray) -> BodyPairs:
        bounces = bounce_speeds(self._scene.solver, shared.sizes, self._scene.gravity)
        return BodyPairs(shared.body_a, shared.body_b, shared.rolling_arm, shared.sizes, bounces, rest_gaps)

    def _traits(self, states: BodyStates) -> Traits:
        if self._known_traits is None or not np.array_equal(self._known_traits.fragment_ids, states.fragment_ids):
            self._known_traits = traits_of(
                states, self._cast.body_of, self._cast.sizes, self._cast.body_id_of, self._cast.breakable,
                self._held_together,
            )  # fmt: skip
        return self._known_traits

    def _break(self, fragment_id: int, frame: FrameState, impact: np.ndarray, overload: float) -> bool:
        """Break a fragment at `impact` (3,) [m], body frame. False if it holds together."""
        body_id = self._cast.body_id_of[fragment_id]
        event = self._cast.breakable[body_id].fracture(
            fragment_id, self._sequence + 1, self._cast.next_fragment_id, impact, overload,
            self._fracture_of(fragment_id).pattern,
            np.random.default_rng([self._seed, self._sequence + 1]),
        )  # fmt: skip
        if event is None:
            return False
        self._sequence += 1
        self._events.append(event)
        self._cast.replace(event, frame, self.dynamics)
        self.drag.keep_hold(body_id, fragment_id)
        return True
