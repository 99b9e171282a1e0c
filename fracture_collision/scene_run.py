"""Runs a scene in one process, without ROS, and keeps the figures of each step and a film of the run."""

from __future__ import annotations

import csv
import hashlib
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

import fracture_collision.simulation.warm_up as simulator
import fracture_collision.world.warm_up as service
from fracture_collision.geometry.tetrahedra import boundary_triangles
from fracture_collision.lockstep import Exchange, Lockstep
from fracture_collision.run_report import summaries
from fracture_collision.simulation.scene.scene import Scene
from fracture_collision.viewer.film.recorded_run import RecordedRun, RecordedStates
from fracture_collision.world import Settings
from fracture_collision.world.settings import values_of

MILLI = 1e3
COUNTS = ("contacts", "colliding_points", "pairs", "visits")


class StepFigures(NamedTuple):
    """One row of steps.csv. Times are wall times of this step."""

    step: int
    time: float  # [s] simulated, at the end of the step
    total_ms: float  # all but `colliding_points`
    collision_ms: float
    physics_ms: float  # the simulator's part, less fracture_ms
    solver_ms: float  # of that, the contact solver
    update_ms: float  # of the service, at fractures; else 0
    fracture_ms: float  # patterns of what was hit hard enough; else 0
    fractures: int  # at the end of this step; the service gets them with the next
    contacts: int
    colliding_points: int  # contacts there would be without a limit; -1: not counted
    pairs: int  # of fragments whose boxes meet
    touching_pairs: int  # of those, listed with contacts or a bound
    visits: int  # sphere tree nodes tested
    fragments: int  # that can move
    deepest_gap: float  # [m] smallest gap of the contacts
    missed_depth_bound: float  # [m] the largest of the pairs
    kinetic_energy: float  # [J]
    potential_energy: float  # [J]
    drift_energy: float  # [J] put in by drift correction
    hand_energy: float  # [J] put in by the hand
    max_speed: float  # [m/s]


class SceneRun:
    """A run of one scene: an iterator over its steps, and afterwards, or when stopped half way, their report.

    Kernels are loaded first, so that no step waits for them; garbage collection and memory are those of any user of the
    library. `count_colliding` adds a query per step, outside the times. Use as a context manager.
    """

    def __init__(
        self, scene: Scene, settings: Settings | None = None, seed: int | None = None, count_colliding: bool = False
    ) -> None:
        self.scene = scene
        self.settings = Settings(lookahead=scene.time_step) if settings is None else settings
        self.seed = scene.seed if seed is None else seed
        self.rows: list[StepFigures] = []
        self._count_colliding = count_colliding
        service.compile_kernels(progress=_say_nothing)
        simulator.compile_kernels(progress=_say_nothing)
        self._lockstep = Lockstep(scene, self.settings, self.seed)
        bodies = {body.body_id: body for body in self._lockstep.simulation.start_bodies()}
        self.film = RecordedRun(bodies, {body.fragment_id: i for i, body in bodies.items()}, {}, [])
        self._living = list(self.film.body_of)
        self._sha = hashlib.sha256()
        self._seconds = 0.0

    def __enter__(self) -> SceneRun:
        return self

    def __exit__(self, *_: object) -> None:
        self._lockstep.close()

    def __iter__(self) -> Iterator[StepFigures]:
        """The remaining steps."""
        while not self._lockstep.simulation.finished:
            yield self.step()

    def step(self) -> StepFigures:
        """One time step, also beyond the scene's duration; its figures, which are also the last of `rows`."""
        started = time.perf_counter()
        exchange = self._lockstep.step()
        world = self._lockstep.world
        visits, pairs = world.last_visits, world.last_pairs
        colliding = len(self._lockstep.every_contact(exchange.states).gaps) if self._count_colliding else -1
        self._keep(exchange)
        report, times, contacts = exchange.report, exchange.times, exchange.contacts
        self.rows.append(
            StepFigures(
                step=report.step,
                time=report.time,
                total_ms=MILLI * times.total,
                collision_ms=MILLI * times.collision,
                physics_ms=MILLI * times.physics,
                solver_ms=MILLI * report.solver_seconds,
                update_ms=MILLI * times.update,
                fracture_ms=MILLI * times.fracture,
                fractures=len(report.events),
                contacts=report.contacts,
                colliding_points=colliding,
                pairs=pairs,
                touching_pairs=len(contacts.fragment_a),
                visits=visits,
                fragments=report.fragments,
                deepest_gap=report.deepest_gap,
                missed_depth_bound=float(contacts.missed_depth_bound.max(initial=0.0)),
                kinetic_energy=report.kinetic_energy,
                potential_energy=report.potential_energy,
                drift_energy=report.drift_energy,
                hand_energy=report.hand_energy,
                max_speed=report.max_speed,
            )
        )
        self._seconds += time.perf_counter() - started
        return self.rows[-1]

    def report(self) -> dict[str, Any]:
        """The contents of report.json: lists with one number per step, their summaries, and sizes of bodies."""
        columns = {name: [getattr(row, name) for row in self.rows] for name in StepFigures._fields}
        if not self._count_colliding:
            del columns["colliding_points"]
        summarized = [name for name in columns if name.endswith("_ms") or name in COUNTS]
        meshes = {i: body for i, body in self.film.bodies.items() if len(body.tetrahedra)}
        pieces = [fragment for fragment in self._living if self.film.body_of[fragment] in meshes]
        movable = [fragment for fragment in pieces if not self.film.bodies[self.film.body_of[fragment]].is_static]
        return {
            "scene": self.scene.name,
            "engine": self.scene.engine,
            "seed": self.seed,
            "settings": values_of(self.settings),
            "seconds": self._seconds,
            "finished": self._lockstep.simulation.finished,
            "digest": self._sha.hexdigest(),
            "living_fragments": len(self._living),
            "triangles": sum(self._triangles(fragment) for fragment in pieces),
            "totals": {
                "time_step_ms": MILLI * self.scene.time_step,
                "triangles_before": sum(self._triangles(self.film.bodies[i].fragment_id) for i in meshes),
                "triangles_after": sum(self._triangles(fragment) for fragment in pieces),
                "fragments": len(movable),
            },
            "sizes": object_sizes(self.scene),
            "summary": summaries({name: columns[name] for name in summarized}),
            **columns,
        }

    def write_steps(self, csv_path: Path) -> None:
        """Writes the figures of all steps so far, a row each."""
        with csv_path.open("w", newline="", encoding="utf-8") as stream:
            writer = csv.writer(stream)
            writer.writerow(StepFigures._fields)
            writer.writerows(self.rows)

    def _keep(self, exchange: Exchange) -> None:
        states, contacts = exchange.states, exchange.contacts
        for part in (states.positions, states.orientations, contacts.contact_ids, contacts.gaps, contacts.normals):
            self._sha.update(np.ascontiguousarray(part).tobytes())
        ids, bodies = exchange.registry.fragment_ids.tolist(), exchange.registry.body_ids.tolist()
        if ids != self._living:
            for fragment_id, body_id in zip(ids, bodies, strict=True):
                if fragment_id not in self.film.body_of:
                    self.film.body_of[fragment_id] = body_id
                    self.film.meshes[fragment_id] = self._lockstep.world.fragment_mesh(fragment_id)
            self._living = ids
        self.film.states.append(
            RecordedStates(
                states.step * self.scene.time_step, states.step, states.fracture_sequence,
                states.fragment_ids.astype(np.int64), states.positions,
                states.orientations,
            )
        )  # fmt: skip

    def _triangles(self, fragment_id: int) -> int:
        if fragment_id in self.film.meshes:
            return len(self.film.meshes[fragment_id].triangles)
        tetrahedra = self.film.bodies[self.film.body_of[fragment_id]].tetrahedra
        return len(boundary_triangles(tetrahedra))


def object_sizes(scene: Scene) -> list[dict[str, Any]]:
    """Table 1 of Glondu et al. 2014: for each mesh of a scene, its sizes and how many bodies have it."""
    sizes: dict[int, dict[str, Any]] = {}
    for body in scene.bodies:
        mesh = body.shape.mesh
        if mesh is None:
            continue
        if id(mesh) not in sizes:
            surface = boundary_triangles(mesh.tetrahedra)
            sizes[id(mesh)] = {
                "object": body.shape.kind,
                "bodies": 0,
                "triangles": len(surface),
                "tetrahedra": len(mesh.tetrahedra),
                "points": len(mesh.vertices),
                "interior_points": len(mesh.vertices) - len(np.unique(surface)),
            }
        sizes[id(mesh)]["bodies"] += 1
    return list(sizes.values())


def _say_nothing(_words: str) -> None:
    pass
