"""`fracture-collision play` in a real Chromium: a user smashes plates, with real nodes over DDS behind the page."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest
from stages.browser import knob, opened, until
from stages.live_page import LivePage, live_page, on_a_plate

PLATES = 4
TRIES, LIFT = 4, 60.0  # tries, and [s] per try to lift a dragged plate


@pytest.fixture
def scene(browser: Any, tmp_path: Path) -> Iterator[LivePage]:
    """Depends on `browser`, so that no nodes start without one."""
    with live_page("plates", tmp_path) as made:
        yield made


def shown_plots(page: Any) -> list[str]:
    return page.evaluate("[...document.querySelectorAll('.uplot canvas')].map(each => each.toDataURL())")


def test_plates_are_smashed_in_the_browser(browser: Any, scene: LivePage) -> None:
    with opened(browser, scene.address) as page:
        page.get_by_label("shadows").uncheck()  # they dominate the time of a software renderer
        x, y = on_a_plate(page)
        before = until(lambda: shown_plots(page), bool)[0]
        page.mouse.click(x, y)
        scene.until(lambda: scene.status.fragments > PLATES + 5, "a ball and shards")
        until(lambda: shown_plots(page), lambda plots: plots[:1] not in ([], [before]))

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
        page.mouse.click(*on_a_plate(page))
        scene.until(lambda: scene.status.fragments > PLATES + 5, "a ball and shards")
        page.reload()  # while shards are flying
        page.wait_for_selector("canvas")
        on_a_plate(page)
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


def listed_and_colliding(page: Any) -> tuple[int, int]:
    words = page.get_by_text("contacts listed of").inner_text()
    found = re.search(r"([\d,]+) contacts listed of ([\d,]+) colliding points", words)
    return int(found[1].replace(",", "")), int(found[2].replace(",", ""))


def unlisted_and_promised(page: Any) -> tuple[float, float]:
    """[mm] The depth of the deepest unlisted point, and the bound."""
    words = page.get_by_text("unlisted penetrations: up to").inner_text()
    found = re.search(r"up to ([\d.]+) mm deep, bound ([\d.]+) mm", words)
    return float(found[1]), float(found[2])


@pytest.mark.slow  # takes minutes with software rendering
def test_the_inside_view_shows_the_service_s_own_answers(browser: Any, scene: LivePage) -> None:
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
