"""The help of the page: a button that opens a text about what there is to do, in the browser of its user."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import viser

from fracture_collision.viewer.page.page_events import Handlers, Start

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
        ("*joint 1* to *joint 7*: the robot arm, in scenes that have one", bool(handlers.joint_set and start.joints)),
        *((f"*{name}*: {knob.hint}", handlers.service_set is not None) for name, knob in start.settings.items()),
    )
