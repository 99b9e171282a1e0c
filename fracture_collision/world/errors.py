"""What the gate says of a message it refuses."""

from __future__ import annotations


class InvalidMessage(ValueError):
    """A message breaks a rule of the protocol; it was refused whole and changed nothing.

    `kind` is a short fixed word for counting ("size_mismatch", "not_finite", "unknown_id", ...); the text names the
    field.
    """

    def __init__(self, kind: str, text: str) -> None:
        super().__init__(text)
        self.kind = kind


class StatesAhead(InvalidMessage):
    """States that speak of an event or a body that has not arrived yet: to be held, not dropped."""
