"""Writes bags in rosbag2's own layout: a folder with metadata.yaml and one MCAP file, messages serialized as sent.

Equal content gives equal bytes: times are those of the messages' headers, and messages of equal time are sorted by
topic, whatever their order of arrival. (`flush` ends a chunk: then equal messages may be in different chunks.)
"""

from __future__ import annotations

import heapq
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import yaml
from mcap.writer import CompressionType, Writer

from fracture_collision.bag.metadata import Span, TopicEntry, write_metadata
from fracture_collision.bag.reader import NOTES

# Messages are held back until this many others have followed: those of equal time arrive on different topics, a few
# messages apart.
REORDER_WINDOW = 256
CHUNK_BYTES = 1 << 20  # before compression

_FOREVER = {"sec": 9223372036, "nsec": 854775807}


class OfferedQos(NamedTuple):
    """Quality of service as the topic's publisher offers it, in rosbag2's terms."""

    history: str  # keep_last, keep_all
    depth: int
    reliability: str  # reliable, best_effort
    durability: str  # volatile, transient_local


class BagTopic(NamedTuple):
    """A topic to record, with all that its channel in the bag states."""

    name: str  # absolute
    message_type: str  # package/msg/Name
    definition: str  # the .msg text with those it refers to, as `ros2msg` schemas require
    type_hash: str  # RIHS01_...; empty where unknown
    qos: OfferedQos


class BagWriter:
    """Writes one bag. Use as a context manager.

    Without `close` the bag has no index and lacks messages after the last `flush`, but it can still be read and
    repaired (bag/reader.py, bag/mend.py).
    """

    def __init__(self, folder: Path | str, topics: Sequence[BagTopic], chunk_bytes: int = CHUNK_BYTES) -> None:
        """Raises FileExistsError if `folder` exists."""
        self._folder = Path(folder)
        self._folder.mkdir(parents=True)
        self._file_name = f"{self._folder.name}_0.mcap"
        self._topics = list(topics)
        self._rank = {topic.name: rank for rank, topic in enumerate(self._topics)}
        self._counts = [0] * len(self._topics)
        self._written = [0] * len(self._topics)  # of those, no longer held
        self._held: list[tuple[int, int, int, bytes]] = []  # heap of (time, topic, count in the topic, data)
        self._first_time: int | None = None
        self._last_time = 0
        self._custom_data: dict[str, str] = {}
        self._stream = (self._folder / self._file_name).open("wb")
        self._writer = Writer(self._stream, chunk_size=chunk_bytes, compression=CompressionType.ZSTD)
        self._writer.start(profile="ros2", library="fracture_collision")
        self._channels = []
        for topic in self._topics:
            schema = self._writer.register_schema(topic.message_type, "ros2msg", topic.definition.encode())
            channel_metadata = {
                "offered_qos_profiles": yaml.safe_dump([_qos_mapping(topic.qos)], sort_keys=False),
                "topic_type_hash": topic.type_hash,
            }
            self._channels.append(self._writer.register_channel(topic.name, "cdr", schema, channel_metadata))
        self._stream.flush()
        self._write_metadata()

    def write(self, topic: str, data: bytes, nanoseconds: int) -> None:
        """Takes a serialized message of `topic` with its time since the epoch (of simulation)."""
        rank = self._rank[topic]
        heapq.heappush(self._held, (nanoseconds, rank, self._counts[rank], data))
        self._counts[rank] += 1
        if len(self._held) > REORDER_WINDOW:
            self._write_first()

    def note(self, name: str, text: str) -> None:
        """Adds custom data `text` under `name`; the last text of a name counts.

        It goes to `custom_data` of metadata.yaml and into the MCAP file, which may be read without metadata.yaml.
        """
        self._custom_data[name] = text
        self._writer.add_metadata(NOTES, {name: text})
        self._stream.flush()
        self._write_metadata()

    def flush(self, until: int) -> None:
        """Hands all messages up to the time `until` [ns] to the operating system; all of them must have arrived.

        They stay in the bag even if this process is killed.
        """
        while self._held and self._held[0][0] <= until:
            self._write_first()
        self._writer.flush()
        self._write_metadata()

    def close(self) -> None:
        """Writes the held messages, the index, and metadata.yaml."""
        while self._held:
            self._write_first()
        self._writer.add_metadata("rosbag2", {"serialized_metadata": self._write_metadata()})
        self._writer.finish()
        self._stream.close()

    def __enter__(self) -> BagWriter:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _write_first(self) -> None:
        time, rank, sequence, data = heapq.heappop(self._held)
        self._first_time = time if self._first_time is None else min(self._first_time, time)
        self._last_time = max(self._last_time, time)
        self._writer.add_message(self._channels[rank], log_time=time, data=data, publish_time=time, sequence=sequence)
        self._written[rank] += 1

    def _write_metadata(self) -> str:
        entries = [
            TopicEntry(topic.name, topic.message_type, [_qos_mapping(topic.qos)], topic.type_hash, count)
            for topic, count in zip(self._topics, self._written, strict=True)
        ]
        span = Span(self._first_time or 0, self._last_time)
        return write_metadata(self._folder, [self._file_name], entries, span, self._custom_data)


def _qos_mapping(qos: OfferedQos) -> dict[str, Any]:
    return {
        **qos._asdict(),
        "deadline": dict(_FOREVER),
        "lifespan": dict(_FOREVER),
        "liveliness": "automatic",
        "liveliness_lease_duration": dict(_FOREVER),
        "avoid_ros_namespace_conventions": False,
    }
