"""What the service publishes on /diagnostics, once a second."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence
from statistics import median
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.node import Node

from fracture_collision.ros.service.collision_run import Refusal
from fracture_collision.world import Settings
from fracture_collision.world.settings import values_of

# Times are reported for this many answers: some seconds of a running simulation.
WINDOW = 1000

# [characters] A reason may quote the message.
LONGEST_REASON = 400


class RefusalCounts:
    """Rejected messages by topic and kind, each with its last reason. The number of kinds is limited."""

    def __init__(self) -> None:
        self._counts: dict[tuple[str, str], int] = {}
        self._reasons: dict[tuple[str, str], str] = {}
        self._new = 0

    def add(self, refusal: Refusal) -> None:
        """Counts a rejected message."""
        key = (refusal.topic, refusal.kind)
        self._counts[key] = self._counts.get(key, 0) + 1
        self._reasons[key] = refusal.reason[:LONGEST_REASON]
        self._new += 1

    def status(self) -> DiagnosticStatus:
        """WARN if a message was rejected since the last call."""
        total, new, self._new = sum(self._counts.values()), self._new, 0
        values = {
            f"{topic}: {kind}": f"{count}, the last: {self._reasons[topic, kind]}"
            for (topic, kind), count in sorted(self._counts.items())
        }
        level = DiagnosticStatus.WARN if new else DiagnosticStatus.OK
        return status("refused messages", level, f"{total} rejected, {new} of them new" if total else "none", values)


class AnswerTimes:
    """Times of the last answers, by part."""

    def __init__(self) -> None:
        self._parts: dict[str, deque[float]] = {}
        self._visits: deque[int] = deque(maxlen=WINDOW)
        self.count = 0

    def add(self, seconds: Mapping[str, float], visits: int) -> None:
        """Adds the times [s] of one answer by part, and the number of tree nodes it tested."""
        self.count += 1
        self._visits.append(visits)
        for part, value in seconds.items():
            self._parts.setdefault(part, deque(maxlen=WINDOW)).append(value)

    def values(self) -> dict[str, Any]:
        """Number of answers; median and worst of each part and of the tree nodes, as texts for /diagnostics."""
        said: dict[str, Any] = {"answers": self.count}
        for part, seconds in self._parts.items():
            text = f"{1e3 * median(seconds):.3f} ms median, {1e3 * max(seconds):.3f} ms worst"
            said[f"{part} (last {len(seconds)})"] = text
        if self._visits:
            text = f"{median(self._visits):.0f} median, {max(self._visits)} worst, {self._visits[-1]} last"
            said[f"tree nodes visited (last {len(self._visits)})"] = text
        return said


def settings_status(settings: Settings, since: str, without_effect: Sequence[str]) -> DiagnosticStatus:
    """The current settings: with these and the messages a recording has all that its answers depend on.

    WARN if parameters were given `without_effect`, each described in words.
    """
    level = DiagnosticStatus.WARN if without_effect else DiagnosticStatus.OK
    return status("settings", level, "; ".join((f"since {since}", *without_effect)), values_of(settings))


def status(name: str, level: bytes, message: str, values: Mapping[str, Any]) -> DiagnosticStatus:
    """A status of this package; `values` are published as texts."""
    return DiagnosticStatus(
        level=level,
        name=f"fracture_collision: {name}",
        message=message,
        values=[KeyValue(key=key, value=str(value)) for key, value in values.items()],
    )


def diagnostic_array(node: Node, *parts: DiagnosticStatus) -> DiagnosticArray:
    """`parts` as published by `node`: all nodes share /diagnostics, so names begin with the node's namespace."""
    namespace = node.get_namespace().strip("/")
    for part in parts:
        part.hardware_id = node.get_fully_qualified_name()
        part.name = f"{namespace}/{part.name}" if namespace else part.name
    array = DiagnosticArray(status=list(parts))
    array.header.stamp = node.get_clock().now().to_msg()
    return array
