"""`fracture-collision play` in a real Chromium: real nodes over DDS behind the page, and a person who smashes."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from browser import chromium, drop_warning, number_of, opened, picture_of, until
from fracture_collision.msg import FragmentStates, SimulationStatus
from ros_client import PATIENCE, ServiceClient

from fracture_collision.ros import qos
from fracture_collision.ros.node_process import free_domain_id
from fracture_collision.ros.play_run import Played, played

PLATES = 4


class Scene:
    """A scene that is played, and what its nodes say of it."""

    def __init__(self, run: Played) -> None:
        self.address = run.address
        self._run = run
        self._ears = ServiceClient(run.domain_id)
        self.told: list[SimulationStatus] = []
        self.states: list[FragmentStates] = []
        for topic, heard in ((qos.SIMULATION_STATUS, self.told), (qos.FRAGMENT_STATES, self.states)):
            self._ears.node.create_subscription(topic.message_class, topic.name, heard.append, topic.qos)
        self.until(lambda: bool(self.told) and bool(self.states), "a live scene")

    @property
    def status(self) -> SimulationStatus:
        return self.told[-1]

    def until(self, condition: Any, what: str) -> None:
        self._ears.spin_until(condition, what, 2 * PATIENCE)
        self._run.check()

    def places(self) -> dict[int, np.ndarray]:
        states = self.states[-1]
        return dict(zip(states.fragment_ids, np.reshape(states.positions, (-1, 3)), strict=True))

    def close(self) -> None:
        self._ears.close()


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    with chromium() as running:
        yield running


@pytest.fixture
def scene(browser: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Scene]:
    """Only where there is a browser: else its nodes would start in vain."""
    monkeypatch.setenv("ROS_DOMAIN_ID", str(free_domain_id()))
    with played("plates", -1, tmp_path, "127.0.0.1", 0) as run:
        made = Scene(run)
        yield made
        made.close()


def colourful(picture: np.ndarray) -> np.ndarray:
    """Where plates are: wood and carpet are nearly grey."""
    return picture.max(axis=2) - picture.min(axis=2) > 0.3


def on_a_plate(page: Any) -> tuple[float, float]:
    """A pixel amid many of one colour family."""
    drop_warning(page)
    seen = colourful(until(lambda: picture_of(page), lambda picture: np.count_nonzero(colourful(picture)) > 300))
    # the pixel with the most others about it
    sums = np.pad(seen.cumsum(0).cumsum(1), ((1, 0), (1, 0)))
    size = 15
    about = sums[size:, size:] - sums[:-size, size:] - sums[size:, :-size] + sums[:-size, :-size]
    row, column = np.unravel_index(np.argmax(about), about.shape)
    return float(column + size // 2), float(row + size // 2)


def drawn_plot(page: Any) -> str:
    """What the first of the plots shows."""
    page.wait_for_selector(".uplot canvas")
    return page.evaluate("document.querySelector('.uplot canvas').toDataURL()")


def test_a_person_smashes_plates(browser: Any, scene: Scene) -> None:
    with opened(browser, scene.address) as page:
        x, y = on_a_plate(page)
        before = drawn_plot(page)
        page.mouse.click(x, y)
        scene.until(lambda: scene.status.fragments > PLATES + 5, "a ball and shards")
        until(lambda: drawn_plot(page), lambda picture: picture != before)

        run_id = scene.status.run_id
        page.get_by_role("button", name="start over").click()
        scene.until(lambda: scene.status.run_id != run_id and scene.status.step > 5, "another run")
        assert scene.status.fragments == PLATES

        x, y = on_a_plate(page)
        begin = scene.places()
        page.mouse.move(x, y)
        page.mouse.down()
        page.mouse.move(x, y - 60, steps=10)
        scene.until(
            lambda: any(place[2] > begin[i][2] + 0.05 for i, place in scene.places().items() if i in begin),
            "a plate in the air",
        )
        page.mouse.up()

        page.get_by_label("pause").check()
        scene.until(lambda: scene.status.paused, "a pause")
        page.reload()  # in the middle of it all
        page.wait_for_selector("canvas")
        on_a_plate(page)
    # nobody looks, and all goes on
    with opened(browser, scene.address) as page, opened(browser, scene.address) as second:
        on_a_plate(page)
        on_a_plate(second)
        step = scene.status.step
        page.get_by_role("button", name="one step").click()
        scene.until(lambda: scene.status.step == step + 1, "one step")


def listed_and_colliding(page: Any) -> tuple[int, int]:
    words = page.get_by_text("contacts listed of").inner_text()
    found = re.search(r"([\d,]+) contacts listed of ([\d,]+) colliding points", words)
    return int(found[1].replace(",", "")), int(found[2].replace(",", ""))


def unlisted_and_promised(page: Any) -> tuple[float, float]:
    """[mm]"""
    words = page.get_by_text("not listed: up to").inner_text()
    found = re.search(r"up to ([\d.]+) mm deep; promised: no more than ([\d.]+) mm", words)
    return float(found[1]), float(found[2])


def shown_plots(page: Any) -> list[str]:
    return page.evaluate("[...document.querySelectorAll('.uplot canvas')].map(each => each.toDataURL())")


def test_a_person_looks_inside(browser: Any, scene: Scene) -> None:
    with opened(browser, scene.address) as page:
        x, y = on_a_plate(page)
        plots = len(until(lambda: shown_plots(page), lambda plots: len(plots) == 3))
        page.get_by_label("sphere trees").check()
        page.get_by_text("level 2 of").wait_for()
        number_of(page, "level").fill("0")
        page.get_by_text(re.compile(f"level 0 of .*: {PLATES} spheres")).wait_for()  # the shelf does not move
        page.get_by_label("sphere trees").uncheck()
        page.get_by_label("field on a plane").check()
        page.get_by_text("mm deep inside").wait_for()
        page.get_by_label("field on a plane").uncheck()

        page.get_by_label("colliding points").check()
        page.get_by_label("error beside speed").check()
        page.mouse.click(x, y)
        scene.until(lambda: scene.status.fragments > PLATES + 5, "a ball and shards")
        page.get_by_text("promised: no more than").wait_for()
        until(lambda: len(shown_plots(page)), lambda count: count == plots + 2)
        # on the run the service's own answers are judged
        number_of(page, "contacts a pair").fill("32")
        many, colliding = until(lambda: listed_and_colliding(page), lambda counts: counts[0] > 20)
        assert many <= colliding

        # and at rest the slider says what it would do
        page.get_by_label("pause").check()
        scene.until(lambda: scene.status.paused, "a pause")
        number_of(page, "contacts a pair").fill("1")
        page.get_by_text("asked of a copy here").wait_for()
        number_of(page, "epsilon, share of R").fill("0")
        until(lambda: unlisted_and_promised(page), lambda depths: depths[0] == 0.0)
        (exact, colliding), drawn = listed_and_colliding(page), shown_plots(page)
        number_of(page, "epsilon, share of R").fill("0.02")
        deep, promised = until(lambda: unlisted_and_promised(page), lambda depths: depths[0] > 0.0)
        assert deep <= promised
        few, still = until(lambda: listed_and_colliding(page), lambda counts: counts[0] < exact)
        assert still == colliding
        until(lambda: shown_plots(page), lambda plots: plots != drawn)
