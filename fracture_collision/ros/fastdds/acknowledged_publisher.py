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
from typing import Any

from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.qos import HistoryPolicy, ReliabilityPolicy

from fracture_collision.ros.fastdds.message_origin import participant_of
from fracture_collision.ros.fastdds.neighbours import Neighbours, is_nameless
from fracture_collision.ros.wire.qos import Topic

# [s] A subscriber that stalls longer than this (on another machine that has gone, say) is left behind rather than
# holding up the run. One of this machine that was killed holds up nothing (neighbours.py). Shorter leases were tried:
# with 5 s the living lost sight of each other on a busy machine, and not all found back.
PATIENCE = 2.0
# [s] Likewise one of a process of this machine that is stopped, by SIGSTOP or a debugger: twice as long as two
# acknowledgements of those beside it take, who cannot be told from it.
PATIENCE_WITH_THE_STOPPED = 0.02
# [s] Since the last message. Until it has caught up that long is left to those beside it; steps that take longer do not
# wait at all.
PATIENCE_WITH_THE_SLOW = 0.01
LOOK_INTERVAL = 0.05  # [s] between two looks at whether somebody has died or is stopped


class AcknowledgedPublisher:
    """Publishes on `topic`; overwrites nothing that some subscriber has yet to receive.

    `answerers`: nodes of this name need not acknowledge anything, for they answer; where no others listen there is no
    wait. `neighbours`: of the node, for all its publishers: whom one has waited for in vain the others need not.
    """

    def __init__(self, node: Node, topic: Topic, answerers: str = "", neighbours: Neighbours | None = None) -> None:
        self._topic = topic
        self._node = node
        self._answerers = answerers
        self._neighbours = neighbours or Neighbours(node)
        self._publisher = node.create_publisher(topic.message_class, topic.name, topic.qos)
        self._subscribers: int | None = None  # when it was last asked who they are; None: not all had a name then
        self._known_listeners: frozenset[bytes] = frozenset()
        self._published_at = 0.0  # [s] of time.monotonic(): the last message
        self.overtaken = 0  # messages that the next one followed before all had acknowledged them

    @property
    def subscriber_count(self) -> int:
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
        self.settle()
        self._publisher.publish(message)
        self._published_at = time.monotonic()

    def publish_again(self, message: Any) -> None:
        """The last message once more, for somebody who was not there: nothing is overwritten that was not the same."""
        self._publisher.publish(message)

    def flush(self) -> bool:
        """Waits until everybody has the last message; needed before the publisher goes. False: not all, in time.

        The wait is at most PATIENCE, once; LOOK_INTERVAL where the one that lags behind is stopped; and until it has
        caught up, no longer than to PATIENCE_WITH_THE_SLOW after the last message.
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
                f"{name}: a subscriber did not acknowledge the last message in time and may miss some. These listen:"
                f" {self._neighbours.names(listeners)}",
                throttle_duration_sec=5.0,
            )
        return False

    def close(self) -> None:
        """Forgets all it sent, once everybody has it."""
        if self.subscriber_count:
            self.flush()
        self._neighbours.slow.pop(self._topic.name, None)
        self._node.destroy_publisher(self._publisher)

    def _listeners(self) -> frozenset[bytes]:
        """Participants of those that need to acknowledge."""
        count = self.subscriber_count
        if count != self._subscribers:
            infos = self._node.get_subscriptions_info_by_topic(self._publisher.topic_name)
            self._neighbours.look(*infos)
            self._subscribers = None if any(is_nameless(info) for info in infos) else count
            # who asks for no promise (best effort) acknowledges nothing
            self._known_listeners = frozenset(
                participant_of(bytes(info.endpoint_gid))
                for info in infos
                if info.node_name != self._answerers and info.qos_profile.reliability == ReliabilityPolicy.RELIABLE
            )
        return self._known_listeners


def _left(deadline: float) -> float:
    """[s]"""
    return max(deadline - time.monotonic(), 0.0)
