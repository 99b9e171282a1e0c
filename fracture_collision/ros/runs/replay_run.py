"""Replay's service over DDS: a collision_node of its own, in a process of its own, on this machine alone."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from types import TracebackType

import rclpy
from rclpy.executors import SingleThreadedExecutor

from fracture_collision.bag.exchanges import Message, Question, Run, canonical, deserialize_record
from fracture_collision.records import ContactConstraintArray
from fracture_collision.replay import Unanswered
from fracture_collision.ros.processes.node_process import NodeProcess, free_domain_id
from fracture_collision.ros.processes.own_context import own_context
from fracture_collision.ros.wire import qos
from fracture_collision.world import Settings
from fracture_collision.world.settings import OF_SERVICE

FIRST_PAUSE = 1.0  # [s] before a request is repeated
LONGEST_PAUSE = 8.0  # [s]
PATIENCE = 60.0  # [s] for one answer
WAITING_INTERVAL = 0.1  # [s]


class OverDds:
    """A service for `replay.Replay`; use as a context manager. `wait` is called while it waits, and may raise."""

    def __init__(self, settings: Settings, log: Path, wait: Callable[[], None] = lambda: None) -> None:
        self._settings = settings
        self._log = log
        self._wait = wait
        self._run: Run | None = None
        self._bodies = self._events = 0  # of the run, already published
        self._asked: tuple[int, int, int] | None = None  # run id, step, fracture sequence
        self._answer: list[bytes] = []  # to `_asked`; empty until it arrives

    def __enter__(self) -> OverDds:
        domain_id = free_domain_id()
        parameters = {name: getattr(self._settings, name) for name in OF_SERVICE}
        self._process = NodeProcess("collision_node", parameters, domain_id, self._log)
        try:
            self._context = own_context(domain_id)
            self._node = rclpy.create_node("replay", context=self._context, enable_rosout=False)
            self._executor = SingleThreadedExecutor(context=self._context)
            self._executor.add_node(self._node)
            self._publishers = {
                topic.name: self._node.create_publisher(topic.message_class, topic.name, topic.qos)
                for topic in (qos.BODIES, qos.FRACTURE_EVENTS, qos.FRAGMENT_STATES)
            }
            topic = qos.CONTACT_CONSTRAINTS
            self._node.create_subscription(
                topic.message_class, topic.name, self._on_contacts, qos.recording(topic.qos), raw=True
            )
            self._await_service()
        except BaseException:
            self._process.stop()
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._process.stop()
        self._executor.shutdown()
        self._node.destroy_node()
        self._context.try_shutdown()

    def ask(self, run: Run, question: Question) -> tuple[bytes, float]:
        """The answer, with zeroed padding, and the time from states to contacts [s]. Raises Unanswered."""
        if run is not self._run:
            self._run, self._bodies, self._events = run, 0, 0
        elif question.bodies_before < self._bodies:
            raise Unanswered(
                f"step {question.step}: bodies are added or removed after it, which a running service cannot undo;"
                " play this bag forwards and once, or without --ros"
            )
        self._tell(qos.BODIES, run.bodies[self._bodies : question.bodies_before])
        self._bodies = max(self._bodies, question.bodies_before)
        while self._events < len(run.events):
            event = run.events[self._events]
            if event.received.record.sequence > question.fracture_sequence:
                break
            self._tell(qos.FRACTURE_EVENTS, [event])
            self._events += 1
        return self._ask(run, question)

    def _ask(self, run: Run, question: Question) -> tuple[bytes, float]:
        self._asked, self._answer = (run.run_id, question.step, question.fracture_sequence), []
        deadline, pause = time.monotonic() + PATIENCE, FIRST_PAUSE
        started = time.perf_counter()
        while time.monotonic() < deadline:
            self._publishers[qos.FRAGMENT_STATES.name].publish(question.states)
            if self._spin_until(lambda: bool(self._answer), pause):
                return self._answer[-1], time.perf_counter() - started
            # Recorders keep no order across topics: bodies and events may come after the states that need them.
            self._tell(qos.BODIES, run.bodies[self._bodies : self._bodies + 1])
            self._tell(qos.FRACTURE_EVENTS, run.events[self._events : self._events + 1])
            self._bodies = min(self._bodies + 1, len(run.bodies))
            self._events = min(self._events + 1, len(run.events))
            pause = min(2.0 * pause, LONGEST_PAUSE)
        raise Unanswered(f"step {question.step}: no answer in {PATIENCE:.0f} s; {self._process.log_end()}")

    def _tell(self, topic: qos.Topic, messages: list[Message]) -> None:
        for message in messages:
            self._publishers[topic.name].publish(message.data)

    def _on_contacts(self, data: bytes) -> None:
        received = deserialize_record(data, ContactConstraintArray)
        key = received.run_id, received.record.step, received.record.fracture_sequence
        if key == self._asked:  # else a late answer to a repeated request
            self._answer.append(canonical(received))

    def _await_service(self) -> None:
        """Waits until it subscribes, once its kernels are loaded, which takes minutes if they must be compiled."""
        publishers = self._publishers.values()
        while not self._spin_until(lambda: all(each.get_subscription_count() for each in publishers), PATIENCE):
            pass

    def _spin_until(self, condition: Callable[[], bool], seconds: float) -> bool:
        deadline = time.monotonic() + seconds
        while not condition():
            self._wait()
            if self._process.exit_status() is not None:
                raise Unanswered(self._process.last_words())
            left = deadline - time.monotonic()
            if left <= 0:
                return False
            self._executor.spin_once(timeout_sec=min(left, WAITING_INTERVAL))
        return True
