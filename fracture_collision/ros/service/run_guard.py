"""Which run the service follows, if more than one simulator publishes on its topics. Independent of ROS.

A simulator, or a bag player, is one process that publishes bodies, events and states: a participant. The service
follows the first that publishes and rejects all others until that one's publishers are gone: two simulators on the same
topics would mix two scenes, and with the same scene they may even give their runs the same id.

Topics that the followed participant does not publish are open to others with the same run id, one on each: bodies may
come from a shell and states from a program.
"""

from __future__ import annotations

from collections.abc import Mapping, Set
from enum import Enum, auto


class Verdict(Enum):
    """What to do with a message."""

    FOLLOW = auto()  # the message belongs to the run
    BEGIN = auto()  # it does, and any earlier run must be discarded, even one with the same id
    REFUSE = auto()


class RunGuard:
    """Participants are given as the bytes that identify them."""

    def __init__(self) -> None:
        self.leader: bytes | None = None  # the followed participant
        self._helpers: dict[str, bytes] = {}  # topic -> participant followed there, as the leader does not publish it
        self._led: set[str] = set()  # topics that the leader was ever seen to publish
        self._publishers: Mapping[str, Set[bytes]] = {}  # as last observed
        self._former: bytes | None = None  # the leader of a run that is over
        self._displaced: set[bytes] = set()  # leaders displaced by a takeover while they were present
        self.waiting: set[bytes] = set()  # participants that were rejected and are still present

    def follows(self, topic: str, participant: bytes) -> bool:
        """Whether messages of `participant` on `topic` belong to the run."""
        return participant == self.leader or self._helpers.get(topic) == participant

    def judge(self, topic: str, participant: bytes, same_run: bool, allow_takeover: bool) -> Verdict:
        """What to do with a message. `same_run`: it has the id of the followed run.

        The verdict on a participant that is not followed yet depends on those present: call `observe` first.
        """
        if self.follows(topic, participant):
            return Verdict.FOLLOW
        if self.leader is None:
            return self._begin(participant, anew=self._former not in (None, participant))
        if same_run and topic not in self._topics_of(self.leader) and topic not in self._helpers:
            self._helpers[topic] = participant
            return Verdict.FOLLOW
        if allow_takeover and participant not in self._displaced:
            self._displaced.add(self.leader)
            return self._begin(participant, anew=True)
        self.waiting.add(participant)
        return Verdict.REFUSE

    def observe(self, publishers: Mapping[str, Set[bytes]], log_topics: Set[str]) -> None:
        """Stores which participants publish which topic now.

        A leader that is gone is dropped. If it published the whole log, all of `log_topics`, its run ends with it; else
        the run continues with the next to publish.
        """
        self._publishers = publishers
        present = set().union(*publishers.values())
        self._helpers = {topic: who for topic, who in self._helpers.items() if who in publishers[topic]}
        self._displaced &= present
        self.waiting &= present
        if self.leader is None:
            return
        if self.leader in present:
            self._led |= self._topics_of(self.leader)
        else:
            self._former = self.leader if log_topics <= self._led else None
            self.leader = None
            self._helpers.clear()

    def _topics_of(self, participant: bytes) -> set[str]:
        return {topic for topic, there in self._publishers.items() if participant in there}

    def _begin(self, participant: bytes, anew: bool) -> Verdict:
        self.leader, self._former = participant, None
        self._led, self._helpers = self._topics_of(participant), {}
        return Verdict.BEGIN if anew else Verdict.FOLLOW
