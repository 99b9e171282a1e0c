"""MuJoCo as the engine: it solves the service's contacts, and holds a model with actuators beside the scene's bodies.

MuJoCo has no way to be given contacts, but its stages can be called one by one: contacts are written where its own
detection would put them, and before its solver starts, the accelerations that it aims at (`efc_aref`) are replaced.
Todorov 2014 minimizes over forces in friction cones; by that alone, sliding contacts lift off, nothing bounces
exactly, and bodies sink. So the normal rows aim at, in units of velocity (De Saxce; Acary et al. 2011):

    h a_n = least - v_n - mu |slip| + h R_n f_n         h a_t = -v_t + h R_t f_t

    least   -g / h of an open gap g; 0 of a closed one; -e v_n of a blow that closes within the step
    slip    the tangential velocity after the step, known from the solve before (`ROUNDS`): Coulomb's friction exactly
    R f     MuJoCo's softness R at the forces of the solve before: a rigid result from a well conditioned problem

Penetrations are corrected in a solve of their own, whose velocities move poses only. Contacts ahead hold bodies back as
in the package's own engine (`touch_ahead`); they do not make up for the time lost. A step starts from the impulses of
the last one, by contact id (`warm_start`).

A body is a slot of a pool that is compiled once; the frame of a slot is the body's centre of mass and principal axes.
Equal runs are equal to the last bit on one kind of processor; on another they may differ, as BLAS-like code does.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from fracture_collision.extras import need

need("mujoco", "the engine MuJoCo")

import mujoco  # noqa: E402

from fracture_collision.portable_math import dots  # noqa: E402
from fracture_collision.records import ContactConstraintArray  # noqa: E402
from fracture_collision.simulation.dynamics import Given, Moved, SleepingWorld, Solved  # noqa: E402
from fracture_collision.simulation.engine import BodyStates, ByFragment, FrameState, Planned, free_velocities  # noqa: E402
from fracture_collision.simulation.mujoco_model import (  # noqa: E402
    name_of,
    put_state,
    quaternion_of,
    read_spec,
    state_of,
)
from fracture_collision.simulation.robot_contacts import RobotStep, solve_with_robot  # noqa: E402
from fracture_collision.simulation.rotations import (  # noqa: E402
    quaternion_products,
    rotation_matrices,
    turned,
)
from fracture_collision.simulation.solver.contact_solver import (  # noqa: E402
    BodyPairs,
    RigidBodies,
    Solution,
    SolverSettings,
    relative_velocities,
    sums_of_bodies,
    work_of_impulses,
)
from fracture_collision.simulation.solver.touch_ahead import Course, shares_of_step  # noqa: E402
from fracture_collision.simulation.solver.warm_start import (  # noqa: E402
    NO_WARM_START,
    WarmStart,
    carried_impulses,
)

# Bytes of an mjContact in the release that requirements/mujoco.in pins: contacts are written to its arena at once, as
# mj_addContact takes the longer the more there are.
CONTACT_BYTES = 608
# Slots at first; twice as many are compiled when they run out, which takes 30 ms. Free ones cost next to nothing.
SLOTS = 256
ARENA = 256 << 20  # [bytes] 65,000 contacts take 40 MB
# MuJoCo's impedance: near to 1 the problem is ill conditioned, and piles do not converge.
IMPEDANCE = 0.99
# Solves of a step at most, until no contact's velocity changes by more than ACCURACY [m/s]; and of a further solve in
# the same step, after a blow that breaks or for bodies that wait, which begins with the slip of the first.
ROUNDS, ROUNDS_AGAIN, ACCURACY = 4, 2, 1.0e-5
TOLERANCE, ITERATIONS = 1.0e-8, 100
# Friction below it is not accepted.
LEAST_FRICTION = 1.0e-5
# [m] Slots that are not in use stand there, one beside the other.
PARKED = 1000.0

_NO_LINKS: Mapping[str, int] = MappingProxyType({})
# Attributes of MujocoDynamics that follow from the others.
_OF_MUJOCO = {
    "_spec", "_model", "_data", "_count", "_bodies_at", "_dofs_at", "_geoms", "_slots", "_in_slots", "_positions_at",
    "_links", "_file", "_link_ids",
}


class _Slots(NamedTuple):
    """Views into MuJoCo's data: a row for each slot."""

    qpos: np.ndarray  # (s, 7) position, quaternion w x y z
    qvel: np.ndarray  # (s, 6) linear, world; angular, body
    smooth: np.ndarray  # (s, 6) accelerations without contacts
    contact: np.ndarray  # (s, 6) generalized forces of contacts
    inertia: np.ndarray  # (s, 6)
    warm: np.ndarray
    applied: np.ndarray  # (s, 6) generalized forces, as qvel


class _Axes(NamedTuple):
    """Principal axes of n bodies."""

    fragment_ids: np.ndarray  # (n,) uint32
    moments: np.ndarray  # (n, 3) [kg m2]
    turns: np.ndarray  # (n, 4) x y z w: body frame to principal axes


class _Contacts(NamedTuple):
    """The N contacts of a step between bodies of which one at least is awake."""

    rows: np.ndarray  # (N,) int64 among all
    body_a: np.ndarray  # (N,) int64 rows of the bodies, n for what cannot move
    body_b: np.ndarray  # (N,) int64
    geom_a: np.ndarray  # (N,) int64 MuJoCo's geoms of what is none of the bodies
    geom_b: np.ndarray  # (N,) int64
    points: np.ndarray  # (N, 3) [m], midway between the witnesses
    frames: np.ndarray  # (N, 3, 3) rows: normal from a to b, two tangents
    gaps: np.ndarray  # (N,) [m] beyond the rest gap
    friction: np.ndarray  # (N,)
    restitution: np.ndarray  # (N,)
    bounce_speeds: np.ndarray  # (N,) [m/s]
    rolling_arms: np.ndarray  # (N,) [m]
    sizes: np.ndarray  # (N,) R [m]


class _Step(NamedTuple):
    """The step between `solve` and `move`."""

    given: Given
    bodies: RigidBodies
    searched: np.ndarray | None  # (n, 6) velocities that the service looked ahead with; None: it does not
    contacts: _Contacts
    is_limited: np.ndarray  # (of all contacts,) bool: impulses that materials limit
    solution: Solution
    flight: np.ndarray  # (n, 6) drift of bodies in free flight
    robot: RobotStep | None


class _Rows(NamedTuple):
    """The constraint rows of N contacts."""

    normal: np.ndarray  # (N,) row of the normal; those of the tangents follow
    velocity: np.ndarray  # (N,) v_n before the step
    sliding: np.ndarray  # (2, N) v_t
    softness: np.ndarray  # (3, N) R


class MujocoDynamics(SleepingWorld):
    """A Dynamics, see the module. gravity (3,) [m/s2]; time_step [s]; looks_ahead: as in OwnDynamics.

    model: an MJCF file, whose colliding geoms are in the scene under `link_ids`, fragments by mujoco_model.name_of.
    """

    def __init__(
        self, time_step: float, gravity: np.ndarray, settings: SolverSettings, looks_ahead: bool = False,
        model: Path | None = None, link_ids: Mapping[str, int] = _NO_LINKS,
    ) -> None:  # fmt: skip
        super().__init__(time_step, gravity, settings)
        self._looks_ahead, self._file, self._link_ids = looks_ahead, model, link_ids
        self._warm_start, self._accelerations = NO_WARM_START, ByFragment(np.zeros(0, np.uint32), np.zeros((0, 6)))
        self._axes = _Axes(np.zeros(0, np.uint32), np.zeros((0, 3)), np.zeros((0, 4)))
        self._step: _Step | None = None
        self._contacts: _Contacts  # of the last solve
        self._spec = mujoco.MjSpec() if model is None else read_spec(model)
        self._spec.memory = ARENA
        self._spec.option.timestep, self._spec.option.gravity = time_step, gravity
        world = self._spec.worldbody.add_geom()
        world.name = "world"
        _make_handle(world)
        self._count = 0
        self._slips = np.zeros(0)  # (N,) [m/s] of the contacts of this step
        self._poses: np.ndarray | None = None  # accelerations that correct poses in this step, of all; None: as all
        self._compile(SLOTS)

    def __deepcopy__(self, memo: dict[int, Any]) -> MujocoDynamics:
        """A copy whose MuJoCo is another one: what it holds between steps is kept here."""
        its = {name: copy.deepcopy(value, memo) for name, value in vars(self).items() if name not in _OF_MUJOCO}
        other = MujocoDynamics(
            self._time_step, self._gravity, self._settings, self._looks_ahead, self._file, self._link_ids
        )
        vars(other).update(its)
        put_state(other._data, self._model_state())
        other._place_links()
        return other

    def begin(self, planned: Planned | None) -> BodyStates:
        """As in Dynamics."""
        return self._to_search(self.states(), planned)

    def _to_search(self, states: BodyStates, planned: Planned | None) -> BodyStates:
        return self._before_contacts(states, planned, np.full(len(states.masses), self._time_step))

    def solve(self, given: Given) -> Solved:
        """As in Dynamics."""
        states, n, (now, pairs, *_) = given.states, len(given.states.masses), given.contacts
        searched = self._to_search(states, given.planned).velocities() if self._looks_ahead else None
        self._settle(given)
        bodies = self._rigid_bodies(states, given.pushes, np.full(n, self._time_step), self._rest.asleep)
        solve = partial(self._solve_with_strengths, states=states, strengths=given.traits.strengths)
        with_robot = None
        if self._robot is None:
            solution, overloaded, limits = solve(bodies, now, pairs, self._warm_start)
        else:
            rows = self._robot_rows(states)
            with_robot = solve_with_robot(self._robot, bodies, now, pairs, self._warm_start, solve, rows)
            bodies, solution, overloaded, limits = (
                with_robot.bodies, with_robot.solution, with_robot.overloaded, with_robot.limits
            )  # fmt: skip
        self._warm_start = solution.warm_start
        flight = self._flight(given, bodies, solution)
        self._step = _Step(given, bodies, searched, self._contacts, limits < np.inf, solution, flight, with_robot)
        return Solved(solution.normal_impulses, overloaded, solution.velocities - bodies.free_velocities)

    def _solve_with_strengths(
        self, bodies: RigidBodies, now: ContactConstraintArray, pairs: BodyPairs, warm_start: WarmStart,
        states: BodyStates, strengths: np.ndarray,
    ) -> tuple[Solution, np.ndarray, np.ndarray]:  # fmt: skip
        """As the contact solver's."""
        n, limits = len(bodies.masses), np.full(len(now.gaps), np.inf)
        contacts = self._contacts = _contacts_of(now, pairs, bodies.asleep, self._geoms_of)
        begin = now.pair_begin.astype(np.int64)
        impulses, rolling = carried_impulses(now.fragment_a, now.fragment_b, begin, now.contact_ids, warm_start)
        at = contacts.rows
        self._put_bodies(states, bodies)
        velocities, drift, local = self._velocities(contacts, impulses[at], bodies)
        after = np.einsum("nk,nkj->nj", local, contacts.frames)
        normal, pressing = np.zeros((2, len(now.gaps)))
        normal[at] = local[:, 0]
        loads = sums_of_bodies(normal, begin, pairs.body_a, pairs.body_b, n)
        overloaded = np.flatnonzero(loads > strengths)
        if len(overloaded):
            share = np.ones(n + 1)
            share[overloaded] = strengths[overloaded] / loads[overloaded]
            share = np.minimum(share[contacts.body_a], share[contacts.body_b])
            after, is_applied = share[:, None] * after, share < 1.0
            limits[at] = np.where(is_applied, share * local[:, 0], np.inf)
            capped, _, _ = self._velocities(contacts, after, bodies, is_applied, True)
            # as in solve_with_strengths: in this step poses move as if the fragments that break held
            velocities, drift = capped, drift + velocities - capped
        impulses[at] = after
        relative = relative_velocities(
            contacts.body_a, contacts.body_b, contacts.points, bodies.centers, bodies.velocities
        )
        is_blow = dots(contacts.frames[:, 0], relative) < -contacts.bounce_speeds
        pressing[at] = np.where(is_blow & (contacts.restitution > 0.0), 0.0, local[:, 0])
        carried = WarmStart(now.fragment_a, now.fragment_b, begin, now.contact_ids, impulses, rolling)
        return Solution(velocities, drift, normal, pressing, carried), overloaded, limits

    def move(self) -> Moved:
        """As in Dynamics: drift correction adds energy where it lifts bodies."""
        assert self._step is not None
        step, self._step = self._step, None
        given, solution, v = step.given, step.solution, step.solution.velocities
        moves, drifting = v + solution.drift + step.flight, solution.drift
        falls = (step.bodies.free_velocities - step.bodies.velocities)[:, :3]
        course, contacts = Course(moves, step.searched, falls, np.zeros(len(v), bool)), given.contacts
        if step.robot is not None:
            course, contacts = self._beside_robot(given, step.robot, solution.warm_start, course)
            moves = course.moves
        shares = shares_of_step(given.states, contacts, course, given.traits.forms, self._settings, self._time_step)
        if step.robot is not None:
            shares[step.robot.beside[:-1]] = 1.0
        if (shares < 1.0).any():
            v = self._until(step, shares * self._time_step)
            touched = np.zeros(len(v) + 1, bool)
            touched[step.contacts.body_a] = touched[step.contacts.body_b] = True
            # or the course would not have the momentum
            moves += np.where(touched[:-1, None], v - solution.velocities, 0.0)
        drift = shares[:, None] * moves - v
        self._move_model()
        self.advance(v[:, :3], v[:, 3:], drift[:, :3], drift[:, 3:])
        work = self._work_of_links(step, v)
        if step.robot is not None:
            is_robot = self._is_robot(given.states)
            work += step.robot.work(is_robot, solution._replace(velocities=v))
            self._commit(step.robot, solution.warm_start)
            drifting = np.where(is_robot[:, None], 0.0, drifting)
        self._rest_after(given, v + drift)
        lifts = shares * self._time_step * dots(drifting[:, :3], self._gravity)
        return Moved(-float((given.states.masses * lifts).sum()), work)

    def _work_of_links(self, step: _Step, after: np.ndarray) -> float:
        """Energy [J] that the model's links add to the bodies, but by rolling resistance; after: (n, 6) velocities."""
        if not self._links:
            return 0.0
        contacts, bodies, work = step.contacts, step.bodies, 0.0
        impulses, links = self._warm_start.impulses[contacts.rows], np.fromiter(self._links.values(), np.int64)
        for rows, geoms, sign in (
            (contacts.body_b, contacts.geom_a, 1.0), (contacts.body_a, contacts.geom_b, -1.0),
        ):  # fmt: skip
            its = np.flatnonzero((rows < len(bodies.masses)) & np.isin(geoms, links))
            arms = contacts.points[its] - bodies.centers[rows[its]]
            work += work_of_impulses(rows[its], sign * impulses[its], arms, bodies.velocities, after)
        return work

    def _move_model(self) -> None:
        """Move the model beside the slots."""
        if not self._dofs_at:
            return
        drift = None if self._poses is None else self._time_step * (self._poses - self._data.qacc)
        mujoco.mj_Euler(self._model, self._data)
        if drift is not None:
            drift[self._dofs_at :] = 0.0
            mujoco.mj_integratePos(self._model, self._data.qpos, drift, self._time_step)
        self._place_links()

    def _until(self, step: _Step, spans: np.ndarray) -> np.ndarray:
        """Velocities (n, 6) with gravity for the times `spans` (n,) [s] only: what waits gains no energy by it."""
        states, bodies = step.given.states, step.bodies
        free = free_velocities(bodies.velocities, states.inertias, self._gravity, spans)
        rows = self._robot_rows(states)
        free[rows] = bodies.free_velocities[rows]
        bodies = bodies._replace(free_velocities=free, spans=spans)
        self._put_bodies(states, bodies)
        impulses, poses = self._warm_start.impulses, self._poses
        rows = step.contacts.rows
        is_applied = step.is_limited[rows]
        velocities, _, local = self._velocities(
            step.contacts, impulses[rows], bodies, is_applied if is_applied.any() else None, True
        )
        found = np.einsum("nk,nkj->nj", local, step.contacts.frames)
        impulses[rows] = np.where(is_applied[:, None], impulses[rows], found)
        self._poses = poses
        return velocities

    def _compile(self, count: int) -> None:
        """Make a model of `count` slots."""
        for k in range(self._count, count):
            body = self._spec.worldbody.add_body()
            body.name = f"slot {k}"
            body.add_freejoint()
            body.explicitinertial, body.mass, body.inertia = True, 1.0, [1.0] * 3
            _make_handle(body.add_geom())
        self._model = self._spec.compile()
        option = self._model.opt
        option.integrator, option.cone = mujoco.mjtIntegrator.mjINT_EULER, mujoco.mjtCone.mjCONE_ELLIPTIC
        option.solver, option.iterations, option.tolerance = mujoco.mjtSolver.mjSOL_NEWTON, ITERATIONS, TOLERANCE
        option.ls_tolerance = 1.0e-4
        # damping is implicit in the contacts, too: see _add_damping
        option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_REFSAFE | mujoco.mjtDisableBit.mjDSBL_EULERDAMP)
        before = self._model_state() if self._count else None
        self._count = count
        data = self._data = mujoco.MjData(self._model)
        first = self._model.body("slot 0").id
        joint = self._model.body_jntadr[first]
        q, v = self._model.jnt_qposadr[joint], self._model.jnt_dofadr[joint]
        self._bodies_at, self._dofs_at, self._positions_at = first, v, q
        self._geoms = np.append(self._model.body_geomadr[first : first + count], self._model.geom("world").id)
        self._slots = _Slots(
            data.qpos[q : q + 7 * count].reshape(count, 7),
            *(x[v : v + 6 * count].reshape(count, 6)
              for x in (data.qvel, data.qacc_smooth, data.qfrc_constraint, self._model.dof_M0,
                        data.qacc_warmstart, data.qfrc_applied)),
        )  # fmt: skip
        self._in_slots = np.zeros(0, np.uint32)
        named = {name_of(self._model, geom): geom for geom in range(self._model.ngeom)}
        self._links = {fragment: named[name] for name, fragment in self._link_ids.items()}
        if before is not None:
            put_state(data, before)
        self._place_links()

    def _model_state(self) -> dict[str, Any]:
        """State of the model beside the slots, which are its last dofs."""
        return state_of(self._data, self._dofs_at, self._positions_at)

    def _place_links(self) -> None:
        mujoco.mj_kinematics(self._model, self._data)
        mujoco.mj_comPos(self._model, self._data)
        mujoco.mj_comVel(self._model, self._data)

    def links(self) -> dict[int, FrameState]:
        """As in Dynamics: the geoms of the model that move."""
        frames, velocity = {}, np.empty(6)
        for fragment, geom in self._links.items():
            if self._model.body_weldid[self._model.geom_bodyid[geom]]:
                mujoco.mj_objectVelocity(
                    self._model, self._data, mujoco.mjtObj.mjOBJ_GEOM, geom, velocity, 0
                )  # fmt: skip
                frames[fragment] = FrameState(
                    self._data.geom_xpos[geom].copy(), quaternion_of(self._data.geom_xmat[geom]), velocity[3:].copy(),
                    velocity[:3].copy(),
                )  # fmt: skip
        return frames

    def _put_bodies(self, states: BodyStates, bodies: RigidBodies) -> None:
        """Give the slots the bodies before the step, in their order, with gyroscopic torques of the midpoint rule."""
        n, ids, h = len(states.masses), states.fragment_ids, self._time_step
        if n > self._count:
            self._compile(max(2 * self._count, n))
        if not np.array_equal(self._in_slots, ids):
            self._put_masses(states)
        slots, moments = self._slots, self._axes.moments
        if self._robot is not None:
            moments = self._put_links(states, bodies)
        slots.qpos[:n, :3] = bodies.centers
        turns = quaternion_products(states.frame_orientations, self._axes.turns)
        slots.qpos[:n, 3:] = turns[:, [3, 0, 1, 2]]
        back = rotation_matrices(turns).transpose(0, 2, 1).copy()
        slots.qvel[:n, :3] = bodies.velocities[:, :3]
        spins, later = turned(back, bodies.velocities[:, 3:]), turned(back, bodies.free_velocities[:, 3:])
        slots.qvel[:n, 3:] = spins
        slots.applied[:] = 0.0
        # what moves for less than a step falls for no longer
        falls = bodies.free_velocities[:, :3] - bodies.velocities[:, :3]
        slots.applied[:n, :3] = bodies.masses[:, None] * (falls / h - self._gravity)
        slots.applied[:n, 3:] = moments * (later - spins) / h + np.cross(spins, moments * spins)
        slots.warm[:n] = self._accelerations.of(ids)

    def _put_links(self, states: BodyStates, bodies: RigidBodies) -> np.ndarray:
        """Write the masses that a robot's bodies have in this step; returns the moments of inertia of all (n, 3)."""
        rows, moments, model = self._robot_rows(states), self._axes.moments.copy(), self._model
        touched = rows[bodies.masses[rows] != states.masses[rows]]
        moments[touched] = bodies.inertias[touched, 0, :1]
        masses = bodies.masses[rows]
        inverse = np.column_stack((1.0 / masses, (1.0 / moments[rows]).mean(axis=1)))
        model.body_mass[self._bodies_at + rows] = model.body_subtreemass[self._bodies_at + rows] = masses
        model.body_inertia[self._bodies_at + rows] = moments[rows]
        model.body_invweight0[self._bodies_at + rows] = inverse
        dofs = self._dofs_at + 6 * rows[:, None] + np.arange(6)
        model.dof_invweight0[dofs] = np.repeat(inverse, 3, axis=1)
        model.dof_M0[dofs] = np.hstack((np.tile(masses[:, None], 3), moments[rows]))
        return moments

    def _geoms_of(self, fragments: np.ndarray) -> np.ndarray:
        """Geoms (p,) of the model's links among the fragments (p,), of all others the world's."""
        geoms = np.full(len(fragments), self._geoms[-1])
        for fragment, geom in self._links.items():
            geoms[fragments == fragment] = geom
        return geoms

    def _never_at_rest(self, given: Given) -> np.ndarray:
        """As in SleepingWorld: the model would not feel what sleeps on it."""
        touch, (now, pairs, *_) = np.append(super()._never_at_rest(given), False), given.contacts
        for fragments, others in ((now.fragment_a, pairs.body_b), (now.fragment_b, pairs.body_a)):
            touch[others[np.isin(fragments, list(self._links))]] = True
        return touch[:-1]

    def _put_masses(self, states: BodyStates) -> None:
        """Write the masses of the bodies to the model's slots, and park the rest."""
        n, model, ids = len(states.masses), self._model, states.fragment_ids
        new = ~np.isin(ids, self._axes.fragment_ids)
        known = ByFragment(self._axes.fragment_ids, np.hstack((self._axes.moments, self._axes.turns))).of(ids)
        if new.any():
            known[new] = _principal_axes(self._bodies.inertias[new])
        self._axes = _Axes(ids, known[:, :3].copy(), known[:, 3:].copy())
        every, dofs = slice(self._bodies_at, self._bodies_at + n), slice(self._dofs_at, self._dofs_at + 6 * n)
        moments, inverse = self._axes.moments, (1.0 / self._axes.moments).mean(axis=1)
        model.body_mass[every] = model.body_subtreemass[every] = states.masses
        model.body_inertia[every] = moments
        model.body_invweight0[every] = np.column_stack((1.0 / states.masses, inverse))
        model.dof_invweight0[dofs] = np.repeat(np.column_stack((1.0 / states.masses, inverse)), 3, axis=1).ravel()
        model.dof_M0[dofs] = np.hstack((np.tile(states.masses[:, None], 3), moments)).ravel()
        self._slots.qpos[n:] = [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]
        self._slots.qpos[n:, 0] = PARKED + np.arange(self._count - n)
        self._slots.qvel[n:] = self._slots.warm[n:] = 0.0
        self._in_slots = ids

    def _velocities(
        self, contacts: _Contacts, impulses: np.ndarray, bodies: RigidBodies, is_applied: np.ndarray | None = None,
        is_again: bool = False,
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Velocities (n, 6) after the step, those that correct poses, and impulses (N, 3) [N s] along the frames.

        impulses (N, 3), world axes, on b: where the solver begins; is_applied (N,) bool: they are applied as they are.
        """
        model, data, h = self._model, self._data, self._time_step
        data.xfrc_applied[:], self._poses = 0.0, None
        if is_applied is not None:
            self._apply(contacts, impulses, is_applied)
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_tendon(model, data)
        mujoco.mj_makeM(model, data)
        self._add_damping()
        mujoco.mj_factorM(model, data)
        self._inject(contacts)
        if is_applied is not None:
            exclude = data.contact.exclude.copy()
            exclude[is_applied] = 1
            data.contact.exclude[:] = exclude
        mujoco.mj_makeConstraint(model, data)
        mujoco.mj_island(model, data)
        mujoco.mj_projectConstraint(model, data)
        mujoco.mj_transmission(model, data)
        mujoco.mj_fwdVelocity(model, data)
        mujoco.mj_fwdActuation(model, data)
        mujoco.mj_fwdAcceleration(model, data)
        chosen = np.arange(len(contacts.rows)) if is_applied is None else np.flatnonzero(~is_applied)
        forces, pose = np.zeros((len(contacts.rows), 3)), None
        if len(chosen):
            picked = _Contacts._make(column[chosen] for column in contacts)
            forces[chosen], accelerations, pose = self._solve_rounds(picked, chosen, impulses[chosen] / h, is_again)
        else:
            mujoco.mj_fwdConstraint(model, data)
            accelerations = self._by_forces()
        self._accelerations = ByFragment(self._in_slots, accelerations)
        velocities = self._after(bodies, accelerations)
        drift = np.zeros_like(velocities)
        if pose is not None:
            drift = self._after(bodies, pose) - velocities
        return velocities, drift, h * forces

    def _add_damping(self) -> None:
        """Make the damping of joints and of servos implicit: M + h D is the inertia that contacts meet.

        MuJoCo's implicit integrators take it out of velocities after the contacts are solved, which then do not hold:
        a stiff servo under a load rattles.
        """
        if not self._dofs_at:
            return
        model, data, damping = self._model, self._data, self._model.dof_damping[: self._dofs_at].copy()
        for k in range(model.nu):
            limits, joint = model.actuator_forcerange[k], model.actuator_trnid[k, 0]
            force = data.actuator_force[k]  # of the last step: a motor at its limit damps nothing
            is_limited = bool(model.actuator_forcelimited[k]) and not limits[0] < force < limits[1]
            if model.actuator_trntype[k] == mujoco.mjtTrn.mjTRN_JOINT and not is_limited:
                gear, rate = model.actuator_gear[k, 0], -model.actuator_biasprm[k, 2]
                damping[model.jnt_dofadr[joint]] += gear * gear * max(rate, 0.0)
        diagonal = (model.M_rowadr + model.M_rownnz - 1)[: self._dofs_at]
        data.M[diagonal] += self._time_step * damping

    def _falling(self) -> np.ndarray:
        """Accelerations without contacts, nor those that are applied as forces: a blow does not bounce off these."""
        accelerations, slots = self._data.qacc_smooth, slice(self._bodies_at, self._bodies_at + self._count)
        forces, turns = self._data.xfrc_applied[slots], self._data.xmat[slots].reshape(-1, 3, 3)
        if not forces.any():
            return accelerations
        local = np.hstack((forces[:, :3], turned(turns.transpose(0, 2, 1), forces[:, 3:])))
        at = slice(self._dofs_at, self._dofs_at + 6 * self._count)
        accelerations = accelerations.copy()
        accelerations[at] -= (local / self._slots.inertia).ravel()
        return accelerations

    def _by_forces(self) -> np.ndarray:
        """Accelerations (n, 6) of the bodies by the forces of contacts, which keep momentum.

        MuJoCo's own are the variable that it minimizes over: they agree with the forces within its tolerance.
        """
        n, slots = len(self._in_slots), self._slots
        return slots.smooth[:n] + slots.contact[:n] / slots.inertia[:n]

    def _after(self, bodies: RigidBodies, accelerations: np.ndarray) -> np.ndarray:
        """Velocities (n, 6) after the step, of slots with `accelerations` (n, 6); asleep: 0."""
        n, h = len(bodies.masses), self._time_step
        quaternions = self._slots.qpos[:n, [4, 5, 6, 3]]
        angular = turned(rotation_matrices(quaternions), self._slots.qvel[:n, 3:] + h * accelerations[:, 3:])
        velocities = np.hstack((self._slots.qvel[:n, :3] + h * accelerations[:, :3], angular))
        velocities[bodies.asleep] = 0.0
        return velocities

    def _apply(self, contacts: _Contacts, impulses: np.ndarray, chosen: np.ndarray) -> None:
        """Apply the impulses of the `chosen` (N,) contacts as forces on their bodies."""
        forces, centers = impulses[chosen] / self._time_step, self._slots.qpos[:, :3]
        at = self._data.xfrc_applied[self._bodies_at : self._bodies_at + self._count]
        for body, sign in ((contacts.body_a[chosen], -1.0), (contacts.body_b[chosen], 1.0)):
            moves = body < len(self._in_slots)
            rows, f = body[moves], sign * forces[moves]
            np.add.at(at, rows, np.hstack((f, np.cross(contacts.points[chosen][moves] - centers[rows], f))))

    def _inject(self, contacts: _Contacts) -> None:
        """Put the contacts where MuJoCo's detection of collisions would."""
        model, data, count, h = self._model, self._data, len(contacts.rows), self._time_step
        data.ncon = 0
        if not count:
            return
        one = mujoco.MjContact()
        one.dim = 3
        # mj_addContact makes room for one, and drops the rows of the step before; the others follow it in the arena
        if mujoco.mj_addContact(model, data, one) or count * CONTACT_BYTES > data.narena // 2:
            raise MemoryError(f"{count} contacts are more than MuJoCo's arena of {data.narena} bytes takes")
        data.parena, data.ncon = count * CONTACT_BYTES, count
        to = data.contact
        rolls = contacts.rolling_arms > 0.0
        to.dim[:] = np.where(rolls, 6, 3)
        to.includemargin[:], to.exclude[:], to.adhesion[:], to.efc_address[:] = 0.0, 0, 0.0, -1
        to.surfacevel[:], to.flex[:], to.elem[:], to.vert[:] = 0.0, -1, -1, -1
        to.solimp[:], to.solref[:] = (IMPEDANCE, IMPEDANCE, 0.001, 0.5, 2.0), (-IMPEDANCE / h**2, -IMPEDANCE / h)
        to.solreffriction[:] = 0.0
        to.pos[:], to.frame[:], to.dist[:] = contacts.points, contacts.frames.reshape(count, 9), contacts.gaps
        geoms = [
            np.where(row < len(self._in_slots), self._geoms[np.minimum(row, self._count)], geom)
            for row, geom in ((contacts.body_a, contacts.geom_a), (contacts.body_b, contacts.geom_b))
        ]
        to.geom[:] = np.column_stack(geoms)
        to.geom1[:], to.geom2[:] = geoms
        friction = np.maximum(contacts.friction, LEAST_FRICTION)
        arms = np.maximum(contacts.rolling_arms, LEAST_FRICTION)
        to.friction[:] = np.column_stack((friction, friction, arms, arms, arms))

    def _solve_rounds(
        self, contacts: _Contacts, chosen: np.ndarray, forces: np.ndarray, is_again: bool
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:
        """Forces (N, 3) [N] along the frames, accelerations (n, 6), and those of what corrects poses; None: the same.

        chosen (N,): the contacts' numbers in MuJoCo; forces (N, 3) [N], world axes: where it begins; is_again: after a
        solve of all contacts in this step, whose slip it begins with and whose poses stay.
        """
        model, data, h = self._model, self._data, self._time_step
        normal = data.contact.efc_address[chosen]
        rows = _Rows(
            normal, data.efc_vel[normal].copy(), np.stack([data.efc_vel[normal + k] for k in (1, 2)]),
            np.stack([data.efc_R[normal + k] for k in range(3)]),
        )  # fmt: skip
        change = np.zeros(data.nefc)
        mujoco.mj_mulJacVec(model, data, change, self._falling())
        least, for_poses = self._least_velocities(contacts, rows.velocity, h * change[normal])
        friction = np.maximum(contacts.friction, LEAST_FRICTION)
        steady = rows.velocity > -contacts.bounce_speeds  # in a blow the slip is not known
        slip = np.where(steady, np.sqrt((rows.sliding * rows.sliding).sum(axis=0)), 0.0)
        if is_again:
            slip = self._slips[chosen]
        pressed = rows.softness * np.einsum("nkj,nj->kn", contacts.frames, forces)

        def solve(least: np.ndarray) -> None:
            data.efc_aref[normal] = (least - friction * slip - rows.velocity) / h + pressed[0]
            for k in (1, 2):
                data.efc_aref[normal + k] = -rows.sliding[k - 1] / h + pressed[k]
            mujoco.mj_fwdConstraint(model, data)
            data.qacc_warmstart[:] = data.qacc

        rounds = ROUNDS_AGAIN if is_again else ROUNDS
        for turn in range(rounds):
            solve(least)
            if turn + 1 == rounds:
                break
            mujoco.mj_mulJacVec(model, data, change, data.qacc)
            slides = rows.sliding + h * np.stack([change[normal + k] for k in (1, 2)])
            slips = np.sqrt((slides * slides).sum(axis=0))
            presses = rows.softness * np.stack([data.efc_force[normal + k] for k in range(3)])
            off = max((friction * np.abs(slips - slip)).max(), h * np.abs(presses - pressed).max())
            if off < ACCURACY:
                break
            slip, pressed = slips, presses
        if not is_again:
            self._slips = slip
        found = np.column_stack([data.efc_force[normal + k] for k in range(3)])
        by_forces = self._by_forces()
        if is_again or not (for_poses > least).any():
            return found, by_forces, None
        accelerations = data.qacc.copy()
        solve(for_poses)
        self._poses = data.qacc.copy()
        data.qacc[:] = data.qacc_warmstart[:] = accelerations
        return found, by_forces, self._by_forces()

    def _least_velocities(
        self, contacts: _Contacts, v: np.ndarray, change: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
        """Least normal velocities (N,) [m/s] after the step: of the bodies, and of what moves their poses.

        v, change (N,) [m/s]: before it, and how it would change without contacts: a blow takes place at its beginning.
        """
        settings, h, gaps = self._settings, self._time_step, contacts.gaps
        is_blow = (v < -contacts.bounce_speeds) & (gaps < -v * h)
        least = np.where(gaps > 0.0, -gaps / h, 0.0)
        least = np.where(is_blow, np.maximum(least, change - contacts.restitution * v), least)
        deep = -gaps - settings.rest_slop * contacts.sizes
        speed = np.minimum(settings.drift_fraction * deep / h, settings.drift_speed * contacts.sizes)
        return least, np.where(deep > 0.0, np.maximum(least, speed), least)


def _make_handle(geom: Any) -> None:
    """A geom that names its body in contacts, and collides with nothing."""
    geom.type, geom.size = mujoco.mjtGeom.mjGEOM_SPHERE, [0.01] * 3
    geom.contype, geom.conaffinity, geom.mass = 0, 0, 0.0


def _principal_axes(inertias: np.ndarray) -> np.ndarray:
    """Principal moments [kg m2] and quaternions x y z w of inertias (n, 3, 3): (n, 7)."""
    moments, axes = np.linalg.eigh(inertias)
    axes[np.linalg.det(axes) < 0.0, :, 0] *= -1.0
    turns, quaternion = np.empty((len(axes), 4)), np.empty(4)
    for k, matrix in enumerate(axes):
        mujoco.mju_mat2Quat(quaternion, matrix.ravel())
        turns[k] = quaternion[[1, 2, 3, 0]]
    return np.hstack((moments, turns))


def _contacts_of(
    contacts: ContactConstraintArray, pairs: BodyPairs, asleep: np.ndarray,
    geoms_of: Callable[[np.ndarray], np.ndarray],
) -> _Contacts:  # fmt: skip
    counts: np.ndarray = np.diff(contacts.pair_begin.astype(np.int64))

    def each(values: np.ndarray) -> np.ndarray:
        return np.repeat(values, counts)

    flat = _Contacts(
        np.arange(len(contacts.gaps)), each(pairs.body_a), each(pairs.body_b),
        each(geoms_of(contacts.fragment_a)), each(geoms_of(contacts.fragment_b)),
        0.5 * (contacts.points_a + contacts.points_b), _frames_of(contacts.normals), contacts.gaps - pairs.rest_gaps,
        each(contacts.friction), each(contacts.restitution), each(pairs.bounce_speeds), each(pairs.rolling_arm),
        each(pairs.sizes),
    )  # fmt: skip
    rests = np.append(asleep, True)
    wakes = ~(rests[flat.body_a] & rests[flat.body_b])
    return flat if wakes.all() else _Contacts._make(column[wakes] for column in flat)


def _frames_of(normals: np.ndarray) -> np.ndarray:
    """(N, 3, 3): rows normal, and two tangents."""
    frames = np.empty((len(normals), 3, 3))
    frames[:, 0] = normals
    axis = np.eye(3)[np.argmin(np.abs(normals), axis=1)]
    tangent = axis - (axis * normals).sum(axis=1, keepdims=True) * normals
    frames[:, 1] = tangent / np.sqrt((tangent * tangent).sum(axis=1, keepdims=True))
    frames[:, 2] = np.cross(frames[:, 0], frames[:, 1])
    return frames
