"""The executor's fast path for messages: it keeps all of rclpy's features and never polls."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from typing import NamedTuple

import pytest
import rclpy
from rcl_interfaces.srv import GetParameters
from rclpy.context import Context
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.serialization import serialize_message
from std_msgs.msg import String

from fracture_collision.ros.fastdds.prompt_executor import PromptExecutor
from fracture_collision.ros.processes.node_process import free_domain_id
from fracture_collision.ros.processes.own_context import own_context

PATIENCE = 30.0  # [s]
LATCHED = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)


class Stage(NamedTuple):
    context: Context
    node: Node
    executor: PromptExecutor

    def spin_until(self, condition: Callable[[], bool]) -> int:
        """Number of spins until the condition holds."""
        deadline, turns = time.monotonic() + PATIENCE, 0
        while not condition():
            assert time.monotonic() < deadline
            self.executor.spin_once(timeout_sec=1.0)
            turns += 1
        return turns


@pytest.fixture
def stage() -> Iterator[Stage]:
    context = own_context(free_domain_id())
    node = rclpy.create_node("prompt", context=context)
    executor = PromptExecutor(context=context)
    executor.add_node(node)
    yield Stage(context, node, executor)
    executor.shutdown()
    node.destroy_node()
    context.try_shutdown()


def test_messages_arrive_in_order_as_objects_or_bytes(stage: Stage) -> None:
    publisher = stage.node.create_publisher(String, "words", LATCHED)
    objects: list[str] = []
    raw: list[bytes] = []
    stage.node.create_subscription(String, "words", lambda message: objects.append(message.data), LATCHED)
    stage.node.create_subscription(String, "words", raw.append, LATCHED, raw=True)
    sent = [f"{i}" * 4 for i in range(50)]
    for words in sent:
        publisher.publish(String(data=words))
    stage.spin_until(lambda: len(objects) == len(raw) == len(sent))
    assert objects == sent
    assert [data.rstrip(b"\0") for data in raw] == [
        serialize_message(String(data=words)).rstrip(b"\0") for words in sent
    ]


def test_timers_services_guards_and_late_entities_are_served(stage: Stage) -> None:
    done: list[str] = []
    stage.node.declare_parameter("answer", 42)
    other = rclpy.create_node("other", context=stage.context)
    stage.executor.add_node(other)
    client = other.create_client(GetParameters, "/prompt/get_parameters")
    stage.spin_until(client.service_is_ready)
    asked = client.call_async(GetParameters.Request(names=["answer"]))
    stage.spin_until(asked.done)
    assert asked.result().values[0].integer_value == 42

    def late_comer() -> None:
        timer.cancel()
        stage.node.create_subscription(String, "late", lambda message: done.append(message.data), LATCHED)

    stage.node.create_publisher(String, "late", LATCHED).publish(String(data="late"))
    timer = stage.node.create_timer(0.001, late_comer)
    guard = stage.node.create_guard_condition(lambda: done.append("guard"))
    guard.trigger()
    stage.executor.create_task(lambda: done.append("task"))
    stage.spin_until(lambda: len(done) == 3)
    assert sorted(done) == ["guard", "late", "task"]

    stage.executor.remove_node(other)
    other.destroy_node()
    stage.executor.spin_once(timeout_sec=0.0)


def test_the_executor_waits_while_idle(stage: Stage) -> None:
    """Also after a timer callback, which wakes rclpy's executor twice for nothing."""
    ticks: list[float] = []
    stage.node.create_timer(0.1, lambda: ticks.append(time.monotonic()))
    publisher = stage.node.create_publisher(String, "words", 10)
    heard: list[String] = []
    stage.node.create_subscription(String, "words", heard.append, 10)
    stage.spin_until(lambda: len(ticks) == 2)
    publisher.publish(String(data="x"))
    turns = stage.spin_until(lambda: len(ticks) == 7)
    assert len(heard) == 1 and turns <= 4 * 5 + 4

    began = time.monotonic()
    stage.node.destroy_timer(next(stage.node.timers))
    for _ in range(5):  # drain remaining wake-ups
        stage.executor.spin_once(timeout_sec=0.0)
    stage.executor.spin_once(timeout_sec=0.2)
    assert time.monotonic() - began >= 0.2


def test_an_error_in_a_callback_is_raised_by_spin(stage: Stage) -> None:
    def fail(message: String) -> None:
        raise ValueError(message.data)

    publisher = stage.node.create_publisher(String, "words", LATCHED)
    stage.node.create_subscription(String, "words", fail, LATCHED)
    publisher.publish(String(data="told"))
    with pytest.raises(ValueError, match="told"):
        stage.spin_until(lambda: False)


def test_the_executor_ends_with_its_context(stage: Stage) -> None:
    stage.node.create_timer(0.01, stage.context.shutdown)
    with pytest.raises(ExternalShutdownException):
        stage.spin_until(lambda: False)
