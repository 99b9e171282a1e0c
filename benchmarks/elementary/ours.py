"""Elementary scenes in our simulator, at its defaults."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from benchmarks.elementary.scenes import Trace
from fracture_collision.lockstep import Lockstep
from fracture_collision.simulation.scene.scene import Scene
from fracture_collision.world import Settings


def run(scene: Scene, scale: float = 1.0) -> Trace:
    """Run a scene to its end."""
    root = math.sqrt(scale)
    rows: list[tuple[Any, ...]] = []
    with Lockstep(scene, Settings(threads=1, lookahead=scene.time_step)) as running:
        for exchange in running:
            states, report = running.simulation._engine.states(), exchange.report
            rows.append((
                states.centers / scale, states.linear / root, states.angular * root, report.kinetic_energy,
                report.kinetic_energy + report.potential_energy, report.deepest_gap / scale,
            ))  # fmt: skip
        asleep = running.simulation._rest.asleep.copy()
    columns = [np.array(column) for column in zip(*rows, strict=True)]
    columns[3] = columns[3] / max(columns[3][0], 1e-300)
    return Trace(*columns, asleep)
