"""The page without a browser: what it serves, stores and sends, also to the client that benchmarks/page uses."""

from __future__ import annotations

import io
import json
import subprocess
import sys
import threading
import time
import urllib.request
from typing import Any

import numpy as np
import pytest
import trimesh
from stages.browser import until
from worlds.small_run import records_of, show

from benchmarks.page.lookers import taker
from fracture_collision.records import CollisionBody, FragmentMesh, FragmentStates
from fracture_collision.viewer.page.page import INTERVAL, MOST_BEHIND, Page
from fracture_collision.viewer.page.page_plots import Figures
from fracture_collision.viewer.page.server.page_stream import STILL, LiveValues
from fracture_collision.viewer.pictures.body_mesh import mesh_of_body, mesh_of_fragment
from fracture_collision.viewer.pictures.gltf import glb_of_mesh
from fracture_collision.viewer.pictures.palette import Palette, display_colour

SERVE = """
import sys
from fracture_collision.viewer.page.page import Page
with Page() as page:
    print(page.address)
print([name for name in ("requests", "certifi", "tqdm", "rclpy") if name in sys.modules])
"""


def test_the_page_serves_localhost_and_loads_no_copyleft_package() -> None:
    done = subprocess.run([sys.executable, "-c", SERVE], capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    address, loaded = done.stdout.splitlines()
    assert address.startswith("http://127.0.0.1:") and loaded == "[]"
    assert not done.stderr


def test_pages_have_ports_of_their_own_and_close() -> None:
    with Page() as one, Page() as other:
        assert one.address != other.address
        with urllib.request.urlopen(one.address, timeout=30) as answer:
            assert b"<html" in answer.read(1000).lower()
        assert one._server.request_share_url() is None
    with pytest.raises(OSError):
        urllib.request.urlopen(one.address, timeout=5)


def test_a_fragment_in_gltf_has_the_triangles_of_its_mesh() -> None:
    palette = Palette()
    for body in records_of(CollisionBody):
        palette.add(body)
    for record in records_of(FragmentMesh):
        mesh = mesh_of_fragment(record)
        paint = palette.paint(record.fragment_id, 3)
        read = trimesh.load(io.BytesIO(glb_of_mesh(mesh, paint)), file_type="glb")
        parts = list(read.geometry.values())
        assert sum(len(part.faces) for part in parts) == len(mesh.triangles)
        assert {len(part.faces) for part in parts} == {n for n in (mesh.is_crack.sum(), (~mesh.is_crack).sum()) if n}
        assert sum(part.area for part in parts) == pytest.approx(
            0.5 * np.linalg.norm(np.cross(*(mesh.triangles[:, i] - mesh.triangles[:, 0] for i in (1, 2))), axis=1).sum()
        )
        assert np.allclose(read.bounds, [mesh.triangles.min(axis=(0, 1)), mesh.triangles.max(axis=(0, 1))], atol=1e-6)


def test_what_does_not_break_has_no_hue_and_hammer_balls_and_arm_differ() -> None:
    palette = Palette()
    plate = next(body for body in records_of(CollisionBody) if len(body.tetrahedra))
    for body_id in range(10, 18):  # one of each family of colours
        palette.add(plate._replace(body_id=body_id))
    ball = next(body for body in records_of(CollisionBody) if body.name == "ball")
    for body_id, name, density in ((1, "thrown 1", 2000.0), (2, "hammer", 7800.0), (3, "robot link", 1000.0)):
        palette.add(ball._replace(body_id=body_id, name=name, density=density))
    paints = [palette.paint(body_id, body_id) for body_id in (1, 2, 3)]
    assert len({paint.outside for paint in paints}) == 3
    assert [paint.is_metal for paint in paints] == [False, True, False]
    for paint in paints:
        assert max(display_colour(paint.outside)) - min(display_colour(paint.outside)) < 0.05
    for body_id in range(10, 18):
        for fragment_id in range(30):
            colour = display_colour(palette.paint(fragment_id, body_id).outside)
            assert max(colour) - min(colour) > 0.3
    assert materials(glb_of_mesh(mesh_of_body(ball), paints[1])) == [1.0]
    assert materials(glb_of_mesh(mesh_of_body(ball), paints[0])) == [0.0]


def materials(glb: bytes) -> list[float]:
    """The metallic factor of each material of a file."""
    length = int.from_bytes(glb[12:16], "little")
    described = json.loads(glb[20 : 20 + length])
    return [material["pbrMetallicRoughness"]["metallicFactor"] for material in described["materials"]]


class OneBrowser:
    """Replaces the server: records what a browser would be sent."""

    def __init__(self) -> None:
        self.sent: list[Any] = []
        self.flushed = 0  # how many of these were flushed
        self._websock_connection = self

    def get_clients(self) -> dict[int, OneBrowser]:
        return {0: self}

    def atomic(self) -> Any:
        return threading.Lock()

    def queue_message(self, message: Any) -> None:
        self.sent.append(message)

    def flush(self) -> None:
        self.flushed = len(self.sent)


def test_only_moved_fragments_are_sent_and_a_late_browser_gets_all() -> None:
    browser = OneBrowser()
    live = LiveValues(browser)
    poses = np.tile([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0], (3, 1))
    live.pose(["/a", "/b", "/c"], poses)
    assert browser.flushed == len(browser.sent) == 6
    moved = poses.copy()
    moved[1, 2] = 0.5  # b moves without turning
    moved[2, 0] = 0.5 * STILL
    live.pose(["/a", "/b", "/c"], moved)
    assert [(message.name, message.position) for message in browser.sent[6:]] == [("/b", (0.0, 0.0, 0.5))]
    for step in range(1, 10):  # slow motion is sent once it adds up to STILL
        moved[2, 0] = 0.3 * step * STILL
        live.pose(["/a", "/b", "/c"], moved)
    assert {message.name for message in browser.sent[7:]} == {"/c"}
    live.forget("/c")
    late = OneBrowser()
    live.send_all(late)
    assert sorted(message.name for message in late.sent) == ["/a", "/a", "/b", "/b"]
    assert live.messages_sent == len(browser.sent)


def test_a_body_is_shown_until_its_pieces_have_meshes() -> None:
    meshes, states = records_of(FragmentMesh), records_of(FragmentStates)
    with Page() as page:
        show(page)
        nodes = page._scene._nodes
        assert sorted(nodes) == [2, 3, 4, 5] and all(node.visible for node in nodes.values())
        for mesh in meshes[1:]:
            page.add_fragment(mesh, 3)
        page.show_states(states[-1])
        page.flush()
        assert nodes[3].visible
        page.add_fragment(meshes[0], 3)
        page.show_states(states[-1])
        page.flush()
        assert not nodes[3].visible and all(nodes[mesh.fragment_id].visible for mesh in meshes)
        page.show_states(states[0])  # rewind
        page.flush()
        assert nodes[3].visible and not nodes[meshes[0].fragment_id].visible
        page.new_run()
        page.flush()
        assert not page._scene._nodes


def test_bodies_that_arrive_after_their_states_are_placed() -> None:
    states = records_of(FragmentStates)
    with Page() as page:
        page.show_states(states[-1])  # and no further states: a pause
        page.flush()
        for record in records_of(CollisionBody):
            page.add_body(record)
        for mesh in records_of(FragmentMesh):
            page.add_fragment(mesh, 3)
        page.flush()
        assert sorted(page._scene._nodes) == sorted(states[-1].fragment_ids)


def test_a_floor_is_not_drawn_as_a_fragment() -> None:
    meshes, states = records_of(FragmentMesh), records_of(FragmentStates)[0]
    with Page() as page:
        for body in records_of(CollisionBody):
            page.add_body(body)
        page.add_fragment(meshes[0]._replace(fragment_id=1), 1)  # services publish meshes of floors too
        floor = {"fragment_ids": [1], "positions": [[0.0, 0.0, 0.0]], "orientations": [[0.0, 0.0, 0.0, 1.0]]}
        for fewer in (0, 1):  # in the second pass the last body is gone
            count = len(states.fragment_ids) - fewer
            named = {
                name: np.concatenate((own, getattr(states, name)[: len(own) * count])) for name, own in floor.items()
            }
            page.show_states(states._replace(**named))
            page.flush()
        nodes = page._scene._nodes
        assert sorted(nodes) == sorted(states.fragment_ids) and 1 not in nodes
        assert not nodes[int(states.fragment_ids[-1])].visible


def test_thirty_two_pictures_a_second_show_the_newest_states_and_all_figures() -> None:
    states = records_of(FragmentStates)[0]
    with Page(told=frozenset({"contacts"})) as page:
        show(page)
        first, seen, step = page.pictures, [time.monotonic()], 0  # when each picture was first seen
        while len(seen) <= 40:
            step += 1
            page.show_states(states._replace(step=step))
            page.show_figures(Figures(1e-3 * step, contacts=step))
            time.sleep(1e-3)
            seen += [time.monotonic()] * (page.pictures - first - len(seen) + 1)
        page.flush()
        # on a busy machine some pictures are late, and at most MOST_BEHIND of them is caught up
        assert (len(seen) - 1) * INTERVAL <= seen[-1] - seen[0] + MOST_BEHIND + 2.0 * INTERVAL
        assert page._placed.step == step
        assert len(page._plots._rows) == step  # all figures are kept, also those between two pictures
    with pytest.raises(ValueError, match="no figures beer; there are time"):
        Page(told=frozenset({"beer"}))


PICTURES = 5


def test_a_test_client_gets_the_meshes_and_poses_of_a_browser() -> None:
    states = records_of(FragmentStates)[0]
    with Page() as page:
        show(page)
        with taker(page.address) as seen:
            until(lambda: sorted(mesh.fragment_id for mesh in seen.meshes()), lambda ids: ids == [2, 3, 4, 5])
            until(lambda: page.browsers, lambda count: count == 1)
            until(lambda: seen.pictures().count, bool)  # the state at its connection
            places, counted = states.positions.reshape(-1, 3), []
            for step in range(1, PICTURES + 1):
                before = page.pictures
                page.show_states(states._replace(positions=places + [0.0, 0.0, 0.01 * step]))
                until(lambda before=before: page.pictures, lambda count, before=before: count > before)
            # a newer pose may replace one that has not been sent
            until(lambda: counted.append(seen.pictures()) or sum(each.count for each in counted), bool)
    assert sum(each.count for each in counted) <= PICTURES + 1  # plus one that may have been in flight
    assert 0.0 < counted[-1].moved <= len(places)
    assert not seen.shown()
