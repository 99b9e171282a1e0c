"""A user's commands in a live scene, as messages to live_simulator_node: for the page, for teleop, for tests."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from geometry_msgs.msg import Point, Twist, Vector3
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.parameter_client import AsyncParameterClient
from rclpy.task import Future
from sensor_msgs.msg import JointState
from std_msgs.msg import Header
from std_srvs.srv import SetBool, Trigger

from fracture_collision.msg import HandTarget, ThrowBall
from fracture_collision.ros.wire import interfaces, qos

Vector = Sequence[float] | np.ndarray  # of three numbers


class LiveClient:
    """Commands of one `node`. Futures complete while the node spins."""

    def __init__(self, node: Node, simulator: str = interfaces.LIVE_SIMULATOR_NODE) -> None:
        """`simulator`: name of the live simulator, in the namespace of `node`."""
        self._balls, self._hand, self._velocity, self._joints = (
            node.create_publisher(topic.message_class, topic.name, topic.qos)
            for topic in (
                qos.of_node(qos.THROW_BALL, simulator), qos.of_node(qos.HAND_TARGET, simulator), qos.CMD_VEL,
                qos.JOINT_COMMANDS,
            )
        )  # fmt: skip
        self._reset, self._rewind, self._step, self._pause = self._services = tuple(
            node.create_client(service.service_class, service.name.replace("~", simulator))
            for service in (interfaces.RESET, interfaces.REWIND, interfaces.STEP, interfaces.PAUSE)
        )
        self._parameters = AsyncParameterClient(node, simulator)

    def is_there(self) -> bool:
        """Whether a live simulator subscribes to all topics and provides all services."""
        said = (self._balls, self._hand, self._velocity, self._joints)
        heard = all(each.get_subscription_count() > 0 for each in said)
        return heard and all(each.service_is_ready() for each in self._services)

    def throw(
        self, position: Vector, velocity: Vector, radius: float = 0.04, density: float = 2000.0
    ) -> None:
        """Arguments as in ThrowBall.msg."""
        self._balls.publish(
            ThrowBall(
                header=Header(frame_id="world"), position=_point(position), velocity=_vector(velocity),
                radius=float(radius), density=float(density),
            )  # fmt: skip
        )

    def drag(self, run_id: int, fragment_id: int, grip: Vector, target: Vector) -> None:
        """Arguments as in HandTarget.msg."""
        self._hand.publish(
            HandTarget(
                header=Header(frame_id="world"), run_id=run_id, fragment_id=fragment_id, grip=_point(grip),
                target=_point(target),
            )  # fmt: skip
        )

    def let_go(self) -> None:
        """Releases what the hand holds."""
        self._hand.publish(HandTarget(header=Header(frame_id="world")))

    def steer(self, velocity: Vector) -> None:
        """Moves the hammer with `velocity` (3,) [m/s], world axes, until the next command."""
        self._velocity.publish(Twist(linear=_vector(velocity)))

    def command_joints(self, positions: Sequence[float], names: Sequence[str] = ()) -> None:
        """Moves the scene's robot to `positions` [rad] of the named joints, or of all in order if `names` is empty."""
        self._joints.publish(JointState(name=list(names), position=[float(position) for position in positions]))

    def reset(self) -> Future:
        """Future of a Trigger.Response."""
        return self._reset.call_async(Trigger.Request())

    def rewind(self) -> Future:
        """Future of a Trigger.Response, whose message has the time to which the scene goes back."""
        return self._rewind.call_async(Trigger.Request())

    def pause(self, paused: bool) -> Future:
        """Future of a SetBool.Response."""
        return self._pause.call_async(SetBool.Request(data=paused))

    def step(self) -> Future:
        """Makes one step while the run is paused; Future of a Trigger.Response."""
        return self._step.call_async(Trigger.Request())

    def set_parameters(self, **values: Any) -> Future:
        """Sets `rate`, `next_scene`; Future of a SetParameters.Response."""
        return self._parameters.set_parameters([Parameter(name, value=value) for name, value in values.items()])


def _point(values: Vector) -> Point:
    x, y, z = map(float, values)
    return Point(x=x, y=y, z=z)


def _vector(values: Vector) -> Vector3:
    x, y, z = map(float, values)
    return Vector3(x=x, y=y, z=z)
