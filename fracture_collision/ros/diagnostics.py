"""What the service says of itself on /diagnostics, once a second."""

from __future__ import annotations

from collections import deque
from statistics import median

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue

from fracture_collision.ros.collision_run import Refusal

# Times are told of this many answers: some seconds of a running simulation.
WINDOW = 1000


class RefusalCounts:
    """Refused messages by topic and kind, each with its last reason."""

    def __init__(self) -> None:
        self._counts: dict[tuple[str, str], int] = {}
        self._reasons: dict[tuple[str, str], str] = {}
        self._new = 0

    def add(self, refusal: Refusal) -> None:
        key = (refusal.topic, refusal.kind)
        self._counts[key] = self._counts.get(key, 0) + 1
        self._reasons[key] = refusal.reason
        self._new += 1

    def status(self) -> DiagnosticStatus:
        """WARN if something was refused since the last call."""
        total, new, self._new = sum(self._counts.values()), self._new, 0
        values = []
        for (topic, kind), count in sorted(self._counts.items()):
            reason = self._reasons[topic, kind]
            values.append(KeyValue(key=f"{topic}: {kind}", value=f"{count}, the last: {reason}"))
        return DiagnosticStatus(
            level=DiagnosticStatus.WARN if new else DiagnosticStatus.OK,
            name="fracture_collision: refused messages",
            message=f"{total} refused, {new} of them new" if total else "none",
            values=values,
        )


class AnswerTimes:
    """Times of the last answers, by part."""

    def __init__(self) -> None:
        self._parts: dict[str, deque[float]] = {}
        self.count = 0

    def add(self, seconds: dict[str, float]) -> None:
        self.count += 1
        for part, value in seconds.items():
            self._parts.setdefault(part, deque(maxlen=WINDOW)).append(value)

    def values(self) -> list[KeyValue]:
        said = [KeyValue(key="answers", value=str(self.count))]
        for part, seconds in self._parts.items():
            text = f"{1e3 * median(seconds):.3f} ms median, {1e3 * max(seconds):.3f} ms worst"
            said.append(KeyValue(key=f"{part} (last {len(seconds)})", value=text))
        return said


def diagnostic_array(stamp, *status: DiagnosticStatus) -> DiagnosticArray:
    array = DiagnosticArray(status=list(status))
    array.header.stamp = stamp
    return array
