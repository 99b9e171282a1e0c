"""Elementary scenes in our simulator, at its defaults."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from benchmarks.elementary.scenes import Trace, turned_back
from benchmarks.elementary.shapes import TRIANGLES
from fracture_collision.geometry.tetrahedra import boundary_triangles
from fracture_collision.lockstep import Lockstep
from fracture_collision.records import CollisionBody
from fracture_collision.simulation.scene.scene import Scene
from fracture_collision.world import CollisionWorld, Settings


def surface_of(body: CollisionBody) -> CollisionBody:
    """A body of tetrahedra as one of triangles, rigid."""
    used, triangles = np.unique(boundary_triangles(body.tetrahedra.reshape(-1, 4)), return_inverse=True)
    return body._replace(
        vertices=body.vertices.reshape(-1, 3)[used].ravel(), triangles=triangles.astype(np.uint32).ravel(),
        tetrahedra=np.zeros(0, np.uint32),
    )  # fmt: skip


def run(scene: Scene, scale: float = 1.0, turn: float = 0.0) -> Trace:
    """Run a scene to its end; scale and turn [degrees] are those of its Setting."""
    root = math.sqrt(scale)
    rows: list[tuple[Any, ...]] = []
    settings = Settings(threads=1, lookahead=scene.time_step)
    is_surface = [body.shape.kind == TRIANGLES for body in scene.bodies]
    with Lockstep(scene, settings) as running:
        if any(is_surface):  # scenes have no such shape: the service gets these bodies anew
            running.world = CollisionWorld(settings)
            for body, has_no_inside in zip(running.simulation.start_bodies(), is_surface, strict=True):
                running.world.add_body(surface_of(body) if has_no_inside else body)
            running._registry = running.world.fragments()
        for exchange in running:
            states, report = running.simulation.dynamics.states(), exchange.report
            rows.append((
                states.centers / scale, states.linear / root, states.angular * root, report.kinetic_energy,
                report.kinetic_energy + report.potential_energy, report.deepest_gap / scale,
            ))  # fmt: skip
        asleep = running.simulation.dynamics._rest.asleep.copy()
    columns = [np.array(column) for column in zip(*rows, strict=True)]
    columns[3] = columns[3] / max(columns[3][0], 1e-300)
    return turned_back(Trace(*columns, asleep), turn)
