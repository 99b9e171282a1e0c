"""Repairs a bag after its recorder was killed: rewrites index and metadata.yaml, keeps the messages."""

from __future__ import annotations

import os
from pathlib import Path
from typing import NamedTuple

from mcap.records import Channel, Schema
from mcap.writer import CompressionType, Writer

from fracture_collision.bag import metadata
from fracture_collision.bag.errors import BagError
from fracture_collision.bag.mcap_file import McapFile
from fracture_collision.bag.reader import mcap_files, mcap_files_without_metadata
from fracture_collision.bag.writer import CHUNK_BYTES


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
