"""metadata.yaml of a rosbag2 folder: files, topics, message counts, and the recorder's custom data."""

from __future__ import annotations

import copy
import os
from collections.abc import Sequence
from pathlib import Path, PurePosixPath
from typing import Any, NamedTuple

import yaml

from fracture_collision.bag.mcap_file import BagError
from fracture_collision.plain_yaml import YamlError, load_yaml

FILE_NAME = "metadata.yaml"
KEY = "rosbag2_bagfile_information"
# rosbag2's metadata of ROS 2 Jazzy.
VERSION = 9
ROS_DISTRO = "jazzy"
LARGEST = 1 << 20  # [bytes]; a hundred topics take 50 kB
MOST_FILES = 10_000


class TopicEntry(NamedTuple):
    """A topic as metadata.yaml lists it."""

    name: str  # absolute
    message_type: str  # package/msg/Name
    qos_profiles: list[dict[str, Any]]  # as offered by the publishers, in rosbag2's terms
    type_hash: str  # RIHS01_...; empty where unknown
    message_count: int


class Span(NamedTuple):
    """Times of a bag's first and last message, since the epoch."""

    begin: int  # [ns]
    end: int  # [ns]


def write_metadata(
    folder: Path, files: Sequence[str], topics: Sequence[TopicEntry], span: Span, custom_data: dict[str, str]
) -> str:
    """Replaces metadata.yaml atomically; returns its text."""
    text = yaml.safe_dump({KEY: _information(files, topics, span, custom_data)}, sort_keys=False)
    new = folder / f"{FILE_NAME}.new"
    new.write_text(text)
    os.replace(new, folder / FILE_NAME)
    return text


def _information(
    files: Sequence[str], topics: Sequence[TopicEntry], span: Span, custom_data: dict[str, str]
) -> dict[str, Any]:
    what = {
        "duration": {"nanoseconds": max(span.end - span.begin, 0)},
        "starting_time": {"nanoseconds_since_epoch": span.begin},
        "message_count": sum(topic.message_count for topic in topics),
    }
    return {
        "version": VERSION,
        "storage_identifier": "mcap",
        **what,
        "topics_with_message_count": [
            {"topic_metadata": _topic_mapping(topic), "message_count": topic.message_count} for topic in topics
        ],
        "compression_format": "",
        "compression_mode": "",
        "relative_file_paths": list(files),
        "files": [{"path": file, **copy.deepcopy(what)} for file in files],  # copied: YAML would write an alias
        "custom_data": custom_data or None,
        "ros_distro": ROS_DISTRO,
    }


def _topic_mapping(topic: TopicEntry) -> dict[str, Any]:
    return {
        "name": topic.name,
        "type": topic.message_type,
        "serialization_format": "cdr",
        "offered_qos_profiles": copy.deepcopy(topic.qos_profiles),
        "type_description_hash": topic.type_hash,
    }


def read_metadata(folder: Path) -> dict[str, Any] | None:
    """The mapping under KEY; None if the folder has no metadata.yaml. Raises BagError."""
    path = folder / FILE_NAME
    if not path.is_file():
        return None
    content = plain_content(_text(path), str(path))
    information = content.get(KEY) if isinstance(content, dict) else None
    if not isinstance(information, dict):
        raise BagError(f"{path}: not the metadata of a rosbag2 folder")
    return information


def plain_content(text: str, where: str) -> Any:
    """YAML of a bag as plain data. Raises BagError, which begins with `where`."""
    try:
        return load_yaml(text)
    except YamlError as error:
        raise BagError(f"{where}: {error}") from error


def named_files(folder: Path, information: dict[str, Any]) -> list[Path]:
    """The files of a bag; none of them outside its folder. Raises BagError."""
    names = information.get("relative_file_paths")
    where = f"{folder / FILE_NAME}: relative_file_paths"
    if not isinstance(names, list) or not names or not all(isinstance(name, str) for name in names):
        raise BagError(f"{where}: needs a list of file names")
    if len(names) > MOST_FILES:
        raise BagError(f"{where}: {len(names)} files are too many")
    files = []
    for name in names:
        path = PurePosixPath(name)
        if not name.strip("./") or "\0" in name or path.is_absolute() or ".." in path.parts:
            raise BagError(f"{where}: {name!r} is not a path inside this folder")
        file = folder / path
        if not file.resolve().is_relative_to(folder.resolve()):
            raise BagError(f"{where}: {name!r} leads out of this folder")
        if not file.is_file():
            raise BagError(f"{where}: {name!r} does not exist")
        files.append(file)
    return files


def custom_data(information: dict[str, Any]) -> dict[str, str]:
    """The recorder's custom data; entries that are not text are left out."""
    data = information.get("custom_data")
    if not isinstance(data, dict):
        return {}
    return {key: value for key, value in data.items() if isinstance(key, str) and isinstance(value, str)}


def _text(path: Path) -> str:
    try:
        with path.open("rb") as stream:
            data = stream.read(LARGEST + 1)
        if len(data) > LARGEST:
            raise BagError(f"{path}: more than {LARGEST} bytes")
        return data.decode()
    except UnicodeDecodeError as error:
        raise BagError(f"{path}: not text: {error}") from error
    except OSError as error:
        raise BagError(f"{path}: {error.strerror}") from error
