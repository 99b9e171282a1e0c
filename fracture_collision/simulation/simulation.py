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
from typing import NamedTuple

import numpy as np

from fracture_collision.portable_math import dots, lengths
from fracture_collision.records import (
    CollisionBody,
    ContactConstraintArray,
    FractureEvent,
    FragmentRegistry,
    FragmentStates,
)
from fracture_collision.simulation.actors.arm import PARTS
from fracture_collision.simulation.actors.arm_control import ArmControl
from fracture_collision.simulation.actors.hand import Drag
from fracture_collision.simulation.cast import Cast, SharedTraits, Traits, shared_traits, traits_of
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
from fracture_collision.simulation.engine import (
    NO_CHANGES,
    BodyStates,
    ByFragment,
    FrameState,
    Planned,
    Pusher,
    Pushes,
    RigidBodyWorld,
    free_velocities,
    mean_spins,
    planned,
    pushes_of,
)
from fracture_collision.simulation.rotations import turned_back
from fracture_collision.simulation.scene.scene import Fracture, Scene, SceneBody
from fracture_collision.simulation.solver import contact_memory, sleep
from fracture_collision.simulation.solver.contact_memory import rest_gaps_of, with_remembered
from fracture_collision.simulation.solver.contact_solver import (
    Again,
    BodyPairs,
    RigidBodies,
    Solution,
    bounce_speeds,
    flight_drift,
    hardest_hit,
    kinetic_energy,
    solve_contacts,
    solve_with_strengths,
)
from fracture_collision.simulation.solver.touch_ahead import Course, StepContacts, shares_of_step, split_by_gap
from fracture_collision.simulation.solver.warm_start import NO_WARM_START
from fracture_collision.simulation.step_records import LookaheadCheck, StepReport, StepRequest, fragment_states


class _Solved(NamedTuple):
    """The solved contacts of a step, before the bodies move."""

    contacts: StepContacts
    bodies: RigidBodies  # with gravity for the time in which they move if nothing holds them back
    searched: np.ndarray | None  # (n, 6) velocities that the service looked ahead with; None: it does not
    solution: Solution
    limits: np.ndarray  # (N,) [N s] of the contacts' impulses: what materials bear
    flight: np.ndarray  # (n, 6) drift of bodies in free flight
    overloaded: np.ndarray  # rows of the bodies that break
    deepest_gap: float  # [m]
    pushed_energy: float  # [J] added by hand, hammer and arm


class Simulation:
    """A run of one scene. The same scene, seed and answers give the same states, byte for byte.

    `seed`, if given, replaces the scene's, `engine` the RigidBodyWorld. looks_ahead: the contacts come from a service
    that looks a step ahead (its parameter `lookahead`), see touch_ahead.
    """

    def __init__(
        self, scene: Scene, seed: int | None = None, engine: RigidBodyWorld | None = None, looks_ahead: bool = False
    ) -> None:
        self._scene = scene
        self._seed = scene.seed if seed is None else seed
        self._looks_ahead = looks_ahead
        self._lookahead_check = LookaheadCheck(scene.time_step if looks_ahead else None)
        self._engine = RigidBodyWorld(scene.time_step) if engine is None else engine
        self._step = 0
        self._sequence = 0
        self._cast = Cast(scene.bodies)
        self._events: list[FractureEvent] = []
        self._held_together: set[int] = set()  # fragments hit hard enough, but with no pattern to break by
        self._known_traits: Traits | None = None
        self._warm_start = NO_WARM_START
        self._memory = contact_memory.NOTHING
        self._rest = sleep.NOBODY
        self._requested: FragmentStates | None = None
        self._searched: tuple[BodyStates, BodyStates] | None = None  # of the request, and as they are searched
        self._planned: Planned | None = None  # of this step, where the service gets the pushes in advance
        self._taken = NO_CHANGES  # by contacts in the last step
        self.shares = np.ones(0)  # of their courses in the last step, for which bodies moved: see touch_ahead
        self._waited: Waited | None = None  # the last step, if the next one has to make up for it
        self._lost = NOTHING.extra  # (n,) [s] that bodies are behind
        self._expected = NOTHING  # of this step
        self._carried: Touching | None = None  # to this step, from the last one that had to be made up for
        names = {i: body.name for i, body in self._cast.body_of.items()}
        self.drag = Drag(scene.hand, names, self._cast.body_id_of, self._cast.breakable)
        self._pushers: list[Pusher] = [self.drag]
        self.arm: ArmControl | None = None  # the scene's
        if scene.arm is not None:
            ids = {name: i for i, name in names.items()}
            self.arm = ArmControl(scene.arm, [ids[part.name] for part in PARTS])
            self._pushers.append(self.arm)

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
        self._engine.close()

    def grab(self, name: str, position: np.ndarray) -> bool:
        """`drag.grab` among the bodies in motion; `drag` moves the hand and lets go."""
        return self.drag.grab(name, position, self._engine.states())

    def hold(self, fragment_id: int, point: np.ndarray, position: np.ndarray) -> bool:
        """`drag.hold` among the bodies in motion."""
        return self.drag.hold(fragment_id, point, position, self._engine.states())

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
        if self.drag.held in self._cast.take_out(body_id, self._engine):
            self.drag.release()

    def start_bodies(self) -> list[CollisionBody]:
        """All bodies of the scene, to be published before the first states; returns the same if called again."""
        return self._cast.announce()

    def begin_step(self) -> StepRequest:
        """Request the contacts at the present time. Repeated before the answer, it has the same states and events."""
        self._cast.enter_until(self.time + 1e-9 * self._scene.time_step)
        # A fragment that waits for the registry may be the one to push: then pushes are not planned.
        if self._looks_ahead and self._planned is None and not self._cast.waiting:
            states = self._engine.states()
            self._planned = planned(states.fragment_ids, self._pushes(states), self._taken)
        if self._waited is not None:
            states = self._engine.states()  # of nothing, if all bodies have left or broken
            self._expected = self._expect(states, self._waited) if len(states.masses) else NOTHING
            self._waited = None
        others = self._cast.static_frames | {i: self._falling(frame) for i, frame in self._cast.waiting.items()}
        states = self._engine.states()
        self._searched = states, self._to_search(states)
        requested = fragment_states(self._step, self._sequence, self._searched[1], others)
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
        self._cast.admit_waiting(registry, self._engine)
        states = self._engine.states()
        started = time.perf_counter()
        solved = self._solve(states, contacts, requested)
        lifted = self._move(states, solved)
        solver_seconds = time.perf_counter() - started
        self._step += 1

        moved = self._engine.states()
        energy = kinetic_energy(moved.masses, moved.inertias, _velocities(moved))
        started = time.perf_counter()
        self._break_overloaded(states, moved, solved)
        return StepReport(
            step=requested.step,
            time=self.time,
            contacts=len(contacts.gaps),
            fragments=len(moved.fragment_ids),
            solver_seconds=solver_seconds,
            fracture_seconds=time.perf_counter() - started if len(solved.overloaded) else 0.0,
            kinetic_energy=energy,
            potential_energy=-float((moved.masses * dots(moved.centers, self._scene.gravity)).sum()),
            drift_energy=lifted,
            max_speed=float(lengths(moved.linear).max(initial=0.0)),
            deepest_gap=solved.deepest_gap,
            events=list(self._events),
            hand_energy=solved.pushed_energy,
        )

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
        states = self._engine.states()
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

    def _solve(self, states: BodyStates, contacts: ContactConstraintArray, requested: FragmentStates) -> _Solved:
        """Solve the contacts of `requested` for the velocities after the step, pushes and sleep included."""
        if self.arm is not None:
            contacts = self.arm.without_own(contacts)
        deepest_gap = float(contacts.gaps.min(initial=0.0))
        settings, traits = self._scene.solver, self._traits(states)
        shared = shared_traits(contacts, traits, self._cast)
        split = split_by_gap(contacts, shared.sizes, settings.ahead_gap)
        ahead, of_ahead, counts = split.ahead, shared.of(split.pairs_ahead), np.diff(split.ahead.pair_begin)
        pairs_ahead = self._body_pairs(of_ahead, np.repeat(settings.rest_gap * of_ahead.sizes, counts))
        contacts, shared = split.now, shared.of(split.pairs)
        touched = self._memory.fragment_a, self._memory.fragment_b
        reach = settings.memory_reach * shared.sizes
        contacts, self._memory = with_remembered(contacts, requested, self._memory, reach)
        gaps = rest_gaps_of(self._memory, shared.is_one_body, settings.rest_gap * shared.sizes)
        pairs = self._body_pairs(shared, gaps)
        searched = None
        if self._looks_ahead:  # with the bodies of the request, or with more that had waited for the registry
            if self._searched is None or self._searched[0] is not states:
                self._searched = states, self._to_search(states)
            searched = _velocities(self._searched[1])
        if self._planned is None:
            pushes = self._pushes(states)
        else:
            pushes = Pushes(self._planned.pushes.of(states.fragment_ids), self._planned.energy)
        self._planned = None
        rest = sleep.roused(self._rest, states.fragment_ids, touched, np.any(pushes.velocities, axis=1))
        self._rest = sleep.settled(rest, self._memory.pair_begin, pairs.body_a, pairs.body_b, settings.sleep_time)
        bodies = self._rigid_bodies(states, pushes.velocities, self._spans(states), self._rest.asleep)
        solution, overloaded, limits = solve_with_strengths(
            bodies, contacts, pairs, self._warm_start, settings, traits.strengths
        )
        flight = self._flight(bodies, contacts, pairs, solution, self._rest.asleep | np.any(pushes.velocities, axis=1))
        if self._looks_ahead:
            self._taken = ByFragment(states.fragment_ids, solution.velocities - bodies.free_velocities)
        return _Solved(
            StepContacts(contacts, pairs, ahead, pairs_ahead), bodies, searched, solution, limits, flight, overloaded,
            deepest_gap, pushes.energy,
        )  # fmt: skip

    def _move(self, states: BodyStates, solved: _Solved) -> float:
        """Move the bodies as far as they may; returns the energy [J] that drift correction adds in lifting them."""
        gravity, settings, time_step = self._scene.gravity, self._scene.solver, self._scene.time_step
        (bodies, solution), forms = (solved.bodies, solved.solution), self._traits(states).forms
        rates = (bodies.spans / time_step)[:, None]
        moves = rates * (solution.velocities + solution.drift + solved.flight)
        falls = rates * (bodies.free_velocities - bodies.velocities)[:, :3]
        is_expected = self._expected.velocities.have(states.fragment_ids)
        course = Course(moves, solved.searched, falls, is_expected)
        self.shares = shares_of_step(states, solved.contacts, course, forms, settings, time_step)
        moved = self.shares * bodies.spans
        if (self.shares < 1.0).any():
            solution = self._solved_until(moved, solved)
        self._warm_start, v = solution.warm_start, solution.velocities
        drift = self.shares[:, None] * moves - v
        self._engine.advance(v[:, :3], v[:, 3:], drift[:, :3], drift[:, 3:])
        farthest = sleep.farthest_at_rest(settings, forms.sizes[:-1], gravity)
        self._rest = sleep.after_step(self._rest, states.masses, states.inertias, v + drift, farthest, time_step)
        if self._looks_ahead:
            self._remember_waiting(states, solved, moved)
        return -float((states.masses * moved * dots(solved.solution.drift[:, :3], gravity)).sum())

    def _remember_waiting(self, states: BodyStates, solved: _Solved, moved: np.ndarray) -> None:
        """Keep what the next step needs to make up for this one, in which bodies moved for `moved` (n,) [s]."""
        is_held = self.shares < 1.0
        is_at_rest = (self._rest.quiet > 0.0) & ~is_held
        lost = np.clip(self._lost.of(states.fragment_ids) + self._scene.time_step - moved, 0.0, None)
        lost = np.where(is_at_rest, 0.0, np.minimum(lost, MOST_LOST * self._scene.time_step))
        carried, self._carried = self._carried, None
        self._lost, self._expected = ByFragment(states.fragment_ids, lost), NOTHING
        if is_held.any() or lost.any():
            is_round = self._traits(states).forms.is_round[:-1]
            self._waited = Waited(states, solved.contacts, carried, is_round, is_held, is_at_rest, lost)

    def _solved_until(self, moved: np.ndarray, solved: _Solved) -> Solution:
        """The solution with gravity for the times `moved` (n,) [s] only: bodies that waited gain no energy by it."""
        bodies, held = solved.bodies, moved < solved.bodies.spans
        free = free_velocities(bodies.velocities, bodies.inertias, self._scene.gravity, moved)
        alone = np.where(held[:, None], free, solved.solution.velocities)
        again = Again(held, solved.limits, solved.solution._replace(velocities=alone))
        return solve_contacts(
            bodies._replace(free_velocities=free), solved.contacts.now, solved.contacts.pairs,
            solved.solution.warm_start, self._scene.solver, again,
        )  # fmt: skip

    def _expect(self, states: BodyStates, waited: Waited) -> Expected:
        """What is known of the coming step, after one in which bodies waited; see catching_up."""
        settings, ids, time_step = self._scene.solver, states.fragment_ids, self._scene.time_step
        contacts, pairs = self._carried = carried_contacts(waited, states, settings)
        pushes = np.zeros((len(ids), 6)) if self._planned is None else self._planned.pushes.of(ids)
        extra, is_expected = extra_times(waited, states, np.any(pushes, axis=1), self._carried, time_step)
        bodies = self._rigid_bodies(states, pushes, time_step + extra, np.zeros(len(ids), bool))
        still, zeros = np.zeros((len(ids), 6)), np.zeros(len(contacts.gaps))
        nothing = Solution(bodies.free_velocities, still, zeros, zeros, self._warm_start)
        again = Again(is_expected, np.full(len(zeros), np.inf), nothing)
        roughly = settings._replace(accuracy=ROUGHLY, rounds=1)
        solution = solve_contacts(bodies, contacts, pairs, self._warm_start, roughly, again)
        return Expected(ByFragment(ids, extra), ByFragment(ids[is_expected], solution.velocities[is_expected]))

    def _break_overloaded(self, states: BodyStates, moved: BodyStates, solved: _Solved) -> None:
        """Break the overloaded fragments, those of `states` before the step; `moved`: after it."""
        for i in solved.overloaded:
            impact, load = hardest_hit(i, solved.contacts.now, solved.contacts.pairs, solved.solution)
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

    def _to_search(self, states: BodyStates) -> BodyStates:
        """`states` with the velocities of the coming step before contacts.

        Otherwise the look-ahead would miss what a hand adds, the gyroscopic torque, which turns the axis of a fast
        shard by a radian, and gravity, by which a body at rest beside a seam would fall into it. Bodies asleep do not
        fall. After a step in which bodies waited, the contacts of some are expected too.
        """
        velocities, spans, ids = _velocities(states), self._spans(states), states.fragment_ids
        if self._planned is not None:
            velocities = velocities + self._planned.expected.of(ids)
        free = free_velocities(velocities, states.inertias, self._scene.gravity, spans)
        asleep = ByFragment(self._rest.fragment_ids, self._rest.asleep).of(ids)
        linear = np.where(asleep[:, None], velocities[:, :3], free[:, :3])
        angular = mean_spins(velocities, free, states.inertias, spans)
        known = self._expected.velocities
        if len(known.fragment_ids):
            moves, is_known = known.of(ids), known.have(ids)[:, None]
            linear, angular = np.where(is_known, moves[:, :3], linear), np.where(is_known, moves[:, 3:], angular)
        rates = (spans / self._scene.time_step)[:, None]
        return states._replace(linear=rates * linear, angular=rates * angular)

    def _falling(self, frame: FrameState) -> FrameState:
        """The frame with the velocity that it will have: as _to_search, without the torque that needs its inertia."""
        return frame._replace(linear_velocity=frame.linear_velocity + self._scene.time_step * self._scene.gravity)

    def _spans(self, states: BodyStates) -> np.ndarray:
        """(n,) [s] for which bodies move in this step, if nothing holds them back."""
        return self._scene.time_step + self._expected.extra.of(states.fragment_ids)

    def _rigid_bodies(
        self, states: BodyStates, pushes: np.ndarray, spans: np.ndarray, asleep: np.ndarray
    ) -> RigidBodies:
        velocities = _velocities(states) + pushes
        free = free_velocities(velocities, states.inertias, self._scene.gravity, spans)
        masses, inertias = states.masses, states.inertias
        return RigidBodies(masses, inertias, states.centers, velocities, free, spans, asleep)

    def _flight(
        self, bodies: RigidBodies, contacts: ContactConstraintArray, pairs: BodyPairs, solution: Solution,
        is_other: np.ndarray,
    ) -> np.ndarray:  # fmt: skip
        """flight_drift; is_other (n,) bool: are not in free flight."""
        free = bodies.free_velocities
        turned = mean_spins(bodies.velocities, free, bodies.inertias, bodies.spans) - free[:, 3:]
        return flight_drift(
            bodies, turned, self._scene.gravity, (solution.velocities, solution.normal_impulses), is_other,
            (solution.pressing, contacts.pair_begin, pairs.body_a, pairs.body_b),
        )  # fmt: skip

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
        self._cast.replace(event, frame, self._engine)
        self.drag.keep_hold(body_id, fragment_id)
        return True


def _velocities(states: BodyStates) -> np.ndarray:
    """Linear and angular velocities, (n, 6) [m/s, rad/s]."""
    return np.hstack((states.linear, states.angular))
