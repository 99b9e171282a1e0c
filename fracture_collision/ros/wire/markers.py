"""The scene as markers for RViz and Foxglove: surfaces of fragments, contacts coloured by gap.

Markers are made only while there is a subscriber. A marker that moves is sent with all its points again, since there
is no transform to move it. So markers that have not moved are left out, and messages are written as bytes
(ros/wire/marker_bytes.py). Messages follow answers, at most ten a second and never after two answers in a row, so that
a step hardly ever waits for them. A message may get lost, and a late joiner receives only the last one, so every two
seconds a message is complete.
"""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from rclpy.clock import Clock, ClockType
from rclpy.duration import Duration
from rclpy.node import Node
from visualization_msgs.msg import Marker

from fracture_collision.cdr import Heading
from fracture_collision.records import ADD, CollisionBody, ContactConstraintArray, FragmentMesh, FragmentStates
from fracture_collision.ros.wire import qos
from fracture_collision.ros.wire.marker_bytes import MarkerRecord, serialize_markers
from fracture_collision.viewer.pictures.palette import Palette, display_colour, gap_colours

if TYPE_CHECKING:  # it imports numba, and the service announces itself before that
    from fracture_collision.world import CollisionWorld

INTERVAL = 0.1  # [s] between two messages
COMPLETE_INTERVAL = 2.0  # [s] between two complete messages
ACKNOWLEDGEMENT = 1.0  # [s] that a message waits for all to acknowledge the last one
# [s] A new subscriber is discovered here before it discovers this publisher, and receives nothing until then.
MATCHING = 1.0
MESH_TIME = 0.02  # [s] of an update for making meshes; the other fragments follow in later updates
STILL = 2e-5  # change of coordinates [m] and of quaternions that is invisible
POINT_SIZE, LINE_WIDTH, NORMAL_LENGTH = 0.008, 0.002, 0.04  # [m]
OUTSIDE, CRACK, CONTACTS, NORMALS = "fragments", "cracks", "contacts", "contact_normals"
AT_ORIGIN = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
CLEAR = MarkerRecord("", 0, Marker.CUBE, Marker.DELETEALL)


class Scene(NamedTuple):
    """What is shown."""

    heading: Heading
    poses: dict[int, np.ndarray]  # by fragment: position [m] and quaternion x y z w
    contacts: ContactConstraintArray


class FragmentMarkers:
    """Computes the markers that bring a viewer from the last message to the current scene. No topics, no clock."""

    def __init__(self) -> None:
        self._palette = Palette()
        self._static: dict[int, bool] = {}  # by body
        self._surfaces: dict[int, list[MarkerRecord]] = {}  # by fragment, in its body frame
        self._body_of: dict[int, int] = {}
        self._sent: dict[int, np.ndarray] = {}  # poses, by fragment

    def add_body(self, body: CollisionBody) -> None:
        """The first body with an id counts."""
        self._palette.add(body)
        self._static.setdefault(body.body_id, body.is_static)

    def set_registry(self, fragment_ids: np.ndarray, body_ids: np.ndarray) -> None:
        """Takes all living fragments."""
        self._body_of = dict(zip(fragment_ids.tolist(), body_ids.tolist(), strict=True))
        for gone in self._surfaces.keys() - self._body_of.keys():
            del self._surfaces[gone]

    def poses(self, states: FragmentStates) -> dict[int, np.ndarray]:
        """Of living fragments: those that the states name, and static ones."""
        table = np.hstack((states.positions.reshape(-1, 3), states.orientations.reshape(-1, 4)))
        static = (each for each, body in self._body_of.items() if self._static.get(body, False))
        named = zip(states.fragment_ids.tolist(), table, strict=True)
        return dict.fromkeys(static, AT_ORIGIN) | {each: pose for each, pose in named if each in self._body_of}

    def lacking(self, fragment_ids: Iterable[int]) -> list[int]:
        """Those without a surface."""
        return [each for each in fragment_ids if each not in self._surfaces]

    def add_surface(self, mesh: FragmentMesh) -> None:
        """Takes the surface of a fragment of the registry."""
        corners = mesh.vertices.reshape(-1, 3).astype(np.float64)[mesh.triangles.reshape(-1, 3)]
        paint = self._palette.paint(mesh.fragment_id, self._body_of[mesh.fragment_id])
        self._surfaces[mesh.fragment_id] = [
            MarkerRecord(
                name, _marker_id(mesh.fragment_id), Marker.TRIANGLE_LIST, colour=(*display_colour(colour), 1.0),
                points=corners[chosen].tobytes(),
            )
            for name, colour, chosen in (
                (OUTSIDE, paint.outside, ~mesh.is_crack), (CRACK, paint.crack, mesh.is_crack),
            )
            if np.any(chosen)
        ]  # fmt: skip

    def message(self, scene: Scene, complete: bool) -> bytes:
        """The serialized message: all markers, or those that changed since the last one."""
        here = {each: pose for each, pose in scene.poses.items() if each in self._surfaces}
        if complete:
            self._sent.clear()
        markers = [CLEAR] if complete else list(self._deletions(here))
        for fragment_id, pose in here.items():
            if fragment_id not in self._sent or np.abs(pose - self._sent[fragment_id]).max() > STILL:
                self._sent[fragment_id] = pose
                position, orientation = tuple(pose[:3].tolist()), tuple(pose[3:].tolist())
                markers += [
                    surface._replace(position=position, orientation=orientation)
                    for surface in self._surfaces[fragment_id]
                ]
        return serialize_markers([*markers, *contact_markers(scene.contacts)], scene.heading)

    def _deletions(self, here: dict[int, np.ndarray]) -> Iterator[MarkerRecord]:
        for gone in sorted(self._sent.keys() - here.keys()):
            del self._sent[gone]
            for name in (OUTSIDE, CRACK):
                yield MarkerRecord(name, _marker_id(gone), Marker.TRIANGLE_LIST, Marker.DELETE)


def _marker_id(fragment_id: int) -> int:
    """The int32 of the same bits as the uint32."""
    return (fragment_id + 2**31) % 2**32 - 2**31


def contact_markers(contacts: ContactConstraintArray) -> list[MarkerRecord]:
    """Points between the witnesses and lines along the normals, by gap from red (penetrating) to green (apart)."""
    if not len(contacts.gaps):
        return [
            MarkerRecord(CONTACTS, 0, Marker.POINTS, Marker.DELETE),
            MarkerRecord(NORMALS, 0, Marker.LINE_LIST, Marker.DELETE),
        ]
    middle = 0.5 * (contacts.points_a + contacts.points_b).reshape(-1, 3)
    lines = np.stack((middle, middle + NORMAL_LENGTH * contacts.normals.reshape(-1, 3)), axis=1)
    colours = np.ones((len(middle), 4), np.float32)
    colours[:, :3] = gap_colours(contacts.gaps)
    return [
        MarkerRecord(
            CONTACTS, 0, Marker.POINTS, scale=(POINT_SIZE, POINT_SIZE, 0.0), colour=(1.0,) * 4,
            points=middle.tobytes(), colours=colours.tobytes(),
        ),
        MarkerRecord(
            NORMALS, 0, Marker.LINE_LIST, scale=(LINE_WIDTH, 0.0, 0.0), colour=(1.0,) * 4, points=lines.tobytes(),
            colours=np.repeat(colours, 2, axis=0).tobytes(),
        ),
    ]  # fmt: skip


class _Answer(NamedTuple):
    """An answer of the service, and the world that made it."""

    world: CollisionWorld
    heading: Heading
    states: FragmentStates
    contacts: ContactConstraintArray


class MarkersPublisher:
    """Publishes a node's `markers`."""

    def __init__(self, node: Node) -> None:
        topic = qos.MARKERS
        self._publisher = node.create_publisher(topic.message_class, topic.name, topic.qos)
        self._subscribers = 0
        self._last_sent = self._last_complete = self._changed = -np.inf
        self._all_have_all = False  # subscribers and markers, as far as can be known
        self._answers_since = 0
        self.forget()
        # For updates that follow no answer: the last states before a pause, remaining meshes, new subscribers.
        node.create_timer(2.5 * INTERVAL, self._look, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def forget(self) -> None:
        """Starts a new run."""
        self._markers = FragmentMarkers()
        self._listed_for: int | None = None  # number of events of the known registry
        self._newest: _Answer | None = None
        self._is_pending = False
        self._must_be_complete = True

    def add_body(self, body: CollisionBody) -> None:
        """Takes an accepted body, or a removal."""
        if body.operation == ADD:
            self._markers.add_body(body)
        self._listed_for = None

    def after_answer(
        self, world: CollisionWorld, heading: Heading, states: FragmentStates, contacts: ContactConstraintArray
    ) -> None:
        """Takes the newest answer and publishes it, unless the last message is too recent."""
        self._newest = _Answer(world, heading, states, contacts)
        self._is_pending = True
        self._answers_since += 1
        if self._answers_since > 1 and time.monotonic() - self._last_sent >= INTERVAL:
            self._update()

    def _look(self) -> None:
        if time.monotonic() - self._last_sent >= 2.0 * INTERVAL:
            self._update()

    def _update(self) -> None:
        now = time.monotonic()
        subscribers = self._publisher.get_subscription_count()
        if subscribers != self._subscribers:
            self._subscribers, self._changed = subscribers, now
            self._must_be_complete = True
        if not subscribers or self._newest is None:
            return
        is_due = now - self._last_complete >= COMPLETE_INTERVAL
        if not (self._is_pending or self._must_be_complete or (is_due and not self._all_have_all)):
            return
        if not self._publisher.wait_for_all_acked(Duration(nanoseconds=0)):
            if now - self._last_sent < ACKNOWLEDGEMENT:
                return
            self._must_be_complete = True
        self._send(self._newest, self._must_be_complete or is_due)

    def _send(self, answer: _Answer, complete: bool) -> None:
        world, heading, states, contacts = answer
        if self._listed_for != states.fracture_sequence:
            self._listed_for = states.fracture_sequence
            record = world.fragments()
            self._markers.set_registry(record.fragment_ids, record.body_ids)
        poses = self._markers.poses(states)
        lacking = self._markers.lacking(poses)
        deadline = time.monotonic() + MESH_TIME
        while lacking:
            self._markers.add_surface(world.fragment_mesh(lacking.pop(0)))
            if time.monotonic() > deadline:
                break
        self._publisher.publish(self._markers.message(Scene(heading, poses, contacts), complete))
        self._is_pending = bool(lacking)
        self._last_sent = time.monotonic()
        self._all_have_all = complete and self._last_sent - self._changed > MATCHING
        self._must_be_complete, self._answers_since = False, 0
        if complete:
            self._last_complete = self._last_sent
