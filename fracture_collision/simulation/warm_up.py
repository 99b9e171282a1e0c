"""Compiles the simulator's kernels into numba's cache, by letting a ball hit the ground and a brick break once."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from fracture_collision.fracture.pattern import PatternSettings
from fracture_collision.geometry import generators
from fracture_collision.records import ContactConstraintArray, FragmentRegistry
from fracture_collision.simulation.breakable_body import BreakableBody
from fracture_collision.simulation.scene.scene import parse_scene
from fracture_collision.simulation.simulation import Simulation

MATERIAL = {"density": 1000.0, "friction": 0.5, "restitution": 0.5, "rolling_arm": 1e-3}
TIME_STEP = 0.01  # [s]
SCENE = {
    "seed": 0,
    "gravity": [0.0, 0.0, -9.81],
    "time_step": TIME_STEP,
    "duration": 2 * TIME_STEP,
    "materials": {"rubber": MATERIAL},
    "bodies": [
        {"name": "ground", "material": "rubber", "static": True, "shape": {"plane": {"coefficients": [0, 0, 1, 0]}}},
        {"name": "ball", "material": "rubber", "shape": {"sphere": {"radius": 0.1}}, "linear_velocity": [1, 0, -1]},
    ],
}


def compile_kernels(progress: Callable[[str], None]) -> None:
    """Compile all kernels of this package for the argument types in use; seconds at first, then milliseconds."""
    progress("contact solver")
    for looks_ahead in (False, True):
        simulation = Simulation(parse_scene(SCENE, "warm_up"), looks_ahead=looks_ahead)
        try:
            while not simulation.finished:
                step = simulation.begin_step().states.step
                simulation.finish_step(_touching(step, TIME_STEP if looks_ahead else 0.0), _registry())
        finally:
            simulation.close()
    progress("fracture patterns")
    for curvature in (0.0, 0.25):
        brick = BreakableBody(1, 1, generators.brick((1.0, 1.0, 1.0), 0.5))
        settings = PatternSettings(curvature=curvature, minimum_nodes=1)
        brick.fracture(1, 1, 2, np.zeros(3), 2.0, settings, np.random.default_rng(1))


def _touching(step: int, lookahead: float) -> ContactConstraintArray:
    """Two contacts of the ground with the ball: one a millimetre deep, one ahead, for which it waits."""
    return ContactConstraintArray(
        step, 0, 0, np.array([1], np.uint32), np.array([2], np.uint32), np.array([0, 2], np.uint32), np.zeros(1),
        np.full(1, 0.5), np.full(1, 0.5), np.zeros((2, 3)), np.array([[0.0, 0.0, -1e-3], [0.0, 0.0, 5e-3]]),
        np.array([[0.0, 0.0, 1.0], [0.0, 0.0, 1.0]]), np.array([-1e-3, 5e-3]), np.arange(2, dtype=np.uint64), lookahead,
    )  # fmt: skip


def _registry() -> FragmentRegistry:
    ids = np.array([1, 2], np.uint32)
    inertias = np.tile([0.016, 0.0, 0.0, 0.016, 0.0, 0.016], (2, 1))
    return FragmentRegistry(0, ids, ids, ids, np.full(2, 4.0), np.zeros((2, 3)), inertias, np.zeros(2), "")
