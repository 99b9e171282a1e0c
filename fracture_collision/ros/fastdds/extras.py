"""All that the other folders use of this one, and the switch that turns off what depends on internals.

With FRACTURE_COLLISION_PLAIN_DDS=1 in its environment, a node uses only public interfaces of rclpy and rmw: rclpy's own
executor, no check of processes and ports, no message in the name of a dead participant, and no file of Fast DDS
removed. Contacts are the same. What is lost: docs/reliability.md, "Without the extras". The profile for LOCALHOST
(this_machine.py) stays: it keeps nodes off the network, and profiles are a public interface of Fast DDS.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from contextlib import AbstractContextManager, nullcontext
from typing import Any

from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node

from fracture_collision.ros.fastdds.acknowledged_publisher import AcknowledgedPublisher
from fracture_collision.ros.fastdds.farewell import PORT_BASE, PORTS_A_DOMAIN, processes_here
from fracture_collision.ros.fastdds.message_origin import Origin, participant_of
from fracture_collision.ros.fastdds.neighbours import Neighbours, is_nameless
from fracture_collision.ros.fastdds.own_ports import fault_of_own_ports
from fracture_collision.ros.fastdds.participant_process import age_of
from fracture_collision.ros.fastdds.shared_memory import remove_left_behind
from fracture_collision.ros.fastdds.successor_ports import orphaned_ports_held
from fracture_collision.ros.fastdds.this_machine import (
    LOCALHOST,
    PROFILES,
    RANGE,
    as_the_user_has_it,
    has_known_transports,
    keep_to_this_machine,
)

__all__ = [
    "LOCALHOST",
    "PROFILES",
    "RANGE",
    "AcknowledgedPublisher",
    "Neighbours",
    "Origin",
    "age_of",
    "as_the_user_has_it",
    "discovery_port",
    "fault_of_ports",
    "is_nameless",
    "is_plain",
    "keep_to_this_machine",
    "make_executor",
    "make_neighbours",
    "origin_of",
    "participant_of",
    "ports_for_new_node",
    "processes_in",
    "remove_unused_files",
]

SWITCH = "FRACTURE_COLLISION_PLAIN_DDS"
UNKNOWN = b""  # publisher of each message in a plain process


def is_plain() -> bool:
    """Whether the extras are switched off in this process."""
    return os.environ.get(SWITCH, "") not in ("", "0")


def make_executor(context: Context | None = None) -> SingleThreadedExecutor:
    """The executor of a node; for a raw message its callback may take a second argument, see `origin_of`."""
    if is_plain():
        return SingleThreadedExecutor(context=context)
    # imports private members of rclpy, which another version may lack
    from fracture_collision.ros.fastdds.prompt_executor import PromptExecutor

    return PromptExecutor(context=context)


def origin_of(second: Origin | Mapping[str, Any]) -> Origin:
    """Where a message came from, of a callback's second argument; rclpy's own does not name the publisher."""
    return second if isinstance(second, Origin) else Origin(UNKNOWN, second["publication_sequence_number"])


def make_neighbours(node: Node) -> Neighbours:
    """The other nodes; in a plain process without their processes, so that none is found dead or stopped."""
    return Neighbours(node, sees_processes=not is_plain())


def remove_unused_files() -> None:
    """Removes what killed nodes have left in shared memory."""
    if not is_plain():
        remove_left_behind()


def ports_for_new_node(domain_id: int) -> AbstractContextManager[Any]:
    """While a node is created, keeps it off the ports of killed nodes."""
    return nullcontext() if is_plain() else orphaned_ports_held(domain_id)


def fault_of_ports(domain_id: int) -> str:
    """Describes why this process's participant receives nothing; "" if it does, or if that cannot be determined."""
    return fault_of_own_ports(domain_id) if not is_plain() and has_known_transports(os.environ) else ""


def processes_in(domain_id: int) -> list[int]:
    """Ids of this user's processes with a node in the domain; none in a plain process."""
    return [] if is_plain() else processes_here(domain_id)


def discovery_port(domain_id: int) -> int:
    """The multicast port of a domain's discovery (DDSI-RTPS 2.2, 9.6.1.1)."""
    return PORT_BASE + PORTS_A_DOMAIN * domain_id
