"""Governance and permissions of DDS security for this package's nodes, generated from what the nodes declare.

    python -m fracture_collision.ros.runs.security_files security [--namespace /cell] [--domain 0] [--encrypt]

writes governance.xml and permissions/ENCLAVE.xml: OMG DDS Security 1.1, 9.4.1.2 and 9.4.1.3, with the names that ROS 2
gives its topics and services in DDS. docs/security.md describes their use.
"""

from __future__ import annotations

import argparse
import sys
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import NamedTuple

from fracture_collision.ros.wire import interfaces, qos

_SCHEMAS = "http://www.omg.org/spec/DDS-SECURITY/20170901"
_SCHEMA_LOCATION = "{http://www.w3.org/2001/XMLSchema-instance}noNamespaceSchemaLocation"
VALID_FROM, VALID_UNTIL = "2025-01-01T00:00:00", "2035-01-01T00:00:00"

# Of every rclpy node, below its own name.
NODE_SERVICES = (
    "describe_parameters", "get_parameter_types", "get_parameters", "get_type_description", "list_parameters",
    "set_parameters", "set_parameters_atomically",
)  # fmt: skip
# Of every rclpy node: its log, changes of its parameters, and which topics it has.
PARAMETER_EVENTS = "rt/parameter_events"
NODE_PUBLISHES = ("rt/rosout", PARAMETER_EVENTS, "ros_discovery_info")
NODE_SUBSCRIBES = ("ros_discovery_info", "rt/clock")  # the clock under use_sim_time

_SHOWN = (qos.ANSWER_TIMES, qos.MARKERS, qos.CONTACT_POSES, qos.CLOCK)


class Role(NamedTuple):
    """Permissions of one enclave."""

    enclave: str  # also the name of its node
    publishes: tuple[qos.Topic, ...] = ()
    subscribes: tuple[qos.Topic, ...] = ()
    also_subscribes: tuple[str, ...] = ()  # DDS names
    calls: tuple[str, ...] = ()  # of collision_node's NODE_SERVICES


ROLES = (
    Role("collision_node", interfaces.COLLISION.publishes, interfaces.COLLISION.subscribes),
    Role(
        "simulator_node", interfaces.SIMULATOR.publishes, interfaces.SIMULATOR.subscribes,
        calls=("set_parameters",),  # its time step, as lookahead
    ),
    Role(
        "recorder_node", subscribes=interfaces.RECORDER.subscribes, also_subscribes=(PARAMETER_EVENTS,),
        calls=("get_parameters",),
    ),
    Role(
        "viewer", subscribes=(*qos.TOPICS, qos.DIAGNOSTICS, *_SHOWN), also_subscribes=(PARAMETER_EVENTS,),
        calls=NODE_SERVICES,
    ),
)


class DdsNames(NamedTuple):
    """DDS names of topics, sorted."""

    publishes: list[str]
    subscribes: list[str]


def dds_names(role: Role, namespace: str = "") -> DdsNames:
    """DDS topics that a node of the role in `namespace` writes and reads."""
    publishes = [_topic(topic, namespace) for topic in role.publishes]
    subscribes = [_topic(topic, namespace) for topic in role.subscribes]
    publishes += NODE_PUBLISHES
    subscribes += [*role.also_subscribes, *NODE_SUBSCRIBES]
    requests, replies = _service_topics(role.enclave, namespace, NODE_SERVICES)
    publishes += replies
    subscribes += requests
    requests, replies = _service_topics("collision_node", namespace, role.calls)
    publishes += requests
    subscribes += replies
    return DdsNames(sorted(publishes), sorted(subscribes))


def permissions(role: Role, namespace: str = "", domain_id: int = 0) -> ET.Element:
    """The permissions document of a role, unsigned; topics that are not named are denied."""
    enclave = f"/fracture_collision/{role.enclave}"
    root = _root("permissions")
    grant = _add(_add(root, "permissions"), "grant")
    grant.set("name", enclave)
    _add(grant, "subject_name", f"CN={enclave}")  # as `ros2 security create_enclave` names them
    validity = _add(grant, "validity")
    _add(validity, "not_before", VALID_FROM)
    _add(validity, "not_after", VALID_UNTIL)
    rule = _add(grant, "allow_rule")
    _add(_add(rule, "domains"), "id", str(domain_id))
    for action, names in zip(("publish", "subscribe"), dds_names(role, namespace), strict=True):
        topics = _add(_add(rule, action), "topics")
        for name in names:
            _add(topics, "topic", name)
    _add(grant, "default", "DENY")
    return root


def governance(namespace: str = "", domain_id: int = 0, encrypt: bool = False) -> ET.Element:
    """The governance document, unsigned: participants need a certificate, and every message is signed.

    Contents of the run's topics are encrypted only on request: they are not secret, and every step waits for them. All
    other topics are always encrypted.
    """
    root = _root("governance")
    rule = _add(_add(root, "domain_access_rules"), "domain_rule")
    _add(_add(rule, "domains"), "id", str(domain_id))
    _add(rule, "allow_unauthenticated_participants", "false")
    _add(rule, "enable_join_access_control", "true")
    _add(rule, "discovery_protection_kind", "ENCRYPT")
    _add(rule, "liveliness_protection_kind", "ENCRYPT")
    _add(rule, "rtps_protection_kind", "ENCRYPT" if encrypt else "SIGN")
    topic_rules = _add(rule, "topic_access_rules")
    for topic in qos.TOPICS:
        _add_topic_rule(topic_rules, _topic(topic, namespace), encrypt)
    _add_topic_rule(topic_rules, "*", True)  # the first rule that matches applies
    return root


def write_files(folder: Path, namespace: str = "", domain_id: int = 0, encrypt: bool = False) -> list[Path]:
    """Writes governance.xml and the permissions of all ROLES below `folder`; returns the paths. Raises OSError."""
    files = {folder / "governance.xml": governance(namespace, domain_id, encrypt)}
    for role in ROLES:
        files[folder / "permissions" / f"{role.enclave}.xml"] = permissions(role, namespace, domain_id)
    for path, root in files.items():
        path.parent.mkdir(parents=True, exist_ok=True)
        ET.indent(root)
        ET.ElementTree(root).write(path, encoding="UTF-8", xml_declaration=True)
    return list(files)


def _topic(topic: qos.Topic, namespace: str) -> str:
    return f"rt{topic.name}" if topic.name.startswith("/") else f"rt{namespace}/{topic.name}"


def _service_topics(node: str, namespace: str, services: tuple[str, ...]) -> tuple[list[str], list[str]]:
    """Requests and replies of some of a node's own services."""
    names = [f"{namespace}/{node}/{service}" for service in services]
    return [f"rq{name}Request" for name in names], [f"rr{name}Reply" for name in names]


def _add_topic_rule(rules: ET.Element, expression: str, encrypt: bool) -> None:
    rule = _add(rules, "topic_rule")
    _add(rule, "topic_expression", expression)
    for name in ("discovery_protection", "liveliness_protection", "read_access_control", "write_access_control"):
        _add(rule, f"enable_{name}", "true")
    _add(rule, "metadata_protection_kind", "ENCRYPT" if encrypt else "SIGN")
    _add(rule, "data_protection_kind", "ENCRYPT" if encrypt else "NONE")


def _root(kind: str) -> ET.Element:
    return ET.Element("dds", {_SCHEMA_LOCATION: f"{_SCHEMAS}/omg_shared_ca_{kind}.xsd"})


def _add(parent: ET.Element, tag: str, text: str | None = None) -> ET.Element:
    element = ET.SubElement(parent, tag)
    element.text = text
    return element


def main() -> int:
    """Writes the files that the arguments describe and prints their paths; returns 0."""
    parser = argparse.ArgumentParser(description="Writes governance and permissions of DDS security for these nodes.")
    parser.add_argument("folder", type=Path)
    parser.add_argument("--namespace", default="", help="namespace of all nodes, such as /cell")
    parser.add_argument("--domain", type=int, default=0, help="ROS_DOMAIN_ID")
    parser.add_argument("--encrypt", action="store_true", help="also encrypt the contents of the run's topics")
    given = parser.parse_args()
    namespace = f"/{given.namespace.strip('/')}" if given.namespace.strip("/") else ""
    for path in write_files(given.folder, namespace, given.domain, given.encrypt):
        print(path)
    return 0


if __name__ == "__main__":
    sys.exit(main())
