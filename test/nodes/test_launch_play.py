"""launch/play.launch.py and config/fracture_collision.rviz, against stand-ins of launch as in test_launch_file.py."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
import urllib.request
from collections.abc import Callable
from pathlib import Path

import pytest
import yaml
from stages.launch_stand_ins import Context, Node, load

from fracture_collision.ros.processes.node_process import free_domain_id
from fracture_collision.ros.start import module_of
from fracture_collision.ros.wire import markers, qos

ROOT = Path(__file__).resolve().parents[2]
PATIENCE = 120.0  # [s]
NAMES = ["collision_node", "live_simulator_node", "page_node"]


@pytest.fixture
def describe(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., list[Node]]:
    def describe(environment: dict[str, str], **arguments: str) -> list[Node]:
        description = load(ROOT / "launch" / "play.launch.py", monkeypatch.setitem)
        return description.execute(Context(arguments, environment), Path, tmp_path)

    return describe


def parameters(node: Node) -> dict[str, object]:
    return yaml.safe_load(Path(node.command[-1]).read_text())["/**"]["ros__parameters"]


def test_arguments_reach_the_nodes(describe) -> None:
    service, simulator, page = nodes = describe({}, scene="wall", seed="7", port="8123", namespace="cell")
    assert [node.executable for node in nodes] == NAMES
    assert all(node.on_exit is not None and "__ns:=/cell" in node.command for node in nodes)
    assert Path(service.command[-1]).name == "collision.yaml"
    assert parameters(simulator) == {"scene": "wall", "seed": 7}
    assert parameters(page) == {"scene": "wall", "host": "127.0.0.1", "port": 8123, "folder": "out/play"}


def test_the_launch_file_serves_a_page(describe, tmp_path: Path) -> None:
    environment = os.environ | {"ROS_DOMAIN_ID": str(free_domain_id())}
    environment.pop("ROS_AUTOMATIC_DISCOVERY_RANGE", None)
    processes, logs = [], {name: tmp_path / f"{name}.log" for name in NAMES}
    try:
        for node in describe(environment, scene="pane", folder=str(tmp_path / "play")):
            command = [sys.executable, "-m", module_of(node.executable), *node.command[1:]]
            with logs[node.executable].open("wb") as log:
                processes.append(subprocess.Popen(command, env=node.environment, stdout=log, stderr=log))
        deadline = time.monotonic() + PATIENCE
        while not (told := [x for x in logs["page_node"].read_text().splitlines() if x.startswith('{"address"')]):
            assert time.monotonic() < deadline, logs["page_node"].read_text()
            assert processes[2].poll() is None, logs["page_node"].read_text()
        with urllib.request.urlopen(json.loads(told[0])["address"], timeout=PATIENCE) as answer:
            assert answer.status == 200
        while "run " not in logs["collision_node"].read_text():
            assert time.monotonic() < deadline, logs["collision_node"].read_text()
        for process in processes:
            process.send_signal(signal.SIGINT)  # Shutdown
        assert [process.wait(60.0) for process in processes] == [0, 0, 0]
    finally:
        for process in processes:
            process.kill()
            process.wait()
    assert "is unknown and has no effect" not in "".join(log.read_text() for log in logs.values())


def test_rviz_shows_the_markers_of_the_service() -> None:
    manager = yaml.safe_load((ROOT / "config" / "fracture_collision.rviz").read_text())["Visualization Manager"]
    (display,) = (each for each in manager["Displays"] if each["Class"] == "rviz_default_plugins/MarkerArray")
    assert display["Topic"]["Value"] == qos.MARKERS.name
    assert display["Topic"]["Durability Policy"] == "Transient Local"  # the publisher's durability
    shown = {markers.OUTSIDE, markers.CRACK, markers.CONTACTS, markers.NORMALS}
    assert set(display["Namespaces"]) == shown
    assert manager["Global Options"]["Fixed Frame"] == "world"
