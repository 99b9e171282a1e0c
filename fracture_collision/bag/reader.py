"""Reads serialized messages from a bag, unchanged."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

from mcap.records import Metadata

from fracture_collision.bag import metadata
from fracture_collision.bag.mcap_file import BagError, McapFile
from fracture_collision.cdr import offset_of_run_id

__all__ = ["BagError", "BagMessage", "RecordedSettings", "mcap_files", "mcap_files_without_metadata", "message_counts", 
           "missing_words", "read_messages", "recorded_settings", "settings_values", "topic_digest",
           "topic_types", "without_run_id"]  # fmt: skip

# Names in a bag's custom data: the settings of the service that answered, as JSON; and its earlier settings, if they
# changed while the recorder ran.
SETTINGS = "collision_settings"
EARLIER_SETTINGS = "earlier_collision_settings"
NOTES = "fracture_collision"  # the name of the MCAP metadata records with the same contents
_ROSBAG2 = "rosbag2"  # likewise of rosbag2's own

LARGEST_SETTINGS = 1 << 16  # [bytes]


class BagMessage(NamedTuple):
    """A serialized message as a bag stores it."""

    topic: str  # absolute name
    nanoseconds: int  # since the epoch
    data: bytes  # CDR


class RecordedSettings(NamedTuple):
    """Settings of the service that a recorder stored."""

    values: dict[str, Any]  # by name, as in the JSON; not validated yet
    changed: bool  # during the recording: some answers were made with others


def mcap_files(bag: Path | str) -> list[Path]:
    """The files of a rosbag2 folder, or the one .mcap file given. Raises BagError.

    For a folder without metadata.yaml, as a killed `ros2 bag record` leaves it: all .mcap files in it.
    """
    bag = Path(bag)
    if bag.is_file():
        return [bag]
    information = metadata.read_metadata(bag)
    if information is not None:
        return metadata.named_files(bag, information)
    return mcap_files_without_metadata(bag)


def mcap_files_without_metadata(bag: Path) -> list[Path]:
    """The .mcap files in the folder, in the order of their numbers. Raises BagError."""
    found = (file for file in bag.glob("*.mcap") if file.is_file())
    files = sorted(found, key=lambda file: (len(file.name), file.name))
    if not files:
        raise BagError(f"{bag}: neither an .mcap file nor a folder with a metadata.yaml or .mcap files")
    return files


def missing_words(bag: Path | str) -> list[str]:
    """The defects of a bag that can still be read, a sentence each. Raises BagError."""
    bag = Path(bag)
    words = []
    if bag.is_dir() and not (bag / metadata.FILE_NAME).is_file():
        words.append(f"{bag}: has no {metadata.FILE_NAME}")
    for path in mcap_files(bag):
        file = McapFile(path)
        if not file.is_whole:
            lost = f"; its last {file.lost_bytes} bytes cannot be read" if file.lost_bytes else ""
            words.append(f"{path}: is truncated, as when a recorder is killed{lost}")
    return words


def read_messages(bag: Path | str, topics: list[str] | None = None) -> Iterator[BagMessage]:
    """All messages of a bag, or those of `topics`, in the order of their times. Raises BagError."""
    for path in mcap_files(bag):
        for _, channel, message in McapFile(path).messages(topics):
            yield BagMessage(channel.topic, message.log_time, message.data)


def topic_types(bag: Path | str) -> dict[str, tuple[str, str]]:
    """By topic: package/msg/Name, and the text of the definition. Raises BagError."""
    types: dict[str, tuple[str, str]] = {}
    for path in mcap_files(bag):
        for channel, schema in McapFile(path).channels():
            if schema is not None:
                types.setdefault(channel.topic, (schema.name, schema.data.decode(errors="replace")))
    return types


def message_counts(bag: Path | str) -> dict[str, int]:
    """Counts messages by topic, since the metadata of a killed recorder lacks the counts. Raises BagError."""
    counts: dict[str, int] = {}
    for path in mcap_files(bag):
        file = McapFile(path)
        for channel, _ in file.channels():
            counts.setdefault(channel.topic, 0)
        for _, channel, _ in file.messages():
            counts[channel.topic] = counts.get(channel.topic, 0) + 1
    return counts


def recorded_settings(bag: Path | str) -> RecordedSettings | None:
    """Settings of the service that answered; None if the bag has none. Raises BagError."""
    bag = Path(bag)
    noted: dict[str, str] = {}
    if bag.is_dir() and (information := metadata.read_metadata(bag)) is not None:
        noted = metadata.custom_data(information)
    if SETTINGS not in noted:
        for path in mcap_files(bag):
            for record in McapFile(path).metadata:
                noted |= _noted(record, path)
    if SETTINGS not in noted:
        return None
    return RecordedSettings(settings_values(noted[SETTINGS], f"{bag}: {SETTINGS}"), EARLIER_SETTINGS in noted)


def settings_values(text: str, where: str) -> dict[str, Any]:
    """Recorded settings by name, not validated yet. Raises BagError, which begins with `where`."""
    try:
        values = json.loads(text) if len(text) <= LARGEST_SETTINGS else None
    except (ValueError, RecursionError) as error:
        raise BagError(f"{where}: not JSON: {error}") from error
    if not isinstance(values, dict):
        raise BagError(f"{where}: not a JSON object")
    return values


def _noted(record: Metadata, path: Path) -> dict[str, str]:
    if record.name == NOTES:
        return record.metadata
    text = record.metadata.get("serialized_metadata", "") if record.name == _ROSBAG2 else ""
    if not text or len(text) > metadata.LARGEST:
        return {}
    content = metadata.plain_content(text, str(path))
    information = content.get(metadata.KEY) if isinstance(content, dict) else None
    return metadata.custom_data(information) if isinstance(information, dict) else {}


def topic_digest(bag: Path | str, topic: str) -> str:
    """SHA-256 over the serialized messages of a topic, times included: equal if and only if the streams are.

    Run ids, which are random, do not count, nor does a repetition of the message before it, as by a simulator that got
    no answer in time.
    """
    digest = hashlib.sha256()
    _, definition = topic_types(bag).get(topic, ("", ""))
    has_run_id = re.search(r"^uint64 run_id\b", definition, re.MULTILINE) is not None
    last = None
    for message in read_messages(bag, [topic]):
        if message == last:
            continue
        last = message
        data = without_run_id(message.data) if has_run_id else message.data
        digest.update(message.nanoseconds.to_bytes(8, "little"))
        digest.update(len(data).to_bytes(8, "little"))
        digest.update(data)
    return digest.hexdigest()


def without_run_id(data: bytes) -> bytes:
    """A serialized message that begins with `header` and `run_id`, with a run id of 0."""
    at = offset_of_run_id(data)
    return data[:at] + bytes(8) + data[at + 8 :]
