"""A simulation and its service in one process, step by step, with what the service was sent. For tests."""

from __future__ import annotations

import numpy as np

from fracture_collision.simulation.live import LiveScene
from fracture_collision.simulation.scene.scene import load_scene
from fracture_collision.simulation.simulation import Simulation, StepReport, StepRequest
from fracture_collision.world import CollisionWorld, Settings


class ServedScene:
    def __init__(self, simulation: Simulation, settings: Settings) -> None:
        self.simulation, self.world = simulation, CollisionWorld(settings)
        self.requests: list[StepRequest] = []

    def step(self, count: int = 1) -> StepReport:
        for _ in range(count):
            request = self.simulation.begin_step()
            self.requests.append(request)
            for body in request.bodies:
                self.world.add_body(body)
            for event in request.events:
                self.world.add_fracture(event)
            contacts = self.world.contacts(request.states)
            report = self.simulation.finish_step(contacts, self.world.fragments())
        return report

    def place(self, fragment_id: int) -> np.ndarray:
        """Position (3,) [m] of a fragment's frame at the last step."""
        states = self.requests[-1].states
        return states.positions.reshape(-1, 3)[states.fragment_ids.tolist().index(fragment_id)]


class PlayedScene(ServedScene):
    """A live scene; looks_ahead: by its time step, as `play` does."""

    def __init__(self, scene: str = "plates", looks_ahead: bool = True) -> None:
        parsed = load_scene(scene)
        self.live = LiveScene(parsed, 7, looks_ahead)
        super().__init__(self.live.simulation, Settings(lookahead=parsed.time_step if looks_ahead else 0.0))
