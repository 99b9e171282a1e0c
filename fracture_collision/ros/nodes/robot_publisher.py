"""The robot of a live scene as standard tools expect a robot: robot_description, joint_states and tf.

Frames are the links of the URDF, each in that of the link before, the first one in `world`. Bodies and fragments have
no frames: there are hundreds of them, and their poses are in fragment_states and markers.
"""

from __future__ import annotations

import numpy as np
from geometry_msgs.msg import Quaternion, Transform, TransformStamped, Vector3
from rclpy.node import Node
from rclpy.publisher import Publisher
from sensor_msgs.msg import JointState
from std_msgs.msg import Header, String

from fracture_collision.cdr import Heading
from fracture_collision.ros.wire import qos
from fracture_collision.ros.wire.conversion import header_of, heading
from fracture_collision.simulation.actors.robot import JointStates, RobotPlan, Urdf, read_urdf

WORLD = "world"


class RobotPublisher:
    """Publishes a robot of a node's scene. Without tf2_msgs (qos.py) there is no tf, which is logged."""

    def __init__(self, node: Node) -> None:
        self._node = node
        self._joints = self._open(qos.JOINT_STATES)
        self._tf = self._open(qos.TF) if qos.TFMessage is not None else None
        self._latched: list[Publisher] = []
        self._urdf: Urdf | None = None
        self._said: Heading | None = None  # of the last tf: listeners warn of a time that comes twice

    def begin(self, robot: RobotPlan | None) -> None:
        """Starts a run with this robot, or without one."""
        for publisher in self._latched:  # late joiners must receive this robot only
            self._node.destroy_publisher(publisher)
        self._latched, self._said = [], None
        self._urdf = None
        if robot is None:
            return
        urdf = self._urdf = read_urdf(robot.urdf)
        self._latch(qos.ROBOT_DESCRIPTION, String(data=robot.description()))
        if qos.TFMessage is None:
            self._node.get_logger().warning("tf2_msgs is not installed: the robot's frames are not published on /tf")
            return
        base = _transform(heading(0.0), WORLD, urdf.root, robot.position, robot.orientation)
        fixed = [
            _transform(heading(0.0), joint.parent, joint.child, *joint.frame(0.0))
            for joint in urdf.joints if joint.kind == "fixed"
        ]  # fmt: skip
        self._latch(qos.TF_STATIC, qos.TFMessage(transforms=[base, *fixed]))

    def publish(self, joints: JointStates, head: Heading) -> None:
        """Publishes the state of the joints and the frames of the links."""
        self._joints.publish(
            JointState(
                header=Header(stamp=header_of(head).stamp), name=list(joints.names),
                position=joints.angles.tolist(), velocity=joints.speeds.tolist(), effort=joints.torques.tolist(),
            )  # fmt: skip
        )
        if self._tf is None or self._urdf is None or head == self._said:
            return
        self._said = head
        moving = zip(self._urdf.moving(), joints.angles.tolist(), strict=True)
        frames = [_transform(head, joint.parent, joint.child, *joint.frame(angle)) for joint, angle in moving]
        self._tf.publish(qos.TFMessage(transforms=frames))

    def _latch(self, topic: qos.Topic, message: object) -> None:
        publisher = self._open(topic)
        publisher.publish(message)
        self._latched.append(publisher)

    def _open(self, topic: qos.Topic) -> Publisher:
        return self._node.create_publisher(topic.message_class, topic.name, topic.qos)


def _transform(
    head: Heading, parent: str, child: str, place: np.ndarray, turn: np.ndarray
) -> TransformStamped:
    x, y, z = map(float, place)
    i, j, k, w = map(float, turn)
    return TransformStamped(
        header=header_of(head._replace(frame_id=parent)), child_frame_id=child,
        transform=Transform(translation=Vector3(x=x, y=y, z=z), rotation=Quaternion(x=i, y=j, z=k, w=w)),
    )  # fmt: skip
