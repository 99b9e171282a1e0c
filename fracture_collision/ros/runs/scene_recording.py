"""Records a scene without DDS: simulator and service in this process, messages as the nodes would publish them.

The bag has the topics that a replay needs; registries, meshes and diagnostics are not in it.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator
from errno import EEXIST
from pathlib import Path
from typing import NamedTuple

from fracture_collision.bag.reader import SETTINGS
from fracture_collision.bag.writer import BagWriter
from fracture_collision.cdr import Heading
from fracture_collision.lockstep import Lockstep
from fracture_collision.ros.nodes.recorder_node import bag_topic
from fracture_collision.ros.wire import qos
from fracture_collision.ros.wire.cdr_records import serialize_record
from fracture_collision.ros.wire.conversion import heading
from fracture_collision.simulation.scene.scene import Scene
from fracture_collision.world import Settings
from fracture_collision.world.settings import values_of

TOPICS = (qos.BODIES, qos.FRACTURE_EVENTS, qos.FRAGMENT_STATES, qos.CONTACT_CONSTRAINTS)
# Bodies of one shape repeat each other's meshes: a chunk that holds them all compresses to one.
CHUNK_BYTES = 1 << 24


class Selection(NamedTuple):
    """The steps to keep: every `every`-th from `first` to before `end`.

    Bodies and events are all kept, up to the last step.
    """

    first: int = 0
    end: int | None = None  # None: the scene's
    every: int = 1


ALL_STEPS = Selection()


def record_scene(
    scene: Scene, settings: Settings, seed: int | None, bag: Path, selection: Selection = ALL_STEPS
) -> Iterator[int]:
    """Runs `scene` and writes `bag`; yields the steps done. Equal arguments give equal bytes.

    Raises FileExistsError if `bag` exists.
    """
    run_id = _run_id(scene.name, scene.seed if seed is None else seed)
    end = scene.step_count if selection.end is None else min(selection.end, scene.step_count)
    if bag.exists():
        raise FileExistsError(EEXIST, "exists already", str(bag))
    topics = [bag_topic(f"/{topic.name}", topic) for topic in TOPICS]
    with Lockstep(scene, settings, seed) as run, BagWriter(bag, topics, CHUNK_BYTES) as writer:

        def write(topic: qos.Topic, record: NamedTuple, stamp: Heading) -> None:
            data = serialize_record(record, stamp, run_id)
            writer.write(f"/{topic.name}", data, stamp.sec * 10**9 + stamp.nanosec)

        # The number of threads changes no answer and depends on this machine.
        writer.note(SETTINGS, json.dumps(values_of(settings._replace(threads=Settings().threads))))
        for body in run.simulation.start_bodies():
            write(qos.BODIES, body, heading(0.0))
        for step in range(end):
            stamp = heading(run.simulation.time)
            for event in run.simulation.begin_step().events:
                write(qos.FRACTURE_EVENTS, event, stamp)
            exchange = run.step()
            if step >= selection.first and (step - selection.first) % selection.every == 0:
                write(qos.FRAGMENT_STATES, exchange.states, stamp)
                write(qos.CONTACT_CONSTRAINTS, exchange.contacts, stamp)
            yield step + 1


def _run_id(scene_name: str, seed: int) -> int:
    """Not random as in simulator_node: equal arguments must give equal bytes."""
    digest = hashlib.sha256(f"{scene_name}/{seed}".encode()).digest()
    return int.from_bytes(digest[:8], "big") >> 2 or 1
