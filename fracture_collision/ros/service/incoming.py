"""The topics of a run: which messages reach the service, and which were dropped or rejected on the way."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

from rclpy.node import Node
from rclpy.subscription import Subscription

from fracture_collision.cdr import Received
from fracture_collision.ros.fastdds.extras import Neighbours, Origin, origin_of, participant_of
from fracture_collision.ros.processes.parameters import Declaration, declare
from fracture_collision.ros.service.collision_run import Refusal
from fracture_collision.ros.service.run_guard import RunGuard, Verdict
from fracture_collision.ros.wire import qos
from fracture_collision.ros.wire.cdr_records import deserialize_record, place_in_log

LOG = (qos.BODIES, qos.FRACTURE_EVENTS)  # a run can be rebuilt from these
TOPICS = (*LOG, qos.FRAGMENT_STATES)
ALLOW_TAKEOVER = Declaration(
    "allow_takeover", False,
    "true: follow another publisher's run at once; false: only when the followed publisher is gone", fixed=False,
)  # fmt: skip


class Incoming:
    """Subscriptions to TOPICS; messages are read, judged by a RunGuard and passed on. Parameter: allow_takeover.

    Needs the executor of extras.make_executor, which provides the publisher of a message.
    """

    def __init__(
        self,
        node: Node,
        neighbours: Neighbours,
        largest_message: Callable[[], int],
        handlers: Mapping[str, Callable[[Received], None]],
        refuse: Callable[[Refusal], None],
        begin_anew: Callable[[], None],
        reject: Callable[[qos.Topic, int, int, str], None],
    ) -> None:
        """Subscribes only when `listen` is called.

        `largest_message`: [bytes]. `handlers`: by the topic's name. `begin_anew`: discards all earlier runs.
        `reject`: takes topic, run id and sequence of a message of the log that cannot be read, and the reason.
        """
        self._node = node
        self._neighbours = neighbours
        self._largest_message = largest_message
        self._handlers = handlers
        self._refuse = refuse
        self._begin_anew = begin_anew
        self._reject = reject
        self._guard = RunGuard()
        self._run_id: int | None = None  # of the last message that was let through
        self._subscriptions: dict[str, Subscription] = {}
        self._log_is_due = False  # rejected messages of it are needed now
        self._asked_in_vain: tuple[Origin, Received] | None = None  # the newest states of another publisher
        self._states_from: Origin | None = None  # the newest states of the followed publisher
        self.dropped_states = 0
        declare(node, ALLOW_TAKEOVER)

    def listen(self) -> None:
        """Subscribes to TOPICS."""
        for topic in TOPICS:
            self._subscribe(topic)

    def look_around(self) -> None:
        """Registers new and gone publishers; must be called regularly, outside the subscriptions' callbacks."""
        if not self._subscriptions:
            return
        self._observe()
        guard = self._guard
        if guard.leader is None and guard.waiting:
            self._log_is_due = True
        if self._log_is_due:
            self._log_is_due = False
            guard.waiting.clear()
            for topic in LOG:  # a new subscription receives everything again
                self._node.destroy_subscription(self._subscriptions[topic.name])
                self._subscribe(topic)
            if self._asked_in_vain is not None:
                question, self._asked_in_vain = self._asked_in_vain, None
                self._let_through(qos.FRAGMENT_STATES, *question)

    def ask_for_log(self) -> None:
        """Requests bodies and events again, at the next `look_around`."""
        self._log_is_due = True

    @property
    def followed(self) -> str:
        """The participant that is followed."""
        return self._neighbours.name(self._guard.leader) if self._guard.leader is not None else "none"

    @property
    def waiting(self) -> list[str]:
        """The participants rejected in its favour."""
        return sorted(map(self._neighbours.name, self._guard.waiting))

    def _subscribe(self, topic: qos.Topic) -> None:
        self._subscriptions[topic.name] = self._node.create_subscription(
            topic.message_class, topic.name, partial(self._on_message, topic), topic.qos, raw=True
        )

    def _on_message(self, topic: qos.Topic, data: bytes, info: Origin | Mapping[str, Any]) -> None:
        origin = origin_of(info)
        last = self._states_from
        if topic is qos.FRAGMENT_STATES and last is not None and origin.publisher == last.publisher:
            # of two unknown publishers, the second begins again at 1
            self.dropped_states += max(origin.sequence_number - last.sequence_number - 1, 0)
            self._states_from = origin
        limit = self._largest_message()
        if len(data) > limit:
            reason = f"{len(data)} bytes, more than the parameter max_message_bytes, {limit}"
            self._refuse_unread(topic, data, origin, "limit_exceeded", reason)
            return
        try:
            received = deserialize_record(data, topic.message_class)
        except ValueError as error:
            self._refuse_unread(topic, data, origin, "malformed", str(error))
            return
        self._let_through(topic, origin, received)

    def _refuse_unread(self, topic: qos.Topic, data: bytes, origin: Origin, kind: str, reason: str) -> None:
        """Also reports a message of the log that cannot be read to its run, for the states that need it."""
        self._refuse(Refusal(topic.name, kind, reason))
        place = place_in_log(data, topic.message_class) if topic in LOG else None
        if place is not None and self._is_followed(topic, origin.participant, place.run_id):
            self._reject(topic, place.run_id, place.record.sequence, reason)

    def _let_through(self, topic: qos.Topic, origin: Origin, received: Received) -> None:
        if not self._is_followed(topic, origin.participant, received.run_id):
            if topic is qos.FRAGMENT_STATES:
                self._asked_in_vain = origin, received
            return
        self._run_id = received.run_id
        if topic is qos.FRAGMENT_STATES:
            self._states_from = origin
        self._handlers[topic.name](received)

    def _is_followed(self, topic: qos.Topic, participant: bytes, run_id: int) -> bool:
        guard = self._guard
        if guard.follows(topic.name, participant):
            return True
        if participant not in guard.waiting:
            self._observe()
        allow_takeover = self._node.get_parameter("allow_takeover").value
        verdict = guard.judge(topic.name, participant, run_id == self._run_id, allow_takeover)
        if verdict is Verdict.REFUSE:
            reason = (
                f"run {run_id} of {self._neighbours.name(participant)}: the service follows {self.followed} until its"
                " publishers are gone; set the parameter allow_takeover to follow another run at once"
            )
            self._refuse(Refusal(topic.name, "other_publisher", reason))
            return False
        if participant in guard.waiting:
            self._log_is_due = True
        if verdict is Verdict.BEGIN:
            self._begin_anew()
        return True

    def _observe(self) -> None:
        infos = {
            topic.name: self._node.get_publishers_info_by_topic(self._subscriptions[topic.name].topic_name)
            for topic in TOPICS
        }
        self._neighbours.look(*(info for there in infos.values() for info in there))
        publishers = {
            name: {participant_of(bytes(info.endpoint_gid)) for info in there} - self._neighbours.dead
            for name, there in infos.items()
        }
        self._guard.observe(publishers, {topic.name for topic in LOG})
