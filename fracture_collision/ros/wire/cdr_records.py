"""Records to serialized messages and back, by the layouts of the message classes.

For the messages of every step, and for untrusted messages: rclpy's executor silently drops what it cannot read, and
creates a Python object of some hundred bytes for each point of a primitive's polygon.
"""

from __future__ import annotations

import importlib
from collections import namedtuple
from functools import cache
from typing import Any, NamedTuple

from fracture_collision.cdr import Codec, Heading, Layout, Received
from fracture_collision.ros.wire.conversion import message_class_of, record_class_of

_LEADING_BYTES = 4096  # of a message of the log: header with the name of a frame, run_id and sequence


def serialize_record(record: NamedTuple, heading: Heading, run_id: int) -> bytes:
    """The serialized message of a record. Raises as Codec.write does.

    It equals rclpy's serialization of conversion.to_message with zeroed padding (ros/wire/cdr_padding.py).
    """
    return _codec(message_class_of(record)).write(record, heading, run_id)


def deserialize_record(data: bytes, message_class: Any) -> Received:
    """The record, heading and run of a serialized message, of any of msg/. Raises as Codec.read does."""
    return _codec(message_class).read(data)


def place_in_log(data: bytes, message_class: Any) -> Received | None:
    """The run and `sequence` of a serialized CollisionBody or FractureEvent; None if these cannot be read.

    For messages that are too long or damaged farther on: the record has the fields up to `sequence` alone.
    """
    try:
        return _beginning(message_class).read(data[:_LEADING_BYTES])
    except ValueError:
        return None


@cache
def _beginning(message_class: Any) -> Codec:
    layout = layout_of(message_class)
    first = layout[: 1 + [name for name, _ in layout].index("sequence")]
    fields = [name for name, _ in first if name not in ("header", "run_id")]
    record_class = namedtuple("Beginning", fields)  # type: ignore[misc]
    return Codec(record_class, first, lambda kind: layout_of(nested_class(kind)))


def layout_of(message_class: Any) -> Layout:
    """The layout of a generated message class."""
    return tuple(message_class.get_fields_and_field_types().items())


def nested_class(kind: str) -> Any:
    """The message class of a name in a layout, such as "std_msgs/Header"."""
    package, name = kind.split("/")
    return getattr(importlib.import_module(f"{package}.msg"), name)


@cache
def _codec(message_class: Any) -> Codec:
    return Codec(record_class_of(message_class), layout_of(message_class), lambda kind: layout_of(nested_class(kind)))
