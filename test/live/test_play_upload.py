"""`fracture-collision play` in a real Chromium: a user uploads a torus and smashes it; other files bring words."""

from __future__ import annotations

import io
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from stages.browser import knob, opened, until
from stages.live_page import LivePage, choose, live_page

from fracture_collision.ros.nodes.live_client import LiveClient
from fracture_collision.viewer.page.server.page_upload import MOST_BYTES


@pytest.fixture
def scene(browser: Any, tmp_path: Path) -> Iterator[LivePage]:
    with live_page("pane", tmp_path / "play") as made:
        yield made


def send(page: Any, name: str, content: bytes) -> None:
    page.locator("input[type=file]").set_input_files({"name": name, "mimeType": "", "buffer": content})


def rejected(page: Any, name: str, content: bytes, words: str) -> None:
    send(page, name, content)
    page.get_by_text(words).wait_for(state="attached")


def with_a_pickle() -> bytes:
    stream = io.BytesIO()
    np.savez(stream, vertices=np.array([{}], dtype=object), tetrahedra=np.array([[0, 1, 2, 3]]))
    return stream.getvalue()


@pytest.mark.slow
def test_an_uploaded_torus_is_smashed(browser: Any, scene: LivePage, tmp_path: Path) -> None:
    torus = trimesh.creation.torus(0.1, 0.03).export(file_type="obj").encode()
    hands = LiveClient(scene.ears.node)
    with opened(browser, scene.address) as page:
        page.get_by_label("shadows").uncheck()
        run_id = scene.status.run_id
        rejected(page, "broken.obj", b"f 1 2 3\n", "broken.obj: ")
        rejected(page, "huge.stl", bytes(MOST_BYTES + 1), "huge.stl: 20.0 MB, more than 20 MB")
        rejected(page, "pickle.npz", with_a_pickle(), "pickle.npz: vertices: not rows of floats but object")
        rejected(page, "..\\x.obj", torus, "a file's name has no folders")
        assert scene.status.run_id == run_id and not list((tmp_path / "play" / "uploads").glob("*.yaml"))

        send(page, "my torus.obj", torus)
        page.get_by_text("my torus.obj is the scene upload_1").wait_for(state="attached")
        scene.until(lambda: scene.status.scene == "upload_1" and scene.status.step > 20, "the uploaded scene")
        page.get_by_text("1 unbroken").wait_for()
        until(lambda: knob(page, "scene").input_value(), lambda name: name == "upload_1")
        hands.throw([0.0, -0.6, 0.05], [0.0, 8.0, 0.3])
        scene.until(lambda: scene.status.fragments > 6, "shards and a ball")
        page.get_by_text("1 in ").wait_for()

        choose(page, "scene", "plates")
        scene.until(lambda: scene.status.scene == "plates", "another scene")
        page.reload()
        page.wait_for_selector("canvas")
        until(lambda: knob(page, "scene").input_value(), lambda name: name == "plates")
        choose(page, "scene", "upload_1")
        scene.until(lambda: scene.status.scene == "upload_1" and scene.status.fragments == 1, "the torus, whole again")

        page.get_by_label("pause").check()
        scene.until(lambda: scene.status.paused, "a pause")
        choose(page, "scene", "plates")
        scene.until(lambda: scene.status.scene == "plates" and scene.status.step == 1, "one step of a paused scene")
        page.get_by_text(f"paused: untick pause to go on · {scene.status.contacts} contacts").wait_for()
    written = sorted(file.name for file in (tmp_path / "play" / "uploads").iterdir())
    assert written == ["upload_1.npz", "upload_1.yaml"]
