"""Input of a user on the page as commands to the live simulator, the service and a recorder."""

from __future__ import annotations

import traceback
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.parameter_client import AsyncParameterClient
from rclpy.timer import Timer

from fracture_collision.records import FragmentStates
from fracture_collision.ros.nodes.live_client import LiveClient
from fracture_collision.ros.nodes.recordings import RecordingFailed, Recordings
from fracture_collision.ros.nodes.repeated_request import RepeatedRequest
from fracture_collision.ros.nodes.uploaded_scenes import UPLOADS, UploadedScenes
from fracture_collision.simulation.rotations import turned_back
from fracture_collision.viewer.page.page_events import Ball, Drag, Handlers, InsideWanted, Ray, ServiceSliders, Upload
from fracture_collision.world.settings import GLONDU2014

SERVICE = "collision_node"
GRAVITY = 9.81  # [m/s2] for which the aim of a thrown ball compensates
OUT_OF_THE_EYE = 0.2  # [m] in front of the eye, where a ball starts
HAMMER_SPEED = 1.0  # [m/s]
MOST_EARLY = 20  # commands that wait for the simulator to be discovered; more drop the first
KEY_HOLDS = 0.3  # [s] that the hammer keeps moving after the last event of an arrow key
ARROWS = {"up": (0.0, 1.0), "down": (0.0, -1.0), "right": (1.0, 0.0), "left": (-1.0, 0.0)}  # x, y


class PageCommands:
    """Commands of one page. `handlers` are called in the page's thread; the commands run in that of `node`."""

    def __init__(
        self,
        node: Node,
        folder: Path,
        look_inside: Callable[[InsideWanted], None],
        notify: Callable[[str], None],
        add_scene: Callable[[str], None],
    ) -> None:
        """`folder`: of recordings and uploads. `notify` shows a text on the page, `add_scene` offers one more there."""
        self._node = node
        self._add_scene = add_scene
        self._look_inside = look_inside
        self._notify = notify
        self._uploads = UploadedScenes(folder / UPLOADS, self._later(self._show_upload))
        self._recordings = Recordings(folder, node.get_namespace())
        self._hands = LiveClient(node)
        self._service = AsyncParameterClient(node, SERVICE)
        # Commands from the page's thread to the node's.
        self._orders: deque[Callable[[], object]] = deque()
        self._wake = node.create_guard_condition(self._obey)
        self._run_id = 0
        self._states: FragmentStates | None = None  # the newest of the run
        self._held: tuple[int, np.ndarray] | None = None  # fragment and grip in its body frame
        self._stop_timer: Timer | None = None  # of the hammer, after the last arrow key
        self._set: list[ServiceSliders] = []  # by the user, since the last value that the service confirmed
        self._early: deque[Callable[[], object]] = deque(maxlen=MOST_EARLY)  # before the simulator was discovered
        self._choice = RepeatedRequest(self._hands.is_there)
        self._lookahead = 0.0  # [s] the service's, the last one that was not 0

    def close(self) -> None:
        """Ends a recording, and the making of a scene."""
        self._uploads.close()
        with suppress(RecordingFailed):  # its log has the reason
            self._recordings.end()

    # --- called by the page's node ---------------------------------------------------------------------------------

    def new_run(self, run_id: int) -> None:
        """Drops what belongs to an earlier run."""
        self._run_id, self._states, self._held = run_id, None, None

    def take_states(self, states: FragmentStates) -> None:
        """Takes the newest states of the run, which the user sees."""
        self._states = states

    def look(self) -> None:
        """Sends what waits for the simulator or the service to be discovered. Must be called regularly."""
        self._choice.look()
        while self._early and self._hands.is_there():
            self._carry_out(self._early.popleft())

    def hear_lookahead(self, seconds: float) -> None:
        """Takes the lookahead that the service has now."""
        self._lookahead = seconds or self._lookahead

    def confirm(self, sliders: ServiceSliders) -> bool:
        """Takes the values that the service has now; returns whether the user set them.

        If so, the page must not show them: sliders that the user has moved meanwhile would jump back.
        """
        if sliders in self._set:
            del self._set[: self._set.index(sliders)]
            return True
        self._set.clear()
        return False

    def handlers(self) -> Handlers:
        """Handlers of all input of the page."""
        later, simulator = self._later, self._to_simulator
        return Handlers(
            clicked=simulator(self._throw),
            drag_begun=later(self._take),
            drag_moved=later(self._pull),
            drag_ended=later(self._let_go),
            arrow=later(self._strike),
            scene_chosen=later(self._choose),
            uploaded=later(self._uploads.add),
            reset=simulator(lambda: self._answered(self._hands.reset(), "reset")),
            rewind=simulator(lambda: self._answered(self._hands.rewind(), "rewind")),
            paused=simulator(lambda paused: self._answered(self._hands.pause(paused), "pause")),
            one_step=simulator(lambda: self._answered(self._hands.step(), "one step")),
            slow_motion=simulator(lambda rate: self._hands.set_parameters(rate=float(rate))),
            service_set=later(self._set_service),
            joint_set=simulator(lambda name, angle: self._hands.command_joints([angle], [name])),
            recording=later(self._record),
            looking_inside=later(self._look_inside),
        )

    def _later(self, act: Callable[..., object]) -> Callable[..., None]:
        """`act` for any thread to call; it runs in the node's."""

        def order(*told: Any) -> None:
            self._orders.append(lambda: act(*told))
            self._wake.trigger()

        return order

    def _to_simulator(self, act: Callable[..., object]) -> Callable[..., None]:
        """As `_later`; before the simulator has been discovered, which takes a moment, `act` waits for that."""

        def when_there(*told: Any) -> None:
            self._early.append(lambda: act(*told))
            self.look()

        return self._later(when_there)

    def _obey(self) -> None:
        while self._orders:
            self._carry_out(self._orders.popleft())

    def _carry_out(self, order: Callable[[], object]) -> None:
        """An order that fails leaves the page running: a client need not be a browser, and may send anything."""
        try:
            order()
        except Exception as error:
            self._node.get_logger().error(traceback.format_exc())
            self._notify(f"a command failed: {error}; the log of {self._node.get_name()} has more")

    # --- the scene -------------------------------------------------------------------------------------------------

    def _throw(self, ray: Ray, ball: Ball) -> None:
        """Aims higher, as the ball falls on its way: it meets the clicked ray at the distance of the scene's middle."""
        middle = ray.origin + ray.direction if self._states is None else _middle(self._states)
        seconds = float(np.linalg.norm(middle - ray.origin)) / ball.speed
        velocity = ball.speed * ray.direction + np.array([0.0, 0.0, 0.5 * GRAVITY * seconds])
        self._hands.throw(ray.origin + OUT_OF_THE_EYE * ray.direction, velocity, ball.radius)

    def _take(self, drag: Drag) -> None:
        frame = self._frame(drag.fragment_id)
        if frame is not None:
            position, turn = frame
            self._held = drag.fragment_id, turned_back(turn, drag.grip - position)
            self._pull(drag)

    def _pull(self, drag: Drag) -> None:
        if self._held is not None:
            fragment_id, grip = self._held
            self._hands.drag(self._run_id, fragment_id, grip, drag.target)

    def _let_go(self, _drag: Drag) -> None:
        self._held = None
        self._hands.let_go()

    def _frame(self, fragment_id: int) -> tuple[np.ndarray, np.ndarray] | None:
        """Position (3,) [m] and quaternion (4,) of a fragment."""
        states = self._states
        if states is None or not (states.fragment_ids == fragment_id).any():
            return None
        row = np.flatnonzero(states.fragment_ids == fragment_id)[0]
        return states.positions[row], states.orientations[row]

    def _strike(self, arrow: str) -> None:
        x, y = ARROWS[arrow]
        self._hands.steer((HAMMER_SPEED * x, HAMMER_SPEED * y, 0.0))
        self._drop_stop_timer()
        self._stop_timer = self._node.create_timer(KEY_HOLDS, self._stand)

    def _stand(self) -> None:
        self._drop_stop_timer()
        self._hands.steer((0.0, 0.0, 0.0))

    def _drop_stop_timer(self) -> None:
        if self._stop_timer is not None:
            self._node.destroy_timer(self._stop_timer)
            self._stop_timer = None

    # --- parameters and recordings ---------------------------------------------------------------------------------

    def _choose(self, scene: str) -> None:
        def begin(done: Any) -> None:
            if self._all_taken(done):
                self._answered(self._hands.reset(), f"scene {scene}")

        self._choice.begin(lambda: self._hands.set_parameters(next_scene=scene), begin)

    def _show_upload(self, scene: str, upload: Upload) -> None:
        upload.tell(f"{upload.name} is the scene {scene}")
        self._add_scene(scene)
        self._choose(scene)

    def _set_service(self, sliders: ServiceSliders) -> None:
        self._set.append(sliders)
        wanted = [Parameter(name, value=value) for name, value in sliders._asdict().items()]
        if sliders.method == GLONDU2014:  # it takes no lookahead
            wanted.insert(0, Parameter("lookahead", value=0.0))
        else:
            wanted.append(Parameter("lookahead", value=self._lookahead))
        self._service.set_parameters(wanted).add_done_callback(self._all_taken)

    def _all_taken(self, done: Any) -> bool:
        """Whether all parameters were set; shows the reasons if not."""
        results = done.result().results if done.result() else []
        for result in results:
            if not result.successful:
                self._warn(result.reason)
        return all(result.successful for result in results)

    def _record(self, wanted: bool) -> None:
        try:
            if (bag := self._recordings.end()) is not None:
                self._say(f"{bag} is complete")
            if wanted:
                self._say(f"recording into {self._recordings.begin()}")
        except RecordingFailed as error:
            self._warn(str(error))

    def _answered(self, future: Any, what: str) -> None:
        def look(done: Any) -> None:
            result = done.result()
            if result is not None and not result.success:
                self._warn(f"{what}: {result.message}")

        future.add_done_callback(look)

    def _say(self, words: str) -> None:
        self._node.get_logger().info(words)
        self._notify(words)

    def _warn(self, words: str) -> None:
        self._node.get_logger().warning(words)
        self._notify(words)


def _middle(states: FragmentStates) -> np.ndarray:
    return np.median(states.positions.reshape(-1, 3), axis=0)
