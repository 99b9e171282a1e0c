"""The least that rclpy takes: a node that answers states with bytes made beforehand, as rclpy's own examples would.

    python -m benchmarks.scaling.floors.plain_echo ANSWER_FILE SECONDS TIMES_FILE

No parameters, no records, nobody else to look after; for SECONDS a question it goes through memory in place of the
computation, as that is what leaves no code in any cache. When told to end it writes how long it really took each time
[s]. round_trips.py asks it.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path

import numpy as np
import rclpy
from rclpy.executors import ExternalShutdownException

from fracture_collision.ros.wire import qos

FOOTPRINT = 8 << 20  # [bytes], about what an answer's geometry takes


def main(answer_file: str, seconds: str, times_file: str) -> None:
    answer, span = Path(answer_file).read_bytes(), float(seconds)
    times: list[float] = []
    memory = np.zeros(FOOTPRINT, np.uint8)
    rclpy.init()
    node = rclpy.create_node("plain_echo")
    publisher = node.create_publisher(
        qos.CONTACT_CONSTRAINTS.message_class, qos.CONTACT_CONSTRAINTS.name, qos.CONTACT_CONSTRAINTS.qos
    )

    def take(data: bytes) -> None:
        began = time.perf_counter()
        while time.perf_counter() < began + span:
            memory[:] += 1
        times.append(time.perf_counter() - began)
        publisher.publish(answer)

    states = qos.FRAGMENT_STATES
    node.create_subscription(states.message_class, states.name, take, states.qos, raw=True)
    try:
        rclpy.spin(node)
    except (KeyboardInterrupt, ExternalShutdownException):
        np.save(Path(times_file), times)


if __name__ == "__main__":
    main(*sys.argv[1:])
