"""A live scene with its page: service, simulator and page as processes that communicate over DDS until stopped."""

from __future__ import annotations

import json
import subprocess
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import NamedTuple

from fracture_collision.process.outputs import NewOutputs
from fracture_collision.ros.processes.node_process import NodeProcess
from fracture_collision.ros.runs.run_domain import run_domain
from fracture_collision.simulation.engines import with_engine
from fracture_collision.simulation.scene.scene import load_scene

LOGS = "logs"
LOOK = 0.05  # [s]
PATIENCE = 120.0  # [s] for the page's address
ENDING = 3.0  # [s] that a node has to end
# Niceness of service and simulator: the page has priority, also while a body breaks.
BEHIND = 5


class PlayFailed(RuntimeError):
    """A node did not start, or ended. Its text has the end of the log."""


class Played(NamedTuple):
    """A scene that is being played."""

    address: str  # of the page
    domain_id: int
    nodes: tuple[NodeProcess, ...]

    def check(self) -> None:
        """Raises PlayFailed if a node has ended."""
        for node in self.nodes:
            if node.exit_status() is not None:
                raise PlayFailed(node.last_words())


@contextmanager
def played(scene: str, seed: int, out: Path, host: str, port: int, engine: str = "") -> Iterator[Played]:
    """Starts all nodes and waits for the page; ends them all afterwards.

    The nodes' logs are in out/logs, where they replace an earlier run's once the page is up. Raises PlayFailed,
    DomainTaken, SceneError, and OSError if `out` cannot be written.
    """
    time_step = with_engine(load_scene(scene), engine).time_step
    with run_domain(default=0) as domain_id, NewOutputs(out, (LOGS,)) as new, ExitStack() as nodes:
        logs = new.folder / LOGS
        logs.mkdir()

        def start(module: str, stdout: int | None = None, niceness: int = 0, **parameters: object) -> NodeProcess:
            node = NodeProcess(module, parameters, domain_id, logs / f"{module}.log", stdout, niceness=niceness)
            nodes.callback(node.stop, ENDING)
            return node

        simulator = start(
            "live_simulator_node", scene=scene, seed=seed, engine=engine, niceness=BEHIND, folder=str(out)
        )  # fmt: skip
        service = start("collision_node", niceness=BEHIND, lookahead=time_step)
        page = start("page_node", subprocess.PIPE, host=host, port=port, folder=str(out), scene=scene)
        run = Played(_address(page, (service, simulator)), domain_id, (service, simulator, page))
        new.publish()
        for node in run.nodes:
            node.log = out / LOGS / node.log.name
        yield run


def _address(page: NodeProcess, others: tuple[NodeProcess, ...]) -> str:
    told: list[str] = []

    def read() -> None:
        for line in page.stdout:
            if line.startswith("{"):  # some libraries print to stdout
                told.append(json.loads(line)["address"])

    threading.Thread(target=read, daemon=True).start()
    deadline = time.monotonic() + PATIENCE
    while not told:
        for node in (page, *others):
            if node.exit_status() is not None:
                raise PlayFailed(node.last_words())
        if time.monotonic() > deadline:
            raise PlayFailed(f"the page did not start within {PATIENCE:.0f} s; {page.log_end()}")
        time.sleep(LOOK)
    return told[0]
