"""A scene run by `play`, with its page in a browser: the nodes' messages and a user's actions. For tests."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from fracture_collision.msg import ContactConstraintArray, FragmentStates, SimulationStatus

from fracture_collision.ros.processes.node_process import free_domain_id
from fracture_collision.ros.runs.play_run import Played, played
from fracture_collision.ros.wire import qos
from fracture_collision.ros.wire.interfaces import LIVE_STATUS
from stages.browser import knob, picture_of, until
from stages.ros_client import PATIENCE, ServiceClient


class LivePage:
    """A scene run by `play`, and the messages of its nodes."""

    def __init__(self, run: Played) -> None:
        self.address = run.address
        self._run = run
        self.ears = ServiceClient(run.domain_id)
        self.told: list[SimulationStatus] = []
        self.states: list[FragmentStates] = []
        for topic, heard in ((LIVE_STATUS, self.told), (qos.FRAGMENT_STATES, self.states)):
            self.ears.node.create_subscription(topic.message_class, topic.name, heard.append, topic.qos)
        self.until(lambda: bool(self.told) and bool(self.states), "a live scene")

    @property
    def status(self) -> SimulationStatus:
        return self.told[-1]

    @property
    def answer(self) -> ContactConstraintArray:
        return self.ears.answers[-1]

    def until(self, condition: Any, what: str) -> None:
        self.ears.spin_until(condition, what, 2 * PATIENCE)
        self._run.check()

    def places(self) -> dict[int, np.ndarray]:
        states = self.states[-1]
        return dict(zip(states.fragment_ids, np.reshape(states.positions, (-1, 3)), strict=True))

    def close(self) -> None:
        self.ears.close()


@contextmanager
def live_page(scene: str, folder: Path) -> Iterator[LivePage]:
    """In a separate domain; recordings go to `folder`."""
    before = os.environ.get("ROS_DOMAIN_ID")
    os.environ["ROS_DOMAIN_ID"] = str(free_domain_id())
    try:
        with played(scene, -1, folder, "127.0.0.1", 0) as run:
            made = LivePage(run)
            try:
                yield made
            finally:
                made.close()
    finally:
        if before is None:
            del os.environ["ROS_DOMAIN_ID"]
        else:
            os.environ["ROS_DOMAIN_ID"] = before


def colourful(picture: np.ndarray) -> np.ndarray:
    """Mask of the plates: wood and carpet are nearly grey."""
    return picture.max(axis=2) - picture.min(axis=2) > 0.3


def on_a_plate(page: Any) -> tuple[float, float]:
    """A pixel amid many colourful ones."""
    seen = colourful(until(lambda: picture_of(page), lambda picture: np.count_nonzero(colourful(picture)) > 300))
    # the pixel with the most of them around it
    sums = np.pad(seen.cumsum(0).cumsum(1), ((1, 0), (1, 0)))
    size = 15
    about = sums[size:, size:] - sums[:-size, size:] - sums[size:, :-size] + sums[:-size, :-size]
    row, column = np.unravel_index(np.argmax(about), about.shape)
    return float(column + size // 2), float(row + size // 2)


def choose(page: Any, label: str, option: str) -> None:
    """As a user does: once more, if the page was drawn anew under the click."""

    def chosen() -> str:
        if knob(page, label).input_value() != option:
            knob(page, label).click()
            page.get_by_role("option", name=option, exact=True).click()
        return knob(page, label).input_value()

    until(chosen, lambda value: value == option)
