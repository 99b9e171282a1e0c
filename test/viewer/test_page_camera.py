"""Where the cameras of the connected browsers are: at the scene's view, and above the floor."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from stages import page_client
from stages.browser import HEIGHT, opened, picture_of, until
from worlds.small_run import records_of, show

from fracture_collision.records import CollisionBody, FragmentStates
from fracture_collision.viewer.page.page import Page
from fracture_collision.viewer.page.page_camera import ABOVE_FLOOR, FREE_ASPECT, WIDE, fitted
from fracture_collision.viewer.pictures.ray_picture import Camera


def begin(page: Page, shift: float = 0.0) -> None:
    page.new_run()
    show(page, shift=shift)


def bricks(picture: np.ndarray) -> np.ndarray:
    """Mask of what is colourful: both bricks."""
    return picture.max(axis=2) - picture.min(axis=2) > 0.25


def seen_bricks(page: Any) -> int:
    return int(np.count_nonzero(bricks(picture_of(page))))


def orbit(page: Any, right: float, down: float) -> None:
    """Drags the floor, in the lower left corner."""
    page.mouse.move(30, HEIGHT - 30)
    page.mouse.down()
    page.mouse.move(30 + right, HEIGHT - 30 + down, steps=10)
    page.mouse.up()


def reports_of(page: Page) -> list[np.ndarray]:
    """The positions that the one browser reports from now on, each after a movement."""
    (client,) = page._server.get_clients().values()
    reported: list[np.ndarray] = []

    async def note(camera: Any) -> None:
        reported.append(np.array(camera.position))

    client.camera.on_update(note)
    return reported


@pytest.mark.slow
def test_another_scene_moves_all_cameras_and_a_new_run_of_the_same_one_none(browser: Any) -> None:
    with Page() as page:
        page.cast_shadows(False)
        page.show_scene("bricks")
        begin(page)
        with opened(browser, page.address) as one, opened(browser, page.address) as other:
            for each in (one, other):
                until(lambda each=each: seen_bricks(each), lambda count: count > 300)
            until(lambda: page.browsers, lambda count: count == 2)
            begin(page, shift=20.0)
            page.show_scene("far away")
            for each in (one, other):
                until(lambda each=each: seen_bricks(each), lambda count: count > 300)
            # the same again, but 20 m to the left: as the scene has the same name, cameras stay
            begin(page)
            for each in (one, other):
                until(lambda each=each: seen_bricks(each), lambda count: count < 30)
            # until their users want to see it
            one.get_by_role("button", name="reset view").click()
            until(lambda: seen_bricks(one), lambda count: count > 300)
            assert seen_bricks(other) < 30


@pytest.mark.slow
@pytest.mark.parametrize("has_floor", [True, False])
def test_a_camera_stays_above_a_floor(browser: Any, has_floor: bool) -> None:
    with Page() as page:
        page.cast_shadows(False)
        for body in records_of(CollisionBody)[0 if has_floor else 1 :]:
            page.add_body(body)
        page.show_states(records_of(FragmentStates)[0])
        with opened(browser, page.address) as seen:
            until(lambda: seen_bricks(seen), lambda count: count > 300)
            until(lambda: page.browsers, lambda count: count == 1)
            reported = reports_of(page)
            orbit(seen, 0.0, -200.0)
            if not has_floor:
                until(lambda: bool(reported) and reported[-1][2], lambda height: height < -0.3)
                return
            until(lambda: bool(reported) and reported[-1][2], lambda height: height == pytest.approx(ABOVE_FLOOR))
            assert min(position[2] for position in reported) == pytest.approx(ABOVE_FLOOR)
            seen.get_by_role("button", name="reset view").click()
            until(lambda: reported[-1][2], lambda height: height > 0.6)


@pytest.mark.slow
@pytest.mark.parametrize(
    "camera", [{"position": (float("nan"), 0.0, 0.0)}, {"image_height": 0}, {"image_width": -5}]
)
def test_a_client_with_a_senseless_camera_does_not_hinder_others(
    browser: Any, camera: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(page_client, "CAMERA", page_client.CAMERA | camera)
    with Page() as page:
        page.cast_shadows(False)
        begin(page)
        with page_client.page_client(page.address), opened(browser, page.address) as seen:
            until(lambda: page.browsers, lambda count: count == 2)
            until(lambda: seen_bricks(seen), lambda count: count > 300)
            begin(page, shift=20.0)
            page.show_scene("far away")
            page.flush()
            until(lambda: seen_bricks(seen), lambda count: count > 300)


@pytest.mark.parametrize("aspect", [390 / 844, 0.8, 1.0, 4 / 3, WIDE, 16 / 9, 3.0])
def test_what_the_view_shows_is_in_the_free_part_of_any_window(aspect: float) -> None:
    view = Camera(np.array([1.0, -5.0, 2.0]), np.array([0.0, 0.0, 1.0]), 0.6)
    camera = fitted(view, aspect)
    ahead = view.target - view.position
    right = np.cross(ahead, [0.0, 0.0, 1.0]) / np.linalg.norm(np.cross(ahead, [0.0, 0.0, 1.0]))
    half_height = np.linalg.norm(ahead) * np.tan(0.3)
    free = 1.0 - 2.0 * 0.25 if aspect >= 1.0 else 1.0  # right edge of the free part, -1..1 across the window
    for side in (-0.9, 0.9):
        point = view.target + side * FREE_ASPECT * half_height * right
        x, y = projected(camera, aspect, point)
        assert -1.0 < x < free + 0.05 and -0.5 < y < 1.0, (side, x, y)


def projected(camera: Camera, aspect: float, point: np.ndarray) -> tuple[float, float]:
    """-1..1 to the right and upwards in the window."""
    ahead = camera.target - camera.position
    ahead /= np.linalg.norm(ahead)
    right = np.cross(ahead, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    offset = point - camera.position
    slope = np.tan(0.5 * camera.opening) * (offset @ ahead)
    return offset @ right / (slope * aspect), offset @ np.cross(right, ahead) / slope
