"""The executor of the service and the simulator: rclpy's EventsExecutor, faster than wait sets."""

from __future__ import annotations

from rclpy.executors import Executor, SingleThreadedExecutor
from rclpy.node import Node

try:
    from rclpy.experimental import EventsExecutor
except ImportError:  # an older rclpy of Jazzy
    EventsExecutor = SingleThreadedExecutor

# [s] In rclpy 7.1.6 an EventsExecutor that waits without a timeout keeps a core busy and runs no timers.
LONGEST_WAIT = 1.0


def executor_of(node: Node) -> Executor:
    """An executor with one thread that has the node."""
    executor = EventsExecutor(context=node.context)
    executor.add_node(node)
    return executor


def spin(executor: Executor, node: Node) -> None:
    """Runs the node's callbacks until its context is shut down."""
    while node.context.ok():
        executor.spin_once(timeout_sec=LONGEST_WAIT)
