"""Files and commands that are sent to the page: what arrives, and what is rejected, with words in the browser.

Commands may come before the simulator is discovered, and their responses may be lost.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from queue import Queue
from typing import Any

import numpy as np
import pytest
from rclpy.task import Future
from stages.browser import chromium, opened, until
from stages.page_client import PageClient, page_client, wait_until
from stages.ros_stage import StageWithClients

from fracture_collision.ros.nodes import repeated_request
from fracture_collision.ros.nodes.page_commands import PageCommands
from fracture_collision.ros.nodes.repeated_request import RepeatedRequest
from fracture_collision.ros.wire.interfaces import LIVE_STATUS
from fracture_collision.viewer.page.page import Page
from fracture_collision.viewer.page.page_events import Ball, Handlers, Ray, ServiceSliders, Start, Upload
from fracture_collision.viewer.page.server.page_upload import MOST_BYTES, MOST_TRANSFERS

START = Start(scenes=("plates",), scene="plates", mesh_suffixes=(".obj", ".npz"))
BUTTON = "upload a mesh"


@pytest.fixture
def got() -> Queue[Upload]:
    return Queue()


@pytest.fixture
def page(got: Queue[Upload]) -> Iterator[Page]:
    with Page(Handlers(uploaded=got.put), START) as served:
        yield served


def refused(client: PageClient, words: str) -> None:
    wait_until(lambda: client.notices)
    assert words in client.notices.pop(0)


def test_a_file_arrives_in_parts(page: Page, got: Queue[Upload]) -> None:
    with page_client(page.address) as client, page_client(page.address) as other:
        client.upload(BUTTON, "a b.OBJ", [b"v 0 0 0\n", b"v 1 0 0\n"])
        upload = got.get(timeout=30.0)
        assert (upload.name, upload.content) == ("a b.OBJ", b"v 0 0 0\nv 1 0 0\n")
        upload.tell("thanks")
        refused(client, "thanks")
        assert client.acknowledged == [8, 16] and client.removed, "the notice of progress is gone"
        assert not other.notices and not other.acknowledged


def test_invalid_files_are_rejected_with_words(page: Page, got: Queue[Upload]) -> None:
    with page_client(page.address) as client:
        for name, size, words in (
            ("../../etc/cron.d/x.obj", 8, "no folders"),
            ("C:\\x.obj", 8, "no folders"),
            ("x\n.obj", 8, "no control characters"),
            ("x" * 400 + ".obj", 8, "more than 255 characters"),
            ("x.pkl", 8, "none of .obj, .npz"),
            ("obj", 8, "none of .obj, .npz"),
            ("x.obj", MOST_BYTES + 1, "20.0 MB, more than 20 MB"),
            ("x.obj", 0, "empty"),
            ("x.obj", -1, "empty"),
            ("x.obj", 4, "longer than declared"),
        ):
            client.upload(BUTTON, name, [b"12345678"], size)
            refused(client, words)
            client.upload(BUTTON, "next.obj", [b"12345678"])
            assert got.get(timeout=30.0).name == "next.obj", "the connection is still there"
            assert got.empty()


def test_few_files_are_sent_at_a_time_and_those_of_closed_pages_forgotten(page: Page, got: Queue[Upload]) -> None:
    with page_client(page.address) as last:
        with page_client(page.address) as one, page_client(page.address) as two:
            others = [one, two]
            assert len(others) < MOST_TRANSFERS
            for client in others:
                client.upload(BUTTON, "x.obj", [b"1"], 8)
            with page_client(page.address) as three, page_client(page.address) as four:
                for client in (three, four):
                    client.upload(BUTTON, "x.obj", [b"1"], 8)
                for client in (one, two, three, four):
                    wait_until(lambda client=client: client.acknowledged == [1])
                last.upload(BUTTON, "x.obj", [b"12"])
                refused(last, "others are sending")
        until(lambda: page.browsers, lambda count: count == 1)
        last.upload(BUTTON, "x.obj", [b"12"])
        assert got.get(timeout=30.0).content == b"12"


@pytest.mark.slow
def test_a_browser_sends_a_file(page: Page, got: Queue[Upload], tmp_path: Path) -> None:
    (tmp_path / "large.obj").write_bytes(bytes(MOST_BYTES + 1))
    (tmp_path / "small.obj").write_bytes(bytes(1_300_000))  # three parts
    with chromium() as browser, opened(browser, page.address) as seen:

        def send(name: str) -> None:
            seen.locator("input[type=file]").set_input_files(str(tmp_path / name))

        send("large.obj")
        seen.get_by_text("large.obj: 20.0 MB, more than 20 MB").wait_for(state="attached")
        assert_ready(seen)
        send("small.obj")
        assert got.get(timeout=60.0).content == bytes(1_300_000)
        assert_ready(seen)
        assert not seen.get_by_text("uploaded successfully").count(), "whether it was is not known before it is read"


def assert_ready(seen: Any) -> None:
    until(seen.get_by_role("button", name=BUTTON).is_enabled, bool)


def test_a_scene_and_a_pause_chosen_before_the_simulator_is_there_are_not_lost(
    stage: StageWithClients, tmp_path: Path
) -> None:
    ears, notices, told = stage.client(), [], []
    commands = PageCommands(ears.node, tmp_path, lambda _: None, notices.append, lambda _: None)
    ears.node.create_subscription(LIVE_STATUS.message_class, LIVE_STATUS.name, told.append, LIVE_STATUS.qos)
    ears.node.create_timer(0.05, commands.look)
    commands.handlers().scene_chosen("bunnies")
    commands.handlers().scene_chosen("pane")
    commands.handlers().paused(True)
    ears.spin_once(0.2)
    stage.start("collision_node")
    stage.start("live_simulator_node", scene="plates", seed=7)
    ears.spin_until(lambda: bool(told) and told[-1].scene == "pane" and told[-1].paused, "the paused scene")
    assert not notices
    commands.close()


def test_a_command_that_fails_leaves_the_page_running(stage: StageWithClients, tmp_path: Path) -> None:
    """A ball without speed never arrives, and no parameter takes an integer of more than 64 bits."""
    ears, notices = stage.client(), []
    commands = PageCommands(ears.node, tmp_path, lambda _: None, notices.append, lambda _: None)
    commands._hands.is_there = lambda: True  # type: ignore[method-assign]
    ray = Ray(np.zeros(3), np.array([1.0, 0.0, 0.0]))
    commands.handlers().clicked(ray, Ball(speed=0.0, radius=0.04))
    commands.handlers().service_set(ServiceSliders(contacts_per_pair=10**30))
    ears.spin_until(lambda: len(notices) == 2, "two notices")
    assert all(notice.startswith("a command failed: ") for notice in notices)
    commands.close()


@pytest.fixture
def sent(monkeypatch: pytest.MonkeyPatch) -> list[Future]:
    monkeypatch.setattr(repeated_request, "ASK_AGAIN", 0.0)
    return []


def sends(sent: list[Future]) -> Future:
    sent.append(Future())
    return sent[-1]


def test_a_newer_request_replaces_one_without_a_response(sent: list[Future]) -> None:
    responses = []
    request = RepeatedRequest(lambda: True)
    for _ in range(2):
        request.begin(lambda: sends(sent), lambda done: responses.append(done.result()))
    sent[0].set_result("of the first")
    assert not responses
    sent[1].set_result("of the second")
    assert responses == ["of the second"]
    request.begin(lambda: sends(sent), lambda done: responses.append(done.result()))
    request.drop()
    sent[2].set_result("of a dropped one")
    request.look()
    assert len(sent) == 3 and len(responses) == 1
