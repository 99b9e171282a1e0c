"""Records to serialized messages and back, without rclpy's message objects in between: for what goes to and fro in
every step, and for whatever a stranger sends.

On its way through a message object each array is copied four times, into fresh memory each time, and each field is
checked; here it is copied once. The layout is read from the message class. The bytes are those that rclpy makes of
conversion.to_message, with zeros in the gaps (ros/cdr_padding.py).

Reading takes no more memory than the message has bytes, whatever it says of its lengths, and all that is wrong with it
is one ValueError in words. rclpy's executor drops what it cannot read without a word, and makes a Python object of some
hundred bytes of each point of a primitive's polygon.

CDR: a number stands at a multiple of its size, counted from behind the four bytes of the encapsulation; a sequence is
its length as uint32, then its elements, and one that is empty is not aligned; a string counts the zero at its end.
"""

from __future__ import annotations

import importlib
import re
from collections.abc import Callable, Mapping
from functools import cache
from struct import Struct
from typing import Any, NamedTuple

import numpy as np

from fracture_collision.records import SolidPrimitive
from fracture_collision.ros.conversion import SEQUENCES, Heading, flat_array, message_class_of, record_class_of

_ENCAPSULATION = b"\x00\x01\x00\x00"  # plain CDR, little-endian
_BYTE_ORDERS = {b"\x00\x00": ">", b"\x00\x01": "<"}  # of plain CDR; its two bytes of options say nothing
_STAMP_AND_LENGTH = Struct("<iII")  # sec, nanosec, and the length of frame_id
_COUNTS = {order: Struct(f"{order}I") for order in "<>"}
_COUNT = _COUNTS["<"]
_NUMBERS = {"uint32": Struct("<I"), "uint64": Struct("<Q")}

# ROS type -> struct's code, and how many numbers one of it has
_ELEMENTS = {
    "boolean": ("?", 1), "uint8": ("B", 1), "int32": ("i", 1), "uint32": ("I", 1), "uint64": ("Q", 1),
    "float": ("f", 1), "double": ("d", 1), "geometry_msgs/Point32": ("f", 3),
}  # fmt: skip
# Messages within messages, as records.
_NESTED: dict[str, Callable[[Mapping[str, Any]], Any]] = {
    "std_msgs/Header": lambda part: Heading(*part["stamp"], part["frame_id"]),
    "builtin_interfaces/Time": lambda part: (part["sec"], part["nanosec"]),
    "shape_msgs/SolidPrimitive": lambda part: SolidPrimitive(part["type"], tuple(part["dimensions"].tolist())),
    "shape_msgs/Plane": lambda part: part["coef"],
    "geometry_msgs/Polygon": lambda part: part["points"],
}
_SEQUENCE = re.compile(r"sequence<([^,>]+)(?:, (\d+))?>")
_ARRAY = re.compile(r"([^\[]+)\[(\d+)\]")


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
    """The record, heading and run of a serialized message, of any of msg/; its arrays are views of one copy of `data`.

    Raises ValueError where `data` is no serialized `message_class`, in plain CDR of either byte order. What stands
    behind its last field is ignored, as rclpy does.
    """
    order = _BYTE_ORDERS.get(bytes(data[:2]))
    name = message_class.__name__
    if order is None:
        raise ValueError(f"no serialized {name}: begins with {bytes(data[:2]).hex() or 'nothing'}, not plain CDR")
    # A copy, for arrays that may be written to and stand at multiples of their numbers' size in memory too.
    reader = _Reader(bytearray(memoryview(data)[len(_ENCAPSULATION) :]), order)
    try:
        values = reader.fields(_layout(message_class, order))
    except _TooShort:
        raise ValueError(f"no serialized {name}: {len(data)} bytes are too few for its field {reader.at}") from None
    except ValueError as error:
        raise ValueError(f"no serialized {name}: {reader.at}: {error}") from None
    return Received(values.pop("header"), values.pop("run_id"), record_class_of(message_class)(**values))


class _TooShort(Exception):
    """More is announced than there is."""


class _Elements(NamedTuple):
    """An array's: of a fixed length, or one that stands before them and has a limit or none."""

    dtype: np.dtype
    numbers: int  # of each element
    length: int | None
    limit: int | None


class _Nested(NamedTuple):
    layout: tuple[tuple[str, Any], ...]
    record: Callable[[Mapping[str, Any]], Any]


class _Reader:
    """Goes through a serialized message field by field."""

    def __init__(self, body: bytearray, order: str) -> None:
        self.at = ""  # the field that is read
        self._body = body
        self._count = _COUNTS[order]
        self._end = 0  # of what was read

    def fields(self, layout: tuple[tuple[str, Any], ...]) -> dict[str, Any]:
        values = {}
        for name, how in layout:
            self.at = name
            if isinstance(how, Struct):
                values[name] = self._number(how)
            elif isinstance(how, _Elements):
                values[name] = self._array(how)
            elif isinstance(how, _Nested):
                values[name] = how.record(self.fields(how.layout))
            else:
                values[name] = self._string()
        return values

    def _number(self, packed: Struct) -> Any:
        begin = self._end + -self._end % packed.size
        end = begin + packed.size
        if end > len(self._body):
            raise _TooShort
        (value,) = packed.unpack_from(self._body, begin)
        if value is True and self._body[begin] != 1:
            raise ValueError("neither true nor false")
        self._end = end
        return value

    def _array(self, how: _Elements) -> np.ndarray:
        count = self._number(self._count) if how.length is None else how.length
        if how.limit is not None and count > how.limit:
            raise ValueError(f"{count} entries, more than {how.limit}")
        dtype, count = how.dtype, count * how.numbers
        if not count:  # what is empty is not aligned
            return np.empty(0, dtype.newbyteorder("="))
        begin = self._end + -self._end % dtype.itemsize
        end = begin + count * dtype.itemsize
        if end > len(self._body):
            raise _TooShort
        if dtype.kind == "b" and max(self._body[begin:end]) > 1:
            raise ValueError("neither true nor false")
        self._end = end
        array = np.frombuffer(self._body, dtype, count, begin)
        return array if dtype.isnative else array.astype(dtype.newbyteorder("="))

    def _string(self) -> str:
        length = self._number(self._count)
        begin, self._end = self._end, self._end + length
        if self._end > len(self._body):
            raise _TooShort
        # up to its zero: as C, and so rclpy, reads it
        return self._body[begin : self._end].partition(b"\0")[0].decode(errors="replace")


@cache
def _layout(message_class: Any, order: str) -> tuple[tuple[str, Any], ...]:
    """Of each field its name and how it is read."""
    types = message_class.get_fields_and_field_types()
    return tuple((name, _how(kind, order)) for name, kind in types.items())


def _how(kind: str, order: str) -> Struct | _Elements | _Nested | str:
    if match := _SEQUENCE.fullmatch(kind):
        code, numbers = _ELEMENTS[match[1]]
        return _Elements(np.dtype(order + code), numbers, None, int(match[2]) if match[2] else None)
    if match := _ARRAY.fullmatch(kind):
        code, numbers = _ELEMENTS[match[1]]
        return _Elements(np.dtype(order + code), numbers, int(match[2]), None)
    if kind in _NESTED:
        package, name = kind.split("/")
        nested_class = getattr(importlib.import_module(f"{package}.msg"), name)
        return _Nested(_layout(nested_class, order), _NESTED[kind])
    return kind if kind == "string" else Struct(order + _ELEMENTS[kind][0])


@cache
def _fields(message_class: Any) -> tuple[tuple[str, Struct | np.dtype], ...]:
    """Behind the header: of each field its name, and how a number is packed or of what type an array's elements are."""
    return tuple(
        (name, _NUMBERS[kind] if kind in _NUMBERS else np.dtype(SEQUENCES[kind][1]))
        for name, kind in message_class.get_fields_and_field_types().items()
        if name != "header"
    )
