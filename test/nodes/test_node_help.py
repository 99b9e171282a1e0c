"""--help and --version of every node: they start nothing, and say what the running node has."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from importlib import import_module
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest
from rcl_interfaces.srv import DescribeParameters, GetParameters, ListParameters
from rclpy.expand_topic_name import expand_topic_name
from rclpy.parameter import parameter_value_to_python
from stages.ros_client import ServiceClient
from stages.ros_stage import StageWithClients

from fracture_collision.ros.processes.node_help import TYPES
from fracture_collision.ros.processes.node_process import free_domain_id, loopback_environment
from fracture_collision.ros.start import NODES, module_of
from fracture_collision.ros.wire import qos
from fracture_collision.ros.wire.message_definitions import type_name

ROOT = Path(__file__).resolve().parents[2]
# What rclpy gives every node, and the service's settings, which some nodes follow.
OF_EVERY_NODE = {"/rosout", "/parameter_events"}
RCL_PARAMETERS = ("use_sim_time", "start_type_description_service", "qos_overrides.")


def class_of(node: str) -> Any:
    module = import_module(module_of(node))
    return getattr(module, "".join(word.capitalize() for word in node.split("_")))


def run_module(*words: str, **environment: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", *words], capture_output=True, text=True, timeout=120.0, env=os.environ | environment,
    )  # fmt: skip


def run(node: str, *arguments: str, **environment: str) -> subprocess.CompletedProcess[str]:
    return run_module("fracture_collision.ros.start", node, *arguments, **environment)


NOWHERE = {"ROS_DOMAIN_ID": "nowhere"}  # where no node starts


@pytest.mark.parametrize("node", NODES)
def test_help_starts_no_dds_and_has_what_the_node_declares(node: str) -> None:
    told = run_module(module_of(node), "--help", **NOWHERE)
    assert told.returncode == 0 and not told.stderr, told.stderr
    assert told.stdout.startswith(f"usage: {node} ")
    made = class_of(node)
    used = [name for example in made.EXAMPLES for name in re.findall(r"-p (\w+):=", example)]
    assert used and set(used) <= {declaration.name for declaration in made.PARAMETERS}
    for title in ("Parameters", "Subscribes to", "Examples"):
        assert f"\n{title}:\n" in told.stdout
    for declaration in made.PARAMETERS:
        head = f"  {declaration.name}  {TYPES[type(declaration.default)]}, default "
        assert head in told.stdout and declaration.description in re.sub(r"\s+", " ", told.stdout)
    for topic in (*made.INTERFACE.subscribes, *made.INTERFACE.publishes):
        assert f"  {topic.name}  {type_name(topic.message_class)}\n      {topic.description}" in told.stdout
    for example in made.EXAMPLES:
        assert f"\n  {node} {example}" in told.stdout


def test_version_and_short_help() -> None:
    started = run("collision_node", **NOWHERE)
    assert started.returncode != 0 and "ROS_DOMAIN_ID" in started.stderr
    version = run("collision_node", "--version")
    assert version.returncode == 0
    assert version.stdout == f"collision_node {ElementTree.parse(ROOT / 'package.xml').findtext('version')}\n"
    help_text = run("collision_node", "--help").stdout
    assert help_text and run("collision_node", "-h", "--ros-args", "-p", "x:=1").stdout == help_text


def test_a_pager_may_end_before_all_help_is_read() -> None:
    command = f"{sys.executable} -m fracture_collision.ros.start collision_node --help | true"
    done = subprocess.run(["sh", "-c", command], capture_output=True, text=True, timeout=120.0)
    assert done.returncode == 0 and not done.stderr


@pytest.mark.parametrize(
    ("arguments", "status", "words"),
    [
        (("-p", "penetration_tolerance:=0.1"), 2, "unknown argument -p; put --ros-args before it"),
        (("--hlep",), 2, "unknown argument --hlep; --help lists what there is"),
        (("scene:=wall", "--ros-args", "-p", "threads:=1"), 2, "unknown argument scene:=wall;"),
        (("--ros-args", "--params-file", "nowhere.yaml"), 1, "nowhere.yaml"),
        (("--ros-args", "-p", ":=1"), 1, ":=1"),
        (("--ros-args", "-q", "1"), 1, "-q"),
        (("--ros-args", "-p", "penetration_tolerance:=0"), 1, "expecting type 'DOUBLE'"),
        (("--ros-args", "-p", "penetration_tolerance:=7.0"), 1, "out of range Min: 0.0, Max: 1"),
    ],
)
def test_invalid_arguments_are_explained(arguments: tuple[str, ...], status: int, words: str) -> None:
    done = run("collision_node", *arguments, **loopback_environment(free_domain_id()))
    assert done.returncode == status
    explanation = done.stderr.splitlines()[-1]  # after rcl's own log
    assert explanation.startswith("collision_node: ") and words in explanation and "Traceback" not in done.stderr


@pytest.mark.parametrize("node", NODES)
def test_running_nodes_have_what_help_says(node: str, stage: StageWithClients, tmp_path: Path) -> None:
    given = {"recorder_node": {"folder": str(tmp_path / "bag")}, "page_node": {"folder": str(tmp_path)}}.get(node, {})
    stage.start(node, "-r", "__ns:=/cell", **given)
    client = stage.client("-r", "__ns:=/cell")
    if node == "recorder_node":  # it records states once there is a service
        topic = qos.CONTACT_CONSTRAINTS
        client.node.create_publisher(topic.message_class, topic.name, topic.qos)
    made = class_of(node)
    subscribes, publishes = (expanded(topics, node) for topics in (made.INTERFACE.subscribes, made.INTERFACE.publishes))
    if node == "live_simulator_node":  # these exist while the scene has an arm; test_live_conventions.py
        publishes = {k: v for k, v in publishes.items() if k not in ("/tf_static", "/cell/robot_description")}

    def has_all() -> bool:
        graph = client.node
        try:
            heard = graph.get_subscriber_names_and_types_by_node(node, "/cell")
            said = graph.get_publisher_names_and_types_by_node(node, "/cell")
            served = [name for name, _ in graph.get_service_names_and_types_by_node(node, "/cell")]
        except Exception as error:  # rclpy raises a type of its own for a node that is not there yet
            assert "node" in str(error).lower(), error
            return False
        own = {f"/cell/{node}/{service.name.removeprefix('~/')}" for service in made.INTERFACE.serves}
        others = [name for name in served if "parameter" not in name and "type_description" not in name]
        return (without_own(heard), without_own(said), set(others)) == (subscribes, publishes, own)

    client.spin_until(has_all, f"{node} with {subscribes} and {publishes}")
    names = list_parameters(client, node)
    assert sorted(names) == sorted(declaration.name for declaration in made.PARAMETERS)
    values = call(client, node, "get_parameters", GetParameters, names=names).values
    described = call(client, node, "describe_parameters", DescribeParameters, names=names).descriptors
    declared = {declaration.name: declaration for declaration in made.PARAMETERS}
    for value, descriptor in zip(values, described, strict=True):
        name, default, description, limits, fixed = declared[descriptor.name]
        assert (descriptor.description, descriptor.read_only) == (description, fixed)
        assert parameter_value_to_python(value) == given.get(name, default)
        ranges = [*descriptor.integer_range, *descriptor.floating_point_range]
        assert [(each.from_value, each.to_value) for each in ranges] == ([tuple(limits)] if limits else [])


def expanded(topics: tuple, node: str) -> dict[str, list[str]]:
    return {expand_topic_name(topic.name, node, "/cell"): [type_name(topic.message_class)] for topic in topics}


def without_own(found: list) -> dict[str, list[str]]:
    return {name: types for name, types in found if name not in OF_EVERY_NODE}


def list_parameters(client: ServiceClient, node: str) -> list[str]:
    names = call(client, node, "list_parameters", ListParameters).result.names
    return [name for name in names if not name.startswith(RCL_PARAMETERS)]


def call(client: ServiceClient, node: str, service: str, service_class: Any, **request: Any) -> Any:
    caller = client.node.create_client(service_class, f"{node}/{service}")
    client.spin_until(caller.service_is_ready, service)
    future = caller.call_async(service_class.Request(**request))
    client.spin_until(future.done, service)
    return future.result()
