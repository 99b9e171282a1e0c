"""The files for RViz and Foxglove show what the nodes of launch/play.launch.py publish."""

from __future__ import annotations

import json
from pathlib import Path

import yaml
from rclpy.expand_topic_name import expand_topic_name

from fracture_collision.ros.wire import interfaces, markers, qos

ROOT = Path(__file__).resolve().parents[2]


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
