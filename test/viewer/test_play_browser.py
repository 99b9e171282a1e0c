"""`fracture-collision play` in a real Chromium: a user smashes plates, with real nodes over DDS behind the page."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest
from stages.browser import opened, until
from stages.live_page import LivePage, live_page, on_a_plate

PLATES = 4
TRIES, LIFT = 4, 60.0  # tries, and [s] per try to lift a dragged plate


@pytest.fixture
def scene(browser: Any, tmp_path: Path) -> Iterator[LivePage]:
    """Depends on `browser`, so that no nodes start without one."""
    with live_page("plates", tmp_path) as made:
        yield made


def drawn_plot(page: Any) -> str:
    """The first plot as drawn."""
    page.wait_for_selector(".uplot canvas")
    return page.evaluate("document.querySelector('.uplot canvas').toDataURL()")


def test_plates_are_smashed_in_the_browser(browser: Any, scene: LivePage) -> None:
    with opened(browser, scene.address) as page:
        page.get_by_label("shadows").uncheck()  # they dominate the time of a software renderer
        x, y = on_a_plate(page)
        before = drawn_plot(page)
        page.mouse.click(x, y)
        scene.until(lambda: scene.status.fragments > PLATES + 5, "a ball and shards")
        page.reload()  # while shards are flying
        page.wait_for_selector("canvas")
        on_a_plate(page)
        until(lambda: drawn_plot(page), lambda picture: picture != before)

        run_id = scene.status.run_id
        page.get_by_role("button", name="start over").click()
        scene.until(lambda: scene.status.run_id != run_id and scene.status.step > 5, "another run")
        assert scene.status.fragments == PLATES
        page.get_by_text(f"{PLATES} unbroken").wait_for()  # until then the page still shows shards

        begin = scene.places()

        def in_the_air() -> list[int]:
            return [i for i, place in scene.places().items() if i in begin and place[2] > begin[i][2] + 0.05]

        for _ in range(TRIES):
            x, y = on_a_plate(page)
            page.mouse.move(x, y)
            page.mouse.down()
            page.mouse.move(x, y - 60, steps=10)
            with suppress(AssertionError):
                scene.ears.spin_until(in_the_air, "a plate in the air", LIFT)
                break
            page.mouse.up()  # on a loaded machine the page shows an outdated picture for a while
        assert in_the_air()
    # closing the page releases the plate
    scene.until(lambda: not in_the_air(), "a plate that fell")


@pytest.mark.slow  # takes minutes with software rendering
def test_two_browsers_show_a_paused_scene(browser: Any, scene: LivePage) -> None:
    with opened(browser, scene.address) as page:
        page.get_by_label("shadows").uncheck()
        page.get_by_label("pause").check()
        scene.until(lambda: scene.status.paused, "a pause")
        page.reload()
        page.wait_for_selector("canvas")
        until(lambda: page.get_by_label("pause").is_checked(), bool)
    # the run continues while no browser is connected
    with opened(browser, scene.address) as page, opened(browser, scene.address) as second:
        on_a_plate(page)
        on_a_plate(second)
        step = scene.status.step
        page.get_by_role("button", name="one step").click()
        scene.until(lambda: scene.status.step == step + 1, "one step")
        # a run that begins paused is shown
        run_id = scene.status.run_id
        second.get_by_role("button", name="start over").click()
        scene.until(lambda: scene.status.run_id != run_id and scene.status.step == 1, "the first step of another run")
        scene.until(lambda: scene.status.paused and scene.status.fragments == PLATES, "all plates")
        on_a_plate(page)
