"""The simulator: runs one scene in lock-step with the collision service, through topics only."""

from __future__ import annotations

import gc
import json
import secrets
import sys
import time
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from rcl_interfaces.srv import SetParameters
from rclpy.duration import Duration
from rclpy.executors import Executor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.publisher import Publisher
from rclpy.task import Future

from fracture_collision.extras import MissingExtra
from fracture_collision.records import INVALID_STATES, ContactConstraintArray, FragmentRegistry, FragmentStates
from fracture_collision.ros.nodes.repeated_request import RepeatedRequest
from fracture_collision.ros.processes.executor import executor_of
from fracture_collision.ros.processes.parameters import Declaration, Range, declare_all
from fracture_collision.ros.processes.process import Fatal, nothing_to_lose, run_node
from fracture_collision.ros.processes.timing_files import SIMULATOR_COLUMNS
from fracture_collision.ros.wire import interfaces, qos
from fracture_collision.ros.wire.cdr_records import deserialize_record, serialize_record
from fracture_collision.ros.wire.conversion import header_of, heading, to_message, to_record
from fracture_collision.ros.wire.interfaces import COLLISION_NODE, Interface
from fracture_collision.simulation.engines import with_engine
from fracture_collision.simulation.scene.scene import Scene, SceneError, load_scene
from fracture_collision.simulation.simulation import Simulation, StepReport
from fracture_collision.simulation.warm_up import compile_kernels
from fracture_collision.world.settings import EXACT, GLONDU2014

# Repeated requests: the first pause covers a service that compiles a kernel, the last one a service started by hand.
# After a new subscriber or publisher the pause is short at first: one of the two directions may not be matched yet.
FIRST_PAUSE = 1.0  # [s]
PAUSE_GROWTH = 1.5
LONGEST_PAUSE = 15.0  # [s]
PAUSE_FOR_NEWCOMERS = 0.05  # [s]
PARAMETER_PATIENCE = 5.0  # [s] for a service that is there to take its lookahead
LOOK_INTERVAL = 0.02  # [s] between two checks for new subscribers and publishers

# [s] Two announcements of each participant on this machine (config/this_machine.xml).
DISCOVERY = 1.0
LAST_STATES = Duration(seconds=1)  # for all subscribers to acknowledge them before their publisher goes

PROGRESS_INTERVAL = 0.1  # [s]

PARAMETERS = (
    Declaration("scene", "plates", "name in config/scenes, or the path of a scene file"),
    Declaration("seed", -1, "seed of the fracture patterns; -1: the scene's own", Range(-1, 2**62)),
    Declaration("engine", "", "what solves contacts and moves bodies: own or mujoco; '': the scene's"),
    Declaration("run_id", 0, "run_id of all messages; 0: drawn at random", Range(0, 2**62)),
    Declaration("looks_ahead", True, "set the service's `lookahead` to the scene's time step, and count on it"),
    Declaration(
        "wait_for_subscribers", 1, "subscribers of states, and of contacts, before the first step", Range(0, 100)
    ),
    Declaration("publish_clock", True, "whether simulation time is published on /clock; one node of a system may"),
    Declaration("timing_file", "", ".npy file for the times of each step, written at the end; '': none"),
    Declaration("progress", False, "print one line of JSON to stdout, ten times a second"),
)


class SimulatorNode(Node):
    """Simulates one scene, as fast as the service answers, and ends. Also the base of live_simulator_node."""

    PARAMETERS: ClassVar[tuple[Declaration, ...]] = PARAMETERS
    INTERFACE: ClassVar[Interface] = interfaces.SIMULATOR
    EXAMPLES: ClassVar[tuple[str, ...]] = (
        "--ros-args -p scene:=wall -p seed:=7",
        "--ros-args -p scene:=/home/me/my_scene.yaml -p publish_clock:=false -r __ns:=/cell",
    )

    def __init__(self, name: str = interfaces.SIMULATOR_NODE) -> None:
        super().__init__(name)
        given = declare_all(self, PARAMETERS)
        scene_name, seed, run_id = given["scene"], given["seed"], given["run_id"]
        self._looks_ahead, self._subscribers = given["looks_ahead"], given["wait_for_subscribers"]
        self._timing_file, self._tells_progress = given["timing_file"], given["progress"]

        self._engine = given["engine"]
        try:
            scene = self._load(scene_name)
        except (SceneError, MissingExtra, OSError) as error:
            raise Fatal(str(error)) from error
        self._simulation = self._make_simulation(scene, scene.seed if seed < 0 else seed)
        self._total_steps = scene.step_count
        self._run_id = run_id or random_run_id()

        self._bodies, self._events = self._open_log()
        topic = qos.FRAGMENT_STATES
        self._states = self.create_publisher(topic.message_class, topic.name, topic.qos)
        self._began = time.monotonic()
        self._time_publisher = (
            self.create_publisher(qos.CLOCK.message_class, qos.CLOCK.name, qos.CLOCK.qos)
            if given["publish_clock"]
            else None
        )
        self._service = self.create_client(SetParameters, f"{COLLISION_NODE}/set_parameters")
        self._lookahead = RepeatedRequest(self._service.service_is_ready)
        self._contacts_topic = self.resolve_topic_name(qos.CONTACT_CONSTRAINTS.name)  # it may be remapped
        for topic, callback, profile, raw in (
            (qos.CONTACT_CONSTRAINTS, self._on_contacts, qos.EACH_STEP, True),  # none of before
            (qos.FRAGMENTS, self._on_registry, qos.FRAGMENTS.qos, False),
        ):
            self.create_subscription(topic.message_class, topic.name, callback, profile, raw=raw)
        self._asked = (0, 0)
        self._contacts: ContactConstraintArray | None = None
        self._registry: FragmentRegistry | None = None
        self._known_settings = ""  # of the service, as its last registry has them
        self._rows: list[tuple[float, ...]] = []
        self._progress_due = 0.0

    # --- the run ---------------------------------------------------------------------------------------------------

    def run(self, executor: Executor) -> None:
        """Simulates the scene to its end. Raises Fatal if the service rejects the states."""
        self._await_subscribers(executor)
        self._announce(self._simulation.start_bodies(), [])
        # The service prepares the bodies that it has before it answers this request: the first step does not wait.
        self._set_lookahead(executor)
        while not self._simulation.finished:
            began = time.perf_counter()
            report, round_trip = self._step(executor)
            total = time.perf_counter() - began
            self._rows.append(
                (
                    report.step, report.time, report.contacts, report.fragments, total, round_trip,
                    report.solver_seconds, report.fracture_seconds, report.kinetic_energy, report.potential_energy,
                    report.drift_energy, report.max_speed, report.deepest_gap,
                )
            )  # fmt: skip
            self._tell_progress()
        self._states.wait_for_all_acked(LAST_STATES)

    def finish(self) -> None:
        """Writes the timing file, if requested; frees the physics engine."""
        if self._timing_file:
            np.save(Path(self._timing_file), np.array(self._rows).reshape(-1, len(SIMULATOR_COLUMNS)))
        self._simulation.close()

    def _load(self, name: str) -> Scene:
        return with_engine(load_scene(name), self._engine)

    def _make_simulation(self, scene: Scene, seed: int) -> Simulation:
        return Simulation(scene, seed, looks_ahead=self._looks_ahead)

    def _open_log(self) -> tuple[Publisher, Publisher]:
        """Publishers of bodies and events, from which late joiners receive a run from its start."""
        bodies, events = (
            self.create_publisher(topic.message_class, topic.name, topic.qos)
            for topic in (qos.BODIES, qos.FRACTURE_EVENTS)
        )
        return bodies, events

    def _step(self, executor: Executor) -> tuple[StepReport, float]:
        """Makes one step; returns its report and the time of `_ask`."""
        self._publish_time()
        request = self._simulation.begin_step()
        self._announce(request.bodies, request.events)
        contacts, registry, round_trip = self._ask(request.states, executor)
        self._tell_unexpected(contacts, registry)
        return self._simulation.finish_step(contacts, registry), round_trip

    def _publish_time(self) -> None:
        """Publishes the time that the next messages are stamped with."""
        if self._time_publisher is not None:
            stamp = header_of(heading(self._simulation.time)).stamp
            self._time_publisher.publish(qos.CLOCK.message_class(clock=stamp))

    def _await_subscribers(self, executor: Executor) -> None:
        """Waits for `wait_for_subscribers`, and until this node has been up for DISCOVERY.

        A recorder that was there before must not miss the first steps, and enough others may be discovered before it.
        """
        if self._subscribers == 0:
            return
        started, said = time.monotonic(), 0.0
        while time.monotonic() < self._began + DISCOVERY or min(self._present_subscribers()) < self._subscribers:
            executor.spin_once(timeout_sec=0.02)
            if time.monotonic() - started > said + 5.0:
                said += 5.0
                self.get_logger().info("waiting for the collision service (and recorders) to subscribe")

    def _present_subscribers(self) -> tuple[int, int]:
        """The number of subscribers to states, and to contacts."""
        return self._states.get_subscription_count(), self.count_subscribers(self._contacts_topic)

    def _set_lookahead(self, executor: Executor) -> None:
        """Sets the service's lookahead to the time step, before states that count on it."""
        if not self._looks_ahead or not self._states.get_subscription_count():
            return
        lookahead = Parameter("lookahead", value=self._simulation.time_step).to_parameter_msg()
        wanted = SetParameters.Request(parameters=[lookahead])
        answers: list[Future] = []
        self._lookahead.begin(lambda: self._service.call_async(wanted), answers.append)
        deadline = time.monotonic() + PARAMETER_PATIENCE
        while not answers and time.monotonic() < deadline:
            executor.spin_once(timeout_sec=LOOK_INTERVAL)
            self._lookahead.look()
        if not answers or not all(result.successful for result in answers[0].result().results):
            self.get_logger().warning(
                f"{COLLISION_NODE} does not take the parameter lookahead:={self._simulation.time_step:g}; set it there,"
                " or start this node with looks_ahead:=false"
            )

    def _announce(self, bodies: list, events: list) -> None:
        stamp = heading(self._simulation.time)
        for body in bodies:
            self._bodies.publish(to_message(body, stamp, self._run_id))
        for event in events:
            self._events.publish(to_message(event, stamp, self._run_id))

    def _ask(
        self, states: FragmentStates, executor: Executor
    ) -> tuple[ContactConstraintArray, FragmentRegistry, float]:
        """Publishes states until their contacts and registry have arrived.

        Returns both, and the time from publishing the states to their answer [s].
        """
        data = serialize_record(states, heading(self._simulation.time), self._run_id)
        self._asked = (states.step, states.fracture_sequence)
        self._contacts = None
        published = time.perf_counter()
        self._states.publish(data)
        pause, there, has_waited = FIRST_PAUSE, None, False
        deadline = time.monotonic() + pause
        while True:
            executor.spin_once(timeout_sec=LOOK_INTERVAL)
            if (answer := self._answer_to(states)) is not None:
                round_trip = time.perf_counter() - published
                if has_waited:
                    self.get_logger().info(f"step {states.step} is answered after {round_trip:.2f} s; continuing")
                return *answer, round_trip
            before, there = there, self._present()
            if before is not None and (there[0] > before[0] or there[1] > before[1]):
                self.get_logger().info(f"new subscriber or publisher; publishing step {states.step} again")
                self._set_lookahead(executor)
                pause = PAUSE_FOR_NEWCOMERS
            elif time.monotonic() < deadline:
                continue
            else:
                self.get_logger().warning(f"no answer to step {states.step} yet; publishing it again")
                pause = min(pause * PAUSE_GROWTH, LONGEST_PAUSE)
            has_waited = True
            self._states.publish(data)
            deadline = time.monotonic() + pause

    def _present(self) -> tuple[int, int]:
        """The number of subscribers to states, and of publishers of contacts."""
        return self._states.get_subscription_count(), self.count_publishers(self._contacts_topic)

    def _answer_to(self, states: FragmentStates) -> tuple[ContactConstraintArray, FragmentRegistry] | None:
        """The contacts, and the registry with all fragments of `states`; None until both have arrived."""
        contacts, registry = self._contacts, self._registry
        if contacts is None or registry is None or registry.fracture_sequence != states.fracture_sequence:
            return None
        return (contacts, registry) if np.isin(states.fragment_ids, registry.fragment_ids).all() else None

    # --- answers ---------------------------------------------------------------------------------------------------

    def _on_contacts(self, data: bytes) -> None:
        try:
            _, run_id, contacts = deserialize_record(data, qos.CONTACT_CONSTRAINTS.message_class)
        except ValueError as error:
            self.get_logger().warning(f"{qos.CONTACT_CONSTRAINTS.name}: {error}", throttle_duration_sec=1.0)
            return
        if run_id != self._run_id or (contacts.step, contacts.fracture_sequence) != self._asked:
            return  # a late answer to a repeated request
        if contacts.status & INVALID_STATES:
            raise Fatal(f"the service rejected the states of step {contacts.step}; see /diagnostics for the reason")
        self._contacts = contacts

    def _on_registry(self, message: Any) -> None:
        if message.run_id == self._run_id:
            self._registry = to_record(message)

    def _tell_unexpected(self, contacts: ContactConstraintArray, registry: FragmentRegistry) -> None:
        """Logs, once per change, which settings of the service are not those that this simulator expects."""
        if words := self._simulation.unexpected(contacts):
            self.get_logger().warning(words)
        if registry.settings == self._known_settings:
            return
        self._known_settings = registry.settings
        if _method_of(registry.settings) == GLONDU2014:
            self.get_logger().warning(
                f"the service has method:={GLONDU2014}, but this simulator expects {EXACT}: contacts are at samples"
                " alone, so bodies whose edges cross may pass through each other, and so may fast ones"
            )

    def _tell_progress(self) -> None:
        if not self._tells_progress:
            return
        now = time.monotonic()
        if now >= self._progress_due or self._simulation.finished:
            self._progress_due = now + PROGRESS_INTERVAL
            step, seconds, contacts, fragments = self._rows[-1][:4]
            told = {"step": step + 1, "steps": self._total_steps, "time": seconds, "contacts": contacts}
            print(json.dumps(told | {"fragments": fragments}), flush=True)


def _method_of(settings: str) -> str:
    """`method` among the settings of a registry; the one expected if it does not say."""
    try:
        return str(json.loads(settings)["method"])
    except (ValueError, LookupError, TypeError):  # another service than ours
        return EXACT


def random_run_id() -> int:
    """Of 62 bits, not 0."""
    return secrets.randbelow(2**62 - 1) + 1


def work(node: SimulatorNode) -> None:
    """Runs the node to its end, or until it is shut down."""
    executor = executor_of(node)
    try:
        # otherwise the first timed step would load them
        with nothing_to_lose():
            compile_kernels(lambda what: node.get_logger().info(f"loading kernels; {what}"))
        gc.freeze()  # garbage collection over all that was loaded takes 80 ms, in the middle of a run
        node.run(executor)
    finally:
        node.finish()
        executor.shutdown()


def main() -> int:
    """Runs the node with the process's arguments; returns its exit status."""
    return run_node(SimulatorNode, work)


if __name__ == "__main__":
    sys.exit(main())
