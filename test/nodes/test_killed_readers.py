"""A writer still serves new readers after many readers were killed while reading."""

from __future__ import annotations

import selectors
import subprocess
import sys
import time

import pytest

from fracture_collision.ros.processes.node_process import free_domain_id

KILLS = 60  # with Fast DDS's default segment of 512 kB, readers got no large messages after 25 to 30 kills
PATIENCE = 20.0  # [s] on a loaded machine
LATCHED = 6
WRITER = """
import sys, time, array
from std_msgs.msg import UInt8MultiArray
from fracture_collision.ros.wire import qos
from fracture_collision.ros.processes.own_context import own_context
import rclpy
node = rclpy.create_node("writer", context=own_context(int(sys.argv[1])))
large = node.create_publisher(UInt8MultiArray, "large", qos.LATCHED)
small = node.create_publisher(UInt8MultiArray, "small", qos.EACH_STEP)
for _ in range(int(sys.argv[2])):
    large.publish(UInt8MultiArray(data=array.array("B", bytes(150_000))))
print("there", flush=True)
message = UInt8MultiArray(data=array.array("B", bytes(60_000)))
while True:
    small.publish(message)
    time.sleep(0.001)
"""
READER = """
import sys
from std_msgs.msg import UInt8MultiArray
from fracture_collision.ros.wire import qos
from fracture_collision.ros.processes.own_context import own_context
import rclpy
from rclpy.executors import SingleThreadedExecutor
context = own_context(int(sys.argv[1]))
node = rclpy.create_node("reader", context=context)
seen = []
def take(message):
    seen.append(message)
    if len(seen) == int(sys.argv[2]):
        print("all", flush=True)
node.create_subscription(UInt8MultiArray, "large", take, qos.LATCHED, raw=True)
node.create_subscription(UInt8MultiArray, "small", lambda _: None, qos.EACH_STEP, raw=True)
executor = SingleThreadedExecutor(context=context)
executor.add_node(node)
executor.spin()
"""


def said(program: subprocess.Popen[str]) -> str:
    with selectors.DefaultSelector() as selector:
        selector.register(program.stdout, selectors.EVENT_READ)
        return program.stdout.readline() if selector.select(PATIENCE) else ""


@pytest.mark.slow
def test_a_writer_still_delivers_after_its_readers_were_killed() -> None:
    """Each is killed some milliseconds after receiving all latched messages, under continuous traffic."""
    domain = str(free_domain_id())

    def started(program: str) -> subprocess.Popen[str]:
        return subprocess.Popen(
            [sys.executable, "-c", program, domain, str(LATCHED)], stdout=subprocess.PIPE, text=True
        )

    with started(WRITER) as writer:
        try:
            assert said(writer) == "there\n"
            for kill in range(KILLS):
                with started(READER) as reader:
                    try:
                        assert said(reader) == "all\n", f"the reader after {kill} kills"
                        time.sleep(0.001 * (kill % 20))  # at a different time after each start
                    finally:
                        reader.kill()
        finally:
            writer.kill()
