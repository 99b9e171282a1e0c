"""Publishes the messages of every step without overwriting one that a reliable subscriber lacks.

The depth of the topic covers a subscriber that is late by up to 64 steps. Acknowledgements, which take up to 5 ms, are
not awaited at each step, but only once that many messages may be unacknowledged.
"""

from __future__ import annotations

from typing import Any

from rclpy.duration import Duration
from rclpy.node import Node

from fracture_collision.ros.wire.qos import Topic

# [s] A killed subscriber stays listed until its lease expires, after 20 s, and acknowledges nothing: it delays one step
# by this time. A node that has just started is known to all others within as long (config/this_machine.xml).
PATIENCE = 0.5
_NONE = Duration()


class StepPublisher:
    """Waits once for subscribers that are late by the topic's depth; then not again until they have caught up."""

    def __init__(self, node: Node, topic: Topic) -> None:
        self._node = node
        self._topic = topic
        self._publisher = node.create_publisher(topic.message_class, topic.name, topic.qos)
        self._open = 0  # messages since the last one that all subscribers were known to have acknowledged
        self.has_late = False  # whether the wait timed out, and not all have caught up since
        self.overwritten = 0  # messages overwritten before all subscribers had acknowledged them

    @property
    def subscriber_count(self) -> int:
        """Number of subscribers, reliable or not."""
        return self._publisher.get_subscription_count()

    def await_room(self) -> None:
        """Waits until the next message overwrites none that a subscriber lacks, for at most PATIENCE."""
        depth = self._topic.qos.depth
        if self._open < depth // 2:
            return
        if self._publisher.wait_for_all_acked(_NONE):
            self._open, self.has_late = 0, False
        elif self._open >= depth and (self.has_late or not self.flush()):
            self.overwritten += 1
            if not self.has_late:
                self.has_late = True
                self._node.get_logger().warning(
                    f"{self._topic.name}: a subscriber has not acknowledged the last {depth} messages; until it does,"
                    " none waits for it, and it may miss some",
                    throttle_duration_sec=5.0,
                )

    def publish(self, message: Any) -> None:
        """Publishes a message, or its bytes, after `await_room`."""
        self.await_room()
        self._publisher.publish(message)
        self._open += 1

    def flush(self) -> bool:
        """Waits until all subscribers have all messages; False: timed out. For the end, too: the history goes then."""
        is_done = self._publisher.wait_for_all_acked(Duration(seconds=PATIENCE))
        if is_done:
            self._open, self.has_late = 0, False
        return is_done
