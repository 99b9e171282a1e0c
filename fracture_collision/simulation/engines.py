"""The engines by name, and scenes with another than their own."""

from __future__ import annotations

from fracture_collision.extras import need
from fracture_collision.simulation.dynamics import Dynamics
from fracture_collision.simulation.own_dynamics import OwnDynamics
from fracture_collision.simulation.scene.scene import (
    MUJOCO,
    Scene,
    SceneError,
    known_engine,
)


def dynamics_of(scene: Scene, looks_ahead: bool) -> Dynamics:
    """A scene's engine, without bodies. looks_ahead: see OwnDynamics.

    MissingExtra if it is not installed, or a robot's.
    """
    _require(scene)
    if scene.engine == MUJOCO:
        from fracture_collision.simulation.mujoco_dynamics import MujocoDynamics

        file = None if scene.model is None else scene.model.file
        ids = {body.name: i for i, body in enumerate(scene.bodies, 1)}  # see Cast
        links = {} if scene.model is None else {name: ids[name] for name in scene.model.links}
        return MujocoDynamics(scene.time_step, scene.gravity, scene.solver, looks_ahead, file, links)
    return OwnDynamics(scene.time_step, scene.gravity, scene.solver, looks_ahead)


def with_engine(scene: Scene, engine: str | None) -> Scene:
    """The scene with this engine; None or "": its own. Raises SceneError, and MissingExtra if it is not installed."""
    if engine:
        scene = scene._replace(engine=known_engine(engine))
        if scene.model is not None and scene.engine != MUJOCO:
            raise SceneError(f"engine: {scene.name} has a MuJoCo model, which needs {MUJOCO}, not {engine}")
    _require(scene)
    return scene


def _require(scene: Scene) -> None:
    """Raise MissingExtra if the scene's engine is not there, or that of its robot."""
    if scene.robot is not None:
        need("bullet", "a scene with a robot")
    if scene.engine == MUJOCO:
        need("mujoco", "the engine MuJoCo")
