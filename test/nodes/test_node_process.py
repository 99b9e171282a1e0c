"""Nodes as processes: their age, priority and end, and what is left of one that could not write."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from stages.page_client import wait_until

from fracture_collision.process.full_disk import REMEDY, STATUS
from fracture_collision.ros.processes.node_process import NodeProcess, free_domain_id
from fracture_collision.ros.processes.process import age_of


def test_a_node_has_the_given_niceness(tmp_path: Path) -> None:
    own, niceness = os.getpriority(os.PRIO_PROCESS, 0), 5
    node = NodeProcess("recorder_node", {"folder": str(tmp_path / "bag")}, free_domain_id(), tmp_path / "log",
                       niceness=niceness)  # fmt: skip
    try:
        assert os.getpriority(os.PRIO_PROCESS, node.pid) == min(own + niceness, 19)
        of_session = Path(f"/proc/{node.pid}/autogroup")  # Linux only; empty without autogroup scheduling
        words = of_session.read_text().split() if of_session.is_file() else []
        if words and os.access(of_session, os.W_OK):
            assert words[-1] == str(niceness)
    finally:
        node.stop()


def test_a_node_whose_disk_is_full_says_so(tmp_path: Path) -> None:
    """Without a traceback; Linux's /dev/full rejects all that is written to it."""
    node = NodeProcess("collision_node", {"timing_file": "/dev/full"}, free_domain_id(), tmp_path / "log")
    try:
        wait_until(lambda: "ready" in node.log_text())
    finally:
        assert node.stop() == STATUS
    assert f"collision_node: No space left on device; {REMEDY}" in node.log_text()
    assert "Traceback" not in node.log_text()
    assert node.last_words().startswith(f"collision_node ended with status {STATUS} (the disk is full; {REMEDY})")


def test_the_age_of_a_process() -> None:
    with subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE) as child:
        assert 0.0 <= age_of(child.pid) < age_of(os.getpid())
    with pytest.raises(OSError):
        age_of(child.pid)


STUCK = """
import sys, time
import fracture_collision.ros.processes.process as process
where = sys.argv.pop()
process.LONGEST_END = 1.0
import rclpy, ctypes
from rclpy.node import Node
class Stuck(Node):
    def __init__(self):
        super().__init__("stuck")
    def destroy_node(self):
        if where == "end":
            ctypes.PyDLL(None).sleep(1000)  # as DDS may: with the interpreter's lock held
        super().destroy_node()
def work(node):
    print("working", flush=True)
    while where == "work":
        ctypes.CDLL(None).sleep(1000)
    while rclpy.ok():
        time.sleep(0.01)
sys.exit(process.run_node(Stuck, work))
"""


@pytest.mark.parametrize(("where", "order"), [("work", signal.SIGINT), ("end", signal.SIGTERM)])
def test_a_node_exits_in_time_even_if_dds_does_not_return(where: str, order: signal.Signals) -> None:
    environment = os.environ | {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
    process = subprocess.Popen([sys.executable, "-c", STUCK, where], stdout=subprocess.PIPE, text=True, env=environment)
    try:
        assert process.stdout.readline() == "working\n"
        process.send_signal(order)
        assert process.wait(20.0) == 1
    finally:
        process.kill()
        process.wait()
        process.stdout.close()
