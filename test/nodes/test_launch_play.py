"""launch/play.launch.py, against stand-ins of launch as in test_launch_file.py; the files for RViz and Foxglove."""

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
from rclpy.expand_topic_name import expand_topic_name
from stages.launch_stand_ins import Context, Node, load

from fracture_collision.ros.processes.node_process import free_domain_id
from fracture_collision.ros.start import module_of
from fracture_collision.ros.wire import interfaces, markers, qos

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
    assert parameters(simulator) == {"scene": "wall", "seed": 7, "folder": "out/play"}
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
    namespaces = display["Namespaces"]
    (display,) = (each for each in manager["Displays"] if each["Class"] == "rviz_default_plugins/RobotModel")
    assert display["Description Topic"]["Value"] == qos.ROBOT_DESCRIPTION.name
    assert display["Description Topic"]["Durability Policy"] == "Transient Local"
    shown = {markers.OUTSIDE, markers.CRACK, markers.CONTACTS, markers.NORMALS}
    assert set(namespaces) == shown
    assert manager["Global Options"]["Fixed Frame"] == "world"


def test_foxglove_layout_shows_what_the_nodes_publish() -> None:
    layout = json.loads((ROOT / "config" / "foxglove_layout.json").read_text())
    panels = layout["configById"]
    assert sorted(leaves(layout["layout"])) == sorted(panels)
    published = (*interfaces.COLLISION.publishes, *interfaces.LIVE_SIMULATOR.publishes)
    topics = {
        expand_topic_name(topic.name, interfaces.LIVE_SIMULATOR_NODE, "/"): topic.message_class for topic in published
    }
    kinds = {name.split("!")[0] for name in panels}
    assert kinds == {"3D", "Plot", "DiagnosticSummary", "DiagnosticStatusPanel"}
    plotted = [path["value"] for name, panel in panels.items() if name.startswith("Plot!") for path in panel["paths"]]
    for value in plotted:
        topic, _, field = value.partition(".")
        assert field_type(topics[topic], field) in ("double", "uint32"), value
    assert {"/contact_constraints.gaps[:]", "/live_simulator_node/status.contacts"} <= set(plotted)
    shown = panels["3D!scene"]["topics"]
    assert {topics[topic] for topic in shown} == {qos.MARKERS.message_class, qos.CONTACT_POSES.message_class}
    assert panels["3D!scene"]["followTf"] == "world"
    (arm,) = (layer for layer in panels["3D!scene"]["layers"].values() if layer["layerId"] == "foxglove.Urdf")
    assert topics[arm["topic"]] is qos.ROBOT_DESCRIPTION.message_class
    for name in ("DiagnosticSummary!nodes", "DiagnosticStatusPanel!answers"):
        assert topics[panels[name]["topicToRender"]] is qos.DIAGNOSTICS.message_class


def leaves(layout: dict | str) -> list[str]:
    """Panels of a Foxglove layout: a binary tree."""
    if isinstance(layout, str):
        return [layout]
    assert layout["direction"] in ("row", "column") and 0 < layout["splitPercentage"] < 100
    return leaves(layout["first"]) + leaves(layout["second"])


def field_type(message_class: type, field: str) -> str:
    """Type of a field, or of its elements for `field[:]`."""
    name, _, all_of_it = field.partition("[:]")
    of_type = message_class.get_fields_and_field_types()[name]
    assert not all_of_it and field.endswith("[:]") == of_type.startswith("sequence<"), field
    return of_type.removeprefix("sequence<").removesuffix(">")
