"""Serialized messages out of a bag, as they went in."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import yaml
from mcap.reader import make_reader


class BagMessage(NamedTuple):
    topic: str
    nanoseconds: int
    data: bytes  # CDR


class BagError(ValueError):
    """Not a bag, or one that holds no run, or not all of it."""


def _information(bag: Path) -> dict[str, Any]:
    metadata = bag / "metadata.yaml"
    if not metadata.is_file():
        raise BagError(f"{bag}: neither an .mcap file nor a folder with a metadata.yaml")
    content = yaml.safe_load(metadata.read_text())
    if not isinstance(content, dict) or "rosbag2_bagfile_information" not in content:
        raise BagError(f"{metadata}: not the metadata of a rosbag2 folder")
    return content["rosbag2_bagfile_information"]


def mcap_files(bag: Path | str) -> list[Path]:
    """The files of a rosbag2 folder, or the one .mcap file given. Raises BagError."""
    bag = Path(bag)
    if bag.is_file():
        return [bag]
    return [bag / name for name in _information(bag)["relative_file_paths"]]


def read_messages(folder: Path | str, topics: list[str] | None = None) -> Iterator[BagMessage]:
    """All messages of a bag, or those of `topics`, in the order of their times. Raises BagError."""
    for file in mcap_files(folder):
        with file.open("rb") as stream:
            for _, channel, message in make_reader(stream).iter_messages(topics):
                yield BagMessage(channel.topic, message.log_time, message.data)


def message_counts(folder: Path | str) -> dict[str, int]:
    """By topic, as metadata.yaml says. Raises BagError."""
    information = _information(Path(folder))
    return {
        entry["topic_metadata"]["name"]: entry["message_count"] for entry in information["topics_with_message_count"]
    }


def topic_digest(folder: Path | str, topic: str) -> str:
    """SHA-256 over the serialized messages of a topic, times included: equal if and only if the streams are.

    A message that is its predecessor sent again, as by a simulator that got no answer in time, counts once.
    """
    digest = hashlib.sha256()
    last = None
    for message in read_messages(folder, [topic]):
        if message == last:
            continue
        last = message
        digest.update(message.nanoseconds.to_bytes(8, "little"))
        digest.update(len(message.data).to_bytes(8, "little"))
        digest.update(message.data)
    return digest.hexdigest()
