"""What a scene's service is told, step by step: recorded once, then answered by everybody who is compared."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fracture_collision.lockstep import Lockstep
from fracture_collision.records import CollisionBody, FractureEvent, FragmentStates
from fracture_collision.simulation.scene.scene import load_scene
from fracture_collision.simulation.scene.scene_changes import with_curvature
from fracture_collision.world import Settings

MOVES = 0.05  # [m/s]


class Step(NamedTuple):
    bodies: list[CollisionBody]  # that are told before it
    events: list[FractureEvent]  # likewise
    states: FragmentStates
    moving: int  # fragments faster than MOVES


class Recording(NamedTuple):
    name: str  # of the scene, and @ its curvature
    steps: list[Step]


def record(name: str) -> Recording:
    """A scene of config/scenes, `bricks`, or with curved cracks, `bricks@0.25`."""
    scene_name, _, curvature = name.partition("@")
    scene = load_scene(scene_name)
    if curvature:
        scene = with_curvature(scene, float(curvature))
    steps, bodies, events = [], None, []
    with Lockstep(scene, Settings(threads=1)) as lockstep:
        bodies = lockstep.simulation.start_bodies()
        for exchange in lockstep:
            speeds = np.sqrt((exchange.states.linear_velocities.reshape(-1, 3) ** 2).sum(axis=1))
            steps.append(Step(bodies, events, exchange.states, int((speeds > MOVES).sum())))
            bodies, events = [], exchange.report.events
    return Recording(name, steps)
