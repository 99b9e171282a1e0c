"""The topics of a run: which messages reach the service, and which were dropped or rejected on the way."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

from rclpy.node import Node
from rclpy.subscription import Subscription

from fracture_collision.cdr import Received
from fracture_collision.ros.service.collision_run import Refusal
from fracture_collision.ros.wire import qos
from fracture_collision.ros.wire.cdr_records import deserialize_record, place_in_log

LOG = (qos.BODIES, qos.FRACTURE_EVENTS)  # a run can be rebuilt from these
MOST_BODIES = 1000  # taken at once: other messages wait meanwhile


class Incoming:
    """Subscriptions to bodies, fracture events and states; messages are read and passed on."""

    def __init__(
        self,
        node: Node,
        largest_message: Callable[[], int],
        handlers: Mapping[str, Callable[[Received], None]],
        refuse: Callable[[Refusal], None],
        reject: Callable[[qos.Topic, int, int, str], None],
        bodies_read: Callable[[Received], None],
    ) -> None:
        """Subscribes only when `listen` is called.

        `largest_message`: [bytes]. `handlers`: by the topic's name. `reject`: takes topic, run id and sequence of a
        message of the log that cannot be read, and the reason. `bodies_read`: takes the last of the bodies
        that waited.
        """
        self._node = node
        self._largest_message = largest_message
        self._handlers = handlers
        self._refuse = refuse
        self._reject = reject
        self._bodies_read = bodies_read
        self._subscriptions: dict[str, Subscription] = {}
        self._log_is_due = False
        self._last_states: tuple[int, int] | None = None  # run id, and number among their publisher's messages
        self.dropped_states = 0

    def listen(self) -> None:
        """Subscribes to the topics."""
        for topic in (*LOG, qos.FRAGMENT_STATES):
            self._subscribe(topic)

    def look(self) -> None:
        """Requests bodies and events again, if they are due; not to be called from a subscription's callback."""
        if self._log_is_due:
            self._log_is_due = False
            for topic in LOG:  # a new subscription receives everything again
                self._node.destroy_subscription(self._subscriptions[topic.name])
                self._subscribe(topic)

    def ask_for_log(self) -> None:
        """Requests bodies and events again, at the next `look`."""
        self._log_is_due = bool(self._subscriptions)

    def _subscribe(self, topic: qos.Topic) -> None:
        # only the newest states are worth an answer
        profile = qos.NEWEST if topic is qos.FRAGMENT_STATES else topic.qos
        self._subscriptions[topic.name] = self._node.create_subscription(
            topic.message_class, topic.name, partial(self._on_message, topic), profile, raw=True
        )

    def _on_message(self, topic: qos.Topic, data: bytes, info: Mapping[str, Any]) -> None:
        if topic is not qos.BODIES:
            self._read(topic, data, info)
            return
        # All that wait: an executor takes one at a time, and what was sent after them, states or a request, in between.
        last, subscription = self._read(topic, data, info), self._subscriptions[topic.name]
        for _ in range(MOST_BODIES):
            with subscription.handle:
                taken = subscription.handle.take_message(subscription.msg_type, True)
            if taken is None:
                break
            last = self._read(topic, *taken) or last
        if last is not None:
            self._bodies_read(last)

    def _read(self, topic: qos.Topic, data: bytes, info: Mapping[str, Any]) -> Received | None:
        """Passes a message on; returns it, None if it cannot be read."""
        limit = self._largest_message()
        if len(data) > limit:
            reason = f"{len(data)} bytes, more than the parameter max_message_bytes, {limit}"
            self._refuse_unread(topic, data, "limit_exceeded", reason)
            return None
        try:
            received = deserialize_record(data, topic.message_class)
        except ValueError as error:
            self._refuse_unread(topic, data, "malformed", str(error))
            return None
        if topic is qos.FRAGMENT_STATES:
            self._count_dropped(received.run_id, info["publication_sequence_number"])
        self._handlers[topic.name](received)
        return received

    def _count_dropped(self, run_id: int, number: int) -> None:
        """The depth of the subscription is 1: what was not taken before the next came is gone."""
        if self._last_states is not None and self._last_states[0] == run_id:
            self.dropped_states += max(number - self._last_states[1] - 1, 0)
        self._last_states = run_id, number

    def _refuse_unread(self, topic: qos.Topic, data: bytes, kind: str, reason: str) -> None:
        """Also reports a message of the log that cannot be read to its run, for the states that need it."""
        self._refuse(Refusal(topic.name, kind, reason))
        if topic is qos.FRAGMENT_STATES:
            if self._last_states is not None:
                self._last_states = self._last_states[0], self._last_states[1] + 1  # it was not dropped
            return
        place = place_in_log(data, topic.message_class)
        if place is not None:
            self._reject(topic, place.run_id, place.record.sequence, reason)
