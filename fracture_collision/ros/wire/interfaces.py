"""What each node publishes, subscribes to and serves: for --help and DDS permissions; compared with running nodes."""

from __future__ import annotations

from typing import Any, NamedTuple

from std_srvs.srv import SetBool, Trigger

from fracture_collision.ros.wire import qos

# default names
COLLISION_NODE, SIMULATOR_NODE, LIVE_SIMULATOR_NODE = "collision_node", "simulator_node", "live_simulator_node"


class Service(NamedTuple):
    """A service with its type."""

    name: str  # as a topic's
    service_class: Any
    description: str


class Interface(NamedTuple):
    """Topics and services of a node, beside those of every node."""

    subscribes: tuple[qos.Topic, ...] = ()
    publishes: tuple[qos.Topic, ...] = ()
    serves: tuple[Service, ...] = ()


RESET = Service("~/reset", Trigger, "starts the scene `next_scene` from its beginning, as a new run")
PAUSE = Service("~/pause", SetBool, "true: pauses the run, false: continues it")
STEP = Service("~/step", Trigger, "makes one step of a paused run")
REWIND = Service("~/rewind", Trigger, "goes back by up to ten simulated seconds, as a new run, and pauses it")

_RUN = (qos.BODIES, qos.FRACTURE_EVENTS, qos.FRAGMENT_STATES)
_TRANSFORMS = (qos.TF, qos.TF_STATIC) if qos.TFMessage is not None else ()

COLLISION = Interface(
    subscribes=_RUN,
    publishes=(
        qos.CONTACT_CONSTRAINTS, qos.FRAGMENTS, qos.FRAGMENT_MESHES, qos.MARKERS, qos.CONTACT_POSES, qos.ANSWER_TIMES,
        qos.DIAGNOSTICS,
    ),
)  # fmt: skip
SIMULATOR = Interface(subscribes=(qos.CONTACT_CONSTRAINTS, qos.FRAGMENTS), publishes=(*_RUN, qos.CLOCK))
LIVE_SIMULATOR = Interface(
    subscribes=(*SIMULATOR.subscribes, qos.CMD_VEL, qos.JOINT_COMMANDS, qos.THROW_BALL, qos.HAND_TARGET),
    publishes=(
        *SIMULATOR.publishes, qos.SIMULATION_STATUS, qos.JOINT_STATES, qos.ROBOT_DESCRIPTION, *_TRANSFORMS,
    ),
    serves=(RESET, REWIND, PAUSE, STEP),
)  # fmt: skip
LIVE_STATUS = qos.of_node(qos.SIMULATION_STATUS, LIVE_SIMULATOR_NODE)  # as others subscribe to it
RECORDER = Interface(subscribes=(*qos.TOPICS, qos.DIAGNOSTICS))
PAGE = Interface(
    subscribes=(
        *qos.TOPICS, LIVE_STATUS, qos.ANSWER_TIMES, qos.JOINT_STATES, qos.ROBOT_DESCRIPTION,
    ),
    publishes=(
        qos.CMD_VEL, qos.JOINT_COMMANDS, qos.of_node(qos.THROW_BALL, LIVE_SIMULATOR_NODE),
        qos.of_node(qos.HAND_TARGET, LIVE_SIMULATOR_NODE),
    ),
)  # fmt: skip
