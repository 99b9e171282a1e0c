"""The topics, their types and quality of service: named once, used by every node."""

from __future__ import annotations

from typing import Any, NamedTuple

from geometry_msgs.msg import Twist
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import JointState
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

# Only the newest step is worth an answer.
EACH_STEP = QoSProfile(
    history=HistoryPolicy.KEEP_LAST,
    depth=1,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.VOLATILE,
)


class Topic(NamedTuple):
    """A topic with its type and its quality of service."""

    name: str  # relative to the node's namespace
    message_class: Any
    qos: QoSProfile  # as offered by its publisher


BODIES = Topic("bodies", CollisionBody, LATCHED)
FRACTURE_EVENTS = Topic("fracture_events", FractureEvent, LATCHED)
FRAGMENT_STATES = Topic("fragment_states", FragmentStates, EACH_STEP)
CONTACT_CONSTRAINTS = Topic("contact_constraints", ContactConstraintArray, EACH_STEP)
FRAGMENTS = Topic("fragments", FragmentRegistry, LATCHED_NEWEST)
FRAGMENT_MESHES = Topic("fragment_meshes", FragmentMesh, LATCHED)

# For RViz and Foxglove (ros/wire/markers.py): for late joiners the last message.
MARKERS = Topic("markers", MarkerArray, LATCHED_NEWEST)

# Inputs and outputs of a live scene (live_simulator_node.py). Of velocities and hand targets only the newest counts, of
# balls all.
COMMANDS = QoSProfile(depth=10, reliability=ReliabilityPolicy.RELIABLE)
THROW_BALL = Topic("throw_ball", ThrowBall, COMMANDS)
HAND_TARGET = Topic("hand_target", HandTarget, EACH_STEP)
CMD_VEL = Topic("cmd_vel", Twist, EACH_STEP)
# Of an arm: target and actual positions of its joints; only `name` and `position` of a command count.
JOINT_COMMANDS = Topic("joint_commands", JointState, COMMANDS)
JOINT_STATES = Topic("joint_states", JointState, EACH_STEP)
SIMULATION_STATUS = Topic("simulation_status", SimulationStatus, EACH_STEP)
ANSWER_TIMES = Topic("answer_times", AnswerTimes, EACH_STEP)

TOPICS = (BODIES, FRACTURE_EVENTS, FRAGMENT_STATES, CONTACT_CONSTRAINTS, FRAGMENTS, FRAGMENT_MESHES)


def recording(qos: QoSProfile) -> QoSProfile:
    """A recorder's QoS: the same reliability and durability, and no message overwritten before it was taken."""
    return QoSProfile(history=HistoryPolicy.KEEP_ALL, reliability=qos.reliability, durability=qos.durability)
