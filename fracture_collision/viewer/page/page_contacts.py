"""Contacts, pairs and bounds drawn over the scene, with their switches."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import viser

from fracture_collision.records import ContactConstraintArray
from fracture_collision.viewer.page.server.page_stream import LiveValues
from fracture_collision.viewer.pictures.palette import gap_colours

MILLI = 1e3
PAIR_COLOUR = np.array((120, 60, 200))
BOUND_SCALE = 2e-3  # [m] colour scale of missed depth: blue 0, magenta this much or more
CERTAIN, UNCERTAIN = np.array((40, 120, 240.0)), np.array((255, 0, 180.0))
POINT_SIZE = 0.008  # [m]
NORMAL_LENGTH = 0.04  # [m]

Centre = Callable[[int], "np.ndarray | None"]


class ContactLayers:
    """Draws the layers that are switched on, from the newest contacts. One thread at a time, except the switches."""

    def __init__(self, server: viser.ViserServer, live: LiveValues, changed: Callable[[], None]) -> None:
        """`changed` is called when a switch changes."""
        self._live = live
        with server.gui.add_folder("Contacts"):
            self._switches = {
                "points": server.gui.add_checkbox("contact points", False, hint="Red: penetrating; green: apart."),
                "normals": server.gui.add_checkbox("contact normals", False),
                "pairs": server.gui.add_checkbox("touching pairs", False),
                "bounds": server.gui.add_checkbox(
                    "missed depth bound", False,
                    hint="No unlisted penetration of a pair is deeper than its bound. Blue: 0; magenta: 2 mm or more.",
                ),
            }  # fmt: skip
            self._words = server.gui.add_markdown("")
        for switch in self._switches.values():
            switch.on_update(lambda _event: changed())
        point, segment = np.zeros((1, 3), np.float32), np.zeros((1, 2, 3), np.float32)
        scene = server.scene
        self._nodes: dict[str, viser.PointCloudHandle | viser.LineSegmentsHandle] = {
            "points": scene.add_point_cloud(
                "/contact_points", point, point.astype(np.uint8), point_size=POINT_SIZE, precision="float32",
                point_shape="circle", visible=False,
            ),
        }  # fmt: skip
        for name, thickness in (("normals", 2.0), ("pairs", 3.0), ("bounds", 4.0)):
            self._nodes[name] = scene.add_line_segments(
                f"/contact_{name}", segment, segment.astype(np.uint8), thickness=thickness, thickness_units="screen",
                visible=False,
            )  # fmt: skip
        self._said = ""

    @property
    def wanted(self) -> bool:
        """Whether any layer is switched on."""
        return any(switch.value for switch in self._switches.values())

    def draw(self, contacts: ContactConstraintArray | None, centre: Centre) -> None:
        """`centre`: of a fragment by its id, world [m]; None: it is not shown."""
        drawn = {} if contacts is None else self._layers(contacts, centre)
        for name, node in self._nodes.items():
            points, colours = drawn.get(name, (np.zeros(0), np.zeros(0)))
            if len(points):
                self._live.properties(node.name, points=points.astype(np.float32), colors=colours.astype(np.uint8))
            node.visible = len(points) > 0
        words = "" if contacts is None or not self._switches["bounds"].value else _bound_words(contacts)
        if words != self._said:
            self._words.content = self._said = words

    def _layers(
        self, contacts: ContactConstraintArray, centre: Centre
    ) -> dict[str, tuple[np.ndarray, np.ndarray]]:
        on = {name for name, switch in self._switches.items() if switch.value}
        layers: dict[str, tuple[np.ndarray, np.ndarray]] = {}
        a, b = contacts.points_a, contacts.points_b
        middle, colours = 0.5 * (a + b), 255.0 * gap_colours(contacts.gaps)
        if "points" in on:
            layers["points"] = middle, colours
        if "normals" in on:
            tips = middle + NORMAL_LENGTH * contacts.normals
            layers["normals"] = np.stack((middle, tips), axis=1), np.repeat(colours[:, None], 2, axis=1)
        if on & {"pairs", "bounds"}:
            listed, lines = _pair_lines(contacts, centre)
            has_contact = np.diff(contacts.pair_begin.astype(np.int64))[listed] > 0
            if "pairs" in on:
                layers["pairs"] = lines[has_contact], np.tile(PAIR_COLOUR, (int(has_contact.sum()), 2, 1))
            if "bounds" in on:
                share = np.clip(contacts.missed_depth_bound[listed] / BOUND_SCALE, 0.0, 1.0)[:, None]
                colour = (1.0 - share) * CERTAIN + share * UNCERTAIN
                layers["bounds"] = lines, np.repeat(colour[:, None], 2, axis=1)
        return layers


def _pair_lines(contacts: ContactConstraintArray, centre: Centre) -> tuple[np.ndarray, np.ndarray]:
    """Indices (n,) of the pairs with both fragments in the scene, and lines (n, 2, 3) between their centres.

    A plane has no centre: its end is the mean of the contacts.
    """
    listed, lines = [], []
    for i, (a, b) in enumerate(zip(contacts.fragment_a.tolist(), contacts.fragment_b.tolist(), strict=True)):
        ends = [centre(a), centre(b)]
        here = contacts.points_a[contacts.pair_begin[i] : contacts.pair_begin[i + 1]]
        if len(here):
            ends = [here.mean(axis=0) if end is None else end for end in ends]
        if all(end is not None for end in ends):
            listed.append(i)
            lines.append(ends)
    return np.array(listed, dtype=np.int64), np.array(lines).reshape(-1, 2, 3)


def _bound_words(contacts: ContactConstraintArray) -> str:
    bounds = contacts.missed_depth_bound
    if not len(bounds):
        return "no pairs"
    worst = int(np.argmax(bounds))
    pair = f"{contacts.fragment_a[worst]} and {contacts.fragment_b[worst]}"
    return f"unlisted penetrations are at most **{MILLI * bounds[worst]:.3f} mm** deep (fragments {pair})"
