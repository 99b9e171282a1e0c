"""DDS security files grant what the nodes need and no more; if security is requested, no node starts without it."""

from __future__ import annotations

import importlib.util
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from stages.ros_stage import StageWithClients

from fracture_collision.ros.processes.node_process import free_domain_id, loopback_environment
from fracture_collision.ros.runs.security_files import (
    NODE_SUBSCRIBES,
    ROLES,
    dds_names,
    governance,
    permissions,
    write_files,
)
from fracture_collision.ros.wire import qos

KEPT = Path(__file__).resolve().parents[2] / "security"

# OMG DDS Security 1.1, 9.4.1.2.2 and 9.4.1.3.1: the order of the elements is part of the schemas.
ORDER = {
    "dds": {"domain_access_rules", "permissions"},
    "domain_rule": [
        "domains", "allow_unauthenticated_participants", "enable_join_access_control", "discovery_protection_kind",
        "liveliness_protection_kind", "rtps_protection_kind", "topic_access_rules",
    ],
    "topic_rule": [
        "topic_expression", "enable_discovery_protection", "enable_liveliness_protection", "enable_read_access_control",
        "enable_write_access_control", "metadata_protection_kind", "data_protection_kind",
    ],
    "grant": ["subject_name", "validity", "allow_rule", "default"],
    "validity": ["not_before", "not_after"],
    "allow_rule": ["domains", "publish", "subscribe"],
}  # fmt: skip
KINDS = {"NONE", "SIGN", "ENCRYPT"}


def test_security_files_equal_those_the_script_writes(tmp_path: Path) -> None:
    written = write_files(tmp_path)
    assert {path.relative_to(tmp_path) for path in written} == {
        path.relative_to(KEPT) for path in KEPT.rglob("*") if path.is_file()
    }
    for path in written:
        assert path.read_bytes() == (KEPT / path.relative_to(tmp_path)).read_bytes(), path


@pytest.mark.parametrize("encrypt", [False, True])
def test_elements_of_security_files_are_in_the_order_of_the_schemas(encrypt: bool) -> None:
    roots = [governance("/cell", 7, encrypt), *(permissions(role, "/cell", 7) for role in ROLES)]
    for root in roots:
        for element in root.iter():
            order = ORDER.get(element.tag)
            tags = [child.tag for child in element]
            assert order is None or tags == order or set(tags) < set(order) == order, element.tag
            if element.tag.endswith("_kind"):
                assert element.text in KINDS
            if element.tag.startswith(("enable_", "allow_un")):
                assert element.text in ("true", "false")
    rules = [rule.findtext("topic_expression") for rule in roots[0].iter("topic_rule")]
    assert rules == [f"rt/cell/{topic.name}" for topic in qos.TOPICS] + ["*"]


def test_security_files_are_valid_by_the_schemas_of_sros2(tmp_path: Path) -> None:
    sros2, xmllint = importlib.util.find_spec("sros2"), shutil.which("xmllint")
    if sros2 is None or xmllint is None:
        pytest.skip("the schemas come with sros2, and are checked by xmllint: neither is part of the project")
    schemas = Path(sros2.origin).parent / "policy" / "schemas" / "dds"
    for path in write_files(tmp_path):
        schema = schemas / ("governance.xsd" if path.name == "governance.xml" else "permissions.xsd")
        if schema.is_file():
            subprocess.run([xmllint, "--noout", "--schema", schema, path], check=True)


def test_nodes_have_exactly_the_permitted_topics_and_services(
    stage: StageWithClients, tmp_path: Path
) -> None:
    stage.start("recorder_node", "-r", "__ns:=/cell", folder=str(tmp_path / "bag"))
    stage.start("collision_node", "-r", "__ns:=/cell", threads=1)
    stage.start("simulator_node", "-r", "__ns:=/cell", scene="pane", wait_for_subscribers=50)  # it waits forever
    client = stage.client()
    for role in ROLES:
        if role.enclave == "viewer":
            continue
        permitted = dds_names(role, "/cell")
        # The discovery topic belongs to rmw, not to a node; /clock is for use_sim_time.
        publishes = set(permitted.publishes) - {"ros_discovery_info"}
        subscribes = set(permitted.subscribes) - set(NODE_SUBSCRIBES)

        def has_all(node: str = role.enclave, wanted: tuple = (publishes, subscribes)) -> bool:
            return names_in_dds(client, node) == wanted

        client.spin_until(has_all, f"{role.enclave}: {publishes}, {subscribes}")


def names_in_dds(client, node: str) -> tuple[set[str], set[str]]:
    """DDS names that a node of /cell writes and reads."""
    try:
        publishers = client.node.get_publisher_names_and_types_by_node(node, "/cell")
        subscribers = client.node.get_subscriber_names_and_types_by_node(node, "/cell")
        services = [name for name, _ in client.node.get_service_names_and_types_by_node(node, "/cell")]
        called = [name for name, _ in client.node.get_client_names_and_types_by_node(node, "/cell")]
    except Exception as error:  # rclpy raises its own type for a node not yet discovered
        assert "node" in str(error).lower(), error
        return set(), set()
    return (
        {f"rt{name}" for name, _ in publishers}
        | {f"rr{name}Reply" for name in services}
        | {f"rq{name}Request" for name in called},
        {f"rt{name}" for name, _ in subscribers}
        | {f"rq{name}Request" for name in services}
        | {f"rr{name}Reply" for name in called},
    )


def test_a_node_does_not_start_unsecured_if_security_is_required(tmp_path: Path) -> None:
    """Without a certificate, or where Fast DDS is built without its security plugins, as in the wheels."""
    secure = {"ROS_SECURITY_ENABLE": "true", "ROS_SECURITY_STRATEGY": "Enforce", "ROS_SECURITY_KEYSTORE": str(tmp_path)}
    enclave = tmp_path / "enclaves" / "fracture_collision" / "collision_node"
    enclave.mkdir(parents=True)
    for name in ("identity_ca.cert", "cert", "key", "permissions_ca.cert"):
        (enclave / f"{name}.pem").touch()
    for name in ("governance", "permissions"):
        (enclave / f"{name}.p7s").touch()
    command = [sys.executable, "-m", "fracture_collision.ros.service.collision_node", "--ros-args", "--enclave"]
    done = subprocess.run(
        [*command, "/fracture_collision/collision_node"], capture_output=True, text=True, timeout=60.0,
        env=os.environ | loopback_environment(free_domain_id()) | secure,
    )  # fmt: skip
    assert done.returncode != 0 and "ready" not in done.stderr
    assert "secur" in (done.stdout + done.stderr).lower()
