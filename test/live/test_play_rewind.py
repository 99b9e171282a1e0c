"""The button "rewind 10 s" of `fracture-collision play` in a real Chromium."""

from __future__ import annotations

from pathlib import Path

import pytest
from stages.browser import chromium, opened, until
from stages.live_page import live_page
from stages.live_player import PLATE

from fracture_collision.ros.nodes.live_client import LiveClient


@pytest.mark.slow
def test_a_scene_is_rewound_and_goes_on(tmp_path: Path) -> None:
    with chromium() as browser, live_page("plates", tmp_path) as scene, opened(browser, scene.address) as page:
        page.get_by_label("shadows").uncheck()
        hands = LiveClient(scene.ears.node)
        scene.until(lambda: hands.is_there() and scene.status.step > 10, "a scene")
        page.get_by_text("4 unbroken").wait_for()
        hands.throw(PLATE - [0.0, 0.5, 0.0], [0.0, 7.0, 0.3])
        scene.until(lambda: scene.status.fragments > 10, "shards and a ball")
        page.get_by_text("3 unbroken").wait_for()
        run_id = scene.status.run_id
        page.get_by_role("button", name="rewind 10 s").click()
        scene.until(lambda: scene.status.run_id != run_id and scene.status.step == 1, "the beginning")
        assert scene.status.paused
        page.get_by_text("4 unbroken").wait_for()
        page.get_by_text("paused").wait_for()
        until(page.get_by_label("pause").is_checked, bool)
        page.get_by_label("pause").uncheck()
        scene.until(lambda: not scene.status.paused and scene.status.step > 20, "the scene that goes on")
        hands.throw(PLATE - [0.0, 0.5, 0.0], [0.0, 7.0, 0.3])
        scene.until(lambda: scene.status.fragments > 10, "shards again")
        page.get_by_text("3 unbroken").wait_for()
