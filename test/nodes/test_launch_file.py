"""The launch file without ROS's launch, which is not available as a wheel.

It is executed against stand-ins of the documented interface, and the resulting commands are run. Where launch is
installed, test_launch_for_real.py starts it.
"""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sysconfig
from pathlib import Path

import pytest
import yaml
from stages.launch_stand_ins import Context, Node, load

from fracture_collision.ros.processes.node_process import free_domain_id

FILE = Path(__file__).resolve().parents[2] / "launch" / "fracture_collision.launch.py"
RANGE = "ROS_AUTOMATIC_DISCOVERY_RANGE"


def installed(executable: str) -> Path:
    return Path(sysconfig.get_path("scripts")) / executable


@pytest.fixture
def describe(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    def describe(environment: dict[str, str], **arguments: str) -> list[Node]:
        description = load(FILE, monkeypatch.setitem)
        return description.execute(Context(arguments, environment), installed, tmp_path)

    return describe


def test_arguments_reach_the_nodes(describe) -> None:
    service, simulator = describe({}, scene="wall", seed="7", namespace="cell")
    assert [node.executable for node in (service, simulator)] == ["collision_node", "simulator_node"]
    assert service.on_exit is not None and simulator.on_exit is not None  # the end of either ends both
    for node in (service, simulator):
        assert os.access(node.command[0], os.X_OK) and "__ns:=/cell" in node.command
        assert node.environment[RANGE] == "LOCALHOST"
        assert Path(node.command[-1]).is_file()
    assert Path(service.command[-1]).name == "collision.yaml"
    given = yaml.safe_load(Path(simulator.command[-1]).read_text())
    assert given == {"/**": {"ros__parameters": {"scene": "wall", "seed": 7}}}


def test_the_discovery_range_is_an_argument(describe) -> None:
    for arguments, expected in (({}, "SUBNET"), ({"discovery_range": "LOCALHOST"}, "LOCALHOST")):
        nodes = describe({RANGE: "SUBNET"}, **arguments)
        assert [node.environment[RANGE] for node in nodes] == [expected] * 2
    with pytest.raises(RuntimeError, match="discovery_range"):
        describe({}, discovery_range="EVERYWHERE")


def test_the_launch_file_runs_a_scene(describe, tmp_path: Path) -> None:
    environment = os.environ | {"ROS_DOMAIN_ID": str(free_domain_id())}
    environment.pop(RANGE, None)
    service, simulator = describe(environment, scene="pane", namespace="cell")
    logs = {node.executable: tmp_path / f"{node.executable}.log" for node in (service, simulator)}
    processes = []
    try:
        for node in (service, simulator):
            with logs[node.executable].open("wb") as log:
                processes.append(subprocess.Popen(node.command, env=node.environment, stdout=log, stderr=log))
        assert processes[1].wait(240.0) == 0, logs["simulator_node"].read_text()
        processes[0].send_signal(signal.SIGINT)  # Shutdown
        assert processes[0].wait(60.0) == 0
    finally:
        for process in processes:
            process.kill()
            process.wait()
    words = "".join(log.read_text() for log in logs.values())
    assert re.search(r"\[cell\.collision_node\]: run \d+ begins", words)
    assert "is unknown and has no effect" not in words  # every parameter is declared by its node
