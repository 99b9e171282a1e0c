"""ROS overhead of a small scene's steps with each executor: from states published to contacts received.

    python -m benchmarks.executors [--scene plates] [--seconds 1] [--repeats 3] [--watched]

Service and simulator are the project's own nodes. `single` is rclpy's SingleThreadedExecutor, `events` the
EventsExecutor, which they use. Repeats are interleaved. With `--watched`, a recorder and two more nodes subscribe.
"""

from __future__ import annotations

import argparse
import os
import signal
import subprocess
import sys
import tempfile
import time
from contextlib import ExitStack, suppress
from pathlib import Path

import numpy as np
import rclpy
import yaml
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor

from fracture_collision.ros.processes import executor
from fracture_collision.ros.processes.node_process import free_domain_id, loopback_environment
from fracture_collision.ros.processes.timing_files import SERVICE_COLUMNS, SIMULATOR_COLUMNS
from fracture_collision.ros.start import start
from fracture_collision.ros.wire import qos
from fracture_collision.share import share_directory

EXECUTORS = {"single": SingleThreadedExecutor, "events": executor.EventsExecutor}
WARM_UP = 20  # steps
PATIENCE = 60.0  # [s] for one run


def main() -> None:
    """Prints a table, or runs one node with an executor, for this program's own child processes."""
    if sys.argv[1:] == ["--listen"]:
        _listen()
        return
    if sys.argv[1:2] == ["--node"]:
        executor.EventsExecutor = EXECUTORS[sys.argv[2]]
        del sys.argv[1:3]
        sys.argv[:2] = sys.argv[1:2]
        sys.exit(start(sys.argv[0]))
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scene", default="plates", help="a scene of config/scenes (default: plates)")
    parser.add_argument("--seconds", type=float, default=1.0, help="simulated time (default: 1)")
    parser.add_argument("--repeats", type=int, default=3, help="runs with each executor (default: 3)")
    parser.add_argument("--watched", action="store_true", help="a recorder and two more nodes subscribe to the run")
    options = parser.parse_args()
    found: dict[str, list[np.ndarray]] = {name: [] for name in EXECUTORS}
    for _ in range(options.repeats):
        for name, times in found.items():
            times.append(_overhead(name, options.scene, options.seconds, options.watched))
    print(f"{options.scene}, {options.seconds:g} s, {options.repeats} runs each; overhead of a step in ms")
    print(f"{'executor':10}{'median':>8}{'99 %':>8}  medians of the runs")
    for name, times in found.items():
        together = 1e3 * np.concatenate(times)
        medians = ", ".join(f"{1e3 * np.median(each):.2f}" for each in times)
        print(f"{name:10}{np.median(together):8.2f}{np.percentile(together, 99):8.2f}  {medians}")


def _listen() -> None:
    """A node that subscribes to states and contacts, as rclpy deserializes them, until it is interrupted."""
    rclpy.init()
    node = rclpy.create_node(f"listener_{os.getpid()}")
    for topic in (qos.FRAGMENT_STATES, qos.CONTACT_CONSTRAINTS):
        node.create_subscription(topic.message_class, topic.name, lambda message: None, topic.qos)
    with suppress(KeyboardInterrupt, ExternalShutdownException):
        rclpy.spin(node)


def _overhead(name: str, scene: str, seconds: float, watched: bool) -> np.ndarray:
    """[s] of each step after WARM_UP: round trip less the service's computation."""
    with tempfile.TemporaryDirectory() as temporary, ExitStack() as stack:
        folder, domain_id = Path(temporary), free_domain_id()
        content = yaml.safe_load((share_directory() / "config" / "scenes" / f"{scene}.yaml").read_text())
        file = folder / f"{scene}.yaml"
        file.write_text(yaml.safe_dump(content | {"duration": seconds}))

        def program(log_name: str, *arguments: str) -> subprocess.Popen:
            command = [sys.executable, "-m", "benchmarks.executors", *arguments]
            log = stack.enter_context((folder / f"{log_name}.log").open("wb"))
            process = subprocess.Popen(
                command, env=loopback_environment(domain_id), stdout=log, stderr=log, cwd=Path(__file__).parents[1]
            )
            stack.callback(process.wait)
            stack.callback(process.kill)
            return process

        def node(module: str, **parameters: object) -> subprocess.Popen:
            given = [part for key, value in parameters.items() for part in ("-p", f"{key}:={value}")]
            return program(module, "--node", name, module, "--ros-args", *given)

        service = node("collision_node", threads=1, timing_file=folder / "service.npy")
        if watched:
            node("recorder_node", folder=folder / "bag")
            for number in range(2):
                program(f"listener_{number}", "--listen")
        simulator = node(
            "simulator_node", scene=file, timing_file=folder / "simulator.npy", wait_for_subscribers=4 if watched else 1
        )
        deadline = time.monotonic() + PATIENCE
        while simulator.poll() is None:
            if service.poll() is not None or time.monotonic() > deadline:
                logs = "\n".join(log.read_text()[-1500:] for log in folder.glob("*.log"))
                raise RuntimeError(f"no end with executor {name}:\n{logs}")
            time.sleep(0.05)
        os.kill(service.pid, signal.SIGINT)
        service.wait(PATIENCE)
        simulated = dict(zip(SIMULATOR_COLUMNS, np.load(folder / "simulator.npy").T, strict=True))
        answered = np.load(folder / "service.npy")
    # if states were published again, one step has two answers
    columns = dict(zip(SERVICE_COLUMNS, answered[np.unique(answered[:, 0], return_index=True)[1]].T, strict=True))
    _, here, there = np.intersect1d(simulated["step"], columns["step"], return_indices=True)
    return (simulated["round_trip"][here] - columns["collision"][there] - columns["update"][there])[WARM_UP:]


if __name__ == "__main__":
    main()
