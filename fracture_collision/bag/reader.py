"""Serialized messages out of a bag, as they went in."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import yaml
from mcap.reader import make_reader


class BagMessage(NamedTuple):
    topic: str
    nanoseconds: int
    data: bytes  # CDR


def read_messages(folder: Path | str, topics: list[str] | None = None) -> Iterator[BagMessage]:
    """All messages of a bag, or those of `topics`, in the order of their times. FileNotFoundError without a bag."""
    folder = Path(folder)
    information = yaml.safe_load((folder / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
    for name in information["relative_file_paths"]:
        with (folder / name).open("rb") as stream:
            for _, channel, message in make_reader(stream).iter_messages(topics):
                yield BagMessage(channel.topic, message.log_time, message.data)


def message_counts(folder: Path | str) -> dict[str, int]:
    """By topic, as metadata.yaml says. FileNotFoundError without a bag."""
    information = yaml.safe_load((Path(folder) / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
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
