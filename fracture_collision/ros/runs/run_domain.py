"""The ROS domain of a run. Two runs in one domain would take each other's bodies, states and contacts for their own."""

from __future__ import annotations

import os
import socket
import struct
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from fracture_collision.ros.processes.node_process import (
    PORT_BASE,
    PORTS_A_DOMAIN,
    default_domain_id,
    free_domain_id,
)
from fracture_collision.ros.wire.interfaces import COLLISION_NODE, LIVE_SIMULATOR_NODE, SIMULATOR_NODE

OF_A_RUN = frozenset({COLLISION_NODE, SIMULATOR_NODE, LIVE_SIMULATOR_NODE})  # others may join any run
_CREDENTIALS = struct.Struct("iII")  # of unix(7): process, user, group


class DomainTaken(RuntimeError):
    """Its text has the processes that use the domain, and what to do."""


@contextmanager
def run_domain(default: int | None = None) -> Iterator[int]:
    """A domain without another run, as long as it lasts.

    ROS_DOMAIN_ID if the user has set it, so that the user's own nodes can join; otherwise `default` or, if that is
    taken or None, a free one. Raises DomainTaken, also if ROS_DOMAIN_ID is not a number.
    """
    if is_given := bool(os.environ.get("ROS_DOMAIN_ID")):
        try:
            default = default_domain_id()
        except ValueError as error:
            raise DomainTaken(str(error)) from error
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as claim:
        try:
            domain_id = free_domain_id() if default is None else default
            _claim(claim, domain_id)
        except DomainTaken:
            if is_given:
                raise
            domain_id = free_domain_id()
            _claim(claim, domain_id)
        yield domain_id


def _claim(claim: socket.socket, domain_id: int) -> None:
    """Binds `claim` to the domain's name, which one process of the machine can do. Raises DomainTaken."""
    name = f"\0fracture_collision/run/{domain_id}"
    if users := _nodes(domain_id):
        raise _taken(domain_id, users)
    try:
        claim.bind(name)
        claim.listen()
    except OSError as error:
        raise _taken(domain_id, _owner(name)) from error


def _taken(domain_id: int, users: str) -> DomainTaken:
    return DomainTaken(
        f"ROS domain {domain_id} is taken by {users}. End that run, or set ROS_DOMAIN_ID to another number; without"
        " ROS_DOMAIN_ID a free domain is chosen."
    )


def _nodes(domain_id: int) -> str:
    """Services and simulators in the domain, started in whatever way."""
    commands = {pid: _command(pid) for pid in processes_in(domain_id)}
    nodes = ((pid, OF_A_RUN.intersection(Path(word).name for word in words)) for pid, words in commands.items())
    return ", ".join(f"{min(names)} (process {pid})" for pid, names in nodes if names)


def processes_in(domain_id: int) -> list[int]:
    """Ids of the processes of this machine with participants in the domain; those of other users only for root.

    A participant of any middleware has a UDP port of the domain (DDSI-RTPS 2.2, 9.6.1.1).
    """
    first = PORT_BASE + PORTS_A_DOMAIN * domain_id
    table = [line.split() for line in Path("/proc/self/net/udp").read_text().splitlines()[1:]]
    ports = range(first, first + PORTS_A_DOMAIN)
    links = {f"socket:[{words[9]}]" for words in table if int(words[1].rpartition(":")[2], 16) in ports}
    if not links:
        return []
    pids = sorted(int(name) for name in os.listdir("/proc") if name.isdigit())
    return [pid for pid in pids if not links.isdisjoint(_open_files(pid))]


def _open_files(pid: int) -> Iterator[str]:
    """What a process has open; nothing if we may not know, or it has ended."""
    with suppress(OSError):
        for file in Path(f"/proc/{pid}/fd").iterdir():
            with suppress(OSError):  # closed in the meantime
                yield os.readlink(file)


def _owner(name: str) -> str:
    """The process that listens on the socket `name`."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as client:
        try:
            client.connect(name)
            pid, _, _ = _CREDENTIALS.unpack(
                client.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, _CREDENTIALS.size)
            )
        except OSError:  # it has just ended, or is just starting
            return "another run"
    words = _command(pid)
    scripts = [at for at, word in enumerate(words) if Path(word).name == "fracture-collision"]
    what = " ".join(["fracture-collision", *words[scripts[0] + 1 :]]) if scripts else "a run"
    return f"{what[:80]} (process {pid})"


def _command(pid: int) -> list[str]:
    """The words of the process's command line; none if it has ended."""
    try:
        return Path(f"/proc/{pid}/cmdline").read_text(errors="replace").rstrip("\0").split("\0")
    except OSError:
        return []
