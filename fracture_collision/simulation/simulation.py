"""The simulator without transport: its requests to the collision service, and its use of the answers.

One step, from t_n to t_n+1:

    begin_step     bodies, fracture events and the states at t_n, for the service
    finish_step    its contacts at t_n and the fragments' masses; new fragments enter the engine with their parent's
                   velocity field; contacts are solved for the velocities at t_n+1, gravity included; the engine moves
                   all poses; fragments hit harder than they bear break, and their events go out with the next states

Impacts that break. To a contact solver bodies are infinitely strong: a ball would bounce off a plate that breaks in
that instant. A real plate transmits no more than its strength, so where the normal impulses on a fragment sum up to
more than that, all its contacts are capped in proportion and the step is solved again: the ball loses the capped
impulse, keeps the rest of its momentum and meets the pieces in the next step.
"""

from __future__ import annotations

import time
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
from fracture_collision.simulation.actors.drag import Drag
from fracture_collision.simulation.body_traits import Traits, traits_of
from fracture_collision.simulation.cast import Cast
from fracture_collision.simulation.engine.engine import BodyStates, Engine, FrameState, rows_of
from fracture_collision.simulation.engine.free_motion import free_velocities
from fracture_collision.simulation.engine.pushes import NO_CHANGES, Changes, Planned, Pusher, Pushes, planned, pushes_of
from fracture_collision.simulation.engine.rigid_body_world import RigidBodyWorld
from fracture_collision.simulation.rotations import turned_back
from fracture_collision.simulation.scene.scene import Scene, SceneBody
from fracture_collision.simulation.solver import contact_memory, sleep
from fracture_collision.simulation.solver.contact_memory import with_remembered
from fracture_collision.simulation.solver.contact_solver import (
    NO_WARM_START,
    BodyPairs,
    RigidBodies,
    Solution,
    kinetic_energy,
    normal_impulse_sums,
    solve_contacts,
)
from fracture_collision.simulation.solver.rest_gaps import rest_gaps_of
from fracture_collision.simulation.solver.touch_ahead import held_back, split_by_gap

_NO_GRAVITY = np.zeros(3)


class StepRequest(NamedTuple):
    """Records to publish before the service can answer."""

    states: FragmentStates
    bodies: list[CollisionBody]  # not yet announced, neither by `start_bodies` nor by an earlier request
    events: list[FractureEvent]  # since the last request


class StepReport(NamedTuple):
    """Figures of one step."""

    step: int
    time: float  # [s] at the end of the step
    contacts: int  # listed by the service
    fragments: int  # in motion
    solver_seconds: float  # wall time of the contact solver
    fracture_seconds: float  # wall time of making the patterns; 0 where nothing was hit hard enough
    kinetic_energy: float  # [J] at the end of the step
    potential_energy: float  # [J] in the scene's gravity, relative to the world's origin
    drift_energy: float  # [J] potential energy added by this step's drift correction in lifting bodies
    max_speed: float  # [m/s] of any centre of mass at the end of the step
    deepest_gap: float  # [m] the smallest gap among the contacts that are solved; 0 without
    events: list[FractureEvent]  # of this step, published with the next request
    hand_energy: float  # [J] added by hand, hammer and arm; negative where they removed some


class Simulation:
    """A run of one scene. The same scene, seed and answers give the same states, byte for byte.

    `seed`, if given, replaces the scene's, `engine` the RigidBodyWorld. looks_ahead: the contacts come from a service
    that looks a step ahead (its parameter `lookahead`), see touch_ahead.
    """

    def __init__(
        self, scene: Scene, seed: int | None = None, engine: Engine | None = None, looks_ahead: bool = False
    ) -> None:
        self._scene = scene
        self._seed = scene.seed if seed is None else seed
        self._looks_ahead = looks_ahead
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
        self._asked: FragmentStates | None = None
        self._planned: Planned | None = None  # of this step, where the service gets the pushes in advance
        self._taken = NO_CHANGES  # by contacts in the last step
        self.shares = np.ones(0)  # of the last step, for which its bodies moved: see touch_ahead
        names = {i: body.name for i, body in self._cast.body_of.items()}
        self.drag = Drag(scene.hand, names, self._cast.body_id_of, self._cast.breakable)
        self._pushers: list[Pusher] = [self.drag]
        self.arm: ArmControl | None = None  # the scene's
        if scene.arm is not None:
            ids = {name: i for i, name in names.items()}
            self.arm = ArmControl(scene.arm, [ids[part.name] for part in PARTS])
            self._pushers.append(self.arm)

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
        self._asked = self._states()
        return StepRequest(self._asked, self._cast.take_news(), list(self._events))

    def finish_step(self, contacts: ContactConstraintArray, registry: FragmentRegistry) -> StepReport:
        """Advance one time step with the answer. ValueError if it answers another request."""
        asked = (self._step, self._sequence)
        if self._asked is None or self._asked.step != self._step:
            raise ValueError(f"step {self._step} has not begun")
        if (contacts.step, contacts.fracture_sequence) != asked or registry.fracture_sequence != self._sequence:
            raise ValueError(
                f"asked for (step, fracture_sequence) {asked}, got contacts of"
                f" {(contacts.step, contacts.fracture_sequence)} and the registry of {registry.fracture_sequence}"
            )
        self._events.clear()
        self._cast.admit_waiting(registry, self._engine)
        states = self._engine.states()
        started = time.perf_counter()
        listed = len(contacts.gaps)
        if self.arm is not None:
            contacts = self.arm.without_own(contacts)
        deepest_gap = float(contacts.gaps.min(initial=0.0))
        contacts, ahead = split_by_gap(contacts, self._scene.solver.ahead_gap)
        touched = self._memory.fragment_a, self._memory.fragment_b
        contacts, self._memory = with_remembered(
            contacts, self._asked, self._memory, self._scene.solver.memory_reach
        )
        pairs = self._body_pairs(contacts, states)
        told = _velocities(self._told(states)) if self._looks_ahead else None
        if self._planned is None:
            pushes = self._pushes(states)
        else:
            pushes = Pushes(self._planned.pushes.of(states.fragment_ids), self._planned.energy)
        self._planned = None
        bodies = self._rigid_bodies(states, pushes.velocities)
        rest = sleep.roused(self._rest, states.fragment_ids, touched, pushes.velocities.any(axis=1))
        rest = sleep.settled(rest, self._memory.pair_begin, pairs.body_a, pairs.body_b, self._scene.solver.sleep_time)
        solution, overloaded = self._solve(bodies, contacts, pairs, self._traits(states).strengths, rest.asleep)
        solver_seconds = time.perf_counter() - started
        if self._looks_ahead:
            self._taken = Changes(states.fragment_ids, solution.velocities - bodies.free_velocities)
        v, drift = solution.velocities, solution.drift
        v, drift, self.shares = held_back(
            states, contacts, pairs, ahead, told, self._traits(states).is_round, v, drift, self._scene.gravity,
            self._scene.solver, self._scene.time_step,
        )  # fmt: skip
        self._engine.advance(v[:, :3], v[:, 3:], drift[:, :3], drift[:, 3:])
        self._warm_start = solution.warm_start
        self._rest = sleep.after_step(
            rest, states.masses, states.inertias, v + drift, self._scene.solver, self._scene.time_step
        )
        self._step += 1

        moved = self._engine.states()
        energy = kinetic_energy(moved.masses, moved.inertias, _velocities(moved))
        lifted = -float((moved.masses * dots(solution.drift[:, :3], self._scene.gravity)).sum()) * self._scene.time_step
        started = time.perf_counter()
        for i in overloaded:
            impact, load = _hardest_hit(i, contacts, pairs, solution)
            fragment_id = int(states.fragment_ids[i])
            strength = self._cast.scene_body(fragment_id).material.fracture.strength
            # The impact point in the pose before the step.
            impact = turned_back(states.frame_orientations[i], impact - states.frame_positions[i])
            if not self._break(fragment_id, moved.frame(i), impact, load / strength):
                self._held_together.add(fragment_id)
                self._known_traits = None
        return StepReport(
            step=asked[0],
            time=self.time,
            contacts=listed,
            fragments=len(moved.fragment_ids),
            solver_seconds=solver_seconds,
            fracture_seconds=time.perf_counter() - started if len(overloaded) else 0.0,
            kinetic_energy=energy,
            potential_energy=-float((moved.masses * dots(moved.centers, self._scene.gravity)).sum()),
            drift_energy=lifted,
            max_speed=float(lengths(moved.linear).max(initial=0.0)),
            deepest_gap=deepest_gap,
            events=list(self._events),
            hand_energy=pushes.energy,
        )

    def strike(self, fragment_id: int, point: np.ndarray, overload: float) -> bool:
        """Break a fragment between two steps, as a blow at `point` (3,) [m] of its body frame would, without a push.

        `overload` is the blow's impulse over the material's strength. Returns False if the fragment holds together.
        ValueError if no such fragment is in motion, or its body does not break.
        """
        states = self._engine.states()
        rows = np.flatnonzero(states.fragment_ids == fragment_id)
        if not len(rows):
            raise ValueError(f"fragment {fragment_id} is not in motion")
        body = self._cast.scene_body(fragment_id)
        if body.material.fracture is None or self._cast.body_id_of[fragment_id] not in self._cast.breakable:
            raise ValueError(f"fragment {fragment_id}, of {body.name!r}, is of a kind that does not break")
        return self._break(fragment_id, states.frame(rows[0]), np.asarray(point, dtype=np.float64), overload)

    def _pushes(self, states: BodyStates) -> Pushes:
        return pushes_of(self._pushers, states, self.time, self._scene.time_step, self._scene.gravity)

    def _told(self, states: BodyStates) -> BodyStates:
        """`states` with the velocities of the coming step before contacts and gravity.

        Otherwise the look-ahead would miss what a hand adds, and the gyroscopic torque, which turns the axis of a fast
        shard by a radian.
        """
        velocities = _velocities(states)
        if self._planned is not None:
            velocities = velocities + self._planned.expected.of(states.fragment_ids)
        free = free_velocities(velocities, states.inertias, _NO_GRAVITY, self._scene.time_step)
        return states._replace(linear=velocities[:, :3].copy(), angular=free[:, 3:].copy())

    def _states(self) -> FragmentStates:
        moving = self._told(self._engine.states())
        others = self._cast.static_frames | self._cast.waiting
        ids = np.concatenate((moving.fragment_ids, np.array(list(others), dtype=np.uint32)))
        order = np.argsort(ids, kind="stable")
        in_engine = FrameState(
            moving.frame_positions, moving.frame_orientations, moving.frame_velocities(), moving.angular
        )
        columns = [
            np.concatenate((values, np.array([frame[k] for frame in others.values()]).reshape(-1, values.shape[1])))
            for k, values in enumerate(in_engine)
        ]
        return FragmentStates(self._step, self._sequence, ids[order], *[column[order].ravel() for column in columns])

    def _rigid_bodies(self, states: BodyStates, pushes: np.ndarray) -> RigidBodies:
        velocities = _velocities(states) + pushes
        free = free_velocities(velocities, states.inertias, self._scene.gravity, self._scene.time_step)
        return RigidBodies(states.masses, states.inertias, states.centers, velocities, free)

    def _body_pairs(self, contacts: ContactConstraintArray, states: BodyStates) -> BodyPairs:
        immovable = len(states.fragment_ids)
        traits = self._traits(states)
        arms_of, bodies_of = traits.rolling_arms, traits.body_ids

        def rows_and_arms(fragments: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            rows = rows_of(fragments, states.fragment_ids)
            arms = arms_of[rows]
            for fragment in np.unique(fragments[rows == immovable]).tolist():
                if fragment not in self._cast.body_id_of or not self._cast.scene_body(fragment).is_static:
                    raise ValueError(f"contacts of step {contacts.step}: fragment {fragment} is not in the states")
                arms[fragments == fragment] = self._cast.scene_body(fragment).material.rolling_arm
            return rows, arms

        (a, arms_a), (b, arms_b) = rows_and_arms(contacts.fragment_a), rows_and_arms(contacts.fragment_b)
        one_body = (bodies_of[a] == bodies_of[b]) & (a < immovable)
        rest_gaps = rest_gaps_of(self._memory, one_body, self._scene.solver.rest_gap)
        return BodyPairs(a, b, np.maximum(arms_a, arms_b), rest_gaps)

    def _solve(
        self, bodies: RigidBodies, contacts: ContactConstraintArray, pairs: BodyPairs, strengths: np.ndarray,
        asleep: np.ndarray,
    ) -> tuple[Solution, np.ndarray]:  # fmt: skip
        """Solution, and the rows of the bodies that break. `strengths` (n,) [N s] of the bodies, `asleep` (n,)."""
        settings, time_step = self._scene.solver, self._scene.time_step
        solution = solve_contacts(bodies, contacts, pairs, self._warm_start, settings, time_step, asleep=asleep)
        count = len(bodies.masses)
        loads = normal_impulse_sums(solution, contacts, pairs, count)
        overloaded = np.flatnonzero(loads > strengths)
        if len(overloaded):
            share = np.ones(count + 1)
            share[overloaded] = strengths[overloaded] / loads[overloaded]
            share = np.repeat(np.minimum(share[pairs.body_a], share[pairs.body_b]), np.diff(contacts.pair_begin))
            limits = np.where(share < 1.0, share * solution.normal_impulses, np.inf)
            capped = solve_contacts(
                bodies, contacts, pairs, solution.warm_start, settings, time_step, limits, solution, asleep
            )
            # No body enters a fragment before it has broken: in this step poses move as if it held. And the impact
            # point follows from the uncapped impulses that broke it.
            solution = capped._replace(
                drift=solution.drift + solution.velocities - capped.velocities,
                normal_impulses=solution.normal_impulses,
            )
        return solution, overloaded

    def _traits(self, states: BodyStates) -> Traits:
        if self._known_traits is None or not np.array_equal(self._known_traits.fragment_ids, states.fragment_ids):
            self._known_traits = traits_of(
                states, self._cast.body_of, self._cast.body_id_of, self._cast.breakable, self._held_together
            )
        return self._known_traits

    def _break(self, fragment_id: int, frame: FrameState, impact: np.ndarray, overload: float) -> bool:
        """Break a fragment at `impact` (3,) [m], body frame. False if it holds together."""
        body_id = self._cast.body_id_of[fragment_id]
        event = self._cast.breakable[body_id].fracture(
            fragment_id, self._sequence + 1, self._cast.next_fragment_id, impact, overload,
            self._cast.scene_body(fragment_id).material.fracture.pattern,
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


def _hardest_hit(
    row: int, contacts: ContactConstraintArray, pairs: BodyPairs, solution: Solution
) -> tuple[np.ndarray, float]:
    """Impact point (world, [m]) and impulse [N s] of the neighbour that hit a body hardest."""
    begin = contacts.pair_begin.astype(np.int64)
    impulses = solution.normal_impulses
    best, best_load = -1, -1.0
    for pair in np.flatnonzero((pairs.body_a == row) | (pairs.body_b == row)):
        load = float(impulses[begin[pair] : begin[pair + 1]].sum())
        if load > best_load:
            best, best_load = pair, load
    those = slice(begin[best], begin[best + 1])
    points = (contacts.points_a if pairs.body_a[best] == row else contacts.points_b).reshape(-1, 3)
    return (impulses[those, None] * points[those]).sum(axis=0) / best_load, best_load
