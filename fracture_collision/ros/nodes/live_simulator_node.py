"""An interactive simulator: paced by the clock, it runs until it is shut down and takes commands from topics.

~/throw_ball, ~/hand_target and cmd_vel (of any teleop tool) act on the scene, joint_commands on its robot. A robot is
published as robot_description, joint_states and tf. The services ~/reset, ~/rewind, ~/pause and ~/step control the
run. The steps themselves are those of simulator_node.
"""

from __future__ import annotations

import sys
import time
from collections import deque
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
from geometry_msgs.msg import Point, Twist, Vector3
from rcl_interfaces.msg import SetParametersResult
from rclpy.executors import Executor
from rclpy.parameter import Parameter
from sensor_msgs.msg import JointState
from std_msgs.msg import Header
from std_srvs.srv import SetBool, Trigger

from fracture_collision.extras import MissingExtra
from fracture_collision.msg import HandTarget, SimulationStatus, ThrowBall
from fracture_collision.ros.nodes.robot_publisher import RobotPublisher
from fracture_collision.ros.nodes.simulator_node import SimulatorNode, random_run_id, work
from fracture_collision.ros.nodes.uploaded_scenes import UPLOADS, scene_file
from fracture_collision.ros.processes.parameters import Declaration, Range, declare
from fracture_collision.ros.processes.process import Fatal, run_node
from fracture_collision.ros.wire import interfaces, qos
from fracture_collision.ros.wire.conversion import header_of, heading
from fracture_collision.simulation.live import REACH, Ball, CommandRefused, History, LiveScene, Moment
from fracture_collision.simulation.scene.scene import Scene, SceneError, scene_names
from fracture_collision.simulation.simulation import Simulation, StepReport

STATUS_INTERVAL = 0.02  # [s]
PAUSE_LOOK = 0.05  # [s] between two checks while paused
# [s] If a run falls further behind the clock, it drops the rest of the lag: nothing is gained by catching up.
MOST_BEHIND = 0.1
RATE_WINDOW = 1.0  # [s] over which the achieved rate is measured
RATE = Declaration(
    "rate", 1.0, "simulated time over real time; 0.1: slow motion", Range(0.01, 10.0), fixed=False
)
NEXT_SCENE = Declaration(
    "next_scene", "", "scene of the next reset, a name in config/scenes or of an upload; '': the same", fixed=False
)
FOLDER = Declaration("folder", "out/play", "that of the page, with the scenes of uploaded meshes")


class LiveSimulatorNode(SimulatorNode):
    """Simulates a live scene; to the service it is the same as simulator_node.

    ~ in names is the node's name. Commands are executed between two steps, in order of arrival.
    """

    PARAMETERS = (*SimulatorNode.PARAMETERS, RATE, FOLDER, NEXT_SCENE)
    INTERFACE = interfaces.LIVE_SIMULATOR
    EXAMPLES = (
        "--ros-args -p scene:=vase -p rate:=0.5",
        "--ros-args -r __ns:=/cell -r cmd_vel:=/cmd_vel -r joint_commands:=/operator/joint_states",
    )

    _live: LiveScene  # made by _make_simulation, which the constructor of SimulatorNode calls

    def __init__(self) -> None:
        super().__init__(interfaces.LIVE_SIMULATOR_NODE)
        declare(self, RATE)
        self._scene_name = self.get_parameter("scene").value  # as load_scene takes it
        self._uploads = Path(declare(self, FOLDER)) / UPLOADS
        # A page in a browser may set this: no paths are accepted, except the one given at the start.
        self._offered = ("", self._scene_name, *scene_names())
        self.add_on_set_parameters_callback(self._judge)
        declare(self, NEXT_SCENE)
        self._commands: deque[Callable[[], None]] = deque()
        self._paused, self._steps_allowed = False, 0
        self._next: Callable[[], None] | None = None  # makes what runs next, once this run is to end
        self._next_status = 0.0
        self._refused = ""
        self._reached: deque[tuple[float, float]] = deque()  # real and simulated time of the last steps
        for topic, callback in (
            (qos.THROW_BALL, self._on_ball), (qos.HAND_TARGET, self._on_hand), (qos.CMD_VEL, self._on_velocity),
            (qos.JOINT_COMMANDS, self._on_joints),
        ):  # fmt: skip
            self.create_subscription(topic.message_class, topic.name, callback, topic.qos)
        topic = qos.SIMULATION_STATUS
        self._status = self.create_publisher(topic.message_class, topic.name, topic.qos)
        self._robot = RobotPublisher(self)
        for service, answer in (
            (interfaces.RESET, self._on_reset), (interfaces.REWIND, self._on_rewind),
            (interfaces.STEP, self._on_step), (interfaces.PAUSE, self._on_pause),
        ):  # fmt: skip
            self.create_service(service.service_class, service.name, answer)

    def _make_simulation(self, scene: Scene, seed: int) -> Simulation:
        self._live, self._scene, self._seed = LiveScene(scene, seed, self._looks_ahead), scene, seed
        self._history = History()
        return self._live.simulation

    # --- the run ---------------------------------------------------------------------------------------------------

    def run(self, executor: Executor) -> None:
        """Runs until rclpy shuts down and raises ExternalShutdownException."""
        self._await_subscribers(executor)
        while True:
            try:
                self._run_once(executor)
            except Fatal as error:
                self.get_logger().error(f"{error}; restarting the scene")
                self._next = None
            self._begin_again(self._next or partial(self._start, self._scene))

    def _run_once(self, executor: Executor) -> None:
        """Runs until a reset or a rewind is requested."""
        self._set_lookahead(executor)
        self._robot.begin(self._scene.robot)
        self._announce(self._simulation.start_bodies(), self._history.events)
        due = time.monotonic()
        report, round_trip = None, 0.0
        while self._next is None:
            # the first step is made even if paused: viewers have nothing to show before it
            if self._paused and not self._steps_allowed and report is not None:
                self._publish_time()
                self._tell(report, round_trip)
                executor.spin_once(timeout_sec=PAUSE_LOOK)
                due = time.monotonic()
            elif (left := due - time.monotonic()) > 0.0:
                executor.spin_once(timeout_sec=left)
                continue
            else:
                self._steps_allowed = max(self._steps_allowed - 1, 0)
                self._history.keep(self._live)
                report, round_trip = self._step(executor)
                due = max(due + self._scene.time_step / self._rate, time.monotonic() - MOST_BEHIND)
                self._tell(report, round_trip)
                executor.spin_once(timeout_sec=0)
            while self._commands and self._next is None:
                self._commands.popleft()()

    def _announce(self, bodies: list, events: list) -> None:
        super()._announce(bodies, events)
        self._history.add(events)

    def _start(self, scene: Scene) -> None:
        self._simulation = self._make_simulation(scene, self._seed + 1)

    def _go_back(self, moment: Moment) -> None:
        self._history = self._history.until(moment)
        self._live = moment.live.copied()
        self._live.rest()
        self._simulation = self._live.simulation

    def _begin_again(self, make: Callable[[], None]) -> None:
        """Begins a new run with what `make` makes."""
        self._next = None
        self._live.close()
        make()
        self._run_id = random_run_id()
        self._registry = None  # of the run before
        self._commands.clear()
        self._reached.clear()
        self._refused = ""
        # late joiners must receive this run only
        for publisher in (self._bodies, self._events):
            self.destroy_publisher(publisher)
        self._bodies, self._events = self._open_log()

    @property
    def _rate(self) -> float:
        return self.get_parameter("rate").value

    def _tell(self, report: StepReport | None, round_trip: float) -> None:
        now = time.monotonic()
        if self._paused:
            self._reached.clear()
        elif report is not None:
            self._reached.append((now, report.time))
        while self._reached and self._reached[0][0] < now - RATE_WINDOW:
            self._reached.popleft()
        if now < self._next_status:
            return
        self._next_status = now + STATUS_INTERVAL
        status = SimulationStatus(
            header=Header(frame_id="world"), run_id=self._run_id, scene=self._scene.name, paused=self._paused,
            time_step_s=self._scene.time_step, rate=self._rate, round_trip_s=round_trip, refused=self._refused,
        )  # fmt: skip
        if len(self._reached) > 1:
            (began, first), (ended, last) = self._reached[0], self._reached[-1]
            status.achieved_rate = (last - first) / max(ended - began, 1e-9)
            self._live.keep_pace(status.achieved_rate)
        if report is not None:
            status.header = header_of(heading(report.time))
            status.step, status.fragments, status.contacts = report.step + 1, report.fragments, report.contacts
            status.solver_s, status.fracture_s = report.solver_seconds, report.fracture_seconds
            status.kinetic_energy = report.kinetic_energy
        self._status.publish(status)
        robot = self._simulation.robot
        if robot is not None:
            self._robot.publish(robot.joints(), heading(0.0 if report is None else report.time))

    # --- commands --------------------------------------------------------------------------------------------------

    def _later(self, topic: qos.Topic, command: Callable[[], None]) -> None:
        """Queues a command to run between two steps; a rejection is reported in the status and in the log."""

        def act() -> None:
            try:
                command()
            except CommandRefused as error:
                self._refused = f"{topic.name.removeprefix('~/')}: {error}"
                self.get_logger().warning(self._refused, throttle_duration_sec=1.0)

        self._commands.append(act)

    def _on_ball(self, message: ThrowBall) -> None:
        ball = Ball(_xyz(message.position), _xyz(message.velocity), message.radius, message.density)
        self._later(qos.THROW_BALL, lambda: self._live.throw(ball))

    def _on_hand(self, message: HandTarget) -> None:
        if message.run_id != self._run_id and message.fragment_id:
            return  # of the run before a reset
        grip, target = _xyz(message.grip), _xyz(message.target)
        self._later(qos.HAND_TARGET, lambda: self._live.drag(message.fragment_id, grip, target))

    def _on_velocity(self, message: Twist) -> None:
        velocity = _xyz(message.linear)
        self._later(qos.CMD_VEL, lambda: self._live.steer(velocity))

    def _on_joints(self, message: JointState) -> None:
        names, positions = list(message.name), list(message.position)
        self._later(qos.JOINT_COMMANDS, lambda: self._live.command_joints(names, positions))

    def _judge(self, parameters: list[Parameter]) -> SetParametersResult:
        names = [each.value for each in parameters if each.name == "next_scene"]
        if all(name in self._offered or scene_file(self._uploads, name) for name in names):
            return SetParametersResult(successful=True)
        reason = f"next_scene: pass the name of a scene: {', '.join(self._offered[1:])}"
        return SetParametersResult(successful=False, reason=reason)

    def _on_reset(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        name = self.get_parameter("next_scene").value or self._scene_name
        try:
            scene = self._load(str(name if name in self._offered else scene_file(self._uploads, name) or name))
        except MissingExtra as error:
            response.message = str(error)
            return response
        except (SceneError, OSError) as error:
            # Errors quote the file, and its content must not leave this machine.
            self.get_logger().error(str(error))
            response.message = f"{name} cannot be read; see the log of {self.get_name()}"
            return response
        self._scene_name = name
        self._next = partial(self._start, scene)
        response.success, response.message = True, f"restarting {name}"
        return response

    def _on_rewind(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        now = self._simulation.time
        moment = self._history.moment(now - REACH)
        if moment is None:
            response.message = "the scene has not begun"
            return response
        self._next = partial(self._go_back, moment)
        self._paused, self._steps_allowed = True, 0
        response.success, response.message = True, f"from {now:.2f} s back to {moment.time:.2f} s, paused"
        return response

    def _on_step(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        response.success = self._paused
        if self._paused:
            self._steps_allowed += 1
        else:
            response.message = "the scene is not paused"
        return response

    def _on_pause(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        self._paused, self._steps_allowed = request.data, 0
        response.success, response.message = True, "paused" if request.data else "running"
        return response


def _xyz(vector: Point | Vector3) -> np.ndarray:
    return np.array([vector.x, vector.y, vector.z])


def main() -> int:
    """Runs the node with the process's arguments; returns its exit status."""
    return run_node(LiveSimulatorNode, work)


if __name__ == "__main__":
    sys.exit(main())
