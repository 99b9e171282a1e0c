"""A user of a live scene over DDS. For tests."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from fracture_collision.msg import FragmentStates, SimulationStatus
from sensor_msgs.msg import JointState

from fracture_collision.ros.nodes.live_client import LiveClient
from fracture_collision.ros.wire import qos
from fracture_collision.ros.wire.interfaces import LIVE_STATUS
from stages.ros_client import PATIENCE
from stages.ros_stage import StageWithClients

PLATE = np.array([-0.45, 0.0, 0.7227])  # [m] the first plate


class Player:
    """A user of a live scene."""

    def __init__(self, stage: StageWithClients, scene: str = "plates", names: Sequence[str] = (), *own: str) -> None:
        """`names`: arguments of all nodes, for a namespace; `own`: of the user's."""
        self.service = stage.start("collision_node", *names)
        self.simulator = stage.start("live_simulator_node", *names, scene=scene, seed=7)
        self.ears = stage.client(*names, *own)
        self.hands = LiveClient(self.ears.node)
        self.told: list[SimulationStatus] = []
        self.states: list[FragmentStates] = []
        self.joints: list[JointState] = []
        for topic, collected in (
            (LIVE_STATUS, self.told), (qos.FRAGMENT_STATES, self.states), (qos.JOINT_STATES, self.joints),
        ):  # fmt: skip
            profile = qos.recording(topic.qos)
            self.ears.node.create_subscription(topic.message_class, topic.name, collected.append, profile)
        self.until(lambda: self.hands.is_there() and bool(self.told) and bool(self.states), "a live scene")

    @property
    def status(self) -> SimulationStatus:
        return self.told[-1]

    def until(self, condition, what: str) -> None:
        self.ears.spin_until(condition, what, 2 * PATIENCE)

    def answer(self, future):
        self.until(future.done, "an answer")
        return future.result()

    def steps_go_on(self, count: int = 10) -> None:
        """Waits for `count` more steps of the same run."""
        run_id, step = self.status.run_id, self.status.step
        self.until(lambda: self.status.run_id == run_id and self.status.step >= step + count, "more steps")

    def begin_again(self, scene: str = "plates") -> None:
        self.answer(self.hands.set_parameters(next_scene=scene, rate=1.0))
        self.answer(self.hands.pause(False))
        before = self.status.run_id
        assert self.answer(self.hands.reset()).success
        self.until(lambda: self.status.run_id != before and self.status.step > 5, "another run")

    def place(self, fragment_id: int) -> np.ndarray:
        """Position [m] of its body frame."""
        row = list(self.states[-1].fragment_ids).index(fragment_id)
        return np.reshape(self.states[-1].positions, (-1, 3))[row]

    def newest_ids(self) -> set[int]:
        return set(self.states[-1].fragment_ids)
