"""The collision service: bodies, fracture events and states in, contact constraints out.

A callback is: convert (incoming.py), one call (collision_run.py), convert and publish (answers.py). The content of
messages is validated in world.
"""

from __future__ import annotations

import gc
import os
import sys
import time
from collections import deque

import rclpy
from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.clock import Clock, ClockType
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node

from fracture_collision.cdr import Received
from fracture_collision.ros.processes.executor import executor_of, spin
from fracture_collision.ros.processes.parameters import SETTINGS, SettingsParameters, unknown_parameters
from fracture_collision.ros.processes.process import Fatal, age_of, nothing_to_lose, run_node
from fracture_collision.ros.service.answers import TIMING_FILE, Answers
from fracture_collision.ros.service.collision_run import CollisionRun, Refusal
from fracture_collision.ros.service.diagnostics import RefusalCounts, diagnostic_array, settings_status, status
from fracture_collision.ros.service.incoming import Incoming
from fracture_collision.ros.wire import interfaces, qos
from fracture_collision.world import InvalidMessage, Settings
from fracture_collision.world.first_start import cache_is_cold
from fracture_collision.world.settings import values_of
from fracture_collision.world.warm_up import compile_kernels

# [s] After states were held for so long, bodies and events are requested again. They are latched and arrive by
# themselves, but discovery sometimes omits a reader that appeared while others were killed. The last pause repeats.
LOG_PAUSES = (1, 2, 4, 8, 16, 32, 64, 128)
PAST_RUNS = 64  # whose late messages are recognized
NO_BODY_SEQUENCE = (
    "states are answered, but have no body_sequence: answers would lack a static body that has not arrived. Number the"
    " bodies (sequence 1, 2, 3 ...) and set body_sequence to the number of those published before the states"
)


class CollisionNode(Node):
    """Answers each FragmentStates with one ContactConstraintArray of the same step."""

    PARAMETERS = (*SETTINGS, TIMING_FILE)
    INTERFACE = interfaces.COLLISION
    EXAMPLES = (
        "--ros-args -p penetration_tolerance:=0.001 -p contacts_per_pair:=16",
        "--ros-args --params-file config/collision.yaml -r __ns:=/cell",
    )

    def __init__(self) -> None:
        super().__init__(interfaces.COLLISION_NODE)
        try:
            self._changeable = SettingsParameters(self, self._on_new_settings)
        except ValueError as error:
            raise Fatal(str(error)) from error
        self._phase = "starting"
        self._run: CollisionRun | None = None
        self._past_runs: deque[int] = deque(maxlen=PAST_RUNS)  # ids
        self._next_run: CollisionRun | None = None  # of events that arrived before the first body of their run
        self._held: Received | None = None  # the newest states that cannot be answered yet
        self._seconds_held = 0
        self._replaced_states = 0  # held ones that newer ones replaced
        self._refusals = RefusalCounts()
        self._settings_since = "the start"
        self._warning = ""  # for the next message on /diagnostics
        self._without_effect: list[str] = []  # parameters, described

        self._incoming = Incoming(
            self,
            lambda: self._settings.max_message_bytes,
            {
                qos.BODIES.name: self._on_body,
                qos.FRACTURE_EVENTS.name: self._on_fracture,
                qos.FRAGMENT_STATES.name: self._on_states,
            },
            self._note,
            self._on_unreadable,
            self._on_bodies_read,
        )
        self._answers = Answers(self)
        self._diagnostics = self.create_publisher(
            qos.DIAGNOSTICS.message_class, qos.DIAGNOSTICS.name, qos.DIAGNOSTICS.qos
        )
        # Not the node's clock: under use_sim_time it stands still until /clock is published.
        self.create_timer(1.0, self._every_second, clock=Clock(clock_type=ClockType.STEADY_TIME))

    @property
    def _settings(self) -> Settings:
        return self._changeable.current

    # --- start and end ---------------------------------------------------------------------------------------------

    def prepare(self) -> None:
        """Loads the kernels from numba's cache, or compiles them, and logs which; then subscribes.

        A simulator that waits for these subscriptions sends no states in vain.
        """
        self._without_effect = unknown_parameters(self)
        doing = "loading kernels"
        if cache_is_cold():
            doing = "compiling kernels (cold cache: some minutes)"
            gc.enable()

        def progress(text: str) -> None:
            if not rclpy.ok():
                raise ExternalShutdownException
            self._phase = f"{doing}; {text}"
            self.get_logger().info(self._phase)
            self._publish_diagnostics()

        with nothing_to_lose():
            compile_kernels(progress=progress)
        self._incoming.listen()
        self._phase = "ready"
        self.get_logger().info(f"ready, {age_of(os.getpid()):.2f} s after its process was started")
        self._publish_diagnostics()
        gc.freeze()
        gc.enable()

    def finish(self) -> None:
        """Completes the timing file, if requested."""
        self._answers.close()

    # --- messages --------------------------------------------------------------------------------------------------

    def _on_body(self, message: Received) -> None:
        run = self._run
        if run is None or message.run_id != run.run_id:
            if message.record.sequence > 1 and self._is_over(qos.BODIES, message.run_id):
                return
            run = self._start_run(message.run_id)
        self._note(*run.add_body(message.record))
        self._answers.add_body(run, message.record)
        self._go_on(run)

    def _on_bodies_read(self, last: Received) -> None:
        """Prepares a run that has no answers yet, so that its first steps need not wait for that."""
        if self._run is not None and self._run.run_id == last.run_id and not self._run.event_count:
            self._answers.prepare(self._run, last.heading)

    def _on_fracture(self, message: Received) -> None:
        if self._is_over(qos.FRACTURE_EVENTS, message.run_id):
            return
        run = self._run_of_event(message.run_id)
        self._note(*run.add_fracture(message.record))
        self._go_on(run)

    def _on_unreadable(self, topic: qos.Topic, run_id: int, sequence: int, reason: str) -> None:
        if topic is qos.FRACTURE_EVENTS:
            if self._is_over(topic, run_id):
                return
            run = self._run_of_event(run_id)
            run.reject_fracture(sequence, reason)
        elif self._run is not None and run_id == self._run.run_id:
            run = self._run
            run.world.reject_body(sequence, reason)
        else:
            return  # a run begins with a body that can be read
        self._go_on(run)

    def _run_of_event(self, run_id: int) -> CollisionRun:
        if self._run is not None and run_id == self._run.run_id:
            return self._run
        if self._next_run is None or run_id != self._next_run.run_id:
            self._next_run = CollisionRun(run_id, self._settings)
        return self._next_run

    def _go_on(self, run: CollisionRun) -> None:
        """After a new body or event."""
        if run.wants_log():
            self._incoming.ask_for_log()
        self._answer_held()

    def _on_states(self, message: Received) -> None:
        if self._is_over(qos.FRAGMENT_STATES, message.run_id):
            return
        self._replaced_states += self._held is not None
        self._held = message
        self._answer_held()

    def _start_run(self, run_id: int) -> CollisionRun:
        """Discards the last run. Only a body starts a run: late events and states of an earlier run must not."""
        waiting = self._next_run
        if self._run is not None:
            self._past_runs.append(self._run.run_id)
        self._run = run = waiting if waiting and waiting.run_id == run_id else CollisionRun(run_id, self._settings)
        self._next_run = None
        self._answers.forget()
        self.get_logger().info(f"run {run_id} begins", throttle_duration_sec=1.0)
        return run

    def _is_over(self, topic: qos.Topic, run_id: int) -> bool:
        """Whether the run was replaced by another one; then its message is reported as rejected.

        Its simulator may still be there, a second one on the same topics. Its first body would begin it again, as when
        a bag is played in a loop.
        """
        if self._run is None or run_id == self._run.run_id or run_id not in self._past_runs:
            return False
        reason = (
            f"run {run_id} is over: run {self._run.run_id} has begun since. If two simulators publish on these topics,"
            " end one, or start it in another namespace or ROS_DOMAIN_ID"
        )
        self._note(Refusal(topic.name, "other_run", reason))
        return True

    def _note(self, *refusals: Refusal) -> None:
        for refusal in refusals:
            self._refusals.add(refusal)
            self.get_logger().warning(
                f"rejected, {refusal.topic}, {refusal.kind}: {refusal.reason}", throttle_duration_sec=1.0
            )

    def _on_new_settings(self, former: Settings, settings: Settings) -> None:
        for run in (self._run, self._next_run):
            if run is not None:
                run.world.change_settings(settings)
        changes = [
            f"{name}: {getattr(former, name)} -> {value}"
            for name, value in values_of(settings).items()
            if value != getattr(former, name)
        ]
        if any(run is not None and run.rejected_event for run in (self._run, self._next_run)):
            self._incoming.ask_for_log()  # a limit may have been the reason
        self._settings_since = self._answers.last
        self.get_logger().info(f"settings changed after {self._answers.last}: {', '.join(changes)}")
        self._publish_diagnostics()

    # --- answers ---------------------------------------------------------------------------------------------------

    def _answer_held(self) -> None:
        """Answers the newest states if all bodies and events that they need have arrived."""
        if self._held is None or self._run is None or self._held.run_id != self._run.run_id:
            return
        heading, _, states = self._held
        started = time.perf_counter()
        try:
            contacts = self._run.answer(states)
        except InvalidMessage as error:
            self._held = None
            self._note(Refusal(qos.FRAGMENT_STATES.name, error.kind, str(error)))
            self._answers.refuse(self._run, heading, states)
            return
        if contacts is not None:
            self._held = None
            if not states.body_sequence and not self._run.lacks_body_sequence:
                self._run.lacks_body_sequence = True
                self._warning = NO_BODY_SEQUENCE
                self.get_logger().warning(NO_BODY_SEQUENCE)
            self._answers.publish(self._run, heading, states, contacts, time.perf_counter() - started)

    # --- diagnostics -----------------------------------------------------------------------------------------------

    def _every_second(self) -> None:
        self._seconds_held = self._seconds_held + 1 if self._held is not None else 0
        if self._held is not None and is_time_for_log(self._seconds_held):
            self.get_logger().warning(f"{self._said_of(self._held)}; requesting bodies and events again")
            self._incoming.ask_for_log()
        self._incoming.look()
        self._publish_diagnostics()

    def _said_of(self, held: Received) -> str:
        """Describes what held states wait for."""
        _, run_id, states = held
        if self._run is None or self._run.run_id != run_id:
            reason = "no body of this run has arrived"
        else:
            reason = self._run.what_states_wait_for()
        return f"states of run {run_id}, step {states.step}, are held: {reason}"

    def _publish_diagnostics(self) -> None:
        run, incoming = self._run, self._incoming
        values = {
            "phase": self._phase,
            "states dropped for newer ones": incoming.dropped_states + self._replaced_states,
            "events held": sum(one.held_event_count for one in (run, self._next_run) if one is not None),
        }
        if run is not None:
            values |= {
                "run_id": run.run_id,
                "bodies": len(run.body_ids),
                "fracture_sequence": run.event_count,
                "states name the bodies before them": not run.lacks_body_sequence,
            }
        message = self._phase
        rejected = run.rejected_event if run is not None else ""
        if rejected:
            message = rejected
        if self._held is not None:
            message = self._said_of(self._held)
        message = self._warning or message
        is_fine = self._held is None and not rejected and not self._warning
        level = DiagnosticStatus.OK if is_fine else DiagnosticStatus.WARN
        self._warning = ""
        self._diagnostics.publish(
            diagnostic_array(
                self,
                status("answers", level, message, values | self._answers.times.values()),
                self._refusals.status(),
                settings_status(self._settings, self._settings_since, self._without_effect),
            )
        )


def is_time_for_log(seconds_held: int) -> bool:
    """Whether bodies and events are requested again after states were held for so long."""
    return seconds_held in LOG_PAUSES or (seconds_held > LOG_PAUSES[-1] and seconds_held % LOG_PAUSES[-1] == 0)


def _work(node: CollisionNode) -> None:
    # One thread: contacts depend on the order in which bodies, events and states are applied, and on nothing else.
    # Created before the node reports that it is ready: after a shutdown none can be created.
    executor = executor_of(node)
    try:
        node.prepare()
        spin(executor, node)
    finally:
        node.finish()
        executor.shutdown()


def main() -> int:
    """Runs the node with the process's arguments; returns its exit status."""
    gc.disable()  # until it is ready: of half a million objects that numba creates almost none are garbage
    return run_node(CollisionNode, _work)


if __name__ == "__main__":
    sys.exit(main())
