"""User input on the page as plain records, and the handlers for it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import NamedTuple

import numpy as np


class Ray(NamedTuple):
    """Line of sight through the pointer."""

    origin: np.ndarray  # (3,) [m], world: the eye
    direction: np.ndarray  # (3,) unit, world: through the pointer


class Drag(NamedTuple):
    """A fragment held by the mouse."""

    fragment_id: int
    grip: np.ndarray  # (3,) [m], world: the held point of the fragment, where it is now
    target: np.ndarray  # (3,) [m], world: the pointer, in the plane through the grip that faces the eye
    ray: Ray  # through the pointer


class Ball(NamedTuple):
    """A ball to be thrown along a ray."""

    speed: float  # [m/s]
    radius: float  # [m]


class ServiceSliders(NamedTuple):
    """Settings of the collision service with controls on the page; names and meaning as in config/collision.yaml."""

    contacts_per_pair: int = 8
    penetration_tolerance: float = 0.002
    method: str = "exact"


class SettingKnob(NamedTuple):
    """The control of a setting."""

    hint: str
    low: float = 0.0  # of a number
    high: float = 0.0
    choices: tuple[str, ...] = ()  # of a text


class PlaneWanted(NamedTuple):
    """A plane across a world axis."""

    axis: int  # 0, 1, 2: x, y, z
    share: float  # of the way from one end of the movable bodies to the other


class InsideWanted(NamedTuple):
    """The internals of collision detection that the user wants to see; None, False: not wanted."""

    level: int | None = None  # of the sphere trees
    plane: PlaneWanted | None = None  # with the field on it
    colliding: bool = False  # all colliding points, counted
    errors: bool = False  # of the service's answers

    @property
    def compares(self) -> bool:
        """Whether to compare answers with all contacts that could be listed."""
        return self.colliding or self.errors

    @property
    def anything(self) -> bool:
        """Whether any data is requested."""
        return self != InsideWanted()


class Joint(NamedTuple):
    """A joint of a robot with a motor; the page has a slider for it while the scene has the robot."""

    name: str
    lower: float  # [rad]; of one that slides [m]
    upper: float
    torque: float  # [N m], [N] of its motor at most
    slides: bool = False


class Upload(NamedTuple):
    """A file that a user has sent."""

    name: str  # as the browser gave it: text for messages, never a path
    content: bytes
    tell: Callable[[str], None]  # shows a notification in the browser that sent it; any thread may call


class Handlers(NamedTuple):
    """Handlers of user input; the page has no control for a missing handler.

    All are called one after another in the page's own thread, and must return at once.
    """

    clicked: Callable[[Ray, Ball], None] | None = None
    drag_begun: Callable[[Drag], None] | None = None  # the three go together
    drag_moved: Callable[[Drag], None] | None = None
    drag_ended: Callable[[Drag], None] | None = None
    arrow: Callable[[str], None] | None = None  # "up", "down", "left", "right", repeated while a key is held
    scene_chosen: Callable[[str], None] | None = None
    uploaded: Callable[[Upload], None] | None = None  # of a mesh, whose name ends in one of Start.mesh_suffixes
    reset: Callable[[], None] | None = None
    rewind: Callable[[], None] | None = None
    paused: Callable[[bool], None] | None = None
    one_step: Callable[[], None] | None = None
    slow_motion: Callable[[float], None] | None = None  # simulated seconds a second of the wall clock, at most 1
    service_set: Callable[[ServiceSliders], None] | None = None
    joint_set: Callable[[str, float], None] | None = None  # name, [rad] or [m] within its limits
    recording: Callable[[bool], None] | None = None
    looking_inside: Callable[[InsideWanted], None] | None = None  # answered by Page.show_inside, repeatedly


class Start(NamedTuple):
    """Initial values of the controls."""

    scenes: tuple[str, ...] = ()
    scene: str = ""
    mesh_suffixes: tuple[str, ...] = ()  # of files that may be uploaded
    ball: Ball = Ball(6.0, 0.04)
    slow_motion: float = 1.0
    service: ServiceSliders = ServiceSliders()
    settings: Mapping[str, SettingKnob] = MappingProxyType({})  # by field of `service`; those that have a control
