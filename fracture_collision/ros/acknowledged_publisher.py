"""Lossless publishing at depth 1.

A publisher of depth 1 overwrites its last message, even if a slow subscriber has not received it. Between the simulator
and the service nothing can be lost, as each publishes only after the other has answered. A third subscriber, such as a
recorder, could miss a step. So where there is one, the next message waits until the last is acknowledged.

Cost, measured on loopback with Fast DDS: an acknowledgement takes up to 5 ms (a reader answers a heartbeat after that
delay), counted from the last message. Steps that take longer than that do not wait at all, shorter ones are stretched
to it; without a third subscriber there is no wait. Setting that delay to 0 by a profile of Fast DDS gained nothing.
"""

from __future__ import annotations

from typing import Any

from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.qos import HistoryPolicy

from fracture_collision.ros.qos import Topic

# A subscriber that stalls longer than this (killed, or stopped in a debugger) is left behind rather than holding up the
# run. One that was killed is listed until its lease has run out, 20 s: while somebody is behind, the others get only as
# much time at each message as they take if they are alive, on a busy machine too. (Leases of 5 s were tried: on a busy
# machine the living lost sight of each other, and not all found back.)
ACKNOWLEDGEMENT_TIMEOUT = Duration(seconds=2)
ALIVE_TIMEOUT = Duration(seconds=0.5)


class AcknowledgedPublisher:
    """Publishes on `topic`; overwrites nothing that some subscriber has yet to receive.

    `answerers`: nodes of this name need not acknowledge anything, for they answer; where no others listen there is no
    wait, be they dead or alive.
    """

    def __init__(self, node: Node, topic: Topic, answerers: str = "") -> None:
        self._topic = topic
        self._node = node
        self._answerers = answerers
        self._publisher = node.create_publisher(topic.message_class, topic.name, topic.qos)
        self._is_behind = False  # whether some subscriber did not acknowledge in time
        self._listeners = 0, False  # subscribers when it was last asked who they are, and whether any is no answerer

    @property
    def subscriber_count(self) -> int:
        return self._publisher.get_subscription_count()

    def settle(self) -> None:
        """Waits until the next message may overwrite the last."""
        if self._topic.qos.history == HistoryPolicy.KEEP_ALL:
            return
        count = self.subscriber_count
        if count != self._listeners[0]:
            names = {info.node_name for info in self._node.get_subscriptions_info_by_topic(self._publisher.topic_name)}
            self._listeners = count, bool(names - {self._answerers})
        if self._listeners[1]:
            self.flush()

    def publish(self, message: Any) -> None:
        self.settle()
        self._publisher.publish(message)

    def publish_again(self, message: Any) -> None:
        """The last message once more, for somebody who was not there: nothing is overwritten that was not the same,
        and whoever has not acknowledged it by now may be gone.
        """
        self._is_behind = True
        self._publisher.publish(message)

    def flush(self) -> None:
        """Waits until everybody has the last message; needed before the publisher goes."""
        was_behind = self._is_behind
        self._is_behind = not self._publisher.wait_for_all_acked(
            ALIVE_TIMEOUT if was_behind else ACKNOWLEDGEMENT_TIMEOUT
        )
        if self._is_behind and not was_behind:
            self._node.get_logger().warning(
                f"{self._topic.name}: a subscriber did not acknowledge the last message in time and may miss it",
                throttle_duration_sec=5.0,
            )

    def close(self) -> None:
        """Forgets all it sent, once everybody has it."""
        if self.subscriber_count:
            self.flush()
        self._node.destroy_publisher(self._publisher)
