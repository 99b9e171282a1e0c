"""A simulator whose states leave out the floor: whether the service ever answers without it.

    python -m campaigns.late_floor

Topics have no mutual order, so states may overtake the floor's message at the start of a run, and whenever a restarted
service receives the log anew. Each trial begins a run or kills the service, and reads all answers that follow.
"""

from __future__ import annotations

import os
import shutil
import signal
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import click
import numpy as np
import rclpy
from rclpy.executors import SingleThreadedExecutor

from campaigns.kills.stage import Stage, await_ready, stage
from fracture_collision.cli.console import interrupt_on_signals
from fracture_collision.records import BOX, CollisionBody, FragmentStates, SolidPrimitive
from fracture_collision.ros.processes.node_process import NodeProcess
from fracture_collision.ros.processes.own_context import own_context
from fracture_collision.ros.wire import qos
from fracture_collision.ros.wire.conversion import heading, to_message

FLOOR = CollisionBody(2, 2, plane=np.array([0.0, 0.0, 1.0, 0.0]), is_static=True, sequence=2)
BODY = CollisionBody(1, 1, primitive=SolidPrimitive(BOX, (1.0, 1.0, 1.0)), sequence=1)
SINKS = FragmentStates(
    1, 0, np.array([1]), np.array([0.0, 0.0, 0.49]), np.array([0.0, 0.0, 0.0, 1.0]), body_sequence=2
)  # fmt: skip
PATIENCE = 60.0  # [s]
ASK_EVERY = 0.01  # [s]


class Findings(NamedTuple):
    """What the answers of all trials were."""

    trials: int
    answers: int
    without_floor: int
    unanswered: int


class Simulator:
    """Publishes a body, the floor and states, in this order and without waiting; collects the answers."""

    def __init__(self, domain_id: int) -> None:
        self._context = own_context(domain_id)
        self._node = rclpy.create_node("late_floor", context=self._context)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._node)
        self._publishers = {
            topic.name: self._node.create_publisher(topic.message_class, topic.name, topic.qos)
            for topic in (qos.BODIES, qos.FRAGMENT_STATES)
        }
        self._node.create_subscription(
            qos.CONTACT_CONSTRAINTS.message_class, qos.CONTACT_CONSTRAINTS.name, self._on_answer,
            qos.CONTACT_CONSTRAINTS.qos,
        )  # fmt: skip
        self._run_id, self._step = 0, 0
        self._answers: list[Any] = []

    def await_service(self) -> None:
        """Until it subscribes and its answers can arrive."""
        publishers, topic = self._publishers.values(), qos.CONTACT_CONSTRAINTS.name
        while not (all(each.get_subscription_count() for each in publishers) and self._node.count_publishers(topic)):
            self._executor.spin_once(timeout_sec=ASK_EVERY)

    def begin_run(self) -> None:
        """Announces both bodies of a new run and asks at once."""
        self._run_id += 1
        for body in (BODY, FLOOR):
            self._publish(qos.BODIES, body)
        self.ask()

    def ask(self) -> None:
        """Publishes the next states."""
        self._step += 1
        self._answers.clear()
        self._publish(qos.FRAGMENT_STATES, SINKS._replace(step=self._step))

    def answers(self) -> list[Any]:
        """Publishes further states until they are answered."""
        for _ in range(int(PATIENCE / ASK_EVERY)):
            self._executor.spin_once(timeout_sec=ASK_EVERY)
            if self._answers:
                break
            self._step += 1
            self._publish(qos.FRAGMENT_STATES, SINKS._replace(step=self._step))
        return list(self._answers)

    def close(self) -> None:
        """Ends the node."""
        self._executor.shutdown()
        self._node.destroy_node()
        self._context.try_shutdown()

    def _publish(self, topic: qos.Topic, record: Any) -> None:
        self._publishers[topic.name].publish(to_message(record, heading(0.0), self._run_id))

    def _on_answer(self, message: Any) -> None:
        if message.run_id == self._run_id:
            self._answers.append(message)


def late_floor(folder: Path, starts: int, restarts: int, progress: Callable[[str], None]) -> Findings:
    """`starts` new runs of one service, then `restarts` of a killed one in the middle of a run."""
    answers = without_floor = unanswered = 0
    with stage(folder) as nodes:
        service = _service(nodes)
        simulator = Simulator(nodes.domain_id)
        try:
            simulator.await_service()
            for trial in range(starts + restarts):
                progress(f"trial {trial + 1} of {starts + restarts}, {without_floor} answers without the floor")
                if trial < starts:
                    simulator.begin_run()
                else:
                    os.kill(service.pid, signal.SIGKILL)
                    service.wait(PATIENCE)
                    nodes.forget(service)
                    service = nodes.start("collision_node", threads=1)
                    simulator.ask()
                came = simulator.answers()
                answers += len(came)
                without_floor += sum(not len(answer.gaps) for answer in came)
                unanswered += not came
        finally:
            simulator.close()
    return Findings(starts + restarts, answers, without_floor, unanswered)


def _service(nodes: Stage) -> NodeProcess:
    service = nodes.start("collision_node", threads=1)
    await_ready(service)
    return service


@click.command(context_settings={"show_default": True, "help_option_names": ["-h", "--help"]})
@click.option("--starts", default=400, type=click.IntRange(min=0), help="New runs of one service.")
@click.option("--restarts", default=100, type=click.IntRange(min=0), help="Kills of the service within a run.")
@click.option("--out", default=Path("out/late_floor"), type=click.Path(path_type=Path), help="Logs.")
def main(starts: int, restarts: int, out: Path) -> None:
    """States that leave out the floor, right after its message: every answer must have it.

    Ends with status 1 if an answer lacks the floor, or states are not answered.
    """
    from rich.console import Console

    interrupt_on_signals()
    shutil.rmtree(out, ignore_errors=True)
    with Console(stderr=True).status("starting") as status:
        found = late_floor(out, starts, restarts, status.update)
    Console().print(
        f"{found.trials} starts and restarts, {found.answers} answers: {found.without_floor} without the floor,"
        f" {found.unanswered} trials without an answer"
    )
    raise SystemExit(bool(found.without_floor or found.unanswered))


if __name__ == "__main__":
    main()
