"""Service and recorder killed at the worst moments: during startup, at fractures, both at once.

Counts nodes that do not recover: one that is up and receives nothing (deaf), and one that does not end when told to
(hung). The output of runs is compared elsewhere (trials.py).
"""

from __future__ import annotations

import json
import math
import signal
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import numpy as np

from campaigns.kills.stage import (
    READY,
    Stage,
    answers_awaited,
    await_step,
    await_that,
    fault_at_end,
    stage,
    steps_told,
)
from fracture_collision.ros.processes.node_process import NodeProcess
from fracture_collision.ros.processes.process import LONGEST_END, age_of

Progress = Callable[[str], None]
DEAF_AFTER = 30.0  # [s] from a node's start, on a machine that is busy with other work
LONGEST_WAIT = 1.0  # [s] between two kills
LONGEST_START = 1.3  # [s] after a start until the kill, at most: about as long as a start takes
LONGEST_QUIET = 5.0  # [s] to wait for a fracture; then the kill happens without one
MOST_RUNS = 200
SERVICE, RECORDER = "service", "recorder"
VICTIMS = ((SERVICE,), (RECORDER,), (SERVICE, RECORDER))
MOMENTS = ("any", "fracture", "start")


class Answered(NamedTuple):
    """One kill of the service, or of both, after which the simulator got an answer that it had requested again."""

    victims: tuple[str, ...]
    moment: str
    seconds: float  # from the start of the new service's process


@dataclass
class Mixed:
    """What kills have shown so far."""

    kills: int = 0
    returns: list[Answered] = field(default_factory=list)
    deaf: list[str] = field(default_factory=list)  # descriptions
    faults: list[str] = field(default_factory=list)  # of nodes that ended by themselves or with an error
    longest_end: float = 0.0  # [s] from SIGINT to a node's end
    is_interrupted: bool = False


class _Trial:
    """A scene with its three nodes."""

    def __init__(self, nodes: Stage, folder: Path, scene: str) -> None:
        self._nodes, self._folder = nodes, folder
        self._bags = 0
        self.node = {name: self._start(name) for name in (RECORDER, SERVICE)}
        self.simulator = nodes.start("simulator_node", scene=scene, wait_for_subscribers=2, progress=True)

    def _start(self, name: str) -> NodeProcess:
        if name == SERVICE:
            return self._nodes.start("collision_node", threads=1)
        self._bags += 1
        folder = self._folder / f"bag_{self._bags}"
        return self._nodes.start("recorder_node", folder=str(folder), progress=True)

    def kill(self, *names: str) -> int:
        """Kills all at once and starts replacements. Returns how many were alive."""
        alive = [name for name in names if self.node[name].exit_status() is None]
        for name in alive:
            self.node[name].send_signal(signal.SIGKILL)
        for name in names:
            self.node[name].wait(60.0)
            self._nodes.forget(self.node[name])
        for name in names:
            self.node[name] = self._start(name)
        return len(alive)

    @property
    def is_over(self) -> bool:
        return self.simulator.exit_status() is not None

    def fragments(self) -> int:
        """As last reported by the simulator."""
        told = self.simulator.log_text().rpartition('"fragments": ')[2]
        return int(told.partition("}")[0]) if told.partition("}")[0].isdigit() else 0

    def await_moment(self, moment: str, seconds: float) -> None:
        count, began = self.fragments(), time.monotonic()
        longest = LONGEST_QUIET if moment == "fracture" else seconds

        def has_come() -> bool:
            broke = moment == "fracture" and self.fragments() > count
            return broke or self.is_over or time.monotonic() > began + longest

        await_that(has_come, "a moment")

    def hears(self, name: str) -> bool:
        """Whether a started node has received data."""
        text = self.node[name].log_text()
        if name == SERVICE:
            return READY in text and "run " in text
        lines = [line for line in text.splitlines() if line.startswith("{") and line.endswith("}")]
        counts = json.loads(lines[-1]) if lines else {}
        return counts.get("fragment_states", 0) > 0 and counts.get("contact_constraints", 0) > 0

    def await_all_up(self) -> None:
        """Waits for it: stop requests during startup are covered elsewhere (trials.orders_of_ending)."""
        bag = self._folder / f"bag_{self._bags}"
        recorder, service = self.node[RECORDER], self.node[SERVICE]
        await_that(lambda: bag.exists() or recorder.exit_status() is not None, "a recorder that is up")
        await_that(lambda: READY in service.log_text() or service.exit_status() is not None, "a service that is up")

    def come_back(self, names: tuple[str, ...], step: int) -> str:
        """Waits until the nodes recover; describes what is wrong, "" if nothing is."""
        began = time.monotonic()

        def is_settled() -> bool:
            ended = any(self.node[name].exit_status() is not None for name in names)
            all_hear = all(self.hears(name) for name in names) and steps_told(self.simulator) > step
            return all_hear or ended or self.is_over or time.monotonic() > began + DEAF_AFTER

        await_that(is_settled, "their return")
        if self.is_over or (all(self.hears(name) for name in names) and steps_told(self.simulator) > step):
            return ""
        logs = "\n".join(f"{name}: {self.node[name].log_text()[-1000:]}" for name in names)
        return f"{' and '.join(names)}, after step {step}:\n{logs}"


def kill_mixed(folder: Path, scene: str, times: int, seed: int, progress: Progress) -> Mixed:
    """`times`: SIGKILLs, in as many runs as needed. Ctrl-C ends it with what there is."""
    random, mixed = np.random.default_rng(seed), Mixed()
    try:
        for run in range(MOST_RUNS):
            if mixed.kills >= times or mixed.deaf:
                break
            own = folder / f"mixed_{run}"
            with stage(own) as nodes:
                _kill_in_a_run(_Trial(nodes, own, scene), mixed, times, random, progress)
    except KeyboardInterrupt:
        mixed.is_interrupted = True
    return mixed


def _kill_in_a_run(
    trial: _Trial, mixed: Mixed, times: int, random: np.random.Generator, progress: Progress
) -> None:  # fmt: skip
    await_step(trial.simulator, 0, *trial.node.values())
    while mixed.kills < times and not trial.is_over:
        progress(f"{mixed.kills} of {times} kills of service and recorder")
        victims, moment = VICTIMS[random.integers(3)], MOMENTS[random.integers(3)]
        trial.await_moment(moment, random.uniform(0.0, LONGEST_WAIT))
        if trial.is_over:
            break
        step = steps_told(trial.simulator)
        mixed.kills += trial.kill(*victims)
        if moment == "start":
            trial.await_moment("any", random.uniform(0.0, LONGEST_START))
            mixed.kills += trial.kill(*victims)
        awaited = len(answers_awaited(trial.simulator))
        started = time.time() - age_of(trial.node[SERVICE].pid)
        if fault := trial.come_back(victims, step):
            ended = [name for name in victims if trial.node[name].exit_status() is not None]
            (mixed.faults if ended else mixed.deaf).append(f"{moment}: {fault}")
            break
        came = answers_awaited(trial.simulator)[awaited:]
        if SERVICE in victims and came:
            mixed.returns.append(Answered(victims, moment, came[0] - started))
    trial.await_all_up()
    for node in (trial.simulator, *trial.node.values()):
        began = time.monotonic()
        if fault := fault_at_end(node, node.stop(patience=2.0 * LONGEST_END)):
            mixed.faults.append(fault)
        mixed.longest_end = max(mixed.longest_end, time.monotonic() - began)


def medians(returns: list[Answered]) -> dict[str, tuple[int, float, float]]:
    """Count, median and worst [s], by victims."""
    found = {}
    for victims in VICTIMS:
        seconds = [each.seconds for each in returns if each.victims == victims and math.isfinite(each.seconds)]
        if seconds:
            found[" and ".join(victims)] = len(seconds), float(np.median(seconds)), max(seconds)
    return found
