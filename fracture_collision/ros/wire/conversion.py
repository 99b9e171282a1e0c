"""Records (fracture_collision.records) to ROS messages and back, whole arrays at a time.

A message's numeric sequence is an array.array. It takes bytes at memory speed; given a list or an ndarray the generated
message classes walk every element. The way back copies nothing: the record's arrays are views of the message's.
"""

from __future__ import annotations

from array import array
from typing import Any, NamedTuple, TypeVar

import numpy as np
from builtin_interfaces.msg import Time
from shape_msgs.msg import Plane
from shape_msgs.msg import SolidPrimitive as SolidPrimitiveMessage
from std_msgs.msg import Header

from fracture_collision import msg as messages
from fracture_collision import records
from fracture_collision.cdr import Heading, flat_array, in_rows

Record = TypeVar("Record", bound=NamedTuple)

# ROS type -> type code of its elements in array.array and numpy
_SEQUENCES = {"sequence<double>": "d", "sequence<float>": "f", "sequence<uint32>": "I", "sequence<uint64>": "Q"}

_RECORD_OF = {
    messages.CollisionBody: records.CollisionBody,
    messages.FractureEvent: records.FractureEvent,
    messages.FragmentStates: records.FragmentStates,
    messages.ContactConstraintArray: records.ContactConstraintArray,
    messages.FragmentRegistry: records.FragmentRegistry,
    messages.FragmentMesh: records.FragmentMesh,
}
_MESSAGE_OF = {record: message for message, record in _RECORD_OF.items()}


def message_class_of(record: NamedTuple) -> Any:
    """The generated message class of the same name as the record's class. Raises KeyError if there is none."""
    return _MESSAGE_OF[type(record)]


def record_class_of(message_class: Any) -> Any:
    """The record class of the same name as a generated message class. Raises KeyError if there is none."""
    return _RECORD_OF[message_class]


def heading(stamp_seconds: float, frame_id: str = "world") -> Heading:
    """A heading of a simulation time [s], to the nearest nanosecond."""
    nanoseconds = round(stamp_seconds * 1e9)
    return Heading(nanoseconds // 10**9, nanoseconds % 10**9, frame_id)


def header_of(head: Heading) -> Header:
    """The ROS message of a heading."""
    return Header(stamp=Time(sec=head.sec, nanosec=head.nanosec), frame_id=head.frame_id)


def to_message(record: NamedTuple, head: Heading, run_id: int) -> Any:
    """The ROS message of a record. ValueError if an array has another shape, or a plane not four numbers."""
    message_class = message_class_of(record)
    message = message_class(header=header_of(head), run_id=run_id)
    for name, field_type in message_class.get_fields_and_field_types().items():
        if name not in ("header", "run_id"):
            setattr(message, name, _to_field(name, getattr(record, name), field_type))
    return message


def to_record(message: Any) -> Any:
    """The record of a ROS message. Its arrays are views: the message must be left alone afterwards."""
    record_class = record_class_of(type(message))
    types = message.get_fields_and_field_types()
    return record_class(
        **{name: _from_field(name, getattr(message, name), types[name]) for name in record_class._fields}
    )


def _to_field(name: str, value: Any, field_type: str) -> Any:
    if field_type in _SEQUENCES:
        code = _SEQUENCES[field_type]
        return array(code, flat_array(value, code, records.WIDTHS.get(name, 0)).tobytes())
    if field_type == "sequence<boolean>":
        return np.asarray(value, dtype=bool).tolist()
    if field_type == "shape_msgs/SolidPrimitive":
        return SolidPrimitiveMessage(type=value.type, dimensions=[float(x) for x in value.dimensions])
    if field_type == "shape_msgs/Plane":
        return Plane(coef=_four(value))
    return {"double": float, "string": str, "boolean": bool}.get(field_type, int)(value)


def _four(value: Any) -> np.ndarray:
    """Coefficients of a plane (4,). Raises ValueError for another number.

    rclpy does not check it, and serializes the memory after them if there are too few.
    """
    coefficients = flat_array(value, np.float64)
    if len(coefficients) != 4:
        raise ValueError(f"plane: {len(coefficients)} coefficients, not 4")
    return coefficients


def _from_field(name: str, value: Any, field_type: str) -> Any:
    if field_type in _SEQUENCES:
        return in_rows(np.asarray(value, dtype=_SEQUENCES[field_type]), records.WIDTHS.get(name, 0))
    if field_type == "sequence<boolean>":
        return np.array(value, dtype=bool)
    if field_type == "shape_msgs/SolidPrimitive":
        return records.SolidPrimitive(value.type, tuple(value.dimensions))
    if field_type == "shape_msgs/Plane":
        return np.array(value.coef, dtype=np.float64)
    return value
