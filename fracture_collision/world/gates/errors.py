"""Exceptions and records for rejected messages."""

from __future__ import annotations

from typing import NamedTuple

from fracture_collision.records import documented


class InvalidMessage(ValueError):
    """A message breaks a rule of the protocol; it was rejected as a whole and changed nothing.

    `kind` is a short fixed word for counting ("size_mismatch", "not_finite", "unknown_id", ...); the text names the
    field.
    """

    def __init__(self, kind: str, text: str) -> None:
        super().__init__(text)
        self.kind = kind


class StatesAhead(InvalidMessage):
    """States that need an event or a body that has not arrived yet: to be held, not dropped.

    `body_sequence`, `fracture_sequence`: numbers of body messages and events they need; 0 if it is not these that are
    missing. `fragment_ids`: their ids that no known body or event has created, ascending; empty while messages are
    missing.
    """

    def __init__(
        self, kind: str, text: str, *, body_sequence: int = 0, fracture_sequence: int = 0,
        fragment_ids: list[int] | None = None,
    ) -> None:  # fmt: skip
        super().__init__(kind, text)
        self.body_sequence = body_sequence
        self.fracture_sequence = fracture_sequence
        self.fragment_ids = fragment_ids or []


@documented
class Rejection(NamedTuple):
    """The next fracture event arrived and was rejected; another of the same sequence is accepted at any time.

    Fields:
      sequence: of the event
      reason: the text of the InvalidMessage
    """

    sequence: int
    reason: str

    def __str__(self) -> str:
        return (
            f"event {self.sequence} was rejected: {self.reason}; a corrected event with sequence {self.sequence} is"
            " awaited"
        )
