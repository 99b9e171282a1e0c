"""The page's controls: only those with a handler, and the help that explains them."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any, Literal

import numpy as np
import viser

from fracture_collision.viewer.page.page_events import Ball, Handlers, Joint, Ray, ServiceSliders, Start
from fracture_collision.viewer.page.server.page_upload import Uploads

ArrowKey = Literal["arrowup", "arrowdown", "arrowleft", "arrowright"]
ARROWS: tuple[tuple[str, ArrowKey], ...] = (
    ("up", "arrowup"), ("down", "arrowdown"), ("left", "arrowleft"), ("right", "arrowright"),
)  # fmt: skip
STEPS = {"penetration_tolerance": 0.0005}  # of a number's arrows
SLOWEST, FASTEST_BALL, LARGEST_BALL = 0.02, 30.0, 0.15  # -, m/s, m
SMALLEST_BALL = 0.01  # [m]


class Controls:
    """Creates the controls and handles their events.

    Callbacks are coroutines because viser runs those one after another; it would run plain functions in threads of a
    pool, in any order.
    """

    def __init__(self, server: viser.ViserServer, handlers: Handlers, start: Start) -> None:
        self._gui = server.gui
        self._handlers = handlers
        self._service: dict[str, Any] = {}  # by name of a setting
        self._robot: viser.GuiFolderHandle | None = None  # hidden while the scene has none
        self._joints: list[tuple[Joint, viser.GuiSliderHandle, viser.GuiTextHandle]] = []
        self._pause: viser.GuiCheckboxHandle | None = None
        self._paused = False  # the scene, when last heard
        self._scene: viser.GuiDropdownHandle[str] | None = None
        if handlers.scene_chosen and start.scenes:
            self._scene = self._gui.add_dropdown("scene", start.scenes, initial_value=start.scene or start.scenes[0])
            on_update(self._scene, handlers.scene_chosen)
        if handlers.uploaded and start.mesh_suffixes:
            Uploads(server, "upload a mesh", start.mesh_suffixes, handlers.uploaded)
        self._add_time(start)
        if handlers.clicked:
            self._add_ball(server, start.ball, handlers.clicked)
        if handlers.joint_set:
            self._robot = self._gui.add_folder("Robot: joints, degrees or mm", visible=False)
        if handlers.arrow:
            self._add_hammer(handlers.arrow)
        if handlers.service_set and start.settings:
            self._add_service(start, handlers.service_set)

    def show_scene(self, name: str) -> None:
        """Show which scene runs, if it is one of those offered."""
        if self._scene is not None and name in self._scene.options and self._scene.value != name:
            self._scene.value = name  # type: ignore[misc]  # mypy misses viser's setter

    def add_scene(self, name: str) -> None:
        """Offer one more scene."""
        if self._scene is not None and name not in self._scene.options:
            self._scene.options = (*self._scene.options, name)

    def show_paused(self, paused: bool) -> None:
        """Show whether the scene is paused, once that has changed: a box that a user has just ticked stays ticked."""
        if self._pause is not None and paused != self._paused:
            self._paused = self._pause.value = paused  # type: ignore[misc]  # mypy misses viser's setter

    def show_service(self, service: ServiceSliders) -> None:
        """Show the current settings of the service."""
        for name, knob in self._service.items():
            knob.value = getattr(service, name)

    def show_robot(self, joints: Sequence[Joint], angles: Sequence[float]) -> None:
        """Show sliders of a robot's joints, which are at `angles` [rad], [m]; without joints: there is no robot."""
        if self._robot is None or self._handlers.joint_set is None:
            return
        for _, slider, text in self._joints:
            slider.remove()
            text.remove()
        self._robot.visible, self._joints = bool(joints), []  # type: ignore[misc]  # as above
        with self._robot:
            for number, (joint, angle) in enumerate(zip(joints, angles, strict=True), 1):
                self._add_joint(number, joint, angle, self._handlers.joint_set)

    def show_torques(self, torques: Sequence[float]) -> None:
        """Show the torques [N m], [N] of the joints of show_robot beside their limits."""
        for (joint, _, text), torque in zip(self._joints, torques, strict=False):
            text.value = f"{torque:.1f} of {joint.torque:g}"  # type: ignore[misc]  # mypy misses viser's setter

    def _add_time(self, start: Start) -> None:
        handlers = self._handlers
        if handlers.paused:
            self._pause = self._gui.add_checkbox("pause", False)
            on_update(self._pause, handlers.paused)
        if handlers.one_step:
            _on_click(self._gui.add_button("one step", icon=viser.Icon.PLAYER_TRACK_NEXT), handlers.one_step)
        if handlers.reset:
            _on_click(self._gui.add_button("start over", icon=viser.Icon.REFRESH), handlers.reset)
        if handlers.rewind:
            _on_click(self._gui.add_button("rewind 10 s", icon=viser.Icon.REWIND_BACKWARD_10), handlers.rewind)
        if handlers.slow_motion:
            slider = self._gui.add_slider("slow motion", SLOWEST, 1.0, 0.01, start.slow_motion)
            on_update(slider, handlers.slow_motion)
        if handlers.recording:
            on_update(self._gui.add_checkbox("record", False, hint="Writes a bag."), handlers.recording)

    def _add_ball(self, server: viser.ViserServer, ball: Ball, clicked: Callable[[Ray, Ball], None]) -> None:
        with self._gui.add_folder("Ball: click to throw"):
            speed = self._gui.add_slider("speed, m/s", 0.5, FASTEST_BALL, 0.5, ball.speed)
            radius = self._gui.add_slider("radius, m", SMALLEST_BALL, LARGEST_BALL, 0.005, ball.radius)
        rays = _rays(clicked, lambda: Ball(float(speed.value), float(radius.value)))
        server.scene.on_click()(rays)

    def _add_hammer(self, arrow: Callable[[str], None]) -> None:
        for word, key in ARROWS:
            command = self._gui.add_command(f"hammer {word}", hotkey=key)
            command.on_trigger(_as_coroutine(_on_arrow(arrow, word)))
        buttons = self._gui.add_button_group(
            "hammer", [word for word, _ in ARROWS], hint="Drive a steel ball, as the arrow keys do."
        )
        buttons.on_click(_as_coroutine(lambda event: arrow(event.target.value)))

    def _add_joint(self, number: int, joint: Joint, angle: float, joint_set: Callable[[str, float], None]) -> None:
        unit, turn = (1e-3, 1.0) if joint.slides else (math.radians(1.0), math.pi)
        lower, upper = (round(limit / unit) for limit in (max(joint.lower, -turn), min(joint.upper, turn)))
        start = min(max(round(angle / unit), lower), upper)
        slider = self._gui.add_slider(f"joint {number}", lower, upper, 1, start, hint=joint.name)
        label = f"torque {number}, {'N' if joint.slides else 'N m'}"
        text = self._gui.add_text(label, f"0 of {joint.torque:g}", disabled=True, hint="Of its motor, and its limit.")
        self._joints.append((joint, slider, text))
        on_update(slider, lambda value: joint_set(joint.name, min(max(value * unit, joint.lower), joint.upper)))

    def _add_service(self, start: Start, service_set: Callable[[ServiceSliders], None]) -> None:
        with self._gui.add_folder("Collision service"):
            for name, knob in start.settings.items():
                value = getattr(start.service, name)
                if knob.choices:
                    self._service[name] = self._gui.add_dropdown(
                        name, knob.choices, initial_value=value, hint=knob.hint
                    )
                else:
                    kind = type(value)
                    self._service[name] = self._gui.add_number(
                        name, value, min=kind(knob.low), max=kind(knob.high), step=STEPS.get(name, 1), hint=knob.hint
                    )

        def told(_value: Any) -> None:
            service_set(start.service._replace(**{name: knob.value for name, knob in self._service.items()}))

        for knob in self._service.values():
            on_update(knob, told)


def _rays(clicked: Callable[[Ray, Ball], None], ball: Callable[[], Ball]) -> Callable[..., Any]:
    def on_click(event: viser.SceneClickEvent) -> None:
        clicked(Ray(np.array(event.ray_origin), np.array(event.ray_direction)), ball())

    return _as_coroutine(on_click)


def on_update(knob: Any, handler: Callable[[Any], None]) -> None:
    """Call `handler` with the knob's new value if a user, not the program, changed it."""

    def told(event: viser.GuiEvent) -> None:
        if event.client is not None:
            handler(event.target.value)

    knob.on_update(_as_coroutine(told))


def _on_arrow(arrow: Callable[[str], None], word: str) -> Callable[[Any], None]:
    return lambda _event: arrow(word)


def _on_click(button: viser.GuiButtonHandle, handler: Callable[[], None]) -> None:
    button.on_click(_as_coroutine(lambda _event: handler()))


def _as_coroutine(function: Callable[[Any], None]) -> Callable[[Any], Any]:
    async def call(event: Any) -> None:
        function(event)

    return call


CAMERA = (
    "**Look around**: drag the background to turn, with the right button (two fingers) to shift; the wheel (pinch)"
    " zooms. *reset view* returns."
)
LAYERS = (
    "*contact points*, *contact normals*: red where bodies penetrate, yellow touching, green about to touch",
    "*touching pairs*: a line between the centres of fragments in contact",
    "*missed depth bound*: how deep a penetration of a pair may be without being listed; blue 0, magenta 2 mm or more",
    "*shadows*: off is faster on a slow graphics processor",
)
INSIDE = (
    "*sphere trees*, *level*: bounding spheres of one level of the trees that the search descends",
    "*field on a plane*, *across*, *place*: exact depths inside the fragments, on a plane across an axis",
    "*colliding points*: all contacts that could be listed, counted",
    "*errors of answers*: what the settings of the service leave unlisted",
)
RECORDED = (
    "*time*, *play*, *one step*: move in the recording",
    "*download .glb*: the run as a 3D animation in one file, for viewers such as Blender",
    "*speed*: simulated seconds per second",
)


def help_text(handlers: Handlers, start: Start, is_recorded: bool) -> str:
    """Markdown about the controls that the page has with these handlers."""
    acts = []
    if handlers.clicked:
        acts.append("**Throw**: click (tap) anywhere. A ball flies there; its *speed* and *radius* are on the panel.")
    if handlers.drag_begun:
        acts.append("**Pull**: press on a body and move. The arrow shows the pull; let go to drop it.")
    if handlers.arrow:
        acts.append("**Hammer**: the arrow keys drive a steel ball, or the buttons *hammer*.")
    acts.append(CAMERA)
    lines = [line for line, is_there in _controls(handlers, start) if is_there]
    if is_recorded:
        lines = [*RECORDED, *lines]
    inside = INSIDE if handlers.looking_inside else ()
    return "\n".join(f"- {line}" for line in (*acts, *lines, *LAYERS, *inside))


def add_help(server: viser.ViserServer, text: str) -> None:
    """Add the button."""
    button = server.gui.add_button("help", icon=viser.Icon.HELP, color="gray")
    opened: dict[int, Any] = {}  # by client: at most one each
    server.on_client_disconnect(lambda client: opened.pop(client.client_id, None))

    @button.on_click
    async def _(event: viser.GuiEvent) -> None:
        client = event.client
        if client is None:
            return
        earlier = opened.pop(client.client_id, None)
        if earlier is not None and not earlier.closed:
            earlier.close()
        modal = opened[client.client_id] = client.gui.add_modal("Help")

        async def close(_event: viser.GuiEvent) -> None:
            if opened.get(client.client_id) is modal:
                del opened[client.client_id]
                modal.close()

        with modal:
            client.gui.add_button("close").on_click(close)
            client.gui.add_markdown(text)
            client.gui.add_button("close").on_click(close)  # the text may be longer than the window


def _controls(handlers: Handlers, start: Start) -> Sequence[tuple[str, bool]]:
    return (
        ("*scene*: begins another one", bool(handlers.scene_chosen and start.scenes)),
        (
            f"*upload a mesh*: your own body ({', '.join(start.mesh_suffixes)}), 0.3 m long, becomes a scene to smash",
            bool(handlers.uploaded and start.mesh_suffixes),
        ),
        ("*pause*, *one step*, *start over*: time of the scene", handlers.paused is not None),
        (
            "*rewind 10 s*: back by up to ten simulated seconds, and paused; *pause* lets the scene go on from there",
            handlers.rewind is not None,
        ),
        ("*slow motion*: simulated seconds per second", handlers.slow_motion is not None),
        ("*record*: writes a bag, for `fracture-collision view`, `film` and `replay`", handlers.recording is not None),
        (
            "*joint 1*, *torque 1* and so on: the robot, in scenes that have one, and what its motors exert",
            handlers.joint_set is not None,
        ),
        *((f"*{name}*: {knob.hint}", handlers.service_set is not None) for name, knob in start.settings.items()),
    )
