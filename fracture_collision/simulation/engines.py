"""The engines by name."""

from __future__ import annotations

from fracture_collision.extras import need
from fracture_collision.simulation.dynamics import Dynamics
from fracture_collision.simulation.own_dynamics import OwnDynamics
from fracture_collision.simulation.scene.scene import MUJOCO, Scene, known_engine, require_engine_for_robot


def dynamics_of(scene: Scene, looks_ahead: bool) -> Dynamics:
    """A scene's engine, without bodies. looks_ahead: see OwnDynamics.

    MissingExtra if it is not installed, or a robot's; SceneError if it cannot have the scene's robot.
    """
    require_engine_for_robot(scene)
    if scene.robot is not None:
        need("bullet", "a scene with a robot")
    if scene.engine == MUJOCO:
        from fracture_collision.simulation.mujoco_dynamics import MujocoDynamics

        return MujocoDynamics(scene.time_step, scene.gravity, scene.solver, looks_ahead)
    return OwnDynamics(scene.time_step, scene.gravity, scene.solver, looks_ahead)


def with_engine(scene: Scene, engine: str | None) -> Scene:
    """The scene with this engine; None or "": its own. Raises SceneError, and MissingExtra if it is not installed."""
    if engine:
        scene = scene._replace(engine=known_engine(engine))
    dynamics_of(scene, False).close()
    return scene
