"""The service's settings as ROS parameters: names and defaults from world.Settings, meaning and range here."""

from __future__ import annotations

from typing import Any, NamedTuple

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.node import Node

from fracture_collision.world import Settings


class Range(NamedTuple):
    low: float
    high: float


# name: (what `ros2 param describe` says, range of numbers)
_DESCRIPTIONS: dict[str, tuple[str, Range | None]] = {
    "contacts_per_pair": ("contacts of a pair before only those deeper than the tolerance count", Range(1, 1024)),
    "penetration_tolerance": ("penetrations up to this may stay unlisted, as a share of the bodies' R", Range(0, 0.1)),
    "detection_tolerance": ("surfaces this far apart are listed already, as a share of the bodies' R", Range(0, 0.1)),
    "field": ("depth inside a fragment: 'exact' (local flood) or 'averaged' (Glondu 2014, eq. 1-2)", None),
    "tree": ("trees of new fragments: 'restructured' (Glondu 2014, 6.2), 'plain' (its [27]) or 'rebuilt'", None),
    "normals": ("which surface a normal is of: one 'facing' the sample, or the 'nearest' (Glondu 2014, 4.4)", None),
    "traversal": ("order of visits: 'alternating' between parents (Glondu 2014, 5.3) or 'queue' (its [27])", None),
    "neighbour_lists": ("remember which samples of slow pairs are near; the answer does not depend on it", None),
    "threads": ("threads of the narrow phase; 0: one for each core. The answer does not depend on it", Range(0, 256)),
    "visit_budget": ("sphere tree nodes that a step may visit; 0: no limit", Range(0, 2**40)),
    "max_bodies": ("more bodies are refused", Range(1, 2**31)),
    "max_nodes": ("more mesh nodes, of all bodies together, are refused", Range(1, 2**31)),
    "max_fragments": ("more fragments in one run are refused", Range(1, 2**31)),
    "max_message_bytes": ("longer messages are refused", Range(1024, 2**32)),
}


def declare_settings(node: Node) -> Settings:
    """Declares every setting of the service and returns what was given. Fixed while the node lives: contacts are a
    function of the messages and the settings, and a change in mid-run would leave no trace in a recording.

    Raises rclpy's InvalidParameterValueException for a value out of range.
    """
    values = {}
    for name, default in Settings()._asdict().items():
        description, limits = _DESCRIPTIONS[name]
        values[name] = declare_fixed(node, name, default, description, limits)
    return Settings(**values)


def declare_fixed(node: Node, name: str, default: Any, description: str, limits: Range | None = None) -> Any:
    """Declares a parameter that is given at start and stays; returns its value."""
    descriptor = ParameterDescriptor(description=description, read_only=True)
    if limits is not None and isinstance(default, int):
        descriptor.integer_range = [IntegerRange(from_value=int(limits.low), to_value=int(limits.high))]
    elif limits is not None:
        descriptor.floating_point_range = [
            FloatingPointRange(from_value=float(limits.low), to_value=float(limits.high))
        ]
    return node.declare_parameter(name, default, descriptor).value
