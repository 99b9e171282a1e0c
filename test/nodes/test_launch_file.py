"""The launch files without ROS's launch, which is not available as a wheel.

They are executed against stand-ins of the documented interface, and the resulting commands are run. Where launch is
installed, test_launch_for_real.py starts it.
"""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sysconfig
import urllib.request
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import yaml
from stages.browser import until
from stages.launch_stand_ins import Context, Node, load

from fracture_collision.ros.processes.node_process import free_domain_id

FILES = Path(__file__).resolve().parents[2] / "launch"
RANGE = "ROS_AUTOMATIC_DISCOVERY_RANGE"
PATIENCE = 240.0  # [s]


def installed(executable: str) -> Path:
    return Path(sysconfig.get_path("scripts")) / executable


@pytest.fixture
def describe(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., list[Node]]:
    def describe(environment: dict[str, str], file: str = "fracture_collision", **arguments: str) -> list[Node]:
        description = load(FILES / f"{file}.launch.py", monkeypatch.setitem)
        return description.execute(Context(arguments, environment), installed, tmp_path)

    return describe


def parameters(node: Node) -> dict[str, object]:
    return yaml.safe_load(Path(node.command[-1]).read_text())["/**"]["ros__parameters"]


def test_arguments_reach_the_nodes(describe) -> None:
    service, simulator = describe({}, scene="wall", seed="7", namespace="cell")
    assert [node.executable for node in (service, simulator)] == ["collision_node", "simulator_node"]
    for node in (service, simulator):
        assert os.access(node.command[0], os.X_OK)
        assert node.environment[RANGE] == "LOCALHOST"
        assert Path(node.command[-1]).is_file()
    played = describe({}, "play", scene="wall", seed="7", port="8123", namespace="cell")
    assert [node.executable for node in played] == ["collision_node", "live_simulator_node", "page_node"]
    for node in (service, simulator, *played):  # the end of any ends all
        assert node.on_exit is not None and "__ns:=/cell" in node.command
    assert Path(service.command[-1]).name == Path(played[0].command[-1]).name == "collision.yaml"
    assert parameters(simulator) == {"scene": "wall", "seed": 7}
    assert parameters(played[1]) == {"scene": "wall", "seed": 7, "folder": "out/play"}
    assert parameters(played[2]) == {"scene": "wall", "host": "127.0.0.1", "port": 8123, "folder": "out/play"}


def test_the_discovery_range_is_an_argument(describe) -> None:
    for arguments, expected in (({}, "SUBNET"), ({"discovery_range": "LOCALHOST"}, "LOCALHOST")):
        nodes = describe({RANGE: "SUBNET"}, **arguments)
        assert [node.environment[RANGE] for node in nodes] == [expected] * 2
    with pytest.raises(RuntimeError, match="discovery_range"):
        describe({}, discovery_range="EVERYWHERE")


class Launched:
    """Nodes by their names, as launch starts and ends them."""

    def __init__(self, nodes: list[Node], folder: Path) -> None:
        self._logs = {node.executable: folder / f"{node.executable}.log" for node in nodes}
        self.processes: dict[str, subprocess.Popen] = {}
        for node in nodes:
            with self._logs[node.executable].open("wb") as log:
                self.processes[node.executable] = subprocess.Popen(
                    node.command, env=node.environment, stdout=log, stderr=log
                )

    def log(self, node: str) -> str:
        return self._logs[node].read_text()

    def shut_down(self) -> None:
        for process in self.processes.values():
            process.send_signal(signal.SIGINT)
        assert {process.wait(60.0) for process in self.processes.values()} == {0}
        # every parameter is declared by its node
        assert "is unknown and has no effect" not in "".join(map(self.log, self._logs))


@pytest.fixture
def launch(describe, tmp_path: Path) -> Iterator[Callable[..., Launched]]:
    made: list[Launched] = []

    def launch(**arguments: str) -> Launched:
        environment = os.environ | {"ROS_DOMAIN_ID": str(free_domain_id())}
        environment.pop(RANGE, None)
        made.append(Launched(describe(environment, **arguments), tmp_path))
        return made[-1]

    yield launch
    for process in (process for each in made for process in each.processes.values()):
        process.kill()
        process.wait()


def test_the_launch_file_runs_a_scene(launch) -> None:
    launched = launch(scene="pane", namespace="cell")
    assert launched.processes["simulator_node"].wait(PATIENCE) == 0, launched.log("simulator_node")
    launched.shut_down()
    assert re.search(r"\[cell\.collision_node\]: run \d+ begins", launched.log("collision_node"))


@pytest.mark.slow
def test_the_launch_file_of_play_serves_a_page(launch, tmp_path: Path) -> None:
    launched = launch(file="play", scene="pane", folder=str(tmp_path / "play"))

    def address() -> str:
        assert launched.processes["page_node"].poll() is None, launched.log("page_node")
        told = [line for line in launched.log("page_node").splitlines() if line.startswith('{"address"')]
        return json.loads(told[0])["address"] if told else ""

    with urllib.request.urlopen(until(address, bool), timeout=PATIENCE) as answer:
        assert answer.status == 200
    until(lambda: launched.log("collision_node"), lambda words: "run " in words)
    launched.shut_down()
