"""The messages that replays and viewers need as bytes, to read bags and compare answers without an installed ROS."""

from __future__ import annotations

from typing import Any, NamedTuple

from fracture_collision.cdr import Codec, Heading, Layout, Received
from fracture_collision.records import (
    CollisionBody,
    ContactConstraintArray,
    FractureEvent,
    FragmentMesh,
    FragmentRegistry,
    FragmentStates,
)

_FIRST = (("header", "std_msgs/Header"), ("run_id", "uint64"))
# Those of the generated message classes, without which bags can be read.
LAYOUTS: dict[type, Layout] = {
    CollisionBody: (
        *_FIRST, ("operation", "uint8"), ("sequence", "uint64"), ("body_id", "uint32"), ("fragment_id", "uint32"),
        ("name", "string"), ("primitive", "shape_msgs/SolidPrimitive"), ("plane", "shape_msgs/Plane"),
        ("vertices", "sequence<double>"), ("triangles", "sequence<uint32>"), ("tetrahedra", "sequence<uint32>"),
        ("is_static", "boolean"), ("density", "double"), ("friction", "double"), ("restitution", "double"),
    ),
    FractureEvent: (
        *_FIRST, ("sequence", "uint64"), ("body_id", "uint32"), ("fragment_id", "uint32"),
        ("new_fragment_ids", "sequence<uint32>"), ("nodes", "sequence<uint32>"),
        ("node_fragments", "sequence<uint32>"), ("cut_edges", "sequence<uint32>"), ("cut_planes", "sequence<double>"),
    ),
    FragmentStates: (
        *_FIRST, ("step", "uint64"), ("fracture_sequence", "uint64"), ("body_sequence", "uint64"),
        ("fragment_ids", "sequence<uint32>"), ("positions", "sequence<double>"), ("orientations", "sequence<double>"),
        ("linear_velocities", "sequence<double>"), ("angular_velocities", "sequence<double>"),
    ),
    ContactConstraintArray: (
        *_FIRST, ("step", "uint64"), ("fracture_sequence", "uint64"), ("status", "uint32"),
        ("fragment_a", "sequence<uint32>"), ("fragment_b", "sequence<uint32>"), ("pair_begin", "sequence<uint32>"),
        ("missed_depth_bound", "sequence<double>"), ("friction", "sequence<double>"),
        ("restitution", "sequence<double>"), ("points_a", "sequence<double>"), ("points_b", "sequence<double>"),
        ("normals", "sequence<double>"), ("gaps", "sequence<double>"), ("contact_ids", "sequence<uint64>"),
        ("lookahead", "double"),
    ),
    FragmentRegistry: (
        *_FIRST, ("fracture_sequence", "uint64"), ("fragment_ids", "sequence<uint32>"),
        ("body_ids", "sequence<uint32>"), ("parent_ids", "sequence<uint32>"), ("masses", "sequence<double>"),
        ("centers_of_mass", "sequence<double>"), ("inertias", "sequence<double>"),
        ("sampling_gaps", "sequence<double>"), ("digest", "string"), ("settings", "string"),
    ),
    FragmentMesh: (
        *_FIRST, ("fragment_id", "uint32"), ("vertices", "sequence<float>"), ("triangles", "sequence<uint32>"),
        ("is_crack", "sequence<boolean>"),
    ),
}  # fmt: skip

# Of nested messages.
NESTED_LAYOUTS: dict[str, Layout] = {
    "std_msgs/Header": (("stamp", "builtin_interfaces/Time"), ("frame_id", "string")),
    "builtin_interfaces/Time": (("sec", "int32"), ("nanosec", "uint32")),
    "shape_msgs/SolidPrimitive": (
        ("type", "uint8"), ("dimensions", "sequence<double, 3>"), ("polygon", "geometry_msgs/Polygon"),
    ),
    "shape_msgs/Plane": (("coef", "double[4]"),),
    "geometry_msgs/Polygon": (("points", "sequence<geometry_msgs/Point32>"),),
}  # fmt: skip

_CODECS = {
    record_class: Codec(record_class, layout, NESTED_LAYOUTS.__getitem__) for record_class, layout in LAYOUTS.items()
}


def present_codec(record_class: Any) -> Codec:
    """Reads and writes messages of the present definition."""
    return _CODECS[record_class]


def codec_of(record_class: Any, layout: Layout) -> Codec | None:
    """Reads messages of a layout from a bag: the present one, or an earlier one without fields that have a default.

    None if it is neither.
    """
    present = LAYOUTS[record_class]
    if layout == present:
        return _CODECS[record_class]
    names = {name for name, _ in layout}
    earlier = tuple(field for field in present if field[0] in names or field[0] not in record_class._field_defaults)
    return Codec(record_class, layout, NESTED_LAYOUTS.__getitem__) if layout == earlier else None


def serialize_record(record: NamedTuple, heading: Heading, run_id: int) -> bytes:
    """The serialized message of a record of LAYOUTS. Raises as Codec.write does."""
    return _CODECS[type(record)].write(record, heading, run_id)


def deserialize_record(data: bytes, record_class: Any) -> Received:
    """The record of a serialized message of the same name. Raises as Codec.read does."""
    return _CODECS[record_class].read(data)
