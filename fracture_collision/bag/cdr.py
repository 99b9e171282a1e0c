"""The messages of msg/*.msg as bytes, without ROS: bags are read and answers compared where no ROS is installed.

CDR: a number stands at a multiple of its size, counted from behind the four bytes of the encapsulation; a sequence is
its length as uint32, then its elements, and one that is empty is not aligned; a string counts the zero at its end.
What is written here has zeros in the gaps and nothing behind its last field: equal messages have equal bytes.
"""

from __future__ import annotations

from struct import Struct
from struct import error as StructError
from typing import Any, NamedTuple

import numpy as np

from fracture_collision.records import (
    CollisionBody,
    ContactConstraintArray,
    FractureEvent,
    FragmentStates,
    SolidPrimitive,
)

LITTLE_ENDIAN = b"\x00\x01"
_ENCAPSULATION = LITTLE_ENDIAN + b"\x00\x00"
_STAMP_AND_LENGTH = Struct("<iII")  # sec, nanosec, and the length of frame_id
_COUNT = Struct("<I")
_NUMBERS = {
    "boolean": Struct("<?"), "uint8": Struct("<B"), "uint32": Struct("<I"), "uint64": Struct("<Q"),
    "double": Struct("<d"),
}  # fmt: skip
_ARRAYS = {
    "sequence<uint32>": np.dtype("<u4"), "sequence<uint64>": np.dtype("<u8"), "sequence<double>": np.dtype("<f8"),
}  # fmt: skip
_POINT32_BYTES = 12
_LARGEST_PRIMITIVE = 3  # dimensions of a shape_msgs/SolidPrimitive

# Behind the header: of each field its name and its type, in the words of the generated message classes.
LAYOUTS: dict[type, tuple[tuple[str, str], ...]] = {
    CollisionBody: (
        ("run_id", "uint64"), ("operation", "uint8"), ("body_id", "uint32"), ("fragment_id", "uint32"),
        ("name", "string"), ("primitive", "shape_msgs/SolidPrimitive"), ("plane", "shape_msgs/Plane"),
        ("vertices", "sequence<double>"), ("triangles", "sequence<uint32>"), ("tetrahedra", "sequence<uint32>"),
        ("is_static", "boolean"), ("density", "double"), ("friction", "double"), ("restitution", "double"),
    ),
    FractureEvent: (
        ("run_id", "uint64"), ("sequence", "uint64"), ("body_id", "uint32"), ("fragment_id", "uint32"),
        ("new_fragment_ids", "sequence<uint32>"), ("nodes", "sequence<uint32>"),
        ("node_fragments", "sequence<uint32>"), ("cut_edges", "sequence<uint32>"), ("cut_planes", "sequence<double>"),
    ),
    FragmentStates: (
        ("run_id", "uint64"), ("step", "uint64"), ("fracture_sequence", "uint64"), ("fragment_ids", "sequence<uint32>"),
        ("positions", "sequence<double>"), ("orientations", "sequence<double>"),
        ("linear_velocities", "sequence<double>"), ("angular_velocities", "sequence<double>"),
    ),
    ContactConstraintArray: (
        ("run_id", "uint64"), ("step", "uint64"), ("fracture_sequence", "uint64"), ("status", "uint32"),
        ("fragment_a", "sequence<uint32>"), ("fragment_b", "sequence<uint32>"), ("pair_begin", "sequence<uint32>"),
        ("missed_depth_bound", "sequence<double>"), ("friction", "sequence<double>"),
        ("restitution", "sequence<double>"), ("points_a", "sequence<double>"), ("points_b", "sequence<double>"),
        ("normals", "sequence<double>"), ("gaps", "sequence<double>"), ("contact_ids", "sequence<uint64>"),
    ),
}  # fmt: skip


class Heading(NamedTuple):
    """std_msgs/Header as a record: simulation time and frame."""

    sec: int
    nanosec: int
    frame_id: str


class Received(NamedTuple):
    heading: Heading
    run_id: int
    record: Any


def serialize_record(record: NamedTuple, heading: Heading, run_id: int) -> bytes:
    """The serialized message of a record whose fields are numbers and flat arrays of numbers (FragmentStates,
    ContactConstraintArray, FractureEvent). ValueError where an array has more than one dimension; struct.error where a
    number does not fit.
    """
    frame_id = heading.frame_id.encode() + b"\0"
    parts: list[Any] = [
        _ENCAPSULATION, _STAMP_AND_LENGTH.pack(heading.sec, heading.nanosec, len(frame_id)), frame_id,
    ]  # fmt: skip
    end = _STAMP_AND_LENGTH.size + len(frame_id)
    for name, kind in LAYOUTS[type(record)]:
        value = run_id if name == "run_id" else getattr(record, name)
        number = _NUMBERS.get(kind)
        if number is not None:
            gap = -end % number.size
            parts += (bytes(gap), number.pack(value))
            end += gap + number.size
            continue
        flat = flat_array(value, _ARRAYS[kind])
        gap = -end % _COUNT.size
        parts += (bytes(gap), _COUNT.pack(len(flat)))
        end += gap + _COUNT.size
        if len(flat):
            gap = -end % flat.itemsize
            parts += (bytes(gap), flat)
            end += gap + flat.nbytes
    return b"".join(parts)


def flat_array(value: Any, dtype: Any) -> np.ndarray:
    """As a contiguous array of `dtype`; ValueError where it has more than one dimension."""
    flat = np.ascontiguousarray(value, dtype=dtype)
    if flat.ndim != 1:
        raise ValueError(f"an array of shape {flat.shape} where the message has a flat one")
    return flat


def deserialize_record(data: bytes, record_class: Any) -> Received:
    """The record of a serialized message of the same name; its arrays are views of one copy of `data`.

    Raises ValueError where `data` is no such message in plain little-endian CDR. What stands behind its last field is
    ignored.
    """
    if data[:2] != LITTLE_ENDIAN:
        raise ValueError(f"no serialized {record_class.__name__}: begins with {data[:2].hex() or 'nothing'}")
    # A copy, for arrays that may be written to and stand at multiples of their numbers' size in memory too.
    reading = _Reading(bytearray(memoryview(data)[len(_ENCAPSULATION) :]))
    try:
        heading = reading.heading()
        values = {name: reading.field(kind) for name, kind in LAYOUTS[record_class]}
    except StructError:
        raise ValueError(f"no serialized {record_class.__name__}: {len(data)} bytes are too few") from None
    return Received(heading, values.pop("run_id"), record_class(**values))


class _Reading:
    """Goes through the fields of a message; struct.error where it ends too early."""

    def __init__(self, body: bytearray) -> None:
        self._body = body
        self._end = 0  # of what has been read

    def heading(self) -> Heading:
        sec, nanosec, length = _STAMP_AND_LENGTH.unpack_from(self._body)
        self._end = _STAMP_AND_LENGTH.size
        return Heading(sec, nanosec, self._text(length))

    def field(self, kind: str) -> Any:
        number = _NUMBERS.get(kind)
        if number is not None:
            return self._number(number)
        dtype = _ARRAYS.get(kind)
        if dtype is not None:
            return self._array(dtype, self._number(_COUNT))
        if kind == "string":
            return self._text(self._number(_COUNT))
        if kind == "shape_msgs/Plane":
            return self._array(_ARRAYS["sequence<double>"], 4)
        return self._primitive()

    def _primitive(self) -> SolidPrimitive:
        primitive_type = self._number(_NUMBERS["uint8"])
        count = self._number(_COUNT)
        if count > _LARGEST_PRIMITIVE:
            raise StructError
        dimensions = self._array(_ARRAYS["sequence<double>"], count)
        points = self._number(_COUNT)  # of its polygon, which only a prism has
        if points:
            self._align(4)
            self._take(points * _POINT32_BYTES)
        return SolidPrimitive(primitive_type, tuple(dimensions.tolist()))

    def _number(self, number: Struct) -> Any:
        self._align(number.size)
        return number.unpack_from(self._body, self._take(number.size))[0]

    def _array(self, dtype: np.dtype, count: int) -> np.ndarray:
        if not count:
            return np.empty(0, dtype)
        self._align(dtype.itemsize)
        return np.frombuffer(self._body, dtype, count, self._take(count * dtype.itemsize))

    def _text(self, length: int) -> str:
        begin = self._take(length)
        return self._body[begin : max(self._end - 1, begin)].decode(errors="replace")

    def _align(self, size: int) -> None:
        self._end += -self._end % size

    def _take(self, size: int) -> int:
        """Where the next `size` bytes begin."""
        begin = self._end
        if begin + size > len(self._body):
            raise StructError
        self._end = begin + size
        return begin
