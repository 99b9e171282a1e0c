"""Lower bound for rclpy: a node that answers states with precomputed bytes, written like rclpy's own examples.

    python -m benchmarks.scaling.floors.plain_echo ANSWER_FILE SECONDS TIMES_FILE

No parameters, no records, no other clients. In place of the computation it walks through memory for SECONDS per query,
as that is what evicts code from all caches. On shutdown it writes the actual durations [s] to TIMES_FILE. Used by
round_trips.py.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path

import numpy as np
import rclpy
from rclpy.executors import ExternalShutdownException

from fracture_collision.ros.wire import qos

FOOTPRINT = 8 << 20  # [bytes], about the size of an answer's geometry


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
