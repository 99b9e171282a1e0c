"""Nodes that the project starts cannot be discovered from another machine, emulated by network namespaces."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from typing import NamedTuple

import pytest

from fracture_collision.ros.processes.node_process import free_domain_id, loopback_environment

HERE, ELSEWHERE = "10.213.7.1", "10.213.7.2"

# Runs on the other machine: counts the service's endpoints that a participant discovers within some seconds.
STRANGER = """
import sys, time, rclpy
rclpy.init()
node = rclpy.create_node("stranger")
deadline = time.monotonic() + float(sys.argv[1])
seen = 0
while time.monotonic() < deadline and not seen:
    seen = node.count_publishers("/contact_constraints") + node.count_subscribers("/fragment_states")
    time.sleep(0.05)
print("saw", seen)
"""
# A link that is not up yet hides a service, too.
LISTEN = f"import socket; s = socket.create_server(('{HERE}', 7999)); s.settimeout(25.0); s.accept()"
CONNECT = f"""
import socket, time
deadline = time.monotonic() + 20.0
while True:
    try:
        socket.create_connection(('{HERE}', 7999), timeout=1.0)
        break
    except OSError:
        if time.monotonic() > deadline:
            raise
        time.sleep(0.05)
"""
# Covers a service's startup and several DDS announcements, one every 3 s; a discoverable service is discovered
# within 5 s.
PATIENCE = 15.0  # [s]


class Machines(NamedTuple):
    """Two network namespaces joined by a veth pair, each with its own shared memory."""

    here: str
    elsewhere: str

    def start(self, machine: str, *command: str, **environment: str) -> subprocess.Popen:
        own_memory = 'mount -t tmpfs tmpfs /dev/shm && exec "$@"'
        return subprocess.Popen(
            ["ip", "netns", "exec", machine, "unshare", "--mount", "sh", "-c", own_memory, "sh", sys.executable]
            + list(command),
            env=environment, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
        )  # fmt: skip


def ip(*arguments: str) -> None:
    subprocess.run(["ip", *arguments], check=True, capture_output=True, timeout=20.0)


@pytest.fixture(scope="module")
def machines() -> Iterator[Machines]:
    number = os.getpid()
    machines = Machines(f"fc_here_{number}", f"fc_there_{number}")
    cable = (f"fch{number}"[:15], f"fct{number}"[:15])
    try:
        for machine in machines:
            ip("netns", "add", machine)
        ends = [(end, "netns", machine) for end, machine in zip(cable, machines, strict=True)]
        ip("link", "add", *ends[0], "type", "veth", "peer", *ends[1])
        for machine, end, address in zip(machines, cable, (HERE, ELSEWHERE), strict=True):
            ip("-n", machine, "addr", "add", f"{address}/24", "dev", end)
            for link in ("lo", end):
                ip("-n", machine, "link", "set", link, "up")
        pair = machines.start(machines.here, "-c", LISTEN), machines.start(machines.elsewhere, "-c", CONNECT)
        texts = [end.communicate(timeout=40.0)[0] for end in reversed(pair)]
        if any(end.returncode != 0 for end in pair):
            raise OSError("; ".join(texts))
    except (OSError, subprocess.CalledProcessError) as error:
        for machine in machines:
            subprocess.run(["ip", "netns", "del", machine], capture_output=True)
        said = getattr(error, "stderr", b"") or str(error)
        pytest.skip(f"network namespaces cannot be made here (that takes root and iproute2): {said}")
    yield machines
    for machine in machines:
        ip("netns", "del", machine)


def seen_from_elsewhere(machines: Machines, environment: dict[str, str], where: str = "", **stranger: str) -> bool:
    """Whether a participant on the other machine discovers a service started in `environment`."""
    domain = {"ROS_DOMAIN_ID": environment["ROS_DOMAIN_ID"], "ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET"}
    service = machines.start(machines.here, "-m", "fracture_collision.ros.service.collision_node", **environment)
    try:
        looks = machines.start(
            where or machines.elsewhere, "-c", STRANGER, str(PATIENCE), **(os.environ | domain | stranger)
        )
        text, _ = looks.communicate(timeout=PATIENCE + 60.0)
        assert looks.returncode == 0 and service.poll() is None, text
        return "saw 0" not in text
    finally:
        service.terminate()
        service.communicate(timeout=30.0)


@pytest.fixture
def default_environment(monkeypatch: pytest.MonkeyPatch) -> dict[str, str]:
    """The environment the project gives its nodes when the user has set nothing."""
    for name in ("ROS_AUTOMATIC_DISCOVERY_RANGE", "FASTRTPS_DEFAULT_PROFILES_FILE", "ROS_STATIC_PEERS"):
        monkeypatch.delenv(name, raising=False)
    return loopback_environment(free_domain_id())


@pytest.mark.slow
def test_another_machine_does_not_discover_the_service(machines: Machines, default_environment: dict[str, str]) -> None:
    assert not seen_from_elsewhere(machines, default_environment)


@pytest.mark.slow
def test_another_machine_does_not_discover_the_service_by_address(
    machines: Machines, default_environment: dict[str, str]
) -> None:
    assert not seen_from_elsewhere(machines, default_environment, ROS_STATIC_PEERS=HERE)


def test_the_same_machine_discovers_the_service(machines: Machines, default_environment: dict[str, str]) -> None:
    assert seen_from_elsewhere(machines, default_environment, where=machines.here)


def test_another_machine_discovers_a_service_on_the_network(
    machines: Machines, default_environment: dict[str, str]
) -> None:
    """The control: without it the tests above would prove nothing."""
    open_to_all = default_environment | {"ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET"}
    assert seen_from_elsewhere(machines, open_to_all)
