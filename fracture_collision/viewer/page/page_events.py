"""What a person does on the page, as plain records, and who is told of it."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np


class Ray(NamedTuple):
    origin: np.ndarray  # (3,) [m], world: the eye
    direction: np.ndarray  # (3,) unit, world: through the pointer


class Drag(NamedTuple):
    """A fragment held by the mouse."""

    fragment_id: int
    grip: np.ndarray  # (3,) [m], world: the point of the fragment that is held, where it is now
    target: np.ndarray  # (3,) [m], world: where the pointer wants it, in the plane through the grip that faces the eye
    ray: Ray  # through the pointer


class Ball(NamedTuple):
    speed: float  # [m/s]
    radius: float  # [m]


class ServiceSliders(NamedTuple):
    """Settings of the collision service that the page has sliders for; named and meant as in config/collision.yaml."""

    contacts_per_pair: int = 8
    penetration_tolerance: float = 0.002
    field: str = "exact"
    visit_budget: int = 0


class PlaneWanted(NamedTuple):
    """A plane across a world axis."""

    axis: int  # 0, 1, 2: x, y, z
    share: float  # of the way from one end of what can move to the other


class InsideWanted(NamedTuple):
    """What of the inside of collision detection a person wants to see; None, False: not."""

    level: int | None = None  # of the sphere trees
    plane: PlaneWanted | None = None  # with the field on it
    colliding: bool = False  # all colliding points, counted
    errors: bool = False  # of the service's answers

    @property
    def compares(self) -> bool:
        """Whether answers are wanted beside all that there is to list."""
        return self.colliding or self.errors

    @property
    def anything(self) -> bool:
        return self != InsideWanted()


class Joint(NamedTuple):
    """Of an arm; the page has a slider for it while the scene has the arm."""

    name: str
    lower: float  # [rad]
    upper: float  # [rad]


class Handlers(NamedTuple):
    """Who is told what a person does; what nobody wants to be told of, the page does not offer.

    All are called one after another in the page's own thread, and have to return at once.
    """

    clicked: Callable[[Ray, Ball], None] | None = None
    drag_begun: Callable[[Drag], None] | None = None  # the three go together
    drag_moved: Callable[[Drag], None] | None = None
    drag_ended: Callable[[Drag], None] | None = None
    arrow: Callable[[str], None] | None = None  # "up", "down", "left", "right", again and again while a key is held
    scene_chosen: Callable[[str], None] | None = None
    reset: Callable[[], None] | None = None
    paused: Callable[[bool], None] | None = None
    one_step: Callable[[], None] | None = None
    slow_motion: Callable[[float], None] | None = None  # simulated seconds a second of the wall clock, at most 1
    service_set: Callable[[ServiceSliders], None] | None = None
    joint_set: Callable[[str, float], None] | None = None  # name, [rad] within its limits
    recording: Callable[[bool], None] | None = None
    looking_inside: Callable[[InsideWanted], None] | None = None  # answered by Page.show_inside, again and again


class Start(NamedTuple):
    """Where controls stand when the page opens."""

    scenes: tuple[str, ...] = ()
    scene: str = ""
    ball: Ball = Ball(6.0, 0.04)
    slow_motion: float = 1.0
    service: ServiceSliders = ServiceSliders()
    joints: tuple[Joint, ...] = ()
