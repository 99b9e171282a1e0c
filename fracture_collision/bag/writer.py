"""Bags in rosbag2's own layout: a folder with metadata.yaml and one MCAP file, serialized messages as they were sent.

Equal content gives equal bytes: times are those of the messages' headers, and messages of one moment are put in the
order of the topics, however they happened to arrive.
"""

from __future__ import annotations

import copy
import heapq
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import yaml
from mcap.writer import CompressionType, Writer

# rosbag2's metadata of ROS 2 Jazzy.
METADATA_VERSION = 9
ROS_DISTRO = "jazzy"

# Messages are held back until this many others came after them: those that belong to one moment arrive on different
# topics, a few messages apart.
REORDER_WINDOW = 256

_FOREVER = {"sec": 9223372036, "nsec": 854775807}


class OfferedQos(NamedTuple):
    """Quality of service as the topic's publisher offers it, in rosbag2's words."""

    history: str  # keep_last, keep_all
    depth: int
    reliability: str  # reliable, best_effort
    durability: str  # volatile, transient_local


class BagTopic(NamedTuple):
    name: str  # absolute
    message_type: str  # package/msg/Name
    definition: str  # the .msg text with those it refers to, as `ros2msg` schemas want them
    type_hash: str  # RIHS01_...; empty where unknown
    qos: OfferedQos


class BagWriter:
    """Writes one bag. Use as a context manager: without `close` the bag has no index and no metadata."""

    def __init__(self, folder: Path | str, topics: Sequence[BagTopic]) -> None:
        """Raises FileExistsError where `folder` is there already."""
        self._folder = Path(folder)
        self._folder.mkdir(parents=True)
        self._file_name = f"{self._folder.name}_0.mcap"
        self._topics = list(topics)
        self._rank = {topic.name: rank for rank, topic in enumerate(self._topics)}
        self._counts = [0] * len(self._topics)
        self._held: list[tuple[int, int, int, bytes]] = []  # heap of (time, topic, count in the topic, data)
        self._first_time: int | None = None
        self._last_time = 0
        self._stream = (self._folder / self._file_name).open("wb")
        self._writer = Writer(self._stream, compression=CompressionType.ZSTD)
        self._writer.start(profile="ros2", library="fracture_collision")
        self._channels = []
        for topic in self._topics:
            schema = self._writer.register_schema(topic.message_type, "ros2msg", topic.definition.encode())
            channel_metadata = {
                "offered_qos_profiles": yaml.safe_dump([_qos_mapping(topic.qos)], sort_keys=False),
                "topic_type_hash": topic.type_hash,
            }
            self._channels.append(self._writer.register_channel(topic.name, "cdr", schema, channel_metadata))

    def write(self, topic: str, data: bytes, nanoseconds: int) -> None:
        """Takes a serialized message of `topic` with its time since the epoch (of simulation)."""
        rank = self._rank[topic]
        heapq.heappush(self._held, (nanoseconds, rank, self._counts[rank], data))
        self._counts[rank] += 1
        if len(self._held) > REORDER_WINDOW:
            self._write_first()

    def close(self) -> None:
        """Writes what is held, the index, and metadata.yaml."""
        while self._held:
            self._write_first()
        metadata = {"rosbag2_bagfile_information": self._metadata()}
        text = yaml.safe_dump(metadata, sort_keys=False)
        self._writer.add_metadata("rosbag2", {"serialized_metadata": text})
        self._writer.finish()
        self._stream.close()
        (self._folder / "metadata.yaml").write_text(text)

    def __enter__(self) -> BagWriter:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _write_first(self) -> None:
        time, rank, sequence, data = heapq.heappop(self._held)
        self._first_time = time if self._first_time is None else min(self._first_time, time)
        self._last_time = max(self._last_time, time)
        self._writer.add_message(self._channels[rank], log_time=time, data=data, publish_time=time, sequence=sequence)

    def _metadata(self) -> dict[str, Any]:
        start = self._first_time or 0
        span = {
            "duration": {"nanoseconds": max(self._last_time - start, 0)},
            "starting_time": {"nanoseconds_since_epoch": start},
            "message_count": sum(self._counts),
        }
        return {
            "version": METADATA_VERSION,
            "storage_identifier": "mcap",
            **span,
            "topics_with_message_count": [
                {"topic_metadata": _topic_mapping(topic), "message_count": count}
                for topic, count in zip(self._topics, self._counts, strict=True)
            ],
            "compression_format": "",
            "compression_mode": "",
            "relative_file_paths": [self._file_name],
            "files": [{"path": self._file_name, **copy.deepcopy(span)}],  # copied: YAML would refer to the one above
            "custom_data": None,
            "ros_distro": ROS_DISTRO,
        }


def _topic_mapping(topic: BagTopic) -> dict[str, Any]:
    return {
        "name": topic.name,
        "type": topic.message_type,
        "serialization_format": "cdr",
        "offered_qos_profiles": [_qos_mapping(topic.qos)],
        "type_description_hash": topic.type_hash,
    }


def _qos_mapping(qos: OfferedQos) -> dict[str, Any]:
    return {
        **qos._asdict(),
        "deadline": dict(_FOREVER),
        "lifespan": dict(_FOREVER),
        "liveliness": "automatic",
        "liveliness_lease_duration": dict(_FOREVER),
        "avoid_ros_namespace_conventions": False,
    }
