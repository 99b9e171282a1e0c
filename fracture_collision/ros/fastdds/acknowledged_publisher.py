"""Lossless publishing at depth 1.

A publisher of depth 1 overwrites its last message, even if a slow subscriber has not received it. Between the simulator
and the service nothing can be lost, as each publishes only after the other has answered. A third subscriber, such as a
recorder, could miss a step. So where there is one, the next message waits until the last is acknowledged.

Cost, measured on loopback with Fast DDS: an acknowledgement takes up to 5 ms (a reader answers a heartbeat after that
delay), counted from the last message. Steps that take longer than that do not wait at all, shorter ones are stretched
to it; without a third subscriber there is no wait. Setting that delay to 0 by a profile of Fast DDS gained nothing.
"""

from __future__ import annotations

import time
from collections.abc import Collection
from typing import Any

from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.qos import HistoryPolicy, ReliabilityPolicy

from fracture_collision.ros.fastdds.message_origin import participant_of
from fracture_collision.ros.fastdds.neighbours import Neighbours, is_nameless
from fracture_collision.ros.wire.qos import Topic

# [s] The publisher stops waiting for a subscriber that stalls longer than this, for example on another machine that has
# gone. A killed process of this machine delays nothing (neighbours.py). Shorter leases were tried: with 5 s, living
# participants lost each other on a busy machine, and not all were discovered again.
PATIENCE = 2.0
# [s] The same if a subscriber's process on this machine is stopped, by SIGSTOP or a debugger: twice the time of two
# acknowledgements by the other subscribers, from which the wait cannot distinguish it.
PATIENCE_WITH_THE_STOPPED = 0.02
# [s] Since the last message. Until a slow subscriber has caught up, the wait ends then, which leaves the others time to
# acknowledge; steps that take longer do not wait at all.
PATIENCE_WITH_THE_SLOW = 0.01
LOOK_INTERVAL = 0.05  # [s] between two checks for dead or stopped processes


class AcknowledgedPublisher:
    """Publishes on `topic` without overwriting a message that some subscriber has yet to receive.

    `answerers`: nodes of these names need not acknowledge, since they answer; without others there is no wait.
    `neighbours`: shared by all publishers of a node: a subscriber for which one timed out does not delay the others.
    """

    def __init__(
        self, node: Node, topic: Topic, answerers: Collection[str] = (), neighbours: Neighbours | None = None
    ) -> None:
        self._topic = topic
        self._node = node
        self._answerers = answerers
        self._neighbours = neighbours or Neighbours(node)
        self._publisher = node.create_publisher(topic.message_class, topic.name, topic.qos)
        self._subscribers: int | None = None  # their number at the last listing; None: some had no name yet
        self._known_listeners: frozenset[bytes] = frozenset()
        self._published_at = 0.0  # [s] time.monotonic() of the last message
        self.overtaken = 0  # messages followed by the next one before all subscribers had acknowledged them

    @property
    def subscriber_count(self) -> int:
        """Number of subscribers, reliable or not."""
        return self._publisher.get_subscription_count()

    def settle(self) -> None:
        """Waits until the next message may overwrite the last."""
        if self._topic.qos.history == HistoryPolicy.KEEP_ALL:
            return
        if not self._listeners():
            self._neighbours.slow.pop(self._topic.name, None)
        elif not self.flush():
            self.overtaken += 1

    def publish(self, message: Any) -> None:
        """Publishes a message, or its bytes, after `settle`."""
        self.settle()
        self._publisher.publish(message)
        self._published_at = time.monotonic()

    def publish_again(self, message: Any) -> None:
        """Publishes the last message again, for late subscribers; it can overwrite only an identical message."""
        self._publisher.publish(message)

    def flush(self) -> bool:
        """Waits until all subscribers have the last message; required before the publisher goes. False: timed out.

        The wait is at most PATIENCE, once. If a subscriber is stopped it is PATIENCE_WITH_THE_STOPPED, or LOOK_INTERVAL
        if it stops during the wait. Until a slow one has caught up, it ends PATIENCE_WITH_THE_SLOW after the message.
        """
        slow, name, listeners = self._neighbours.slow, self._topic.name, self._listeners()
        are_slow = any(not listeners.isdisjoint(some) for some in slow.values())
        began = time.monotonic()
        deadline = self._published_at + PATIENCE_WITH_THE_SLOW if are_slow else began + PATIENCE
        pause = PATIENCE_WITH_THE_STOPPED if self._neighbours.are_some_stopped(listeners) else LOOK_INTERVAL
        while not self._publisher.wait_for_all_acked(Duration(seconds=min(pause, _left(deadline)))):
            if _left(deadline) == 0.0 or self._neighbours.are_some_stopped(listeners):
                break
            self._neighbours.look()
        else:
            slow.pop(name, None)
            return True
        if name not in slow:
            slow[name] = listeners
            self._node.get_logger().warning(
                f"{name}: a subscriber did not acknowledge the last message in time and may miss messages. Subscribers:"
                f" {self._neighbours.names(listeners)}",
                throttle_duration_sec=5.0,
            )
        return False

    def close(self) -> None:
        """Destroys the publisher and its history after waiting until all subscribers have the last message."""
        if self.subscriber_count:
            self.flush()
        self._neighbours.slow.pop(self._topic.name, None)
        self._node.destroy_publisher(self._publisher)

    def _listeners(self) -> frozenset[bytes]:
        """Participants of the subscribers that must acknowledge."""
        count = self.subscriber_count
        if count != self._subscribers:
            infos = self._node.get_subscriptions_info_by_topic(self._publisher.topic_name)
            self._neighbours.look(*infos)
            self._subscribers = None if any(is_nameless(info) for info in infos) else count
            # best-effort subscribers do not acknowledge
            self._known_listeners = frozenset(
                participant_of(bytes(info.endpoint_gid))
                for info in infos
                if info.node_name not in self._answerers and info.qos_profile.reliability == ReliabilityPolicy.RELIABLE
            )
        return self._known_listeners


def _left(deadline: float) -> float:
    """Time [s] left until `deadline`, a time.monotonic(); 0 after it."""
    return max(deadline - time.monotonic(), 0.0)
