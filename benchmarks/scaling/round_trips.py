"""ROS overhead of an answer: from states published to contacts received, less the service's computation.

The service is a separate process; states and answers are sent and received as in simulator_node.
"""

from __future__ import annotations

import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from statistics import median
from typing import Any, NamedTuple

import numpy as np
import rclpy
from rclpy.executors import SingleThreadedExecutor

from benchmarks.peers.worlds import World
from benchmarks.scaling.growth import Progress, silent
from benchmarks.scaling.piles import Pile, make_pile
from fracture_collision.cdr import Received
from fracture_collision.records import FragmentStates
from fracture_collision.ros.processes.node_process import NodeProcess, free_domain_id, loopback_environment
from fracture_collision.ros.processes.own_context import own_context
from fracture_collision.ros.processes.timing_files import SERVICE_COLUMNS
from fracture_collision.ros.wire import qos
from fracture_collision.ros.wire.cdr_records import deserialize_record, serialize_record
from fracture_collision.ros.wire.conversion import heading, to_message

FRAGMENTS = 166  # as in drop_bunnies at its end
PRESSED = 0.982  # gives about 900 contacts with this many fragments
RUN_ID = 1
WARM_UP = 20  # steps
PATIENCE = 120.0  # [s]
SOLVER = 0.010  # [s] between an answer and the next states: the duration of a step's solver


class RoundTripRow(NamedTuple):
    """Medians and worst case [ms] over the steps."""

    recorder: bool  # whether a recorder also subscribes to states and contacts
    fragments: int
    contacts: int
    steps: int
    computation: float  # broad and narrow phase, by the service's own clock
    beyond: float  # states published to contacts received, less that and the registry's update
    beyond_worst: float
    beyond_empty: float  # the same for states without fragments, interleaved: the part independent of size
    in_service: float  # part of `beyond`: converting contacts to a message and publishing it
    serialization: float  # states and contacts, each from record to bytes and back, in this process
    answer_bytes: int
    beyond_plain: float  # the same bytes, there and back, between two plain rclpy nodes that do nothing else


def measure_round_trips(
    source: World, fragments: int = FRAGMENTS, steps: int = 300, progress: Progress = silent
) -> list[RoundTripRow]:
    """Without and with a recorder; the pile moves slightly from step to step, so that no two queries are equal."""
    progress(f"a pile of {fragments}")
    pile = make_pile(source, fragments, pressed=PRESSED)
    rows = []
    for recorder in (False, True):
        progress(f"round trips {'with' if recorder else 'without'} a recorder")
        rows.append(_measure(pile, steps, recorder))
    return rows


class _Simulator:
    """Publishes and waits as simulator_node does."""

    def __init__(self, domain_id: int) -> None:
        self._context = own_context(domain_id)
        self._node = rclpy.create_node("simulator_node", context=self._context)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._node)
        self._bodies, self._events = (
            self._node.create_publisher(topic.message_class, topic.name, topic.qos)
            for topic in (qos.BODIES, qos.FRACTURE_EVENTS)
        )
        states = qos.FRAGMENT_STATES
        self._states = self._node.create_publisher(states.message_class, states.name, states.qos)
        topic = qos.CONTACT_CONSTRAINTS
        self._node.create_subscription(topic.message_class, topic.name, self._take, topic.qos, raw=True)
        self.answer: Received | None = None
        self.answer_data = b""

    def close(self) -> None:
        self._executor.shutdown()
        self._node.destroy_node()
        self._context.try_shutdown()

    def _take(self, data: bytes) -> None:
        self.answer = deserialize_record(data, qos.CONTACT_CONSTRAINTS.message_class)
        self.answer_data = data

    def await_subscribers(self, count: int) -> None:
        deadline = time.monotonic() + PATIENCE
        while min(self._states.get_subscription_count(), self._node.count_subscribers("contact_constraints")) < count:
            if time.monotonic() > deadline:
                raise RuntimeError(f"{self._states.get_subscription_count()} of {count} subscribers came")
            self._executor.spin_once(timeout_sec=0.02)

    def tell(self, pile: Pile) -> None:
        for publisher, records in ((self._bodies, pile.bodies), (self._events, pile.events)):
            for record in records:
                publisher.publish(to_message(record, heading(0.0), RUN_ID))

    def ask(self, states: Any) -> float:
        """[s] from publishing the states to their answer."""
        data = serialize_record(states, heading(0.005 * states.step), RUN_ID)
        self.answer = None
        published = time.perf_counter()
        self._states.publish(data)
        deadline = time.monotonic() + PATIENCE
        while self.answer is None or self.answer.record.step != states.step:
            if time.monotonic() > deadline:
                raise RuntimeError(f"no answer to step {states.step}")
            self._executor.spin_once(timeout_sec=1.0)
        return time.perf_counter() - published


def _measure(pile: Pile, steps: int, recorder: bool) -> RoundTripRow:
    with tempfile.TemporaryDirectory() as name, ExitStack() as stack:
        folder, domain_id = Path(name), free_domain_id()
        simulator = _Simulator(domain_id)
        stack.callback(simulator.close)
        times_file = folder / "service.npy"
        service = NodeProcess(
            "collision_node", {"threads": 1, "timing_file": str(times_file)}, domain_id, folder / "service.log"
        )
        stack.callback(service.stop)
        if recorder:
            listener = NodeProcess(
                "recorder_node", {"folder": str(folder / "bag")}, domain_id, folder / "recorder.log"
            )
            stack.callback(listener.stop)
        # the simulator itself subscribes to the contacts
        simulator.await_subscribers(2 if recorder else 1)
        simulator.tell(pile)
        # one extra step, as the service may be stopped before it has recorded the last step's times
        its, contacts, answer = [], None, b""
        for step in _paced(2 * (WARM_UP + steps) + 1):
            its.append(simulator.ask(_moved(pile, step) if step % 2 else _nobody(pile, step)))
            if step % 2:
                contacts, answer = simulator.answer.record, simulator.answer_data
        if service.stop():
            raise RuntimeError(service.log_text())
        round_trip = np.array(its[2 * WARM_UP : -1])
        rows = dict(zip(SERVICE_COLUMNS, np.load(times_file)[2 * WARM_UP : 2 * (WARM_UP + steps)].T, strict=True))
    beyond, empty = np.reshape(round_trip - rows["collision"] - rows["update"], (steps, 2)).T
    computation, conversion = rows["collision"][::2], rows["conversion"][::2]
    question = serialize_record(pile.states, heading(0.0), RUN_ID)
    return RoundTripRow(
        recorder, len(pile.states.fragment_ids), len(contacts.gaps), steps, _ms(computation), _ms(beyond),
        1e3 * float(beyond.max()), _ms(empty), _ms(conversion),
        _serialization(pile.states, qos.FRAGMENT_STATES) + _serialization(contacts, qos.CONTACT_CONSTRAINTS),
        len(answer), _plain(question, answer, float(np.median(computation)), steps),
    )  # fmt: skip


def _plain(question: bytes, answer: bytes, computation: float, steps: int) -> float:
    """Median [ms] from a query published to its answer received, less the time in plain_echo.py."""
    with tempfile.TemporaryDirectory() as name, ExitStack() as stack:
        answer_file, times_file, domain_id = Path(name) / "answer", Path(name) / "times.npy", free_domain_id()
        answer_file.write_bytes(answer)
        module = "benchmarks.scaling.floors.plain_echo"
        command = [sys.executable, "-m", module, answer_file, str(computation), times_file]
        echo = subprocess.Popen(command, env=loopback_environment(domain_id))
        stack.callback(echo.kill)
        context = own_context(domain_id)
        stack.callback(context.try_shutdown)
        node = rclpy.create_node("plain_questioner", context=context)
        stack.callback(node.destroy_node)
        executor = SingleThreadedExecutor(context=context)
        stack.callback(executor.shutdown)
        executor.add_node(node)
        states, contacts = qos.FRAGMENT_STATES, qos.CONTACT_CONSTRAINTS
        publisher = node.create_publisher(states.message_class, states.name, states.qos)
        taken: list[bytes] = []
        node.create_subscription(contacts.message_class, contacts.name, taken.append, contacts.qos, raw=True)
        deadline = time.monotonic() + PATIENCE
        while not (publisher.get_subscription_count() and node.count_publishers(contacts.name)):
            _before(deadline, "plain_echo did not come")
            executor.spin_once(timeout_sec=0.02)
        its = []
        for _ in _paced(WARM_UP + steps):
            taken.clear()
            deadline = time.monotonic() + PATIENCE
            began = time.perf_counter()
            publisher.publish(question)
            while not taken:
                _before(deadline, "plain_echo did not answer")
                executor.spin_once(timeout_sec=1.0)
            its.append(time.perf_counter() - began)
        echo.send_signal(signal.SIGINT)
        echo.wait(PATIENCE)
        return _ms((np.array(its) - np.load(times_file)[: len(its)])[WARM_UP:])


def _before(deadline: float, otherwise: str) -> None:
    if time.monotonic() > deadline:
        raise RuntimeError(otherwise)


def _paced(steps: int) -> Iterator[int]:
    """1, 2 ...: each SOLVER after the previous step is done."""
    for step in range(1, steps + 1):
        time.sleep(SOLVER)
        yield step


def _moved(pile: Pile, step: int) -> FragmentStates:
    return pile.states._replace(step=step, positions=pile.states.positions + 1e-6 * np.sin(0.1 * step))


def _nobody(pile: Pile, step: int) -> FragmentStates:
    return FragmentStates(step, pile.states.fracture_sequence, np.zeros(0, np.uint32), np.zeros(0), np.zeros(0))


def _ms(seconds: np.ndarray) -> float:
    return 1e3 * float(np.median(seconds))


def _serialization(record: Any, topic: qos.Topic) -> float:
    """[ms] to bytes and back."""

    def both() -> None:
        deserialize_record(serialize_record(record, heading(0.0), RUN_ID), topic.message_class)

    both()
    times = []
    for _ in range(50):
        began = time.perf_counter()
        both()
        times.append(time.perf_counter() - began)
    return 1e3 * median(times)
