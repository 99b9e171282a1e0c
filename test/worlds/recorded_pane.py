"""A recorded run of the smallest scene, and bags made from it by changing messages. For tests."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

from fracture_collision.bag.exchanges import Run
from fracture_collision.bag.reader import BagMessage, read_messages
from fracture_collision.bag.writer import BagWriter
from fracture_collision.replay import AS_RECORDED, InProcess, Order, Replay, Report
from fracture_collision.ros.nodes.recorder_node import bag_topic
from fracture_collision.ros.runs.scene_recording import TOPICS, Selection, record_scene
from fracture_collision.ros.wire.conversion import record_class_of
from fracture_collision.simulation.scene.scene import load_scene
from fracture_collision.world import Settings

STEPS = 30  # the pane breaks three times in these
CLASSES = {f"/{topic.name}": record_class_of(topic.message_class) for topic in TOPICS}


def record_pane(bag: Path, settings: Settings | None = None, seed: int | None = None) -> Path:
    for _ in record_scene(load_scene("pane"), settings or Settings(), seed, bag, Selection(end=STEPS)):
        pass
    return bag


def write_bag(folder: Path, messages: Iterable[BagMessage], namespaces: Iterable[str] = ("",)) -> Path:
    """A bag of these messages, ordered by time and, at equal times, as given."""
    topics = [bag_topic(f"{namespace}/{topic.name}", topic) for namespace in namespaces for topic in TOPICS]
    with BagWriter(folder, topics) as writer:
        for topic, nanoseconds, data in messages:
            writer.write(topic, data, nanoseconds)
    return folder


def changed_bag(folder: Path, bag: Path, change: Callable[[BagMessage], Iterable[BagMessage]]) -> Path:
    """`bag` with each message replaced by the messages of `change(message)`."""
    return write_bag(folder, (new for message in read_messages(bag) for new in change(message)))


def replayed(runs: list[Run], order: Order = AS_RECORDED, rate: float | None = None, **settings: Any) -> Report:
    replay = Replay(runs, InProcess(Settings()._replace(**{"threads": 1, **settings})), order, rate)
    assert list(replay) == list(range(1, replay.total + 1))
    return replay.report()
