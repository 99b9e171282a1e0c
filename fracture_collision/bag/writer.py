"""Writes bags in rosbag2's own layout, and repairs those of killed recorders.

A bag is a folder with metadata.yaml and one MCAP file, messages serialized as sent.

Equal content gives equal bytes: times are those of the messages' headers, and messages of equal time are sorted by
topic, whatever their order of arrival. (`flush` ends a chunk: then equal messages may be in different chunks.)
"""

from __future__ import annotations

import heapq
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import yaml
from mcap.records import Channel, Schema
from mcap.writer import CompressionType, Writer

from fracture_collision.bag import metadata
from fracture_collision.bag.mcap_file import BagError, McapFile
from fracture_collision.bag.metadata import Span, TopicEntry, write_metadata
from fracture_collision.bag.reader import NOTES, mcap_files, mcap_files_without_metadata

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
    repaired (bag/reader.py, bag/writer.py).
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


class Mended(NamedTuple):
    """What a repair kept and what it could not read."""

    messages: int
    lost_bytes: int  # unreadable ones at the end of files
    damaged: list[str]  # descriptions of the unreadable chunks


def mend_bag(folder: Path) -> Mended:
    """Rewrites the files of a rosbag2 folder; each replaces the old one when it is complete.

    Unreadable data is not in the new files. Raises BagError if there is nothing to repair, OSError if the folder cannot
    be written.
    """
    if not folder.is_dir():
        raise BagError(f"{folder}: not a folder")
    paths, custom_data = _files(folder)
    tally = _Tally()
    for path in paths:
        file = McapFile(path)
        tally.lost_bytes += file.lost_bytes
        new = path.with_name(f"{path.name}.new")
        try:
            _copy(file, new, tally)
            os.replace(new, path)
        finally:
            new.unlink(missing_ok=True)
    topics = [entry._replace(message_count=tally.counts[name]) for name, entry in tally.entries.items()]
    span = metadata.Span(tally.first_time or 0, tally.last_time)
    metadata.write_metadata(folder, [str(path.relative_to(folder)) for path in paths], topics, span, custom_data)
    return Mended(sum(tally.counts.values()), tally.lost_bytes, tally.damaged)


class _Tally:
    """What has been found so far."""

    def __init__(self) -> None:
        self.counts: dict[str, int] = {}  # by topic
        self.entries: dict[str, metadata.TopicEntry] = {}  # by topic
        self.first_time: int | None = None  # [ns]
        self.last_time = 0
        self.lost_bytes = 0
        self.damaged: list[str] = []


def _files(folder: Path) -> tuple[list[Path], dict[str, str]]:
    """The folder's files, and its recorder's custom data. Invalid metadata counts as none."""
    try:
        information = metadata.read_metadata(folder) or {}
        return mcap_files(folder), metadata.custom_data(information)
    except BagError:
        return mcap_files_without_metadata(folder), {}


def _copy(file: McapFile, new: Path, tally: _Tally) -> None:
    with new.open("wb") as stream:
        writer = Writer(stream, chunk_size=CHUNK_BYTES, compression=CompressionType.ZSTD)
        writer.start(profile="ros2", library="fracture_collision")
        channels: dict[int, int] = {}
        # damage is reported when the messages are read
        for channel, schema in file.channels(on_damage=lambda _: None):
            schema_id = writer.register_schema(schema.name, schema.encoding, schema.data) if schema is not None else 0
            channels[channel.id] = writer.register_channel(
                channel.topic, channel.message_encoding, schema_id, channel.metadata
            )
            tally.counts.setdefault(channel.topic, 0)
            tally.entries.setdefault(channel.topic, _entry(channel, schema))
        for record in file.metadata:
            writer.add_metadata(record.name, record.metadata)
        for _, channel, message in file.messages(on_damage=lambda error: tally.damaged.append(str(error))):
            time = message.log_time
            writer.add_message(channels[channel.id], time, message.data, message.publish_time, message.sequence)
            tally.counts[channel.topic] += 1
            tally.first_time = time if tally.first_time is None else min(tally.first_time, time)
            tally.last_time = max(tally.last_time, time)
        writer.finish()


def _entry(channel: Channel, schema: Schema | None) -> metadata.TopicEntry:
    text = channel.metadata.get("offered_qos_profiles", "")
    profiles = metadata.plain_content(text, channel.topic) if len(text) <= metadata.LARGEST else None
    if not isinstance(profiles, list) or not all(isinstance(profile, dict) for profile in profiles):
        profiles = []
    message_type = schema.name if schema is not None else ""
    return metadata.TopicEntry(channel.topic, message_type, profiles, channel.metadata.get("topic_type_hash", ""), 0)
