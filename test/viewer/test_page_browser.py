"""The page in a real Chromium: what a user sees and does."""

from __future__ import annotations

import queue
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from stages.bag_of_records import write_bag
from stages.browser import HEIGHT, PATIENCE, WIDTH, await_frames, camera_of, knob, opened, picture_of, until
from worlds.small_run import BREAKS, records_of, show, small_run

from fracture_collision.records import ContactConstraintArray, FragmentMesh, FragmentStates, refusal_of
from fracture_collision.run_meshes import read_run_with_meshes
from fracture_collision.viewer.page.bag_player import BagPlayer
from fracture_collision.viewer.page.page import INTERVAL, Page
from fracture_collision.viewer.page.page_events import Handlers, InsideWanted, PlaneWanted
from fracture_collision.viewer.page.page_inside import InsideFigures, InsideView, PlanePicture, Spheres
from fracture_collision.viewer.page.page_plots import Figures
from fracture_collision.viewer.pictures.ray_picture import Camera

AT_THE_OTHER = Camera(np.array([0.4, -3.0, 0.6]), np.array([0.4, 0.0, 0.6]), 0.6)
"""Level, straight at the second brick, at (0.4, 0, 0.6), 0.3 m high and deep, 0.4 m wide."""


@pytest.fixture
def player(tmp_path: Path) -> Iterator[BagPlayer]:
    """Paused at the beginning; a thread advances it while it plays."""
    write_bag(tmp_path / "small", small_run())
    with BagPlayer(read_run_with_meshes(tmp_path / "small")) as made:
        made.page.cast_shadows(False)  # shadows dominate the time of a software renderer
        made.play(False)
        made.seek(0.0)
        stopped = threading.Event()

        def advance() -> None:
            while not stopped.wait(INTERVAL):
                made.advance()

        thread = threading.Thread(target=advance)
        thread.start()
        yield made
        stopped.set()
        thread.join()


def blue(picture: np.ndarray) -> np.ndarray:
    """Mask of the first brick, whose colour family is blue."""
    return (picture[..., 2] > picture[..., 0] + 0.15) & (picture[..., 2] > 0.3) & ~sky(picture)


def sky(picture: np.ndarray) -> np.ndarray:
    return (picture[..., 2] > 0.78) & (picture[..., 0] > 0.55)


def red(picture: np.ndarray) -> np.ndarray:
    return (picture[..., 0] > picture[..., 2] + 0.2) & (picture[..., 0] > picture[..., 1] + 0.12)


def shows_bricks(picture: np.ndarray) -> bool:
    return np.count_nonzero(blue(picture)) > 80 and np.count_nonzero(red(picture)) > 80


@pytest.mark.slow
def test_a_bag_is_played_reloaded_and_shown_in_two_windows(browser: Any, player: BagPlayer) -> None:
    with opened(browser, player.page.address) as page:
        until(lambda: picture_of(page), shows_bricks)
        still = steady(page)  # bricks appear before all lights do
        page.get_by_role("button", name="play").click()
        page.get_by_text("1.18 s").wait_for()  # the end
        moved = until(lambda: picture_of(page), shows_bricks)
        changed = np.abs(moved - still).max(axis=2) > 0.15
        assert np.count_nonzero(changed) > 200
        assert np.count_nonzero(changed & blue(still)) > 25  # the brick that broke
        until(lambda: page.get_by_role("button", name="play").count(), bool)  # it stops by itself at the end
        page.get_by_role("button", name="back").click()
        page.get_by_text("1.16 s").wait_for()

        player.play(True)
        page.reload()
        page.wait_for_selector("canvas")
        until(lambda: picture_of(page), shows_bricks)
        page.get_by_text("1.18 s").wait_for()
        with opened(browser, player.page.address) as second:
            until(lambda: picture_of(second), shows_bricks)
            until(lambda: player.page.browsers, lambda count: count == 2)
            # both browsers get the same
            player.seek(0.0)
            for each in (page, second):
                each.get_by_text("0.00 s").wait_for()
                until(lambda each=each: np.abs(picture_of(each) - still).mean(), lambda difference: difference < 0.02)
        until(lambda: (page.title(), player.page.browsers), lambda seen: seen[1] == 1)
    assert player.page.messages_sent > 0


def contacts_at(points: np.ndarray) -> ContactConstraintArray:
    """One pair, fragments 3 and 4, penetrating by a millimetre at each point."""
    count = len(points)
    empty = refusal_of(FragmentStates(0, 0, *(np.zeros(0),) * 3), 0.0)
    return empty._replace(
        status=0, fragment_a=np.array([3]), fragment_b=np.array([4]), pair_begin=np.array([0, count]),
        missed_depth_bound=np.array([0.0012]), friction=np.zeros(1), restitution=np.zeros(1),
        points_a=points, points_b=points, normals=np.tile([0.0, 0.0, 1.0], (count, 1)),
        gaps=np.full(count, -1e-3), contact_ids=np.arange(count, dtype=np.uint64),
    )  # fmt: skip


def hearing(heard: queue.Queue[tuple[str, Any]]) -> Handlers:
    """Handlers that put their names and arguments into `heard`."""

    def hear(name: str) -> Any:
        return lambda *what: heard.put((name, what))

    return Handlers(
        clicked=hear("clicked"), drag_begun=hear("begun"), drag_moved=hear("moved"), drag_ended=hear("ended"),
        arrow=hear("arrow"), reset=hear("reset"),
    )  # fmt: skip


def drag_to_the_right(seen: Any, heard: queue.Queue[tuple[str, Any]], eye: np.ndarray) -> None:
    """Drags the brick in the middle of the window, and checks what the page passes on."""
    x, y = WIDTH / 2, HEIGHT / 2
    seen.mouse.move(x, y)
    seen.mouse.down()
    seen.mouse.move(x + 40, y, steps=8)
    name, (drag,) = heard.get(timeout=PATIENCE)
    assert name == "begun" and drag.fragment_id == 4
    assert np.allclose(drag.grip, [0.4, -0.15, 0.6], atol=0.03)
    seen.mouse.up()
    steps = []
    while not steps or steps[-1][0] != "ended":
        steps.append(heard.get(timeout=PATIENCE))
    assert {name for name, _ in steps} <= {"moved", "ended"}
    (last,) = steps[-1][1]
    # 40 pixels to the right, in the plane through the grip that faces the camera, 2.85 m away
    assert last.target - last.grip == pytest.approx([40 * 2.85 * 2.0 * np.tan(0.3) / HEIGHT, 0.0, 0.0], abs=0.03)
    ahead = last.target - eye
    assert last.ray.direction == pytest.approx(ahead / np.linalg.norm(ahead), abs=1e-3)


def test_clicks_drags_keys_and_layers_work_in_the_browser(browser: Any) -> None:
    heard: queue.Queue[tuple[str, Any]] = queue.Queue()
    eye = AT_THE_OTHER.position
    with Page(hearing(heard), told=frozenset({"contacts"})) as page:
        page.look_from(AT_THE_OTHER)
        page.cast_shadows(False)
        show(page)
        page.show_contacts(contacts_at(np.array([[0.4 + 0.02 * i, -0.3, 0.6] for i in range(-5, 6)])))
        page.show_figures(Figures(0.0, contacts=11))
        with opened(browser, page.address) as seen:
            until(lambda: picture_of(seen), lambda picture: np.count_nonzero(red(picture)) > 150)
            seen.get_by_text("11 contacts").wait_for()

            seen.mouse.click(WIDTH / 2, HEIGHT / 2)
            name, (ray, ball) = heard.get(timeout=PATIENCE)
            assert name == "clicked" and ball.speed > 0.0
            assert np.allclose(ray.origin, eye, atol=1e-3) and np.allclose(ray.direction, [0.0, 1.0, 0.0], atol=0.02)

            drag_to_the_right(seen, heard, eye)

            seen.get_by_role("button", name="start over").click()
            assert heard.get(timeout=PATIENCE)[0] == "reset"
            before = camera_of(page)
            seen.keyboard.down("ArrowUp")
            assert heard.get(timeout=PATIENCE) == ("arrow", ("up",))
            await_frames(seen)
            seen.keyboard.up("ArrowUp")
            assert np.array_equal(camera_of(page), before), "only the hammer moves"

            before = np.count_nonzero(bright_red(picture_of(seen)))
            seen.get_by_label("contact points").check()
            until(lambda: np.count_nonzero(bright_red(picture_of(seen))), lambda count: count > before + 10)
            seen.get_by_label("missed depth bound").check()
            seen.get_by_text("1.200 mm").wait_for()


@pytest.mark.slow
def test_the_inside_view_works_in_the_browser(browser: Any) -> None:
    asked: queue.Queue[InsideWanted] = queue.Queue()
    with Page(Handlers(looking_inside=asked.put)) as page:
        page.look_from(AT_THE_OTHER)
        page.cast_shadows(False)
        show(page)
        with opened(browser, page.address) as seen:
            until(lambda: picture_of(seen), lambda picture: np.count_nonzero(red(picture)) > 150)
            bare = steady(seen)
            seen.get_by_label("sphere trees").check()
            assert asked.get(timeout=PATIENCE) == InsideWanted(level=2)
            knob(seen, "level").fill("5")
            assert asked.get(timeout=PATIENCE) == InsideWanted(level=5)
            around = Spheres(5, 7, np.array([4]), np.zeros((1, 3)), np.array([0.35]))
            page.show_inside(InsideView(around))
            seen.get_by_text("level 5 of 7: 1 sphere").wait_for()
            # translucent, and wider than the brick
            brick = np.count_nonzero(bare_brick := red(bare)[:, WIDTH // 2 - 35 :])
            assert 1500 < brick < bare_brick.size / 4
            until(lambda: changed(picture_of(seen), bare), lambda count: count > 1.2 * brick)
            both = Spheres(5, 7, np.array([3, 4]), np.zeros((2, 3)), np.array([0.3, 0.3]))
            page.show_inside(InsideView(both))
            with opened(browser, page.address) as late:  # a browser that connects later shows them too
                until(lambda: changed(steady(late), bare), lambda count: count > 1.5 * brick)
            seen.get_by_label("sphere trees").uncheck()
            assert asked.get(timeout=PATIENCE) == InsideWanted()
            until(lambda: changed(picture_of(seen), bare), lambda count: count < EDGES)

            seen.get_by_label("field on a plane").check()
            assert asked.get(timeout=PATIENCE) == InsideWanted(plane=PlaneWanted(1, 0.5))
            # the brick's section; its right half is in two fragments at once
            owners = np.full((30, 40), 4)
            shared = np.zeros((30, 40), dtype=bool)
            shared[:, 20:] = True
            section = PlanePicture(1, 0.0, np.array([0.2, 0.45]), 0.01, owners, np.full((30, 40), 0.01), shared)
            page.show_inside(InsideView(plane=section))
            found = until(lambda: picture_of(seen), lambda picture: np.count_nonzero(bright_red(picture)) > 100)
            columns = np.flatnonzero(bright_red(found).any(axis=0))
            assert columns.min() > WIDTH / 2 - 4  # only on the right
            seen.get_by_label("field on a plane").uncheck()
            assert asked.get(timeout=PATIENCE) == InsideWanted()
            until(lambda: changed(picture_of(seen), bare), lambda count: count < EDGES)

            seen.get_by_label("errors of answers").check()
            assert asked.get(timeout=PATIENCE) == InsideWanted(errors=True)
            for moment in (0.1, 0.2):
                page.show_inside(InsideView(figures=InsideFigures(moment, 3, 40, 0.25, 0.5, 0.0, 1.5)))
            seen.get_by_text("bound 0.500 mm").wait_for()
            until(lambda: seen.locator(".uplot").count(), lambda count: count == 1)


@pytest.mark.slow
def test_a_held_body_that_breaks_stays_in_the_hand(browser: Any) -> None:
    heard: queue.Queue[tuple[str, Any]] = queue.Queue()
    with Page(hearing(heard)) as page:
        page.look_from(Camera(np.array([-0.4, -3.0, 0.6]), np.array([-0.4, 0.0, 0.6]), 0.6))  # at the brick that breaks
        page.cast_shadows(False)
        show(page)
        with opened(browser, page.address) as seen:
            until(lambda: picture_of(seen), lambda picture: np.count_nonzero(blue(picture)) > 150)
            x, y = WIDTH / 2, HEIGHT / 2
            seen.mouse.move(x, y)
            seen.mouse.down()
            seen.mouse.move(x, y - 60, steps=8)
            assert heard.get(timeout=PATIENCE)[0] == "begun"
            # the pull is seen: an arrow from the grip to the pointer
            until(lambda: picture_of(seen), lambda picture: np.count_nonzero(orange(picture)) > 20)
            for mesh in records_of(FragmentMesh):
                page.add_fragment(mesh, BREAKS)
            page.show_states(records_of(FragmentStates)[-1])
            page.flush()
            while not heard.empty():
                assert heard.get()[0] == "moved"
            until(lambda: picture_of(seen), lambda picture: np.count_nonzero(blue(picture)) > 100)
            seen.mouse.move(x + 60, y - 60, steps=8)
            name, (drag,) = heard.get(timeout=PATIENCE)
            assert name == "moved" and drag.fragment_id == 3, "the hand still knows it by the id it took"
            until(lambda: picture_of(seen), lambda picture: np.count_nonzero(orange(picture)) > 20)
            seen.mouse.up()
            until(lambda: heard.get(timeout=PATIENCE)[0], lambda name: name == "ended")
            assert not page._scene._nodes[3].visible


def orange(picture: np.ndarray) -> np.ndarray:
    """Mask of the arrow of a drag."""
    return (picture[..., 0] > 0.85) & (abs(picture[..., 1] - 0.5) < 0.15) & (picture[..., 2] < 0.4)


EDGES = 500  # pixels that may differ when edges are redrawn


def steady(page: Any) -> np.ndarray:
    """A picture that no longer changes: lights and sky load gradually."""
    page.wait_for_load_state("networkidle")
    last, equal = picture_of(page), 0
    while equal < 5:
        picture = picture_of(page)
        equal = equal + 1 if changed(picture, last) == 0 else 0
        last = picture
    return last


def changed(picture: np.ndarray, before: np.ndarray) -> int:
    return int(np.count_nonzero(np.abs(picture - before).max(axis=2) > 0.08))


def bright_red(picture: np.ndarray) -> np.ndarray:
    """Mask of penetrating points."""
    return (picture[..., 0] > 0.8) & (picture[..., 1] < 0.25) & (picture[..., 2] < 0.25)
