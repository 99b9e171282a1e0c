"""The collision service: bodies, fracture events and states in, contact constraints out.

A callback is: convert, one call, convert, publish. The order of messages across topics is collision_run's business,
what they may say is world's.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node

from fracture_collision.records import INVALID_STATES, ContactConstraintArray, FragmentStates
from fracture_collision.ros import qos
from fracture_collision.ros.acknowledged_publisher import AcknowledgedPublisher
from fracture_collision.ros.cdr_records import Received, deserialize_record, serialize_record
from fracture_collision.ros.collision_run import CollisionRun, Refusal
from fracture_collision.ros.conversion import Heading, array_bytes, to_message, to_record
from fracture_collision.ros.diagnostics import AnswerTimes, RefusalCounts, diagnostic_array
from fracture_collision.ros.parameters import declare_fixed, declare_settings
from fracture_collision.ros.process import nothing_to_lose, run_node
from fracture_collision.ros.prompt_executor import PromptExecutor
from fracture_collision.ros.timing_files import SERVICE_COLUMNS
from fracture_collision.world import InvalidMessage
from fracture_collision.world.warm_up import cache_is_cold, compile_kernels


class CollisionNode(Node):
    """Parameters: those of world.Settings, and `timing_file`. Topics: ros/qos.py."""

    def __init__(self) -> None:
        super().__init__("collision_node")
        self._settings = declare_settings(self)
        self._timing_file = declare_fixed(self, "timing_file", "", "times of each answer are written there at the end")
        self._phase = "starting"
        self._run: CollisionRun | None = None
        self._next_run: CollisionRun | None = None  # of events that came before the first body of their run
        self._held: Received | None = None  # the newest states that cannot be answered yet
        self._registry_version: tuple[int, int, int, int] | None = None
        self._meshes_published: set[int] = set()
        self._refusals = RefusalCounts()
        self._times = AnswerTimes()
        self._timing_rows: list[tuple[float, ...]] = []

        self._contacts = AcknowledgedPublisher(self, qos.CONTACT_CONSTRAINTS)
        self._fragments = AcknowledgedPublisher(self, qos.FRAGMENTS)
        self._meshes = AcknowledgedPublisher(self, qos.FRAGMENT_MESHES)
        self._diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics", 10)
        self.create_timer(1.0, self._publish_diagnostics)

    # --- start and end ---------------------------------------------------------------------------------------------

    def prepare(self) -> None:
        """Loads the kernels from numba's cache, or compiles them, and says which; then listens. Who waits for the
        service to subscribe need not ask in vain.
        """
        started = time.perf_counter()
        doing = "compiling kernels (cold cache, one to two minutes)" if cache_is_cold() else "loading kernels"

        def progress(text: str) -> None:
            if not rclpy.ok():
                raise ExternalShutdownException
            self._phase = f"{doing}; {text}"
            self.get_logger().info(self._phase)
            self._publish_diagnostics()

        with nothing_to_lose():
            compile_kernels(progress=progress)
        for topic, callback, raw in (
            (qos.BODIES, self._on_body, False),
            (qos.FRACTURE_EVENTS, self._on_fracture, False),
            (qos.FRAGMENT_STATES, self._on_states, True),
        ):
            self.create_subscription(topic.message_class, topic.name, callback, topic.qos, raw=raw)
        self._phase = "ready"
        self.get_logger().info(f"ready, {time.perf_counter() - started:.1f} s after its start")
        self._publish_diagnostics()

    def finish(self) -> None:
        """Writes what was asked for."""
        if self._timing_file:
            rows = np.array(self._timing_rows, dtype=np.float64).reshape(-1, len(SERVICE_COLUMNS))
            np.save(Path(self._timing_file), rows)

    # --- messages --------------------------------------------------------------------------------------------------

    def _on_body(self, message: qos.BODIES.message_class) -> None:
        if not self._size_allowed(qos.BODIES, array_bytes(message)):
            return
        if self._run is None or message.run_id != self._run.run_id:
            self._start_run(message.run_id)
        self._note(self._run.add_body(to_record(message)))
        self._answer_held()

    def _on_fracture(self, message: qos.FRACTURE_EVENTS.message_class) -> None:
        if not self._size_allowed(qos.FRACTURE_EVENTS, array_bytes(message)):
            return
        run = self._run
        if run is None or message.run_id != run.run_id:
            if self._next_run is None or message.run_id != self._next_run.run_id:
                self._next_run = CollisionRun(message.run_id, self._settings)
            run = self._next_run
        self._note(run.add_fracture(to_record(message)))
        self._answer_held()

    def _on_states(self, data: bytes) -> None:
        if not self._size_allowed(qos.FRAGMENT_STATES, len(data)):
            return
        try:
            self._held = deserialize_record(data, qos.FRAGMENT_STATES.message_class)
        except ValueError as error:
            self._note([Refusal(qos.FRAGMENT_STATES.name, "malformed", str(error))])
            return
        self._answer_held()

    def _start_run(self, run_id: int) -> None:
        """Forgets the last run. Only a body starts a run: events and states that outlived theirs must not."""
        waiting = self._next_run
        self._run = waiting if waiting and waiting.run_id == run_id else CollisionRun(run_id, self._settings)
        self._next_run = None
        self._registry_version = None
        self._meshes_published.clear()
        self.get_logger().info(f"run {run_id} begins")

    def _size_allowed(self, topic: qos.Topic, size: int) -> bool:
        limit = self._settings.max_message_bytes
        if size > limit:
            reason = f"{size} bytes, more than the parameter max_message_bytes, {limit}"
            self._note([Refusal(topic.name, "limit_exceeded", reason)])
        return size <= limit

    def _note(self, refusals: list[Refusal]) -> None:
        for refusal in refusals:
            self._refusals.add(refusal)
            self.get_logger().warning(
                f"refused, {refusal.topic}, {refusal.kind}: {refusal.reason}", throttle_duration_sec=1.0
            )

    # --- answers ---------------------------------------------------------------------------------------------------

    def _answer_held(self) -> None:
        """Answers the newest states if all they speak of is there."""
        if self._held is None or self._run is None or self._held.run_id != self._run.run_id:
            return
        heading, run_id, states = self._held
        started = time.perf_counter()
        try:
            contacts = self._run.answer(states)
        except InvalidMessage as error:
            self._held = None
            self._note([Refusal(qos.FRAGMENT_STATES.name, error.kind, str(error))])
            self._contacts.publish(serialize_record(_refusal_of(states), heading, run_id))
            return
        if contacts is None:
            return
        self._held = None
        answered = time.perf_counter()
        self._publish_registry(heading, states.fracture_sequence)
        self._contacts.publish(serialize_record(contacts, heading, run_id))
        self._record_times(states, answered - started, time.perf_counter() - answered)
        self._publish_meshes(heading)

    def _publish_registry(self, heading: Heading, fracture_sequence: int) -> None:
        run = self._run
        version = (run.run_id, fracture_sequence, len(run.body_ids), run.removals)
        if version != self._registry_version:
            self._registry_version = version
            self._fragments.publish(to_message(run.world.fragments(), heading, run.run_id))

    def _publish_meshes(self, heading: Heading) -> None:
        """Of fragments that have none on the topic yet, while somebody looks."""
        if self._meshes.subscriber_count == 0:
            return
        for fragment_id in self._run.world.fragments().fragment_ids.tolist():
            if fragment_id not in self._meshes_published:
                self._meshes_published.add(fragment_id)
                mesh = self._run.world.fragment_mesh(fragment_id)
                self._meshes.publish(to_message(mesh, heading, self._run.run_id))

    # --- what it says of itself ------------------------------------------------------------------------------------

    def _record_times(self, states: FragmentStates, answer: float, conversion: float) -> None:
        parts = dict(self._run.world.last_timings)
        self._times.add({"answer": answer, **parts, "conversion and publishing": conversion})
        if self._timing_file:
            collision = parts["broad_phase"] + parts["narrow_phase"]
            visits = self._run.world.last_visits
            row = (states.step, states.fracture_sequence, collision, parts["update"], conversion, visits)
            self._timing_rows.append(tuple(map(float, row)))

    def _publish_diagnostics(self) -> None:
        run = self._run
        values = [KeyValue(key="phase", value=self._phase)]
        if run is not None:
            values += [
                KeyValue(key="run_id", value=str(run.run_id)),
                KeyValue(key="bodies", value=str(len(run.body_ids))),
                KeyValue(key="fracture_sequence", value=str(run.event_count)),
                KeyValue(key="events held for their body", value=str(run.held_event_count)),
            ]
        message = self._phase
        if self._held is not None:
            _, run_id, states = self._held
            message = (
                f"states of run {run_id}, step {states.step}, are held: their bodies, or the events up to"
                f" {states.fracture_sequence}, have not all arrived"
            )
        self._diagnostics.publish(
            diagnostic_array(
                self.get_clock().now().to_msg(),
                DiagnosticStatus(
                    level=DiagnosticStatus.WARN if self._held is not None else DiagnosticStatus.OK,
                    name="fracture_collision: answers",
                    message=message,
                    values=values + self._times.values(),
                ),
                self._refusals.status(),
            )
        )


def _refusal_of(states: FragmentStates) -> ContactConstraintArray:
    """The answer to states that break a rule: no contacts, and the status says why."""
    floats, ids = np.zeros(0), np.zeros(0, dtype=np.uint32)
    return ContactConstraintArray(
        step=states.step, fracture_sequence=states.fracture_sequence, status=INVALID_STATES,
        fragment_a=ids, fragment_b=ids, pair_begin=np.zeros(1, dtype=np.uint32), missed_depth_bound=floats,
        friction=floats, restitution=floats, points_a=floats, points_b=floats, normals=floats, gaps=floats,
        contact_ids=np.zeros(0, dtype=np.uint64),
    )  # fmt: skip


def _work(node: CollisionNode) -> None:
    # One thread: contacts depend on the order in which bodies, events and states are applied, and on nothing else.
    # Made before the node says that it is ready: once told to end, none can be made.
    executor = PromptExecutor()
    executor.add_node(node)
    try:
        node.prepare()
        executor.spin()
    finally:
        node.finish()
        executor.shutdown()


def main() -> int:
    return run_node(CollisionNode, _work)


if __name__ == "__main__":
    sys.exit(main())
