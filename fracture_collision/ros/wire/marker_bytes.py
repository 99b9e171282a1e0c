"""Serialized visualization_msgs/MarkerArray, without rclpy's message objects.

100,000 points as Python objects take a second, as bytes one copy. Equal to rclpy's bytes of the same message with
zeroed padding (cdr_padding.py).
"""

from __future__ import annotations

from collections.abc import Iterable
from functools import cache
from struct import Struct, calcsize, pack
from typing import NamedTuple

from visualization_msgs.msg import Marker

from fracture_collision.cdr import LITTLE_ENDIAN, Heading

_ENCAPSULATION = LITTLE_ENDIAN + b"\x00\x00"
_POINT, _COLOUR = 24, 16  # bytes
_NO_TEXT = "Is3x"  # its length with the zero at its end, the zero, and the padding before the next length
# Fields that no marker here uses, all aligned to 4: texture, its coordinates, text, mesh.
_REST = pack(
    f"<{_NO_TEXT}iI{_NO_TEXT}{_NO_TEXT}I" + "I" + _NO_TEXT * 3 + "I?",
    1, b"", 0, 0, 1, b"", 1, b"", 0, 0, 1, b"", 1, b"", 1, b"", 0, False,
)  # fmt: skip


class MarkerRecord(NamedTuple):
    """The fields of visualization_msgs/Marker that are used here; `points` and `colours` as they are serialized."""

    namespace: str
    marker_id: int  # int32
    marker_type: int
    action: int = Marker.ADD
    position: tuple[float, ...] = (0.0, 0.0, 0.0)  # [m]
    orientation: tuple[float, ...] = (0.0, 0.0, 0.0, 1.0)  # x y z w
    scale: tuple[float, ...] = (1.0, 1.0, 1.0)
    colour: tuple[float, ...] = (0.0, 0.0, 0.0, 0.0)  # RGBA, 0..1
    points: bytes = b""  # (n, 3) float64 [m], in the marker's own frame
    colours: bytes = b""  # (n, 4) float32, RGBA 0..1; empty: `colour` for all


def serialize_markers(markers: Iterable[MarkerRecord], heading: Heading) -> bytes:
    """A MarkerArray; each marker has the same heading."""
    frame = heading.frame_id.encode() + b"\0"
    parts: list[bytes] = [_ENCAPSULATION, b""]
    end, count = 4, 0
    for marker in markers:
        namespace = marker.namespace.encode() + b"\0"
        gap = -end % 4
        head = _head((end + gap) % 8, len(frame), len(namespace))
        points, colours = marker.points, marker.colours
        end += gap + head.size
        aligned = -end % 8 if points else 0  # an empty sequence is not aligned
        parts += (
            bytes(gap),
            head.pack(
                heading.sec, heading.nanosec, len(frame), frame, len(namespace), namespace, marker.marker_id,
                marker.marker_type, marker.action, *marker.position, *marker.orientation, *marker.scale,
                *marker.colour, 0, 0, False, len(points) // _POINT,
            ),
            bytes(aligned), points, pack("<I", len(colours) // _COLOUR), colours, _REST,
        )  # fmt: skip
        end += aligned + len(points) + 4 + len(colours) + len(_REST)
        count += 1
    parts[1] = pack("<I", count)
    return b"".join(parts)


@cache
def _head(begin: int, frame_size: int, namespace_size: int) -> Struct:
    """The fields up to the number of points, of a marker that begins at `begin` modulo 8."""
    codes = ["i", "I", "I", f"{frame_size}s", "I", f"{namespace_size}s", *"iii", *"d" * 10, *"ffff", *"iI", "?", "I"]
    layout, end = "<", begin
    for code in codes:
        size = calcsize("<" + code)
        gap = 0 if code.endswith("s") else -end % size
        layout += f"{gap}x{code}"
        end += gap + size
    return Struct(layout)
