"""Runs a simulator node of any language with the service and a recorder, for `check-solver`."""

from __future__ import annotations

import os
import shlex
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import yaml

from fracture_collision.bag.mcap_file import BagError
from fracture_collision.ros.processes.node_process import NodeProcess, loopback_environment
from fracture_collision.ros.runs.run_domain import DomainTaken, run_domain
from fracture_collision.solver_check.cases import Part
from fracture_collision.solver_check.check import CouldNotRun
from fracture_collision.solver_check.recorded import Recorded, read_recorded

SCENE = "{scene}"
PATIENCE = 300.0  # [s] for a scene of at most 1,000 steps
# [s] for the recorder to receive the last messages when the simulator has ended.
RECORDER_PATIENCE = 1.0
POLL_INTERVAL = 0.05  # [s]


class BadCommand(ValueError):
    """A command that cannot be run; the text has the reason."""


def command_words(command: str, scene: Path) -> list[str]:
    """The words of a command, with the scene's path in place of {scene}. Raises BadCommand.

    Commands of this environment, such as python and simulator_node, are found first.
    """
    if SCENE not in command:
        raise BadCommand(f"{command!r} has no {SCENE}: the path of the scene file is put there")
    try:
        words = [word.replace(SCENE, str(scene)) for word in shlex.split(command)]
    except ValueError as error:
        raise BadCommand(f"{command!r}: {error}") from error
    if shutil.which(words[0], path=_path()) is None:
        raise BadCommand(f"{words[0]}: no such command")
    return words


def run_node(
    command: str, part: Part, name: str, folder: Path, check: Callable[[], None], patience: float = PATIENCE
) -> Recorded:
    """The recorded run of a scene by the node that `command` starts. Raises CouldNotRun, BadCommand.

    Writes the scene, a bag and logs to a folder of this `name` in `folder`. `check`: called often, may raise to stop.
    No process is left behind.
    """
    here = folder / name.replace(" ", "_")
    here.mkdir()
    scene, bag, log = here / "scene.yaml", here / "bag", here / "simulator.log"
    scene.write_text(yaml.safe_dump(part.content), encoding="utf-8")
    words, time_step = command_words(command, scene), part.content["time_step"]
    try:
        with run_domain() as domain_id, ExitStack() as processes:
            def start(module: str, parameters: dict[str, Any]) -> NodeProcess:
                process = NodeProcess(module, parameters, domain_id, here / f"{module}.log")
                processes.callback(process.stop)
                return process

            service = start("collision_node", {"lookahead": time_step})
            recorder = start("recorder_node", {"folder": str(bag)})
            with _simulator(words, domain_id, log) as simulator:
                deadline = time.monotonic() + patience
                while (status := simulator.poll()) is None:
                    check()
                    for process in (service, recorder):
                        if process.exit_status() is not None:
                            raise CouldNotRun(process.last_words())
                    if time.monotonic() > deadline:
                        raise CouldNotRun(
                            f"the command has not ended after {patience:.0f} s: a simulator must end after the scene's"
                            f" last step; {_end_of(log)}"
                        )
                    time.sleep(POLL_INTERVAL)
            if status != 0:
                raise CouldNotRun(f"the command ended with status {status}; {_end_of(log)}")
            time.sleep(RECORDER_PATIENCE)
            for process in (recorder, service):  # in this order: the service must run until the recorder has ended
                if process.stop() != 0:
                    raise CouldNotRun(process.last_words())
        return read_recorded(bag, time_step)
    except (BagError, DomainTaken) as error:
        raise CouldNotRun(f"{error}; {_end_of(log)}") from error


@contextmanager
def _simulator(words: list[str], domain_id: int, log: Path) -> Iterator[subprocess.Popen[bytes]]:
    """The process of a command; it and what it has started end with this."""
    with log.open("wb") as stream:
        process = subprocess.Popen(
            [shutil.which(words[0], path=_path()) or words[0], *words[1:]], stdin=subprocess.DEVNULL, stdout=stream,
            stderr=stream, env=loopback_environment(domain_id) | {"PATH": _path()}, start_new_session=True,
        )  # fmt: skip
    try:
        yield process
    finally:
        for order in (signal.SIGINT, signal.SIGKILL):
            if process.poll() is None:
                os.killpg(process.pid, order)
                try:
                    process.wait(5.0)
                except subprocess.TimeoutExpired:
                    continue
        process.wait()


def _path() -> str:
    """PATH, with the commands of this environment first."""
    return os.pathsep.join((str(Path(sys.executable).parent), os.environ.get("PATH", os.defpath)))


def _end_of(log: Path) -> str:
    lines = log.read_text(errors="replace").splitlines() if log.is_file() else []
    return "the end of its output:\n" + "\n".join(lines[-15:])
