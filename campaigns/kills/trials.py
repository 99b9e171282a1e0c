"""Runs of a scene in which a node is killed, each compared byte by byte with an undisturbed run."""

from __future__ import annotations

import itertools
import math
import signal
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np

from campaigns.kills.stage import (
    Digests,
    Stage,
    answers_awaited,
    await_end,
    await_ready,
    await_recording,
    await_step,
    await_that,
    await_words,
    digests,
    fault_at_end,
    must_end,
    ready_told,
    stage,
    steps_told,
)
from fracture_collision.ros.processes.node_process import NodeProcess
from fracture_collision.ros.processes.process import age_of

Progress = Callable[[str], None]
MOST_RUNS = 100  # if these do not contain the requested kills, the scene is too short
LONGEST_WAIT = 1.5  # [s]


class Return(NamedTuple):
    """A service that was killed and restarted. Seconds."""

    step: int  # last step completed by the simulator before the kill
    ready: float  # from the start of its process, from /proc, until it reports that it is ready
    answered: float  # from the start of its process to the arrival of its first answer; nan: the scene was over


class KilledServices(NamedTuple):
    returns: list[Return]
    different: int  # runs
    lost: int  # answers missing in the recording, as the service was killed while publishing them


def undisturbed(folder: Path, scene: str) -> Digests:
    """The output of an undisturbed run."""
    with stage(folder) as nodes:
        recorder, service, simulator = _start(nodes, folder, scene)
        _end(simulator, recorder, service)
    return digests(folder / "bag")


def kill_services(
    folder: Path, scene: str, times: int, seed: int, reference: Digests, progress: Progress,
    longest_wait: float = LONGEST_WAIT,
) -> KilledServices:  # fmt: skip
    """SIGKILL to the service at random instants, in as many runs as `times` kills take, followed by a restart.

    longest_wait [s]: from one answer after a kill to the next kill, at most.
    """
    random = np.random.default_rng(seed)
    returns: list[Return] = []
    different = lost = 0
    for run in range(MOST_RUNS):
        own, before = folder / f"run_{run}", len(returns)
        with stage(own) as nodes:
            recorder, service, simulator = _start(nodes, own, scene)
            while len(returns) < times:
                progress(f"run {run + 1}: {len(returns)} of {times} services killed")
                if _ends_before(simulator, random.uniform(0.0, longest_wait), recorder, service):
                    break
                service.stop(patience=0.0, orders=(signal.SIGKILL,))
                step, awaited = steps_told(simulator), len(answers_awaited(simulator))
                service = nodes.start("collision_node", threads=1)
                started = time.time() - age_of(service.pid)
                await_ready(service, recorder)
                await_step(simulator, step, recorder, service)
                came = answers_awaited(simulator)[awaited:]
                returns.append(Return(step, ready_told(service), came[0] - started if came else math.nan))
            may_lack = len(returns) - before
            _end(simulator, recorder, service, may_lack)
        said = digests(own / "bag")
        different += said.differs(reference, may_lack)
        lost += said.lost(reference)
        if len(returns) >= times:
            return KilledServices(returns, different, lost)
    raise RuntimeError(f"{scene}: only {len(returns)} kills in {MOST_RUNS} runs")


def kill_simulators(folder: Path, scene: str, times: int, seed: int, reference: Digests, progress: Progress) -> int:
    """The simulator is killed and restarted, each time with the same service; then one run is completed.

    Returns 1 if that differed from `reference`, else 0.
    """
    random = np.random.default_rng(seed)
    with stage(folder) as nodes:
        service = nodes.start("collision_node", threads=1)
        await_ready(service)
        for i in range(times):
            progress(f"{i} of {times} simulators killed")
            simulator = nodes.start("simulator_node", scene=scene, progress=True)
            await_step(simulator, 0, service)
            _ends_before(simulator, random.uniform(0.0, LONGEST_WAIT), service)
            simulator.stop(patience=0.0, orders=(signal.SIGKILL,))
        recorder, _, simulator = _start(nodes, folder, scene, service)
        _end(simulator, recorder, service)
    return int(digests(folder / "bag").differs(reference))


def kill_listeners(folder: Path, scene: str, times: int, seed: int, reference: Digests, progress: Progress) -> int:
    """A further subscriber to everything is killed again and again; returns the number of runs that differed."""
    random = np.random.default_rng(seed)
    killed, different = 0, 0
    for run in range(MOST_RUNS):
        own = folder / f"run_{run}"
        with stage(own) as nodes:
            recorder, service, simulator = _start(nodes, own, scene)
            while killed < times:
                progress(f"run {run + 1}: {killed} of {times} listeners killed")
                listener = nodes.start("recorder_node", folder=str(own / f"listener_{killed}"), progress=True)
                await_words(listener, "{", simulator)
                is_last = _ends_before(simulator, random.uniform(0.0, 0.5), service, recorder)
                listener.stop(patience=0.0, orders=(signal.SIGKILL,))
                killed += 1
                if is_last:
                    break
            _end(simulator, recorder, service)
        different += digests(own / "bag").differs(reference)
        if killed >= times:
            break
    return different


def orders_of_ending(folder: Path, scene: str, progress: Progress) -> Iterator[str]:
    """Ctrl-C and SIGTERM to all three nodes in all orders, in mid-run; yields descriptions of what went wrong."""
    orders = list(itertools.permutations(range(3)))
    for i, (order, sign) in enumerate(itertools.product(orders, (signal.SIGINT, signal.SIGTERM))):
        progress(f"{i} of {2 * len(orders)} orders of ending")
        own = folder / f"order_{i}"
        with stage(own) as nodes:
            three = _start(nodes, own, scene)
            await_step(three[2], 0, *three[:2])
            for k in order:
                three[k].send_signal(sign)
            for node in three:
                if fault := fault_at_end(node, node.wait(60.0)):
                    yield f"{sign.name} to {', '.join(three[k].name for k in order)}: {fault}"


def _start(
    nodes: Stage, folder: Path, scene: str, service: NodeProcess | None = None
) -> tuple[NodeProcess, NodeProcess, NodeProcess]:
    """Recorder, service and simulator."""
    recorder = nodes.start("recorder_node", folder=str(folder / "bag"), progress=True)
    service = service or nodes.start("collision_node", threads=1)
    return recorder, service, nodes.start("simulator_node", scene=scene, wait_for_subscribers=2, progress=True)


def _ends_before(simulator: NodeProcess, seconds: float, *alive: NodeProcess) -> bool:
    """Waits for `seconds` after the first step; returns whether the scene has ended by then."""
    await_step(simulator, 0, *alive)
    deadline = time.monotonic() + seconds
    await_that(lambda: simulator.exit_status() is not None or time.monotonic() > deadline, "an instant", *alive)
    return simulator.exit_status() is not None


def _end(simulator: NodeProcess, recorder: NodeProcess, service: NodeProcess, may_lack: int = 0) -> None:
    """Waits for the scene's end, then ends the others."""
    await_end(simulator, recorder, service)
    await_recording(recorder, simulator, service, may_lack=may_lack)
    for node in (simulator, recorder, service):
        must_end(node)
