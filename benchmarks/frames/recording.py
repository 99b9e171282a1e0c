"""The service's input in a scene, step by step: recorded once, then replayed to every library compared."""

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
    bodies: list[CollisionBody]  # published before the step
    events: list[FractureEvent]  # published before the step
    states: FragmentStates
    moving: int  # fragments faster than MOVES


class Recording(NamedTuple):
    name: str  # of the scene, with @ and its curvature
    settings: Settings  # of the service: the defaults of what simulates, one thread
    steps: list[Step]


def record(name: str) -> Recording:
    """A scene of config/scenes: `bricks`, or with curved cracks `bricks@0.25`."""
    scene_name, _, curvature = name.partition("@")
    scene = load_scene(scene_name)
    if curvature:
        scene = with_curvature(scene, float(curvature))
    settings = Settings(threads=1, lookahead=scene.time_step)
    steps, bodies, events = [], None, []
    with Lockstep(scene, settings) as lockstep:
        bodies = lockstep.simulation.start_bodies()
        for exchange in lockstep:
            speeds = np.sqrt((exchange.states.linear_velocities.reshape(-1, 3) ** 2).sum(axis=1))
            steps.append(Step(bodies, events, exchange.states, int((speeds > MOVES).sum())))
            bodies, events = [], exchange.report.events
    return Recording(name, settings, steps)
