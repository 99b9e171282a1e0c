"""Contacts as poses, for tools that plot standard messages: their bytes, their content, and when they are published."""

from __future__ import annotations

import numpy as np
from geometry_msgs.msg import Point, Pose, PoseArray, Quaternion
from rclpy.serialization import deserialize_message, serialize_message
from scipy.spatial.transform import Rotation
from stages.ros_client import ServiceClient
from worlds.broken_bar import STATES, expected_contacts, tell_all

from fracture_collision.cdr import Heading
from fracture_collision.records import ContactConstraintArray
from fracture_collision.ros.wire import qos
from fracture_collision.ros.wire.cdr_padding import zero_padding
from fracture_collision.ros.wire.contact_poses import contact_poses, serialize_contact_poses
from fracture_collision.ros.wire.conversion import header_of

UP, DOWN = [0.0, 0.0, 1.0], [0.0, 0.0, -1.0]


def contacts_of(normals: np.ndarray, rng: np.random.Generator) -> ContactConstraintArray:
    count = len(normals)
    ids, begin = np.array([1], np.uint32), np.array([0, count], np.uint32)
    points_a = rng.normal(size=(count, 3))
    points_b = points_a + 0.01 * normals
    return ContactConstraintArray(
        step=1, fracture_sequence=0, status=0, fragment_a=ids, fragment_b=ids + 1, pair_begin=begin,
        missed_depth_bound=np.zeros(1), friction=np.zeros(1), restitution=np.zeros(1), points_a=points_a,
        points_b=points_b, normals=normals, gaps=np.full(count, 0.01),
        contact_ids=np.arange(count, dtype=np.uint64),
    )  # fmt: skip


def normals_of(count: int, rng: np.random.Generator) -> np.ndarray:
    normals = rng.normal(size=(count, 3))
    return normals / np.linalg.norm(normals, axis=1)[:, None]


def as_message(poses: np.ndarray, heading: Heading) -> PoseArray:
    """The slow twin: a PoseArray of message objects."""
    return PoseArray(
        header=header_of(heading),
        poses=[
            Pose(position=Point(x=x, y=y, z=z), orientation=Quaternion(x=i, y=j, z=k, w=w))
            for x, y, z, i, j, k, w in poses.tolist()
        ],
    )


def test_bytes_are_those_of_message_objects() -> None:
    rng = np.random.default_rng(3)
    for count in (0, 1, 2, 50):
        for frame in ("", "w", "wo", "wor", "world", "a frame"):
            heading = Heading(int(rng.integers(0, 2**31)), int(rng.integers(0, 10**9)), frame)
            contacts = contacts_of(normals_of(count, rng), rng)
            ours = serialize_contact_poses(contacts, heading)
            message = as_message(contact_poses(contacts), heading)
            assert ours == zero_padding(serialize_message(message), PoseArray), (count, frame)
            assert deserialize_message(ours, PoseArray) == message


def test_z_points_along_the_normal() -> None:
    rng = np.random.default_rng(4)
    nearly_down = np.array([[1e-7, 0.0, -1.0], [0.0, -1e-12, -1.0]])
    axes = np.vstack((np.eye(3), -np.eye(3)))
    contacts = contacts_of(np.vstack((normals_of(200, rng), [UP, DOWN], nearly_down, axes)), rng)
    poses = contact_poses(contacts)
    assert np.allclose(np.linalg.norm(poses[:, 3:], axis=1), 1.0, atol=1e-14)
    turned = Rotation.from_quat(poses[:, 3:]).apply(UP)
    assert np.abs(turned - contacts.normals.reshape(-1, 3)).max() < 1e-14
    middle = (contacts.points_a + contacts.points_b).reshape(-1, 3) / 2.0
    assert np.array_equal(poses[:, :3], middle)
    assert np.allclose(poses[200, 3:], [0.0, 0.0, 0.0, 1.0])


def test_the_service_publishes_poses_while_there_is_a_subscriber(client: ServiceClient, run_id: int) -> None:
    tell_all(client, run_id)
    client.ask(STATES, run_id)  # nobody plots yet
    heard: list[PoseArray] = []
    topic = qos.CONTACT_POSES
    subscription = client.node.create_subscription(PoseArray, topic.name, heard.append, 10)
    client.spin_until(lambda: subscription.get_publisher_count() == 1, "the service's publisher")
    step = STATES.step
    while not heard:  # the service matches the subscriber at a time of its own
        step += 1
        client.ask(STATES._replace(step=step), run_id)
    expected = expected_contacts()
    assert len(expected.gaps) > 0 and heard[-1].header == client.answers[-1].header
    assert heard[-1] == as_message(contact_poses(expected), Heading(0, 0, "world"))
