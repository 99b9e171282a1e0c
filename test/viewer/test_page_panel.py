"""The panel and the tab of the page: title, icon, help, summary, settings, plots, and the layout on a phone."""

from __future__ import annotations

import gzip
import itertools
import re
import urllib.request
from pathlib import Path
from queue import Queue
from typing import Any
from urllib.parse import unquote

import numpy as np
import pytest
from stages.browser import await_frames, camera_of, knob, opened, until
from worlds.small_run import records_of, show

from fracture_collision.records import FragmentMesh
from fracture_collision.run_meshes import read_run_with_meshes
from fracture_collision.viewer.page.bag_player import BagPlayer
from fracture_collision.viewer.page.page import Page
from fracture_collision.viewer.page.page_controls import help_text
from fracture_collision.viewer.page.page_events import Handlers, Joint, ServiceSliders, SettingKnob, Start
from fracture_collision.viewer.page.page_plots import (
    BUSY_WORDS,
    PATIENCE,
    PAUSED_WORDS,
    SHOWN,
    SLOW_WORDS,
    Census,
    Figures,
    has_time_left,
    words_of,
)

PHONE, DESKTOP = (390, 844), (1280, 720)
KNOBS = {
    "contacts_per_pair": SettingKnob("contacts of a pair", 1, 1024),
    "penetration_tolerance": SettingKnob("penetrations", 0, 1),
    "method": SettingKnob("contacts", choices=("exact", "glondu2014")),
}
ALL = Handlers(*(lambda *_: None,) * len(Handlers._fields))
JOINTS = (Joint("turn", -1.0, 1.0, 320.0), Joint("slide", -0.1, 0.2, 50.0, slides=True))
START = Start(("plates", "vase"), "plates", mesh_suffixes=(".obj",), settings=KNOBS)


def begin(page: Page, step: int = 0) -> None:
    page.cast_shadows(False)
    page.show_figures(Figures(0.15, contacts=76))
    show(page, step, with_meshes=True)


@pytest.mark.parametrize("encoding", ["gzip", "identity"])
def test_the_document_has_a_title_and_an_icon_of_its_own(encoding: str) -> None:
    with Page(name='a "bag" <1>') as page:
        request = urllib.request.Request(page.address, headers={"Accept-Encoding": encoding})
        with urllib.request.urlopen(request, timeout=30) as answer:
            body = answer.read()
            assert len(body) == int(answer.headers["Content-Length"])
            assert answer.headers.get("Content-Encoding", "identity") == encoding
    text = (gzip.decompress(body) if encoding == "gzip" else body).decode()
    assert re.findall("<title>(.*?)</title>", text) == ["a &quot;bag&quot; &lt;1&gt; - fracture_collision"]
    (icon,) = re.findall(r'<link\s+rel="icon"\s+href="data:image/svg\+xml,(.*?)"', text, re.DOTALL)
    assert unquote(icon).startswith("<svg") and "#265e96" in unquote(icon)


def test_the_title_names_the_scene_settings_have_ranges_and_arrows_turn_the_camera(browser: Any) -> None:
    """Arrows do so where no hammer has them."""
    heard: Queue[ServiceSliders] = Queue()
    handlers = ALL._replace(service_set=heard.put, arrow=None)
    with Page(handlers, START) as page, opened(browser, page.address) as seen:
        assert seen.title() == "plates - fracture_collision"
        until(lambda: page.browsers, bool)
        page.show_scene("vase")
        until(seen.title, lambda title: title == "vase - fracture_collision")
        until(lambda: knob(seen, "scene").input_value(), lambda name: name == "vase")
        seen.reload()
        until(seen.title, lambda title: title == "vase - fracture_collision")
        until(lambda: page.browsers, lambda count: count == 1)
        before = camera_of(page)
        seen.keyboard.down("ArrowUp")
        await_frames(seen)
        until(lambda: camera_of(page), lambda now: not np.array_equal(now, before))
        seen.keyboard.up("ArrowUp")
        knob(seen, "contacts_per_pair").fill("1024")
        assert heard.get(timeout=60).contacts_per_pair == 1024
        knob(seen, "contacts_per_pair").fill("2000")
        knob(seen, "contacts_per_pair").press("Tab")
        until(lambda: knob(seen, "contacts_per_pair").input_value(), lambda value: value == "1024")
        knob(seen, "penetration_tolerance").fill("0.3")
        until(lambda: heard.get(timeout=60), lambda settings: settings.penetration_tolerance == 0.3)


def test_the_help_mentions_every_control() -> None:
    for handlers, start in ((ALL, START), (Handlers(), Start())):
        with Page(handlers, start) as page:
            page.show_robot(JOINTS, (0.0, 0.0))
            page.flush()
            handles = page._server.gui._gui_input_handle_from_uuid.values()
            labels = {handle._impl.props.label for handle in handles} - {"help"}
        text = help_text(handlers, start, is_recorded=False)
        named = {label.split(",")[0] for label in labels}  # without units
        assert not {name for name in named if f"*{name}*" not in text and not re.match(r"(joint|torque) 2$", name)}
        assert ("Throw" in text) == (handlers is ALL)


@pytest.mark.slow
@pytest.mark.parametrize("size", [DESKTOP, PHONE])
def test_the_help_opens_and_closes_in_one_browser(browser: Any, size: tuple[int, int]) -> None:
    with Page(ALL, START) as page:
        begin(page)
        with opened(browser, page.address, *size) as seen, opened(browser, page.address) as other:
            if size == PHONE:
                seen.get_by_text("fracture_collision").click()
            seen.get_by_role("button", name="help").click()
            seen.get_by_text("The arrow shows the pull").wait_for()
            box = seen.get_by_role("dialog").bounding_box()
            assert box["x"] >= 0 and box["x"] + box["width"] <= size[0] and box["y"] + box["height"] <= size[1]
            assert not other.get_by_role("dialog").count()
            seen.get_by_role("button", name="close").last.scroll_into_view_if_needed()
            seen.get_by_role("button", name="close").last.click()
            until(lambda: seen.get_by_role("dialog").count(), lambda count: not count)
            seen.get_by_role("button", name="help").click()  # again
            seen.get_by_role("button", name="close").first.click()
            until(lambda: seen.get_by_role("dialog").count(), lambda count: not count)


@pytest.mark.slow
def test_the_controls_do_not_cover_the_scene_on_a_phone(browser: Any) -> None:
    width, height = PHONE
    with Page(ALL, START) as page:
        begin(page)
        with opened(browser, page.address, *PHONE) as seen:
            handle = seen.get_by_text("fracture_collision")
            bar = until(handle.bounding_box, lambda box: box["y"] > height - 60)  # closed at first
            assert seen.evaluate(f"document.elementFromPoint({width / 2}, {bar['y'] - 30}).tagName") == "CANVAS"
            handle.click()
            opened_at = until(handle.bounding_box, lambda box: box["y"] < 0.6 * height)
            assert opened_at["y"] > 0.45 * height  # half of the window stays free
            for name in ("help", "start over", "reset view"):
                button = seen.get_by_role("button", name=name)
                button.scroll_into_view_if_needed()
                box = button.bounding_box()
                assert box["height"] > 25 and box["width"] > 0.8 * width and box["x"] + box["width"] <= width
            label = knob(seen, "contacts_per_pair")
            label.scroll_into_view_if_needed()
            assert label.bounding_box()["x"] + label.bounding_box()["width"] <= width
            handle.click()
            until(handle.bounding_box, lambda box: box["y"] > height - 60)


@pytest.mark.slow
def test_a_robot_has_sliders_and_torques_until_the_next_run(browser: Any) -> None:
    heard: Queue[tuple[str, float]] = Queue()
    handlers = ALL._replace(joint_set=lambda *told: heard.put(told))
    with Page(handlers, START) as page, opened(browser, page.address) as seen:
        page.show_robot(JOINTS, (0.5, 0.1))
        page.show_torques((-12.34, 7.0))
        until(lambda: [knob(seen, f"joint {j}").input_value() for j in (1, 2)], lambda found: found == ["29", "100"])
        until(lambda: [knob(seen, each).input_value() for each in ("torque 1, N m", "torque 2, N")],
              lambda found: found == ["-12.3 of 320", "7.0 of 50"])  # fmt: skip
        knob(seen, "joint 1").fill("58")
        assert heard.get(timeout=60) == ("turn", pytest.approx(np.radians(57.0))), "the last degree within its limit"
        knob(seen, "joint 2").fill("150")
        assert heard.get(timeout=60) == ("slide", pytest.approx(0.15))
        page.new_run()
        until(lambda: seen.get_by_text("joint 1").count(), lambda count: not count)


def test_the_summary_counts_what_can_break_apart_from_the_rest() -> None:
    assert words_of(Census(1, 0, 0, 14)) == "1 unbroken · 14 other bodies"
    assert words_of(Census(2, 2, 45, 1)) == "2 unbroken · 2 in 45 pieces · 1 other body"
    with Page() as page:
        begin(page)
        assert page._summary._said == "**0.15 s** · 76 contacts  \n2 unbroken · 1 other body"  # the shelf is fixed
        begin(page, step=-1)
        pieces = len(records_of(FragmentMesh))
        assert page._summary._said.endswith(f"1 unbroken · 1 in {pieces} pieces · 1 other body")


def test_a_simulation_whose_steps_are_short_waits_for_a_busy_machine() -> None:
    """36 contacts take a millisecond; interrupted steps take longer."""
    assert has_time_left([1.0] * 40 + [30.0] * 20, step_ms=5.0)
    assert not has_time_left([4.0] * 60, step_ms=5.0)
    assert not has_time_left([1.0] * 60, step_ms=0.0) and not has_time_left([], step_ms=5.0)
    with Page() as page:
        summary = page._summary
        for solver_ms, words in ((0.5, BUSY_WORDS), (20.0, SLOW_WORDS)):
            page.new_run()
            page.show_figures(Figures(0.1, collision_ms=0.5, update_ms=0.0, solver_ms=solver_ms, contacts=36))
            page.flush()
            for now in (10.0, 10.1 + PATIENCE):
                summary.show_rate(now, 0.2, 1.0, False, step_ms=5.0)
            assert summary._warning.visible and summary._warning.content == words
            summary.show_rate(20.0, 1.0, 1.0, False, step_ms=5.0)
            assert not summary._warning.visible


def test_a_new_run_has_no_figures_of_the_last_one_and_a_hint_if_it_is_paused() -> None:
    with Page() as page:
        begin(page)
        page.show_rate(0.0, 1.0, True)
        assert "76 contacts" in page._summary._said
        page.new_run()
        page.flush()
        assert page._summary._said == page._summary._line.content == PAUSED_WORDS


@pytest.mark.slow
def test_the_pace_is_shown_with_a_message_while_it_is_slow(browser: Any) -> None:
    with Page(ALL, START) as page, opened(browser, page.address) as seen:
        begin(page)
        page.show_rate(0.97, 1.0, False)
        seen.get_by_text("0.97 × real time").wait_for()
        slow = seen.get_by_text("The simulation is slow.")
        assert not slow.is_visible()

        def crawling() -> bool:
            page.show_rate(0.2, 1.0, False)
            return slow.is_visible()

        until(crawling, bool)
        seen.get_by_text("0.20 × real time").wait_for()
        page.show_rate(0.8, 1.0, False)
        slow.wait_for(state="hidden")
        page.show_rate(0.0, 1.0, True)
        seen.get_by_text("paused").wait_for()
        until(seen.get_by_label("pause").is_checked, bool)
        page.show_rate(1.0, 1.0, False)
        until(seen.get_by_label("pause").is_checked, lambda ticked: not ticked)


# Of the plot of contacts: the widest label of its vertical axis, and the room for it [px].
ROOM = """() => {
  const chart = Object.values(window.__viserTestpoints.uplots)[0].chart, axis = chart.axes[1];
  chart.ctx.save(); chart.ctx.font = axis.font[0];
  const widths = axis._values.map(label => chart.ctx.measureText(label).width / devicePixelRatio);
  chart.ctx.restore();
  return [Math.max(...widths), axis._size - axis.gap];
}"""


@pytest.mark.slow
def test_labels_of_the_plots_have_room(browser: Any) -> None:
    with Page(told=frozenset({"contacts"})) as page, opened(browser, page.address) as seen:
        begin(page)
        steps = itertools.count()

        def measured() -> list[float]:
            step = next(steps)
            page.show_figures(Figures(0.2 + 1e-3 * step, contacts=190_000 + step))
            return seen.evaluate(ROOM)

        widest, room = until(measured, lambda found: found[0] > 40.0)  # as wide as 200,000
        assert widest < room


def test_plots_show_the_recording_before_a_jump() -> None:
    run = read_run_with_meshes(Path(__file__).parents[2] / "bags" / "plates")
    with BagPlayer(run, name="plates") as player:
        plot = player.page._plots._plots[0][0]

        def times() -> list[float]:
            player.advance()
            player.page.flush()
            player.page._plots._next = 0.0  # draw now
            player.page._plots.draw()
            return list(plot.data[0])

        player.play(False)
        recorded = [states.time for states in run.states]
        assert times() == recorded[:1]
        assert plot.scales["x"]["range"] == (max(recorded[0] - SHOWN, 0.0), max(recorded[0] - SHOWN, 0.0) + SHOWN)
        player.seek(player.duration)
        assert times() == recorded, "all of it, also what was skipped"
        assert "range" not in plot.scales["x"]
        player.step(-5)
        assert times() == recorded[:-5]
        player.step(1)
        assert times() == recorded[:-4]
        listed = [len(run.contacts(states.step).gaps) for states in run.states]
        assert np.array_equal(plot.data[1], listed[:-4])
