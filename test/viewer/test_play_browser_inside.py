"""`fracture-collision play` in a real Chromium: the collision detection views."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from stages.browser import chromium, knob, opened, until
from stages.live_page import LivePage, live_page, on_a_plate

PLATES = 4
# With software rendering, on the processors that run the nodes, these take minutes.
pytestmark = pytest.mark.slow


@pytest.fixture
def scene(tmp_path: Path) -> Iterator[tuple[Any, LivePage]]:
    """Starts the browser first, so that no nodes start without one."""
    with chromium() as browser, live_page("plates", tmp_path) as made:
        yield browser, made


def listed_and_colliding(page: Any) -> tuple[int, int]:
    words = page.get_by_text("contacts listed of").inner_text()
    found = re.search(r"([\d,]+) contacts listed of ([\d,]+) colliding points", words)
    return int(found[1].replace(",", "")), int(found[2].replace(",", ""))


def unlisted_and_promised(page: Any) -> tuple[float, float]:
    """[mm] The depth of the deepest unlisted point, and the bound."""
    words = page.get_by_text("unlisted penetrations: up to").inner_text()
    found = re.search(r"up to ([\d.]+) mm deep, bound ([\d.]+) mm", words)
    return float(found[1]), float(found[2])


def shown_plots(page: Any) -> list[str]:
    return page.evaluate("[...document.querySelectorAll('.uplot canvas')].map(each => each.toDataURL())")


def test_the_inside_view_works_in_the_browser(scene: tuple[Any, LivePage]) -> None:
    browser, scene = scene
    with opened(browser, scene.address) as page:
        x, y = on_a_plate(page)
        plots = len(until(lambda: shown_plots(page), lambda plots: len(plots) == 3))
        page.get_by_label("sphere trees").check()
        page.get_by_text("level 2 of").wait_for()
        knob(page, "level").fill("0")
        page.get_by_text(re.compile(f"level 0 of .*: {PLATES} spheres")).wait_for()  # the static shelf is left out
        page.get_by_label("sphere trees").uncheck()
        page.get_by_label("field on a plane").check()
        page.get_by_text("deepest point").wait_for()
        page.get_by_label("field on a plane").uncheck()

        page.get_by_label("colliding points").check()
        page.get_by_label("errors of answers").check()
        page.mouse.click(x, y)
        scene.until(lambda: scene.status.fragments > PLATES + 5, "a ball and shards")
        page.get_by_text("unlisted penetrations: up to").wait_for()
        until(lambda: len(shown_plots(page)), lambda count: count == plots + 2)
        # while running, the figures are of the service's own answers
        knob(page, "contacts_per_pair").fill("32")
        many, colliding = until(lambda: listed_and_colliding(page), lambda counts: counts[0] > 20)
        assert many <= colliding

        # while paused, they show the effect of a changed setting
        page.get_by_label("pause").check()
        scene.until(lambda: scene.status.paused, "a pause")
        drawn = shown_plots(page)
        knob(page, "contacts_per_pair").fill("1")
        page.get_by_text("by a copy of the service").wait_for()
        few, colliding = until(lambda: listed_and_colliding(page), lambda counts: counts[0] < counts[1])
        unlisted, promised = unlisted_and_promised(page)
        assert unlisted <= promised
        drawn = until(lambda: shown_plots(page), lambda plots: plots != drawn)
        knob(page, "contacts_per_pair").fill("32")
        more, still = until(lambda: listed_and_colliding(page), lambda counts: counts[0] > few)
        assert still == colliding >= more
        until(lambda: shown_plots(page), lambda plots: plots != drawn)
