"""Records to serialized messages and back, without rclpy's message objects in between: for what goes to and fro in
every step.

On its way through a message object each array is copied four times, into fresh memory each time, and each field is
checked; here it is copied once. The layout is read from the message class. The bytes are those that rclpy makes of
conversion.to_message, with zeros in the gaps (ros/cdr_padding.py).

CDR: a number stands at a multiple of its size, counted from behind the four bytes of the encapsulation; a sequence is
its length as uint32, then its elements, and one that is empty is not aligned; a string counts the zero at its end.
"""

from __future__ import annotations

from functools import cache
from struct import Struct
from struct import error as StructError
from typing import Any, NamedTuple

import numpy as np
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.serialization import deserialize_message

from fracture_collision.ros.conversion import (
    SEQUENCES,
    Heading,
    flat_array,
    message_class_of,
    record_class_of,
    to_record,
)

_ENCAPSULATION = b"\x00\x01\x00\x00"  # plain CDR, little-endian
_LITTLE_ENDIAN = _ENCAPSULATION[:2]
_STAMP_AND_LENGTH = Struct("<iII")  # sec, nanosec, and the length of frame_id
_COUNT = Struct("<I")
_NUMBERS = {"uint32": Struct("<I"), "uint64": Struct("<Q")}


class Received(NamedTuple):
    heading: Heading
    run_id: int
    record: Any


def serialize_record(record: NamedTuple, heading: Heading, run_id: int) -> bytes:
    """The serialized message of a record whose fields are numbers and flat arrays of numbers (FragmentStates,
    ContactConstraintArray). ValueError where an array has more than one dimension; struct.error where a number does
    not fit.
    """
    frame_id = heading.frame_id.encode() + b"\0"
    parts: list[Any] = [
        _ENCAPSULATION, _STAMP_AND_LENGTH.pack(heading.sec, heading.nanosec, len(frame_id)), frame_id,
    ]  # fmt: skip
    end = _STAMP_AND_LENGTH.size + len(frame_id)
    for name, field in _fields(message_class_of(record)):
        value = run_id if name == "run_id" else getattr(record, name)
        if isinstance(field, Struct):
            gap = -end % field.size
            parts += (bytes(gap), field.pack(value))
            end += gap + field.size
            continue
        flat = flat_array(value, field)
        gap = -end % _COUNT.size
        parts += (bytes(gap), _COUNT.pack(len(flat)))
        end += gap + _COUNT.size
        if len(flat):
            gap = -end % flat.itemsize
            parts += (bytes(gap), flat)
            end += gap + flat.nbytes
    return b"".join(parts)


def deserialize_record(data: bytes, message_class: Any) -> Received:
    """What `serialize_record` was given; its arrays are views of one copy of `data`. Other encapsulations than plain
    little-endian CDR, of machines of another kind, are left to rclpy.

    Raises ValueError where `data` is no serialized `message_class`. What stands behind its last field is ignored.
    """
    if data[:2] != _LITTLE_ENDIAN:
        return _by_rclpy(data, message_class)
    # A copy, for arrays that may be written to and stand at multiples of their numbers' size in memory too.
    body = bytearray(memoryview(data)[len(_ENCAPSULATION) :])
    try:
        return _read(body, message_class)
    except StructError:
        raise ValueError(f"no serialized {message_class.__name__}: {len(data)} bytes are too few") from None


def _read(body: bytearray, message_class: Any) -> Received:
    sec, nanosec, length = _STAMP_AND_LENGTH.unpack_from(body)
    end = _require(body, _STAMP_AND_LENGTH.size, length)
    frame_id = body[_STAMP_AND_LENGTH.size : max(end - 1, _STAMP_AND_LENGTH.size)].decode(errors="replace")
    values: dict[str, Any] = {}
    for name, field in _fields(message_class):
        if isinstance(field, Struct):
            begin = end + -end % field.size
            (values[name],) = field.unpack_from(body, begin)
            end = begin + field.size
            continue
        begin = end + -end % _COUNT.size
        (count,) = _COUNT.unpack_from(body, begin)
        end = begin + _COUNT.size
        if not count:
            values[name] = np.empty(0, field)
            continue
        begin = end + -end % field.itemsize
        end = _require(body, begin, count * field.itemsize)
        values[name] = np.frombuffer(body, field, count, begin)
    return Received(Heading(sec, nanosec, frame_id), values.pop("run_id"), record_class_of(message_class)(**values))


def _require(body: bytearray, begin: int, size: int) -> int:
    """Where `size` bytes from `begin` on end; struct.error where they are not all there."""
    if begin + size > len(body):
        raise StructError
    return begin + size


def _by_rclpy(data: bytes, message_class: Any) -> Received:
    try:
        message = deserialize_message(data, message_class)
    except rclpy_implementation.RMWError as error:
        raise ValueError(f"no serialized {message_class.__name__}: {error}") from error
    stamp = message.header.stamp
    return Received(Heading(stamp.sec, stamp.nanosec, message.header.frame_id), message.run_id, to_record(message))


@cache
def _fields(message_class: Any) -> tuple[tuple[str, Struct | np.dtype], ...]:
    """Behind the header: of each field its name, and how a number is packed or of what type an array's elements are."""
    return tuple(
        (name, _NUMBERS[kind] if kind in _NUMBERS else np.dtype(SEQUENCES[kind][1]))
        for name, kind in message_class.get_fields_and_field_types().items()
        if name != "header"
    )
