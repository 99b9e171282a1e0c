"""rclpy's executor with a fast path for messages.

For every callback rclpy's executor collects all entities and creates a wait set, a generator, a task and a coroutine,
and after each callback it wakes itself once more without work. Here the wait set is kept and messages are taken
directly from it; everything else (timers, services, events) takes rclpy's path. Nothing is polled: one wait covers all.

rclpy.experimental's EventsExecutor is as fast, but does not provide the publisher of a message. In rclpy 7.1.6 its
`spin` keeps a core busy and runs no timer, and it fails if a callback takes message info (docs/decisions/0028).
"""

from __future__ import annotations

from collections.abc import Callable, Coroutine
from typing import Any

from rclpy.context import Context
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.subscription import Subscription
from rclpy.utilities import timeout_sec_to_nsec
from rclpy.waitable import NumberOfEntities

from fracture_collision.ros.fastdds.message_origin import take_with_origin


class PromptExecutor(SingleThreadedExecutor):
    """For nodes whose subscriptions have plain callbacks, not coroutines.

    A callback has one argument, the message. For a raw message it may have two: the second is the message's Origin
    (ros/fastdds/message_origin.py) in place of rclpy's message info.

    Messages are delivered in the order in which subscriptions were created, one of each before the next wait.
    """

    def __init__(self, *, context: Context | None = None) -> None:
        super().__init__(context=context)
        self._entities: _Entities | None = None  # None: to be collected again

    def add_node(self, node: Node) -> bool:
        """As in rclpy; the wait set is built again."""
        self._entities = None
        return super().add_node(node)

    def remove_node(self, node: Node) -> None:
        """As in rclpy; the wait set is built again."""
        self._entities = None
        super().remove_node(node)

    def wake(self) -> None:
        """Wakes a wait; a node calls it when one of its entities is created or destroyed."""
        self._entities = None
        super().wake()

    def spin_once(self, timeout_sec: float | None = None) -> None:
        """Waits until something is ready and handles it. Raises ExternalShutdownException after a shutdown."""
        if self._is_shutdown:
            return
        if not self.context.ok():
            raise ExternalShutdownException
        if self._entities is None:
            self._entities = _Entities(self.get_nodes(), (self._guard, self._sigint_gc), self.context)
        subscriptions, others = self._entities.wait(timeout_sec_to_nsec(timeout_sec))
        if not self.context.ok():
            raise ExternalShutdownException
        for subscription in subscriptions:
            arguments = _taken(subscription)
            if arguments is not None:
                subscription.callback(*arguments)
        if others:
            super().spin_once(timeout_sec=0)

    def _take_subscription(self, subscription: Subscription) -> Callable[[], Coroutine] | None:
        """For messages that rclpy's executor finds while it handles other entities."""
        if subscription._callback_type is Subscription.CallbackType.MessageOnly:
            return super()._take_subscription(subscription)
        arguments = _taken(subscription)
        if arguments is None:
            return None

        async def call() -> None:
            subscription.callback(*arguments)

        return call


def _taken(subscription: Subscription) -> tuple[Any, ...] | None:
    """The arguments for the callback; None if there is no message after all."""
    if subscription._callback_type is Subscription.CallbackType.WithMessageInfo:
        return take_with_origin(subscription)
    with subscription.handle:
        taken = subscription.handle.take_message(subscription.msg_type, subscription.raw)
    return None if taken is None else taken[:1]


class _Entities:
    """All entities of some nodes, and the wait set for them."""

    def __init__(self, nodes: list[Node], guards: tuple[Any, ...], context: Context) -> None:
        self._subscriptions = [each for node in nodes for each in node.subscriptions]
        self._own_guards = guards
        self._guards = [each for node in nodes for each in node.guards]
        self._timers = [each for node in nodes for each in node.timers]
        self._clients = [each for node in nodes for each in node.clients]
        self._services = [each for node in nodes for each in node.services]
        self._waitables = [each for node in nodes for each in node.waitables]
        counts = NumberOfEntities(
            len(self._subscriptions), len(guards) + len(self._guards), len(self._timers), len(self._clients),
            len(self._services),
        )  # fmt: skip
        for waitable in self._waitables:
            counts += waitable.get_num_entities()
        assert context.handle is not None  # only before rclpy.init
        with context.handle:
            self._wait_set = rclpy_implementation.WaitSet(
                counts.num_subscriptions, counts.num_guard_conditions, counts.num_timers, counts.num_clients,
                counts.num_services, counts.num_events, context.handle,
            )  # fmt: skip

    def wait(self, nanoseconds: int) -> tuple[list[Any], bool]:
        """The subscriptions that have a message, and whether anything else is ready; nanoseconds < 0: no timeout."""
        wait_set = self._wait_set
        wait_set.clear_entities()  # waiting removes what is not ready
        for subscription in self._subscriptions:
            wait_set.add_subscription(subscription.handle)
        for guard in (*self._own_guards, *self._guards):
            wait_set.add_guard_condition(guard.handle)
        for timer in self._timers:
            wait_set.add_timer(timer.handle)
        for client in self._clients:
            wait_set.add_client(client.handle)
        for service in self._services:
            wait_set.add_service(service.handle)
        for waitable in self._waitables:
            waitable.add_to_wait_set(wait_set)
        wait_set.wait(nanoseconds)
        ready = wait_set.get_ready_entities("subscription")
        triggered = wait_set.get_ready_entities("guard_condition")
        for guard in self._guards:
            if guard.handle.pointer in triggered:
                guard.trigger()  # waiting has reset it, and rclpy must find it triggered
        others = bool(triggered) or any(wait_set.get_ready_entities(kind) for kind in ("timer", "client", "service"))
        for waitable in self._waitables:  # all of them: each stores whether it was ready
            others |= waitable.is_ready(wait_set)
        return [each for each in self._subscriptions if each.handle.pointer in ready], others
