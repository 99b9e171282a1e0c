"""Plays a scene as a person would, and subscribes to what its nodes publish."""

from __future__ import annotations

import os
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import QoSProfile, ReliabilityPolicy

from fracture_collision.ros.nodes.live_client import LiveClient
from fracture_collision.ros.processes.node_process import free_domain_id
from fracture_collision.ros.processes.own_context import own_context
from fracture_collision.ros.runs.play_run import Played, played
from fracture_collision.ros.wire import qos
from fracture_collision.ros.wire.interfaces import LIVE_STATUS

PATIENCE = 120.0  # [s]
PLATES = tuple((0.3 * i - 0.45, 0.0, 0.7227) for i in range(4))  # [m] in the scene `plates`
LOOKING = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)  # the publisher never waits for this


class Fracture(NamedTuple):
    time: float  # [s] wall clock at publication
    fragment_ids: tuple[int, ...]  # of the new fragments


class Person:
    def __init__(self, run: Played) -> None:
        self._run = run
        self._context = own_context(run.domain_id)
        self._node = rclpy.create_node("person", context=self._context)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._node)
        self.hands = LiveClient(self._node)
        self.fractures: list[Fracture] = []
        self.status: Any = None
        events, told = qos.FRACTURE_EVENTS, LIVE_STATUS
        self._node.create_subscription(events.message_class, events.name, self._on_fracture, events.qos)
        self._node.create_subscription(told.message_class, told.name, self._on_status, LOOKING)
        self.until(lambda: self.hands.is_there() and self.status is not None, "a live scene")

    def close(self) -> None:
        self._executor.shutdown()
        self._node.destroy_node()
        self._context.try_shutdown()

    def until(self, condition: Callable[[], bool], what: str) -> None:
        """Raises RuntimeError after PATIENCE, PlayFailed if a node ends."""
        deadline = time.monotonic() + PATIENCE
        while not condition():
            if time.monotonic() > deadline:
                raise RuntimeError(f"in vain: {what}")
            self._run.check()
            self._executor.spin_once(timeout_sec=0.05)

    def wait(self, seconds: float) -> None:
        end = time.monotonic() + seconds
        self.until(lambda: time.monotonic() > end, "time")

    def begin_again(self) -> None:
        """Resets the scene and waits until the new run has completed a step."""
        before = self.status.run_id
        future = self.hands.reset()
        self.until(future.done, "a reset")
        self.until(lambda: self.status.run_id != before and self.status.step > 0, "another run")

    def _on_status(self, message: Any) -> None:
        self.status = message

    def _on_fracture(self, message: Any, info: dict[str, int]) -> None:
        self.fractures.append(Fracture(1e-9 * info["source_timestamp"], tuple(message.new_fragment_ids)))


@contextmanager
def scene_played(scene: str) -> Iterator[tuple[Played, Person]]:
    """As `fracture-collision play` runs it, in a domain of its own."""
    os.environ["ROS_DOMAIN_ID"] = str(free_domain_id())
    with (
        tempfile.TemporaryDirectory() as folder,
        played(scene, -1, Path(folder), "127.0.0.1", 0) as run,
        closing(Person(run)) as person,
    ):
        yield run, person


def throw_at(person: Person, place: Sequence[float]) -> None:
    """Throws a ball that soon hits whatever stands at `place`."""
    x, y, z = place
    person.hands.throw((x, y - 0.5, z), (0.0, 7.0, 0.3))
