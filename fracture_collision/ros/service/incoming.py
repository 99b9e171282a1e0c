"""The topics of a run: which messages reach the service, and which were dropped or rejected on the way."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from functools import partial

from rclpy.node import Node
from rclpy.subscription import Subscription

from fracture_collision.cdr import Received
from fracture_collision.ros.service.collision_run import Refusal
from fracture_collision.ros.wire import qos
from fracture_collision.ros.wire.cdr_records import deserialize_record, place_in_log

LOG = (qos.BODIES, qos.FRACTURE_EVENTS)  # a run can be rebuilt from these
MOST_WAITING = 1000  # messages taken at once: other topics wait meanwhile


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
        self._subscriptions[topic.name] = self._node.create_subscription(
            topic.message_class, topic.name, partial(self._on_message, topic), topic.qos, raw=True
        )

    def _on_message(self, topic: qos.Topic, data: bytes) -> None:
        # All that wait: an executor takes one at a time, and what was sent after them, states or a request, in between.
        waiting = self._waiting(topic, data)
        if topic is qos.FRAGMENT_STATES:
            *older, newest = waiting  # only the newest states are worth an answer
            self.dropped_states += len(older)
            self._read(topic, newest)
            return
        last = None
        for each in waiting:
            last = self._read(topic, each) or last
        if topic is qos.BODIES and last is not None:
            self._bodies_read(last)

    def _waiting(self, topic: qos.Topic, first: bytes) -> Iterator[bytes]:
        """The first message, which was taken, and those behind it."""
        yield first
        subscription = self._subscriptions[topic.name]
        for _ in range(MOST_WAITING):
            with subscription.handle:
                taken = subscription.handle.take_message(subscription.msg_type, True)
            if taken is None:
                return
            yield taken[0]

    def _read(self, topic: qos.Topic, data: bytes) -> Received | None:
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
        self._handlers[topic.name](received)
        return received

    def _refuse_unread(self, topic: qos.Topic, data: bytes, kind: str, reason: str) -> None:
        """Also reports a message of the log that cannot be read to its run, for the states that need it."""
        self._refuse(Refusal(topic.name, kind, reason))
        if topic is qos.FRAGMENT_STATES:
            return
        place = place_in_log(data, topic.message_class)
        if place is not None:
            self._reject(topic, place.run_id, place.record.sequence, reason)
