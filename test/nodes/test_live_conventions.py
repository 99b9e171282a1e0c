"""What standard ROS tools expect of a simulator: /clock, robot_description, tf, private and relative names."""

from __future__ import annotations

from xml.etree import ElementTree

import numpy as np
import pytest
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rosgraph_msgs.msg import Clock
from scipy.spatial.transform import Rotation
from stages.live_player import Player
from stages.ros_stage import StageWithClients
from std_msgs.msg import String

from fracture_collision.ros.wire import qos
from fracture_collision.ros.wire.message_definitions import type_hash
from fracture_collision.simulation.scene.scene import load_scene

pybullet = pytest.importorskip("pybullet")

CELL = ("-r", "__ns:=/cell")
JOINTS = [f"lbr_iiwa_joint_{j}" for j in range(1, 8)]
TF_HASH = "RIHS01_e369d0f05a23ae52508854b66f6aa0437f3449d652e8cbf22d5abe85d020f087"
LINKS = [f"lbr_iiwa_link_{j}" for j in range(8)]


class Visitor(Player):
    """A live scene with a robot in a namespace, and a node with use_sim_time beside it."""

    def __init__(self, stage: StageWithClients) -> None:
        super().__init__(stage, "vase", CELL, "-p", "use_sim_time:=true")
        self.stage = stage
        self.clock: list[Clock] = []
        reliable = QoSProfile(depth=100, reliability=ReliabilityPolicy.RELIABLE)
        self.ears.node.create_subscription(Clock, "/clock", self.clock.append, reliable)
        self.until(lambda: bool(self.joints), "a robot")

    def now(self) -> int:
        """[ns] of a node with use_sim_time."""
        return self.ears.node.get_clock().now().nanoseconds


@pytest.fixture(scope="module")
def visitor(shared_stage: StageWithClients) -> Visitor:
    return Visitor(shared_stage)


def nanoseconds(stamp) -> int:
    return stamp.sec * 10**9 + stamp.nanosec


def test_nodes_with_use_sim_time_follow_the_scene(visitor: Visitor) -> None:
    visitor.begin_again("vase")
    visitor.states.clear()
    visitor.clock.clear()
    visitor.until(lambda: len(visitor.states) > 30 and len(visitor.clock) > 30, "steps")
    ticks = [nanoseconds(each.clock) for each in visitor.clock]
    stamps = [nanoseconds(each.header.stamp) for each in visitor.states]
    assert ticks == sorted(ticks) and len(set(stamps) & set(ticks)) > 20, "the clock has the time of the states"
    assert visitor.answer(visitor.hands.pause(True)).success
    visitor.until(lambda: visitor.told[-1].paused, "a pause")
    visitor.clock.clear()
    visitor.until(lambda: len(visitor.clock) > 3, "the clock of a pause, for nodes that join")
    stands = visitor.now()
    assert {nanoseconds(each.clock) for each in visitor.clock[1:]} == {stands} and stands >= ticks[-1]
    visitor.begin_again("vase")
    visitor.until(lambda: visitor.now() < stands, "a clock that jumped back with the reset")


def test_a_simulator_leaves_the_clock_to_others_on_request(visitor: Visitor) -> None:
    node = visitor.ears.node
    assert node.count_publishers("/clock") == 1
    visitor.stage.start("simulator_node", "-r", "__ns:=/quiet", publish_clock=False, wait_for_subscribers=50)
    visitor.until(lambda: node.count_publishers("/quiet/fragment_states") == 1, "another simulator")
    assert node.count_publishers("/clock") == 1, "that of the scene, by default"


def test_names_are_private_or_those_of_standard_tools(visitor: Visitor) -> None:
    node = visitor.ears.node
    services = dict(node.get_service_names_and_types_by_node("live_simulator_node", "/cell"))
    heard = dict(node.get_subscriber_names_and_types_by_node("live_simulator_node", "/cell"))
    said = dict(node.get_publisher_names_and_types_by_node("live_simulator_node", "/cell"))
    own = "/cell/live_simulator_node"
    assert services[f"{own}/reset"] == services[f"{own}/step"] == services[f"{own}/rewind"] == ["std_srvs/srv/Trigger"]
    assert services[f"{own}/pause"] == ["std_srvs/srv/SetBool"]
    assert {f"{own}/throw_ball", f"{own}/hand_target", "/cell/cmd_vel", "/cell/joint_commands"} <= heard.keys()
    assert {f"{own}/status", "/cell/joint_states", "/cell/robot_description", "/cell/bodies", "/clock"} <= said.keys()


def test_a_late_viewer_gets_the_robot_and_none_where_there_is_none(visitor: Visitor) -> None:
    visitor.begin_again("vase")
    topic = qos.ROBOT_DESCRIPTION
    heard: list[String] = []
    visitor.ears.node.create_subscription(String, topic.name, heard.append, topic.qos)
    visitor.until(lambda: bool(heard), "a description")
    robot = ElementTree.fromstring(heard[0].data)
    assert [link.get("name") for link in robot.iter("link")] == LINKS
    assert [joint.get("name") for joint in robot.iter("joint")] == JOINTS == visitor.joints[-1].name
    assert not list(robot.iter("mesh")) and len(list(robot.iter("visual"))) == 15
    efforts = [float(limit.get("effort")) for limit in robot.iter("limit")]
    assert efforts == [motor.torque for motor in load_scene("vase").robot.motors]
    visitor.begin_again("plates")
    visitor.until(lambda: visitor.ears.node.count_publishers(topic.name) == 0, "no robot any more")
    visitor.begin_again("vase")
    visitor.until(lambda: len(heard) == 2 and heard[0] == heard[1], "the robot again")


def test_tf_has_the_frames_of_the_links(visitor: Visitor) -> None:
    tf2_msgs = pytest.importorskip("tf2_msgs.msg", reason="tf2_msgs is neither of a ROS nor built by pip install")
    assert type_hash(tf2_msgs.TFMessage) == TF_HASH, "that of every ROS, from Iron on"
    visitor.begin_again("vase")
    moving: list[tf2_msgs.TFMessage] = []
    fixed: list[tf2_msgs.TFMessage] = []
    for topic, collected in ((qos.TF, moving), (qos.TF_STATIC, fixed)):
        assert topic.name in ("/tf", "/tf_static")  # in every namespace, as tf2_ros subscribes
        visitor.ears.node.create_subscription(tf2_msgs.TFMessage, topic.name, collected.append, topic.qos)
    visitor.until(lambda: bool(fixed) and bool(moving), "frames")
    visitor.hands.command_joints(np.radians([-70.0, 60.0, 20.0, -80.0, 30.0, -50.0, 40.0]))
    visitor.until(lambda: abs(visitor.joints[-1].position[0]) > 0.2, "a robot on its way")
    count = len(moving)
    visitor.until(lambda: len(moving) > count + 20, "more frames")
    stamps = [nanoseconds(each.transforms[0].header.stamp) for each in moving]
    assert len(set(stamps)) == len(stamps), "tf2 warns of a time that comes twice"
    angles = {nanoseconds(each.header.stamp): list(each.position) for each in visitor.joints}
    (foot,) = fixed[-1].transforms
    assert (foot.header.frame_id, foot.child_frame_id) == ("world", LINKS[0])
    compared = 0
    for message, stamp in list(zip(moving, stamps, strict=True))[::10]:
        pairs = [(each.header.frame_id, each.child_frame_id) for each in message.transforms]
        assert pairs == list(zip(LINKS[:-1], LINKS[1:], strict=True))
        if stamp in angles:
            compared += 1
            origins, turns = composed([foot, *message.transforms])
            theirs, their_turns = bullet_frames(angles[stamp])
            assert np.abs(origins[1:] - theirs).max() < 1e-6
            assert (turns[1:] * Rotation.from_quat(their_turns).inv()).magnitude().max() < 1e-6
    assert compared > 1


def composed(chain: list) -> tuple[np.ndarray, Rotation]:
    """Origins and orientations in the first frame, as a tf buffer composes them."""
    origin, turn, origins, turns = np.zeros(3), Rotation.identity(), [], []
    for each in chain:
        place, rotation = each.transform.translation, each.transform.rotation
        origin = origin + turn.apply([place.x, place.y, place.z])
        turn = turn * Rotation.from_quat([rotation.x, rotation.y, rotation.z, rotation.w])
        origins.append(origin)
        turns.append(turn.as_quat())
    return np.array(origins), Rotation.from_quat(np.array(turns))


def bullet_frames(angles: list[float]) -> tuple[np.ndarray, np.ndarray]:
    """Frames of the links by Bullet, for the robot of the scene `vase`."""
    plan = load_scene("vase").robot
    client = pybullet.connect(pybullet.DIRECT)
    try:
        robot = pybullet.loadURDF(
            str(plan.urdf), plan.position.tolist(), plan.orientation.tolist(),
            useFixedBase=True, physicsClientId=client,
        )  # fmt: skip
        for j, angle in enumerate(angles):
            pybullet.resetJointState(robot, j, angle, physicsClientId=client)
        states = pybullet.getLinkStates(robot, range(7), computeForwardKinematics=1, physicsClientId=client)
        return np.array([state[4] for state in states]), np.array([state[5] for state in states])
    finally:
        pybullet.disconnect(client)
