"""The topics, their types and quality of service: named once, used by every node."""

from __future__ import annotations

from typing import Any, NamedTuple

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseArray, Twist
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from visualization_msgs.msg import MarkerArray

from fracture_collision.msg import (
    AnswerTimes,
    CollisionBody,
    ContactConstraintArray,
    FractureEvent,
    FragmentMesh,
    FragmentRegistry,
    FragmentStates,
    HandTarget,
    SimulationStatus,
    ThrowBall,
)

try:
    from tf2_msgs.msg import TFMessage
except ImportError:  # not among the ROS wheels; `pip install` builds it from vendor/
    TFMessage = None

# Every message ever sent, for late joiners too: a restarted service rebuilds the whole run from these. "Every" ends at
# 5000 messages a topic, which a Fast DDS publisher keeps unless a profile allows more (max_samples): a later joiner
# gets the last 5000.
LATCHED = QoSProfile(
    history=HistoryPolicy.KEEP_ALL,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.TRANSIENT_LOCAL,
)

# Only the newest registry lists the living fragments.
LATCHED_NEWEST = QoSProfile(
    history=HistoryPolicy.KEEP_LAST,
    depth=1,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.TRANSIENT_LOCAL,
)

# [messages] A subscriber may be late by this many steps before one is overwritten. Publishers do not wait for it; the
# recorder checks the step numbers.
STEP_DEPTH = 64
EACH_STEP = QoSProfile(
    history=HistoryPolicy.KEEP_LAST,
    depth=STEP_DEPTH,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.VOLATILE,
)

# A restarted service may answer before it has discovered a recorder, which asks for the answers that it missed.
EACH_ANSWER = QoSProfile(
    history=HistoryPolicy.KEEP_LAST,
    depth=STEP_DEPTH,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.TRANSIENT_LOCAL,
)

# Of these only the newest counts.
NEWEST = QoSProfile(
    history=HistoryPolicy.KEEP_LAST,
    depth=1,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.VOLATILE,
)


class Topic(NamedTuple):
    """A topic with its type and its quality of service."""

    name: str  # relative to the node's namespace; ~/NAME: to the node's own, private one; /NAME: absolute
    message_class: Any
    qos: QoSProfile  # as offered by its publisher
    description: str  # for --help


BODIES = Topic("bodies", CollisionBody, LATCHED, "bodies as they are before anything breaks")
FRACTURE_EVENTS = Topic("fracture_events", FractureEvent, LATCHED, "fragments that break")
FRAGMENT_STATES = Topic("fragment_states", FragmentStates, EACH_STEP, "poses and velocities at one step")
CONTACT_CONSTRAINTS = Topic("contact_constraints", ContactConstraintArray, EACH_ANSWER, "contacts of these states")
FRAGMENTS = Topic("fragments", FragmentRegistry, LATCHED_NEWEST, "all living fragments: masses, inertias")
FRAGMENT_MESHES = Topic("fragment_meshes", FragmentMesh, LATCHED, "surfaces, made while subscribed to")

# For RViz and Foxglove (ros/wire/markers.py): for late joiners the last message.
MARKERS = Topic("markers", MarkerArray, LATCHED_NEWEST, "surfaces and contacts to look at")
# For PlotJuggler and Foxglove (ros/wire/contact_poses.py).
CONTACT_POSES = Topic("contact_poses", PoseArray, NEWEST, "a pose per contact, z along its normal")
ANSWER_TIMES = Topic("answer_times", AnswerTimes, NEWEST, "times of one answer")
DIAGNOSTICS = Topic("/diagnostics", DiagnosticArray, QoSProfile(depth=10), "state, times, counts, rejections; 1 Hz")

# Simulation time, for nodes with use_sim_time. rclcpp and rclpy subscribe best-effort, `ros2 topic echo` may not.
CLOCK = Topic("/clock", Clock, NEWEST, "simulation time")

# Inputs and outputs of a live scene (live_simulator_node.py). Of velocities and hand targets only the newest counts, of
# balls all. Topics of standard tools are relative, those that only this node has are private.
COMMANDS = QoSProfile(depth=10, reliability=ReliabilityPolicy.RELIABLE)
THROW_BALL = Topic("~/throw_ball", ThrowBall, COMMANDS, "a ball to throw into the scene")
HAND_TARGET = Topic("~/hand_target", HandTarget, NEWEST, "a hand that drags a fragment")
SIMULATION_STATUS = Topic("~/status", SimulationStatus, NEWEST, "step, times, rate, last rejected command")
CMD_VEL = Topic("cmd_vel", Twist, NEWEST, "velocity of the hammer: linear, world axes")
# Of a robot: target and actual positions of its joints; only `name` and `position` of a command count.
JOINT_COMMANDS = Topic("joint_commands", JointState, COMMANDS, "target angles of the robot's joints")
JOINT_STATES = Topic("joint_states", JointState, NEWEST, "angles, speeds and motor torques of the robot's joints")
# QoS as of robot_state_publisher and of tf2_ros's broadcasters.
ROBOT_DESCRIPTION = Topic("robot_description", String, LATCHED_NEWEST, "the robot as URDF, with its motors' torques")
TF = Topic("/tf", TFMessage, QoSProfile(depth=100), "frames of the robot's links, each in that of its parent")
TF_STATIC = Topic("/tf_static", TFMessage, LATCHED_NEWEST, "frame of the robot's base link in the world")

TOPICS = (BODIES, FRACTURE_EVENTS, FRAGMENT_STATES, CONTACT_CONSTRAINTS, FRAGMENTS, FRAGMENT_MESHES)


def of_node(topic: Topic, node: str) -> Topic:
    """A private topic of `node`, as named by another node of the same namespace."""
    return topic._replace(name=topic.name.replace("~", node, 1))


def recording(qos: QoSProfile) -> QoSProfile:
    """A recorder's QoS: the same reliability and durability, and no message overwritten before it was taken."""
    return QoSProfile(history=HistoryPolicy.KEEP_ALL, reliability=qos.reliability, durability=qos.durability)
