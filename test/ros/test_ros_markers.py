"""Markers for RViz and Foxglove: their bytes, their content, and when they are published."""

from __future__ import annotations

import colorsys
import time

import numpy as np
import pytest
from geometry_msgs.msg import Point, Pose, Quaternion, Vector3
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.serialization import deserialize_message, serialize_message
from stages.ros_client import ServiceClient
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker, MarkerArray
from worlds.broken_bar import BAR, GROUND, STATES
from worlds.gate_world import FIRST, SECOND

from fracture_collision.cdr import Heading
from fracture_collision.records import REMOVE, FragmentMesh, FragmentStates, refusal_of
from fracture_collision.ros.wire.cdr_padding import zero_padding
from fracture_collision.ros.wire.conversion import header_of
from fracture_collision.ros.wire.marker_bytes import MarkerRecord, serialize_markers
from fracture_collision.ros.wire.markers import FragmentMarkers, Scene
from fracture_collision.world import CollisionWorld, Settings


def as_message(records: list[MarkerRecord], heading: Heading) -> MarkerArray:
    """The slow twin: a MarkerArray built with rclpy's classes."""
    return MarkerArray(
        markers=[
            Marker(
                header=header_of(heading), ns=each.namespace, id=each.marker_id, type=each.marker_type,
                action=each.action, scale=Vector3(**dict(zip("xyz", each.scale, strict=True))),
                pose=Pose(
                    position=Point(**dict(zip("xyz", each.position, strict=True))),
                    orientation=Quaternion(**dict(zip("xyzw", each.orientation, strict=True))),
                ),
                color=ColorRGBA(**dict(zip("rgba", map(float, each.colour), strict=True))),
                points=[Point(x=x, y=y, z=z) for x, y, z in np.frombuffer(each.points).reshape(-1, 3).tolist()],
                colors=[
                    ColorRGBA(r=r, g=g, b=b, a=a)
                    for r, g, b, a in np.frombuffer(each.colours, np.float32).reshape(-1, 4).tolist()
                ],
            )
            for each in records
        ]
    )  # fmt: skip


@pytest.mark.parametrize("frame", ["", "world", "map/of/all", "ö"])
def test_bytes_of_markers_equal_those_of_rclpy(frame: str) -> None:
    rng = np.random.default_rng(5)
    heading = Heading(3, 999_999_999, frame)
    for size in (0, 1, 2, 7):
        records = []
        for _ in range(size):
            count = int(rng.integers(0, 4))
            coloured = bool(rng.integers(0, 2))
            records.append(
                MarkerRecord(
                    "x" * int(rng.integers(0, 9)), int(rng.integers(-(2**31), 2**31)), int(rng.integers(0, 12)),
                    int(rng.choice([Marker.ADD, Marker.DELETE, Marker.DELETEALL])), *rng.normal(size=(1, 3)),
                    rng.normal(size=4), rng.normal(size=3), rng.random(4).astype(np.float32),
                    rng.normal(size=(count, 3)).tobytes(),
                    rng.random((count, 4)).astype(np.float32).tobytes() if coloured else b"",
                )
            )  # fmt: skip
        message = as_message(records, heading)
        ours = serialize_markers(records, heading)
        assert ours == zero_padding(serialize_message(message), MarkerArray)
        assert deserialize_message(ours, MarkerArray) == message


def one_run() -> tuple[CollisionWorld, FragmentMarkers]:
    world, markers = CollisionWorld(Settings(threads=1)), FragmentMarkers()
    for body in (BAR, GROUND):
        world.add_body(body)
        markers.add_body(body)
    return world, markers


def shown(world: CollisionWorld, markers: FragmentMarkers, states: FragmentStates, complete: bool) -> list[Marker]:
    """The markers published to a viewer."""
    contacts = world.contacts(states)
    record = world.fragments()
    markers.set_registry(record.fragment_ids, record.body_ids)
    poses = markers.poses(states)
    for fragment_id in markers.lacking(poses):
        markers.add_surface(world.fragment_mesh(fragment_id))
    data = markers.message(Scene(Heading(1, 0, "world"), poses, contacts), complete)
    return deserialize_message(data, MarkerArray).markers


def whole(step: int = 1, height: float = 0.24) -> FragmentStates:
    return FragmentStates(step, 0, np.array([1]), np.array([0.0, 0.0, height]), np.array([0.0, 0.0, 0.0, 1.0]))


def by_name(sent: list[Marker]) -> dict[tuple[str, int], Marker]:
    assert len({(each.ns, each.id) for each in sent}) == len(sent)
    return {(each.ns, each.id): each for each in sent}


def test_markers_show_the_fragment_meshes() -> None:
    world, markers = one_run()
    clear, *sent = shown(world, markers, whole(), complete=True)
    assert clear.action == Marker.DELETEALL
    before = by_name(sent)
    assert set(before) == {("fragments", 1), ("fragments", 2), ("contacts", 0), ("contact_normals", 0)}
    assert before["fragments", 1].pose.position.z == 0.24 and before["fragments", 2].pose.position.z == 0.0

    world.add_fracture(FIRST)
    world.add_fracture(SECOND)
    after = by_name(shown(world, markers, STATES, complete=False))
    assert after["fragments", 1].action == after["cracks", 1].action == Marker.DELETE
    assert ("fragments", 2) not in after  # it has not moved
    outside_hues = set()
    for fragment_id in (10, 12, 13):
        mesh = world.fragment_mesh(fragment_id)
        corners = mesh.vertices.reshape(-1, 3).astype(np.float64)[mesh.triangles.reshape(-1, 3)]
        outside, cracks = after["fragments", fragment_id], after["cracks", fragment_id]
        for marker, chosen in ((outside, ~mesh.is_crack), (cracks, mesh.is_crack)):
            assert marker.type == Marker.TRIANGLE_LIST and marker.action == Marker.ADD
            points = np.array([(p.x, p.y, p.z) for p in marker.points])
            assert np.array_equal(points, corners[chosen].reshape(-1, 3))
            assert marker.pose.position.z == 0.24 and marker.pose.orientation.w == 1.0
        assert lightness(cracks.color) > lightness(outside.color) + 0.1
        outside_hues.add(round(hue(outside.color), 1))
    assert len(outside_hues) == 1  # one colour family per body


def lightness(colour: ColorRGBA) -> float:
    return colorsys.rgb_to_hls(colour.r, colour.g, colour.b)[1]


def hue(colour: ColorRGBA) -> float:
    return colorsys.rgb_to_hls(colour.r, colour.g, colour.b)[0]


def test_only_changed_markers_are_published_again() -> None:
    world, markers = one_run()
    shown(world, markers, whole(), complete=True)
    assert set(by_name(shown(world, markers, whole(2), complete=False))) == {("contacts", 0), ("contact_normals", 0)}
    risen = by_name(shown(world, markers, whole(3, height=0.3), complete=False))
    assert risen["fragments", 1].pose.position.z == 0.3
    assert risen["contacts", 0].action == risen["contact_normals", 0].action == Marker.DELETE  # no contacts in the air
    # markers are deleted after a rewind to before the fracture, and after a body is removed
    world.add_fracture(FIRST)
    broken = STATES._replace(step=4, fracture_sequence=1, fragment_ids=np.array([10, 11]),
                             positions=np.tile([0.0, 0.0, 0.24], (2, 1)),
                             orientations=np.tile([0.0, 0.0, 0.0, 1.0], (2, 1)))
    assert {("fragments", 10), ("fragments", 11)} < set(by_name(shown(world, markers, broken, complete=False)))
    back = by_name(shown(world, markers, whole(5), complete=False))
    assert back["fragments", 10].action == Marker.DELETE and back["fragments", 1].action == Marker.ADD
    world.add_body(GROUND._replace(operation=REMOVE))
    assert by_name(shown(world, markers, whole(6), complete=False))["fragments", 2].action == Marker.DELETE


def test_contacts_are_points_and_normals_coloured_by_gap() -> None:
    world, markers = one_run()
    contacts = world.contacts(whole(height=0.2495))
    assert len(contacts.gaps) > 0
    sent = by_name(shown(world, markers, whole(height=0.2495), complete=False))
    points, lines = sent["contacts", 0], sent["contact_normals", 0]
    middle = 0.5 * (contacts.points_a + contacts.points_b).reshape(-1, 3)
    assert np.array_equal([(p.x, p.y, p.z) for p in points.points], middle)
    ends = np.array([(p.x, p.y, p.z) for p in lines.points]).reshape(-1, 2, 3)
    directions = (ends[:, 1] - ends[:, 0]) / np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)[:, None]
    assert np.allclose(directions, contacts.normals.reshape(-1, 3))
    assert all(c.r > 0.8 and c.g < 0.3 for c in points.colors)  # half a millimetre deep: red
    assert len(lines.colors) == 2 * len(points.colors) == 2 * len(contacts.gaps)


def test_fragment_ids_above_the_signed_range_become_negative() -> None:
    markers = FragmentMarkers()
    highest = 2**32 - 1
    markers.add_body(BAR._replace(fragment_id=highest))
    markers.set_registry(np.array([highest]), np.array([1]))
    mesh = FragmentMesh(highest, np.eye(3, dtype=np.float32), np.arange(3, dtype=np.uint32)[None], np.zeros(1, bool))
    markers.add_surface(mesh)
    states = whole()._replace(fragment_ids=np.array([highest]))
    nothing = refusal_of(states, 0.0)
    data = markers.message(Scene(Heading(0, 0, "world"), markers.poses(states), nothing), True)
    assert [each.id for each in deserialize_message(data, MarkerArray).markers if each.ns == "fragments"] == [-1]


class Viewer:
    """The markers RViz would display."""

    def __init__(self, client: ServiceClient, durability: DurabilityPolicy) -> None:
        self.shown: dict[tuple[str, int], Marker] = {}
        self.sequence_numbers: list[int] = []  # of the messages: 1, 2, 3 ... as the publisher counts them
        profile = QoSProfile(depth=10, durability=durability)
        self.subscription = client.node.create_subscription(MarkerArray, "markers", self._on_markers, profile)

    def _on_markers(self, message: MarkerArray, info: dict[str, int]) -> None:
        self.sequence_numbers.append(info["publication_sequence_number"])
        for marker in message.markers:
            if marker.action == Marker.DELETEALL:
                self.shown.clear()
            elif marker.action == Marker.DELETE:
                self.shown.pop((marker.ns, marker.id), None)
            else:
                self.shown[marker.ns, marker.id] = marker

    def fragments(self) -> set[int]:
        return {number for name, number in self.shown if name == "fragments"}


def test_viewers_get_the_complete_scene_whenever_they_join(client: ServiceClient, run_id: int) -> None:
    viewer = Viewer(client, DurabilityPolicy.VOLATILE)
    for body in (BAR, GROUND):
        client.publish("bodies", body, run_id)
    client.ask(whole(1), run_id)
    client.spin_until(lambda: viewer.fragments() == {1, 2}, "the whole body")
    for event in (FIRST, SECOND):
        client.publish("fracture_events", event, run_id)
    client.ask(STATES, run_id)
    client.spin_until(lambda: viewer.fragments() == {2, 10, 12, 13}, "its fragments")
    late = Viewer(client, DurabilityPolicy.TRANSIENT_LOCAL)  # joins while no states are published
    client.spin_until(lambda: late.shown.keys() == viewer.shown.keys(), "all for a late one")

    # a new run: all markers of the first are gone
    client.publish("bodies", BAR._replace(body_id=5, fragment_id=5), run_id + 1)
    client.ask(whole(1)._replace(fragment_ids=np.array([5])), run_id + 1)
    client.spin_until(lambda: viewer.fragments() == late.fragments() == {5}, "the other run")

    # a subscriber that joins after all others have left gets the complete scene
    for each in (viewer, late):
        client.node.destroy_subscription(each.subscription)
    client.ask(whole(2, height=0.3)._replace(fragment_ids=np.array([5])), run_id + 1)
    again = Viewer(client, DurabilityPolicy.VOLATILE)
    client.spin_until(lambda: again.fragments() == {5}, "all again")
    assert again.shown["fragments", 5].pose.position.z == 0.3


def test_nothing_is_published_without_subscribers(client: ServiceClient, run_id: int) -> None:
    """While there is a subscriber, as many states give several messages."""
    for body in (BAR, GROUND):
        client.publish("bodies", body, run_id)

    def ask_for_a_second(first_step: int) -> None:
        for step in range(first_step, first_step + 20):
            client.ask(whole(step, height=0.3 + 0.01 * step), run_id)
            pause(client, 0.05)

    viewer = Viewer(client, DurabilityPolicy.VOLATILE)
    client.ask(whole(1), run_id)
    client.spin_until(lambda: viewer.fragments() == {1, 2}, "the whole body")
    before = len(viewer.sequence_numbers)
    ask_for_a_second(2)
    assert len(viewer.sequence_numbers) > before + 4

    client.node.destroy_subscription(viewer.subscription)
    pause(client, 1.0)  # until the service has noticed, it may publish the last states
    ask_for_a_second(22)
    again = Viewer(client, DurabilityPolicy.VOLATILE)
    client.spin_until(lambda: again.fragments() == {1, 2}, "all again")
    assert again.sequence_numbers[0] <= viewer.sequence_numbers[-1] + 3


def pause(client: ServiceClient, seconds: float) -> None:
    ends = time.monotonic() + seconds
    while time.monotonic() < ends:
        client.spin_once(max(ends - time.monotonic(), 0.0))
