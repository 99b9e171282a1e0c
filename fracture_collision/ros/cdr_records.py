"""Records to serialized messages and back, by the layouts of the message classes.

This is for what goes to and fro in every step, and for whatever a stranger sends: rclpy's executor drops what it cannot
read without a word, and makes a Python object of some hundred bytes of each point of a primitive's polygon.
"""

from __future__ import annotations

import importlib
from functools import cache
from typing import Any, NamedTuple

from fracture_collision.cdr import Codec, Heading, Layout, Received
from fracture_collision.ros.conversion import message_class_of, record_class_of


def serialize_record(record: NamedTuple, heading: Heading, run_id: int) -> bytes:
    """The serialized message of a record, as rclpy makes it of conversion.to_message, with zeros in the gaps
    (ros/cdr_padding.py). Raises as Codec.write does.
    """
    return _codec(message_class_of(record)).write(record, heading, run_id)


def deserialize_record(data: bytes, message_class: Any) -> Received:
    """The record, heading and run of a serialized message, of any of msg/. Raises as Codec.read does."""
    return _codec(message_class).read(data)


def layout_of(message_class: Any) -> Layout:
    return tuple(message_class.get_fields_and_field_types().items())


def nested_class(kind: str) -> Any:
    """The message class that a layout speaks of, as in "std_msgs/Header"."""
    package, name = kind.split("/")
    return getattr(importlib.import_module(f"{package}.msg"), name)


@cache
def _codec(message_class: Any) -> Codec:
    return Codec(record_class_of(message_class), layout_of(message_class), lambda kind: layout_of(nested_class(kind)))
