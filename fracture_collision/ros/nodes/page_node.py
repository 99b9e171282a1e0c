"""The page of a live scene: shows the nodes' messages in browsers, and sends the user's commands to the nodes.

All data comes from topics, so the page may run wherever a viewer may, and may start and end while the scene runs. It
subscribes to states and contacts best-effort, so no publisher waits for it.
"""

from __future__ import annotations

import gc
import json
import sys
import time
from contextlib import suppress
from pathlib import Path
from typing import Any

from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import JointState
from std_msgs.msg import String

from fracture_collision.cdr import Received
from fracture_collision.msg import AnswerTimes, SimulationStatus
from fracture_collision.records import REMOVE
from fracture_collision.ros.nodes.page_commands import PageCommands
from fracture_collision.ros.nodes.page_mirror import Mirror
from fracture_collision.ros.nodes.settings_watcher import ServiceSettings
from fracture_collision.ros.processes.parameters import Declaration, Range, declare_all
from fracture_collision.ros.processes.process import Fatal, nothing_to_lose, run_node
from fracture_collision.ros.wire import interfaces, qos
from fracture_collision.ros.wire.cdr_records import deserialize_record
from fracture_collision.ros.wire.conversion import to_record
from fracture_collision.simulation.actors.robot import BODY_PREFIX, SLIDING, parse_urdf
from fracture_collision.simulation.scene.scene import scene_files
from fracture_collision.uploaded_scene import SUFFIXES
from fracture_collision.viewer.page.page import Page
from fracture_collision.viewer.page.page_events import Joint, ServiceSliders, SettingKnob, Start
from fracture_collision.viewer.page.page_plots import Figures
from fracture_collision.viewer.pictures.body_mesh import compile_mesh_kernels
from fracture_collision.world.settings import CHOICES, RANGES, meaning

LOOKING = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
TOLD = frozenset({"collision_ms", "update_ms", "solver_ms", "ros_ms", "contacts", "fragments"})
# [s] Messages, pictures and browsers have a thread each: with Python's default of 5 ms, a thread with a short task
# waits too long for one with a long task.
SWITCH_INTERVAL = 0.5e-3
LOOK_INTERVAL = 0.2  # [s] between two checks for the service and its settings, and of the pace
LONG_STEP = 1.0  # [s] without a status: the simulator is within a step

# The page's controls of settings, with the meanings and ranges that the service's parameters have.
KNOBS = {
    name: SettingKnob(meaning(name), *RANGES.get(name, (0.0, 0.0)), CHOICES.get(name, ()))
    for name in ServiceSliders._fields
}


class PageNode(Node):
    """Prints the page's address as a line of JSON.

    Everything comes from topics, so the page may start and end while a scene runs.
    """

    PARAMETERS = (
        Declaration("host", "127.0.0.1", "address of the page; 0.0.0.0: open to the network"),
        Declaration("port", 0, "port of the page; 0: any free one", Range(0, 65535)),
        Declaration("scene", "plates", "scene that runs when the page starts"),
        Declaration("folder", "out/play", "folder of recordings and of uploads"),
    )
    INTERFACE = interfaces.PAGE
    EXAMPLES = ("--ros-args -p port:=8080", "--ros-args -p scene:=vase -r __ns:=/cell")

    def __init__(self) -> None:
        super().__init__("page_node")
        host, port, scene, folder = declare_all(self, self.PARAMETERS).values()
        self._mirror = Mirror(lambda view: self.page.show_inside(view))
        self._commands = PageCommands(
            self, Path(folder), self._mirror.want, lambda words: self.page.notify(words),
            lambda name: self.page.add_scene(name),
        )  # fmt: skip

        self._run_id = 0
        self._body_of: dict[int, int] = {}  # of each fragment
        self._meshes: dict[int, Any] = {}  # that arrived before the body of their fragment was known
        self._early: Received | None = None  # states that arrived before the first body of their run
        self._status: SimulationStatus | None = None
        self._times: AnswerTimes | None = None  # not shown yet
        self._status_at = 0.0  # time.monotonic() of its arrival
        self._awaits_joints = False  # of a robot that was added
        self._robot: tuple[Joint, ...] = ()  # those with a motor, of the last robot_description
        self._joints: JointState | None = None  # the last one
        self._refused = ""  # the last rejection that the simulator reported

        scenes = tuple(dict.fromkeys((scene, *(file.path.stem for file in scene_files()))))
        try:
            start = Start(scenes=scenes, scene=scene, mesh_suffixes=SUFFIXES, settings=KNOBS)
            self.page = Page(self._commands.handlers(), start, host, port, TOLD)
        except OSError as error:
            raise Fatal(f"the page cannot be served at {host}:{port}: {error}") from error
        print(json.dumps({"address": self.page.address}), flush=True)
        self._listen()
        self._settings = ServiceSettings(self, qos.CONTACT_CONSTRAINTS.name, self._on_settings)
        self.create_timer(LOOK_INTERVAL, self._look)

    def close(self) -> None:
        """Ends the mirror, the page and a recording."""
        self._mirror.close()
        self.page.close()
        self._commands.close()

    def _look(self) -> None:
        self._settings.look()
        self._commands.look()
        self._show_joints()
        if (status := self._status) is not None:
            in_step = time.monotonic() - self._status_at > LONG_STEP
            if in_step:
                self.page.show_rate(0.0, status.rate, status.paused)
            else:
                step_ms = 1e3 * status.time_step_s / max(status.rate, 1e-9)
                self.page.show_rate(status.achieved_rate, status.rate, status.paused, step_ms)

    def _listen(self) -> None:
        for topic, callback, profile, raw in (
            (qos.BODIES, self._on_body, qos.BODIES.qos, False),
            (qos.FRACTURE_EVENTS, self._on_fracture, qos.FRACTURE_EVENTS.qos, False),
            (qos.FRAGMENTS, self._on_registry, qos.FRAGMENTS.qos, False),
            (qos.FRAGMENT_MESHES, self._on_mesh, qos.FRAGMENT_MESHES.qos, True),
            (qos.FRAGMENT_STATES, self._on_states, LOOKING, True),
            (qos.CONTACT_CONSTRAINTS, self._on_contacts, LOOKING, True),
            (interfaces.LIVE_STATUS, self._on_status, LOOKING, False),
            (qos.ANSWER_TIMES, self._on_times, LOOKING, False),
            (qos.JOINT_STATES, self._on_joints, LOOKING, False),
            (qos.ROBOT_DESCRIPTION, self._on_robot, qos.ROBOT_DESCRIPTION.qos, False),
        ):
            self.create_subscription(topic.message_class, topic.name, callback, profile, raw=raw)

    # --- messages of the nodes -------------------------------------------------------------------------------------

    def _of_this_run(self, run_id: int) -> bool:
        """Only a body begins a run."""
        return run_id == self._run_id

    def _on_body(self, message: Any) -> None:
        if not self._of_this_run(message.run_id):
            self._run_id = message.run_id
            self._body_of.clear()
            self._meshes.clear()
            self._commands.new_run(message.run_id)
            self._mirror.new_run(message.run_id)
            self._awaits_joints, self._joints = False, None
            self.page.new_run()
            if self._early is not None and self._of_this_run(self._early.run_id):
                self._show(self._early)
            self._early = None
        body = to_record(message)
        self._mirror.hear(body)
        if body.operation == REMOVE:
            self.page.remove_body(body.body_id)
            return
        self._awaits_joints |= body.name.startswith(BODY_PREFIX)
        self._body_of[body.fragment_id] = body.body_id
        self.page.add_body(body)

    def _on_fracture(self, message: Any) -> None:
        if not self._of_this_run(message.run_id):
            return
        self._mirror.hear(message)
        for fragment_id in message.new_fragment_ids:
            self._body_of[fragment_id] = message.body_id
        self._add_waiting()

    def _on_registry(self, message: Any) -> None:
        """Living fragments, for a page that joins a run late."""
        if self._of_this_run(message.run_id):
            self._body_of.update(zip(message.fragment_ids, message.body_ids, strict=True))
            self._add_waiting()

    def _add_waiting(self) -> None:
        for fragment_id in [each for each in self._meshes if each in self._body_of]:
            self.page.add_fragment(self._meshes.pop(fragment_id), self._body_of[fragment_id])

    def _on_mesh(self, data: bytes) -> None:
        with suppress(ValueError):  # not a mesh
            _, run_id, mesh = deserialize_record(data, qos.FRAGMENT_MESHES.message_class)
            if not self._of_this_run(run_id):
                return
            body_id = self._body_of.get(mesh.fragment_id)
            if body_id is None:
                self._meshes[mesh.fragment_id] = mesh  # its event is still on its way
            else:
                self.page.add_fragment(mesh, body_id)

    def _on_states(self, data: bytes) -> None:
        with suppress(ValueError):  # not states; the service reports it
            received = deserialize_record(data, qos.FRAGMENT_STATES.message_class)
            if self._of_this_run(received.run_id):
                self._show(received)
            else:
                self._early = received

    def _show(self, received: Received) -> None:
        self._commands.take_states(received.record)
        self._mirror.hear_states(received)
        self.page.show_states(received.record)

    def _on_contacts(self, data: bytes) -> None:
        if self.page.wants_contacts or self._mirror.wants_contacts:
            with suppress(ValueError):
                received = deserialize_record(data, qos.CONTACT_CONSTRAINTS.message_class)
                if self._of_this_run(received.run_id):
                    self._mirror.hear_contacts(received.record)
                    self.page.show_contacts(received.record)

    def _on_status(self, message: SimulationStatus) -> None:
        if self._of_this_run(message.run_id):
            self._status, self._status_at = message, time.monotonic()
            self._show_figures()
            self.page.show_scene(message.scene)
            self._mirror.hear_paused(message.paused)
            if message.refused and message.refused != self._refused:
                self.page.notify(message.refused)
            self._refused = message.refused

    def _on_joints(self, message: JointState) -> None:
        self._joints = message

    def _on_robot(self, message: String) -> None:
        with suppress(ValueError):  # not a robot's
            self._robot = tuple(
                Joint(joint.name, lower, upper, torque, joint.kind in SLIDING)
                for joint in parse_urdf(message.data, qos.ROBOT_DESCRIPTION.name).moving()
                for lower, upper, _, torque in (joint.limits,) if torque > 0.0
            )  # fmt: skip

    def _show_joints(self) -> None:
        """Shows sliders once a run's robot is described and has told its angles, then torques."""
        joints, names = self._joints, [joint.name for joint in self._robot]
        if joints is None or not names or not set(names) <= set(joints.name):
            return
        angles, torques = (dict(zip(joints.name, each)) for each in (joints.position, joints.effort))  # noqa: B905
        if self._awaits_joints:
            self._awaits_joints = False
            self.page.show_robot(self._robot, [angles[name] for name in names])
        self.page.show_torques([torques.get(name, 0.0) for name in names])

    def _on_settings(self, settings: dict[str, Any]) -> None:
        self._mirror.hear_settings(settings)
        self._commands.hear_lookahead(settings["lookahead"])
        has = ServiceSliders(**{name: settings[name] for name in ServiceSliders._fields})
        if not self._commands.confirm(has):
            self.page.show_service(has)

    def _on_times(self, message: AnswerTimes) -> None:
        if self._of_this_run(message.run_id):
            self._times = message
            self._mirror.hear_times(1e3 * message.collision_s)
            self._show_figures()

    def _show_figures(self) -> None:
        """Once both messages of a run have come: after a reset the simulator's follows, for a while."""
        status, message = self._status, self._times
        if status is None or message is None or status.run_id != message.run_id:
            return
        self._times = None
        beyond = status.round_trip_s - message.collision_s - message.update_s
        self.page.show_figures(
            Figures(
                time=message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec,
                collision_ms=1e3 * message.collision_s,
                update_ms=1e3 * message.update_s,
                solver_ms=1e3 * status.solver_s,
                ros_ms=1e3 * max(beyond, 0.0),
                contacts=status.contacts,
            )
        )


def _work(node: PageNode) -> None:
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    try:
        with nothing_to_lose():
            compile_mesh_kernels()
        gc.freeze()  # garbage collection over all that was loaded takes 120 ms and delays meshes
        executor.spin()
    finally:
        node.close()
        executor.shutdown()


def main() -> int:
    """Runs the node with the process's arguments; returns its exit status."""
    sys.setswitchinterval(SWITCH_INTERVAL)
    return run_node(PageNode, _work)


if __name__ == "__main__":
    sys.exit(main())
