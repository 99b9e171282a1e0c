"""Which of a run's numbered body messages have arrived: states wait for those that precede them.

States may leave static bodies out, so their ids do not show whether all bodies that take part have arrived.
"""

from __future__ import annotations

from fracture_collision.world.gates.checks import refuse
from fracture_collision.world.gates.errors import StatesAhead

# A topic keeps the order of its messages.
OVERTAKEN = (
    ", but later ones have: its publisher does not keep it any more (Fast DDS keeps the last 5,000 messages of a"
    " latched topic); start a new run"
)
MOST_REJECTED = 10_000  # reasons that are kept


class BodySequence:
    """The messages 1 to `count` have arrived and were accepted, perhaps some after the next one as well."""

    def __init__(self) -> None:
        self.count = 0
        self._subjects: dict[int, tuple[int, int]] = {}  # sequence -> operation, body id
        self._rejected: dict[int, str] = {}  # sequence -> reason, until a corrected message is accepted
        self._unnumbered = 0
        self._present: list[tuple[int, int, int]] = []  # of removed static bodies: id, sequences of addition, removal

    def check(self, sequence: int, operation: int, body_id: int) -> None:
        """Raise InvalidMessage if another message has the same `sequence`."""
        known = self._subjects.get(sequence, (operation, body_id))
        if known != (operation, body_id):
            refuse("sequence_repeat", f"sequence: body message {sequence} already exists and names body {known[1]}")

    def accept(self, sequence: int, operation: int, body_id: int) -> None:
        """A message is applied, or was before; `sequence` 0: it is not numbered."""
        if not sequence:
            self._unnumbered += 1
            return
        self._rejected.pop(sequence, None)
        self._subjects[sequence] = operation, body_id
        while self.count + 1 in self._subjects:
            self.count += 1

    def reject(self, sequence: int, reason: str) -> None:
        """Message `sequence` arrived and is not acceptable."""
        if sequence > self.count and sequence not in self._subjects and len(self._rejected) < MOST_REJECTED:
            self._rejected[sequence] = reason

    def remove_static(self, body_id: int, added: int, removed: int) -> None:
        """A static body was added by one message and removed by another (sequences; 0: not numbered)."""
        if removed:
            self._present.append((body_id, added, removed))

    def require(self, sequence: int) -> None:
        """Raise unless the bodies after `sequence` messages are known; 0: whatever has arrived will do.

        InvalidMessage if they never will be, else StatesAhead.
        """
        for body_id, added, removed in self._present:
            if added <= sequence < removed:
                refuse(
                    "retired_id",
                    f"body_sequence: {sequence}, but body message {removed} has removed static body {body_id} since;"
                    " remove a static body only after the last states before that are answered",
                )
        if sequence <= self.count:
            return
        due = self.count + 1
        if due in self._rejected:
            refuse(
                "body_rejected",
                f"body_sequence: {sequence}, but body message {due} was rejected: {self._rejected[due]}; a corrected"
                f" one with sequence {due} is awaited",
            )
        arrived = f"body message {due} has not arrived"
        if any(later > due for later in self._subjects):
            arrived += OVERTAKEN
        if self._unnumbered:
            arrived += f"; {self._unnumbered} arrived without a sequence: number them 1, 2, 3 ..."
        raise StatesAhead("sequence_gap", f"body_sequence: {sequence}, but {arrived}", body_sequence=sequence)

    def lacks(self, sequence: int) -> bool:
        """Whether states of `sequence` still wait for a body message."""
        return sequence > self.count and self.count + 1 not in self._rejected
