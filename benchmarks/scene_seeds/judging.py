"""Whether a run of a scene is right: what rests is supported and not in each other, and energy never rises."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

sys.path.append(str(Path(__file__).resolve().parents[2] / "test"))  # the ground truth lives with the tests

from truth.contact_truth import Poses  # noqa: E402
from truth.static_support import SPEED_AT_REST, support_of  # noqa: E402
from truth.surface_truth import Solid  # noqa: E402

from fracture_collision.lockstep import Exchange, Lockstep  # noqa: E402
from fracture_collision.records import (  # noqa: E402
    CollisionBody,
    ContactConstraintArray,
    FractureEvent,
    FragmentStates,
)
from fracture_collision.simulation.engine import BodyStates  # noqa: E402
from fracture_collision.simulation.scene.scene import Scene  # noqa: E402
from fracture_collision.world import CollisionWorld, PaperSettings, Settings  # noqa: E402
from fracture_collision.world.inspection import every_contact  # noqa: E402

EPSILON = Settings().penetration_tolerance  # [R]
FINEST = EPSILON / 20.0  # [R] resolution of libigl's search of surfaces
# Depths of samples along the shortest way out: the paper's method, with exact distances.
NEAREST = Settings(threads=1, method="glondu2014", paper=PaperSettings(field="exact"))
# [of the energy so far] Lifts what is 10 cm high by 1 nm, a few atoms. The solver itself lets a step gain 1e-7 of the
# energy m g^2 h^2 / 2 that gravity gives a body in it (ROUNDING of solver/contact_step.py), 3e-11 at 10 cm and 2.5 ms,
# as long as its rounds suffice.
ROUNDING = 1e-8


class Overlap(NamedTuple):
    """Of the two bodies at rest that are deepest in each other, in R of the two."""

    depth: float = 0.0  # [R] of the deepest point of either surface; 0 where none is inside
    depth_m: float = 0.0  # [m]
    fragments: tuple[int, int] = (0, 0)
    listed: float = 0.0  # [R] depth of the deepest contact that the service itself lists, of any pair at rest


class Rise(NamedTuple):
    """The largest rise of the energy in a step; shares of the largest energy until then."""

    share: float = 0.0
    lifted: float = 0.0  # by drift correction in that step
    solved: float = 0.0  # the largest rise in a step beyond what drift correction lifted
    step: int = 0
    judged: int = 0  # steps


class Verdict(NamedTuple):
    """What was found of a run."""

    fragments: int  # that can move, at the end; not a robot's
    at_rest: int  # of these
    unsupported: list[int]  # fragment ids
    overlap: Overlap
    rise: Rise
    steps: int

    @property
    def faults(self) -> list[str]:
        """What is wrong, in words; empty if the run is right."""
        found = []
        if self.unsupported:
            found.append(f"{len(self.unsupported)} unsupported: {', '.join(map(str, self.unsupported))}")
        deep = self.overlap
        if deep.depth > EPSILON:
            found.append(
                f"{deep.fragments[0]} in {deep.fragments[1]}: {100.0 * deep.depth:.2f} % R, {1e3 * deep.depth_m:.2f} mm"
            )
        if self.rise.share > ROUNDING:
            found.append(
                f"energy rises by {self.rise.share:.1e} in step {self.rise.step}, lifted: {self.rise.lifted:.1e}"
            )
        return found


def robot_of(run: Lockstep) -> np.ndarray:
    """Fragment ids of a robot's parts."""
    robot = run.simulation.robot
    return np.zeros(0, int) if robot is None else robot.fragment_ids.astype(int)


class EnergyWatch:
    """Kinetic and potential energy of all bodies but a robot's, from step to step.

    Judged are all steps but those in which a body joins, which brings its own energy, and those in which a robot does
    work: that is known to the time step's order. The work of a hand is known to rounding (StepReport.hand_energy), and
    subtracted. Neither drift correction nor a fracture may raise the energy; how much drift correction does is told.
    """

    def __init__(self, has_robot: bool = False) -> None:
        self._has_robot = has_robot
        self._fragments = -1  # that there will be in the next step, if no body joins
        self._energy, self._largest = 0.0, 0.0  # [J]
        self.rise = Rise(-np.inf, solved=-np.inf)

    def take(self, exchange: Exchange) -> None:
        """Takes the step that the run has just done."""
        report = exchange.report
        # the report's energy has the bodies that break at the step's end
        energy = report.kinetic_energy + report.potential_energy
        if report.fragments == self._fragments and not (self._has_robot and report.hand_energy):
            scale = max(self._largest, 1e-300)
            self._judge((energy - self._energy - report.hand_energy) / scale, report.drift_energy / scale, report.step)
        self._fragments = report.fragments + sum(len(event.new_fragment_ids) - 1 for event in report.events)
        self._energy = energy
        self._largest = max(self._largest, abs(energy))

    def _judge(self, share: float, lifted: float, step: int) -> None:
        worst = self.rise if share <= self.rise.share else self.rise._replace(share=share, lifted=lifted, step=step)
        solved = max(worst.solved, share - max(lifted, 0.0))
        self.rise = worst._replace(solved=solved, judged=worst.judged + 1)


def judged(scene: Scene, settings: Settings, seed: int) -> Verdict:
    """Runs a scene to its end."""
    events: list[FractureEvent] = []
    with Lockstep(scene, settings, seed) as run:
        bodies, watch, steps = run.simulation.start_bodies(), EnergyWatch(scene.robot is not None), 0
        now = run.simulation.dynamics.states()
        for exchange in run:
            before, now = now, run.simulation.dynamics.states()
            watch.take(exchange)
            events += exchange.report.events
            steps += 1
        restless = moved(before, now, scene.time_step)
        return verdict(run, scene, (bodies, events), restless)._replace(rise=watch.rise, steps=steps)


def verdict(
    run: Lockstep, scene: Scene, told: tuple[list[CollisionBody], list[FractureEvent]], restless: np.ndarray
) -> Verdict:
    """Judges the present state of a run, without its energy.

    told: the bodies and events that led to it; restless: ids of bodies that are not at rest, whatever their velocity.
    """
    states, support = run.states(), support_of(run, scene)
    bodies = run.simulation.dynamics.states()
    resting = np.setdiff1d(support.fragment_ids, restless)
    restless = np.setdiff1d(bodies.fragment_ids, resting)
    answer = run.world.contacts(states)
    listed = _deepest_pair(answer, _radii(run.world, states, answer), restless)
    unsupported = np.intersect1d(support.unsupported, resting).astype(int).tolist()
    return Verdict(
        len(np.setdiff1d(bodies.fragment_ids, robot_of(run))), len(resting), unsupported,
        deepest_of(told, states, restless)._replace(listed=listed.depth), Rise(), 0,
    )  # fmt: skip


def moved(before: BodyStates, after: BodyStates, time_step: float) -> np.ndarray:
    """Ids of the bodies that a step took farther than SPEED_AT_REST would, or broke.

    What drift correction pushes out of another moves without a velocity.
    """
    stayed = np.isin(after.fragment_ids, before.fragment_ids)
    rows = np.searchsorted(before.fragment_ids, after.fragment_ids[stayed])
    shift = np.linalg.norm(after.centers[stayed] - before.centers[rows], axis=1)
    cosine = np.abs((after.frame_orientations[stayed] * before.frame_orientations[rows]).sum(axis=1))
    size = np.sqrt(np.trace(before.inertias, axis1=1, axis2=2) / before.masses)[rows]
    far = shift + 2.0 * np.sqrt(np.maximum(2.0 - 2.0 * cosine, 0.0)) * size > SPEED_AT_REST * time_step
    return np.setdiff1d(before.fragment_ids, after.fragment_ids[stayed][~far])


def deepest_of(
    told: tuple[Iterable[CollisionBody], Iterable[FractureEvent]], states: FragmentStates, restless: np.ndarray
) -> Overlap:
    """Of all pairs with no fragment of `restless`, measured apart from the run's service.

    A pair is as deep as its deepest sample. Where none is deeper than epsilon and the two may be, by their contacts and
    their bound, libigl searches their whole surfaces.
    """
    nearest, world = _world_of(told, NEAREST), _world_of(told, Settings(threads=1))
    samples, answer, poses = every_contact(nearest, states), every_contact(world, states), Poses(states)
    depths = dict(_depths_of(samples, restless))
    found = _deepest_pair(samples, _radii(nearest, states, samples), restless)
    for i, radius in enumerate(_radii(world, states, answer).tolist()):
        pair, allowed = (int(answer.fragment_a[i]), int(answer.fragment_b[i])), EPSILON * radius
        listed = -float(answer.gaps[answer.pair_begin[i] : answer.pair_begin[i + 1]].min(initial=0.0))
        may_be_deep = max(listed, float(answer.missed_depth_bound[i])) > allowed
        if np.isin(pair, restless).any() or not may_be_deep or depths.get(pair, 0.0) > allowed:
            continue
        one, other = (_surface(world, poses, fragment) for fragment in pair)
        # contacts of a plane or a ball are exact
        depth = _by_libigl(one, other, allowed, FINEST * radius) if len(one) and len(other) else listed
        if depth > found.depth * radius:
            found = Overlap(depth / radius, depth, pair)
    return found


def _world_of(
    told: tuple[Iterable[CollisionBody], Iterable[FractureEvent]], settings: Settings
) -> CollisionWorld:
    world = CollisionWorld(settings)
    for body in told[0]:
        world.add_body(body)
    for event in told[1]:
        world.add_fracture(event)
    return world


def _by_libigl(one: np.ndarray, other: np.ndarray, more_than: float, finest: float) -> float:
    """[m] Depth of the deepest point of either surface in the other, 0 if none is deeper than `more_than`.

    That none is, is known to `finest` [m]; how deep the deepest is, to a quarter of its depth: faces that lie in each
    other flush have very many points as deep.
    """
    solids, finer = ((Solid(one), other), (Solid(other), one)), 4.0 * more_than
    while True:
        depth = max(solid.deepest_of(triangles, more_than, finer).depth for solid, triangles in solids)
        if finer <= max(0.25 * depth, finest):
            return depth
        finer = max(0.5 * finer, finest)


def _surface(world: CollisionWorld, poses: Poses, fragment: int) -> np.ndarray:
    """Triangles (t, 3, 3) [m] in the world."""
    mesh = world.fragment_mesh(fragment)
    corners = np.asarray(mesh.vertices).reshape(-1, 3)[np.asarray(mesh.triangles)]
    return poses.to_world(fragment, corners).reshape(-1, 3, 3)


def _radii(world: CollisionWorld, states: FragmentStates, answer: ContactConstraintArray) -> np.ndarray:
    """R of each pair (n,) [m]: half the longest side of the smaller body."""
    here = world.present(states)
    radius = world.geometry.pools.fragment.radius[here.rows]
    ends: Any = (radius[np.searchsorted(here.ids, end)] for end in (answer.fragment_a, answer.fragment_b))
    return np.minimum(*ends)


def _depths_of(
    answer: ContactConstraintArray, restless: np.ndarray
) -> Iterator[tuple[tuple[int, int], float]]:
    """Each pair with no fragment of `restless`, and the depth [m] of its deepest contact; 0 if none penetrates."""
    for i, pair in enumerate(zip(answer.fragment_a.tolist(), answer.fragment_b.tolist(), strict=True)):
        if not np.isin(pair, restless).any():
            gaps = answer.gaps[answer.pair_begin[i] : answer.pair_begin[i + 1]]
            yield pair, -float(gaps.min(initial=0.0))


def _deepest_pair(answer: ContactConstraintArray, radii: np.ndarray, restless: np.ndarray) -> Overlap:
    """Of the pairs with no fragment of `restless`, by their contacts; radii: (n,) [m] R of all pairs."""
    pairs = zip(answer.fragment_a.tolist(), answer.fragment_b.tolist(), strict=True)
    of, found = dict(zip(pairs, radii.tolist(), strict=True)), Overlap()
    for pair, depth in _depths_of(answer, restless):
        if depth > found.depth * of[pair]:
            found = Overlap(depth / of[pair], depth, pair)
    return found
