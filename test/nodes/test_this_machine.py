"""Participants restricted to this machine open all their sockets on loopback."""

from __future__ import annotations

import os
import socket
import struct
import subprocess
import sys
from pathlib import Path

import pytest
from stages.ros_stage import StageWithClients

from fracture_collision.ros.processes.node_process import free_domain_id, loopback_environment
from fracture_collision.ros.processes.this_machine import PROFILES, RANGE, keep_to_this_machine

# A program that communicates with nodes it started, as `teleop` and `replay --ros` do. Exits at end of stdin.
OWN_CONTEXT = """
import sys, rclpy
from fracture_collision.ros.processes.own_context import own_context
context = own_context(int(sys.argv[1]))
node = rclpy.create_node("own", context=context)
print("there", flush=True)
sys.stdin.read()
"""


def udp_addresses(pid: int) -> set[str]:
    """Local addresses of the process's UDP sockets."""
    links = set()
    for descriptor in Path(f"/proc/{pid}/fd").iterdir():
        try:
            links.add(os.readlink(descriptor))
        except FileNotFoundError:  # closed in the meantime
            continue
    found = set()
    for family, table in ((socket.AF_INET, "udp"), (socket.AF_INET6, "udp6")):
        for line in Path(f"/proc/{pid}/net/{table}").read_text().splitlines()[1:]:
            words = line.split()
            if f"socket:[{words[9]}]" in links:
                digits = words[1].split(":")[0]
                parts = [int(digits[i : i + 8], 16) for i in range(0, len(digits), 8)]
                found.add(socket.inet_ntop(family, struct.pack(f"={len(parts)}I", *parts)))
    return found


@pytest.fixture(autouse=True)
def nothing_said(monkeypatch: pytest.MonkeyPatch) -> None:
    """Clears settings made by the user or by an earlier test in this process."""
    for name in (RANGE, *PROFILES, "ROS_STATIC_PEERS"):
        monkeypatch.delenv(name, raising=False)


def test_nodes_have_sockets_on_loopback_only_where_programs_set_up_as_in_readme_find_them(
    stage: StageWithClients,
) -> None:
    """With LOCALHOST and no XML profile."""
    node, _ = stage.served()
    assert udp_addresses(node.pid) == {"127.0.0.1"}
    look = """
import time, rclpy
rclpy.init()
node = rclpy.create_node("user")
end = time.monotonic() + 60.0
while not node.count_publishers("/contact_constraints"):
    assert time.monotonic() < end
    rclpy.spin_once(node, timeout_sec=0.05)
"""
    done = subprocess.run([sys.executable, "-c", look], env=loopback_environment(stage.domain_id), timeout=120.0)
    assert done.returncode == 0


def test_an_own_context_has_sockets_on_loopback_only() -> None:
    command = [sys.executable, "-c", OWN_CONTEXT, str(free_domain_id())]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as program:
        try:
            assert program.stdout.readline() == "there\n"
            assert udp_addresses(program.pid) == {"127.0.0.1"}
        finally:
            program.kill()


def test_settings_of_the_user_take_precedence_and_reach_child_processes(monkeypatch: pytest.MonkeyPatch) -> None:
    chosen = loopback_environment(7)
    assert chosen[RANGE] == "LOCALHOST" and PROFILES[0] not in chosen
    keep_to_this_machine(chosen)
    assert chosen[RANGE] == "SYSTEM_DEFAULT" and chosen[PROFILES[0]].endswith("this_machine.xml")
    for name in (RANGE, PROFILES[0]):
        monkeypatch.setenv(name, chosen[name])
    assert loopback_environment(7)[RANGE] == "LOCALHOST" and PROFILES[0] not in loopback_environment(7)
    for own in ({RANGE: "SUBNET"}, {RANGE: "LOCALHOST", PROFILES[1]: "mine.xml"}, {}):
        environment = dict(own)
        keep_to_this_machine(environment)
        assert environment == own
