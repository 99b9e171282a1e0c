"""An external client of the service: communicates over DDS as any simulator would. For tests."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.executors import SingleThreadedExecutor
from rclpy.parameter import Parameter, parameter_value_to_python
from rclpy.parameter_client import AsyncParameterClient

from fracture_collision.records import ContactConstraintArray, FragmentRegistry
from fracture_collision.ros.processes.own_context import own_context
from fracture_collision.ros.wire import qos
from fracture_collision.ros.wire.conversion import heading, to_message, to_record

PATIENCE = 120.0  # [s] on a loaded machine
ASK_AGAIN = 5.0  # [s]


class ServiceClient:
    """Publishes bodies, events and states; collects answers, registries and diagnostics."""

    def __init__(self, domain_id: int, ros_arguments: Sequence[str] = (), own_runs: bool = False) -> None:
        """`ros_arguments`: arguments after --ros-args, for namespace and remapping.

        `own_runs`: collects nothing of runs that it does not publish, as of earlier ones of the same service.
        """
        self._context = own_context(domain_id)
        self.node = rclpy.create_node(
            "service_client", context=self._context, cli_args=["--ros-args", *ros_arguments] if ros_arguments else None
        )
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self.node)
        self._publishers = {
            topic.name: self.node.create_publisher(topic.message_class, topic.name, topic.qos)
            for topic in (qos.BODIES, qos.FRACTURE_EVENTS, qos.FRAGMENT_STATES)
        }
        self._parameters: AsyncParameterClient | None = None
        self._own_runs: set[int] | None = set() if own_runs else None
        self.answers: list[Any] = []
        self.registries: list[Any] = []
        self.diagnostics: dict[str, str] = {}
        self.levels: dict[str, bytes] = {}
        self.details: dict[str, dict[str, str]] = {}  # status name -> its key-value pairs
        self.diagnostics_came: list[float] = []  # time.monotonic()
        self._refusals: dict[str, str] = {}
        for topic, profile, collected in (
            (qos.CONTACT_CONSTRAINTS, qos.EACH_STEP, self.answers), (qos.FRAGMENTS, qos.FRAGMENTS.qos, self.registries)
        ):  # fmt: skip
            self.node.create_subscription(
                topic.message_class, topic.name, self._collecting(collected), qos.recording(profile)
            )
        self.node.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, 10)

    def close(self) -> None:
        self._executor.shutdown()
        self.node.destroy_node()
        self._context.try_shutdown()

    def spin_once(self, timeout_sec: float) -> None:
        self._executor.spin_once(timeout_sec=timeout_sec)

    def spin_until(self, condition: Callable[[], bool], what: str, patience: float = PATIENCE) -> None:
        deadline = time.monotonic() + patience
        while not condition():
            assert time.monotonic() < deadline, f"in vain: {what}"
            self._executor.spin_once(timeout_sec=0.1)

    def await_service(self) -> None:
        self.spin_until(lambda: self._publishers["fragment_states"].get_subscription_count() == 1, "a service")

    def drop_publisher(self, topic: str) -> None:
        self.node.destroy_publisher(self._publishers.pop(topic))

    def publish(self, topic: str, record: Any, run_id: int, time_stamp: float = 0.0) -> None:
        if self._own_runs is not None:
            self._own_runs.add(run_id)
        self._publishers[topic].publish(to_message(record, heading(time_stamp), run_id))

    def publish_bytes(self, topic: str, data: bytes) -> None:
        """Publishes raw bytes, valid or not."""
        self._publishers[topic].publish(data)

    def ask(self, states: Any, run_id: int) -> ContactConstraintArray:
        """Publishes states and waits for their answer."""
        before = len(self.answers)
        self.publish("fragment_states", states, run_id)
        self.spin_until(lambda: len(self.answers) > before, f"an answer to step {states.step}")
        assert len(self.answers) == before + 1 and self.answers[-1].run_id == run_id
        return to_record(self.answers[-1])

    def await_registry(self, run_id: int, fracture_sequence: int) -> FragmentRegistry:
        wanted = (run_id, fracture_sequence)

        def matching() -> list[Any]:
            return [r for r in self.registries if (r.run_id, r.fracture_sequence) == wanted]

        self.spin_until(lambda: bool(matching()), f"the registry after {fracture_sequence} events")
        return to_record(matching()[-1])

    def await_refusal(self, key: str, words: str) -> None:
        """`key`: 'topic: kind' on /diagnostics; `words` must be in its last reason."""
        self.spin_until(lambda: words in self._refusals.get(key, ""), f"a refusal under {key!r} with {words!r}")

    def set_parameters(self, **values: Any) -> list[str]:
        """Sets the service's parameters; returns the reason for each rejected one, "" for each accepted one."""
        wanted = [Parameter(name, value=value) for name, value in values.items()]
        answer = self._ask_parameters(lambda client: client.set_parameters(wanted))
        return [result.reason if not result.successful else "" for result in answer.results]

    def parameters(self, *names: str) -> list[Any]:
        """Values of the service's parameters."""
        answer = self._ask_parameters(lambda client: client.get_parameters(list(names)))
        return [parameter_value_to_python(value) for value in answer.values]

    def _ask_parameters(self, ask: Callable[[AsyncParameterClient], Any]) -> Any:
        if self._parameters is None:
            self._parameters = AsyncParameterClient(self.node, "collision_node")
        assert self._parameters.wait_for_services(PATIENCE)
        futures: list[Any] = []

        def is_answered() -> bool:
            # rmw drops a response if it has not yet discovered its reader, even though the request has arrived.
            if time.monotonic() >= began + len(futures) * ASK_AGAIN:
                futures.append(ask(self._parameters))
            return any(future.done() for future in futures)

        began = time.monotonic()
        self.spin_until(is_answered, "an answer of the parameter service")
        return next(future.result() for future in futures if future.done())

    def _collecting(self, collected: list[Any]) -> Callable[[Any], None]:
        def collect(message: Any) -> None:
            if self._own_runs is None or message.run_id in self._own_runs:
                collected.append(message)

        return collect

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        self.diagnostics_came.append(time.monotonic())
        for status in message.status:
            self.diagnostics[status.name], self.levels[status.name] = status.message, status.level
            self.details[status.name] = {value.key: value.value for value in status.values}
            if status.name.endswith("refused messages"):
                self._refusals = {value.key: value.value for value in status.values}
