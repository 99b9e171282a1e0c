"""The other nodes of a domain: their names, and the removal of those that were killed."""

from __future__ import annotations

import time
from collections.abc import Iterable

from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.topic_endpoint_info import TopicEndpointInfo

from fracture_collision.ros.fastdds.farewell import participants_here, say_farewell_of
from fracture_collision.ros.fastdds.message_origin import participant_of
from fracture_collision.ros.fastdds.participant_process import (
    Process,
    are_of_one_host,
    is_dead,
    is_of_this_process,
    is_stopped,
    process_of,
)

EVERYBODYS_TOPICS = ("/rosout", "/parameter_events")  # a node publishes both unless configured not to
LOOK_INTERVAL = 1.0  # [s]
LONGEST_FAREWELL = 0.1  # [s] one takes effect in less than a millisecond, or not at all
# Participants are usually discovered within a second; one that misses the first announcement gets the next after 3 s.
LONGEST_ACQUAINTANCE = 3.5  # [s]
QUIET = 0.1  # [s] without a new participant
_DISCOVERY_TOPIC = "ros_discovery_info"  # rmw's own topic, which each participant reads
_UNKNOWN = "_NODE_NAME_UNKNOWN_"  # rmw's name for a node of which it has discovered publishers only


class Neighbours:
    """Checks the other participants once a second while its node spins, and on each call of `look`."""

    def __init__(self, node: Node, sees_processes: bool = True) -> None:
        """`sees_processes`: whether participants of this machine are counted, and dead and stopped ones detected."""
        self._node = node
        self._sees_processes = sees_processes
        self._names: dict[bytes, str] = {}
        self._processes: dict[bytes, Process | None] = {}  # None: not known to be of this machine
        self.dead: set[bytes] = set()  # dead participants that are still listed, or were at the last look
        # By topic, the subscribers of a message that not all acknowledged in time: at least one of them is slow.
        self.slow: dict[str, frozenset[bytes]] = {}
        self._count, self._count_since = 0, time.monotonic()  # of participants, at the last are_all_known
        # Not the node's clock: under use_sim_time it stands still until /clock is published.
        node.create_timer(LOOK_INTERVAL, self.look, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def await_all(self) -> bool:
        """Waits until all participants of this machine and their subscriptions are discovered.

        Earlier messages would not reach them. False: timed out after LONGEST_ACQUAINTANCE.
        """
        deadline = time.monotonic() + LONGEST_ACQUAINTANCE
        while not self.are_all_known():
            if time.monotonic() > deadline:
                return False
            time.sleep(0.01)
        return True

    def are_all_known(self) -> bool:
        """Whether all participants of this machine are discovered.

        Their number must also have stayed the same for QUIET, as far as the earlier calls show.
        """
        count = len(self._node.get_subscriptions_info_by_topic(_DISCOVERY_TOPIC, no_mangle=True))
        if count != self._count:
            self._count, self._count_since = count, time.monotonic()
        if time.monotonic() - self._count_since < QUIET:
            return False
        return not self._sees_processes or count >= participants_here(self._node.context.get_domain_id())

    def look(self, *more: TopicEndpointInfo) -> None:
        """Registers new participants, including those of `more`, and removes those with a dead process."""
        infos = [*more, *self._everybody()]
        present = {participant_of(bytes(info.endpoint_gid)) for info in infos}
        for known in (self._names, self._processes):
            for participant in known.keys() - present:
                del known[participant]
        self.dead &= present
        for info in infos:
            if not is_nameless(info):
                name = f"{info.node_namespace.rstrip('/')}/{info.node_name}"
                self._names[participant_of(bytes(info.endpoint_gid))] = name
        own = self._own(infos) if self._sees_processes else None
        if own is None:
            return
        for participant in sorted(present - self._processes.keys()):
            is_near = are_of_one_host(participant, own) and participant != own
            self._processes[participant] = process_of(participant) if is_near else None
        for participant in sorted(present - {own}):
            process = self._processes[participant]
            if process is not None and is_dead(process):
                self._bury(participant)

    def name(self, participant: bytes) -> str:
        """Node name with part of the GUID, since two nodes may share a name; and whether its process is stopped."""
        if not participant:
            return "a node"
        process = self._processes.get(participant)
        state = ", stopped" if process is not None and is_stopped(process) else ""
        return f"{self._names.get(participant, 'a node')} [{participant[4:].hex()}]{state}"

    def are_some_stopped(self, participants: Iterable[bytes]) -> bool:
        """Considers only known processes of this machine."""
        processes = (self._processes.get(participant) for participant in participants)
        return any(process is not None and is_stopped(process) for process in processes)

    def names(self, participants: Iterable[bytes]) -> str:
        """Their names in one text, sorted; "none" if there are none."""
        return ", ".join(sorted(map(self.name, participants))) or "none"

    def said_of_the_slow(self) -> str:
        """Topics with a slow subscriber, each with all subscribers that may be the slow one."""
        return "; ".join(f"{topic}: {self.names(who)}" for topic, who in sorted(self.slow.items())) or "none"

    def _everybody(self) -> list[TopicEndpointInfo]:
        return [info for topic in EVERYBODYS_TOPICS for info in self._node.get_publishers_info_by_topic(topic)]

    def _own(self, infos: list[TopicEndpointInfo]) -> bytes | None:
        own_name = self._node.get_name(), self._node.get_namespace()
        for info in infos:
            participant = participant_of(bytes(info.endpoint_gid))
            if (info.node_name, info.node_namespace) == own_name and is_of_this_process(participant):
                return participant
        return None

    def _bury(self, participant: bytes) -> None:
        say_farewell_of(participant, self._node.context.get_domain_id())
        if participant in self.dead:  # an earlier farewell had no effect, and this one may have none
            return
        self.dead.add(participant)
        deadline = time.monotonic() + LONGEST_FAREWELL
        while (is_listed := self._lists(participant)) and time.monotonic() < deadline:
            time.sleep(0.001)
        outcome = "stays listed until its lease expires" if is_listed else "is removed"
        self._node.get_logger().info(f"{self.name(participant)} has died; its participant {outcome}")

    def _lists(self, participant: bytes) -> bool:
        return any(participant_of(bytes(info.endpoint_gid)) == participant for info in self._everybody())


def is_nameless(info: TopicEndpointInfo) -> bool:
    """The name of its node has not been discovered yet."""
    return info.node_name.startswith(_UNKNOWN)
