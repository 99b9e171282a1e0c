"""The collision detection views of the page, without a browser: what is drawn for given data."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from worlds.small_run import small_run

from fracture_collision.records import FragmentStates
from fracture_collision.viewer.page.page import Page
from fracture_collision.viewer.page.page_events import Handlers, InsideWanted, PlaneWanted
from fracture_collision.viewer.page.page_inside import (
    AXES,
    MOST_SPHERES,
    SHARED_COLOUR,
    InsideFigures,
    InsideView,
    PlanePicture,
    Spheres,
)

NOBODY = -1


def states_of(poses: dict[int, tuple[np.ndarray, Rotation]]) -> FragmentStates:
    return FragmentStates(
        1, 0, np.array(list(poses)), np.concatenate([place for place, _ in poses.values()]),
        np.concatenate([turn.as_quat() for _, turn in poses.values()]),
    )  # fmt: skip


POSES = {
    2: (np.array([0.0, 0.0, 0.2]), Rotation.identity()),
    3: (np.array([-0.4, 0.0, 0.6]), Rotation.from_rotvec([0.3, -0.5, 0.2])),
    4: (np.array([0.4, 0.5, 0.6]), Rotation.identity()),
}


@pytest.fixture
def page() -> Iterator[Page]:
    """A shelf and two bricks, one of them turned."""
    with Page(Handlers(looking_inside=lambda _wanted: None)) as made:
        for _, body in small_run(steps=1)[:4]:
            made.add_body(body)
        made.show_states(states_of(POSES))
        made.flush()
        yield made


def show(page: Page, wanted: InsideWanted, view: InsideView) -> Any:
    """Sets the switches as a user would and shows `view` as the answer."""
    page._inside._wanted = wanted
    page.show_inside(view)
    page.flush()
    return page._inside


def sent_spheres(page: Page) -> dict[str, np.ndarray]:
    return page._live._properties["/spheres"]


def test_the_inside_view_is_offered_only_with_a_handler() -> None:
    with Page(told=frozenset({"contacts"})) as page:
        assert page._inside is None
        page.new_run()
        page.flush()


def test_spheres_follow_their_fragments(page: Page) -> None:
    random = np.random.default_rng(1)
    ids = np.repeat([3, 4, 77], 5)  # 77 is unknown
    spheres = Spheres(2, 6, ids, random.uniform(-0.2, 0.2, (15, 3)), random.uniform(0.01, 0.1, 15))
    inside = show(page, InsideWanted(level=2), InsideView(spheres))
    assert inside._balls.visible and inside._words.content == "level 2 of 6: 15 spheres"

    def expected(poses: dict[int, tuple[np.ndarray, Rotation]]) -> np.ndarray:
        order = np.argsort(-spheres.radii, kind="stable")
        return np.array(
            [poses[f][1].apply(spheres.centres[i]) + poses[f][0] for i in order if (f := int(ids[i])) in poses]
        )

    assert np.allclose(sent_spheres(page)["batched_positions"], expected(POSES), atol=1e-6)
    assert np.allclose(sent_spheres(page)["batched_scales"], np.sort(spheres.radii[:10])[::-1])
    assert {len(values) for values in sent_spheres(page).values()} == {10}
    moved = POSES | {4: (np.array([1.0, 0.0, 2.0]), Rotation.from_rotvec([1.0, 0.0, 0.0]))}
    page.show_states(states_of(moved))
    page.flush()
    assert np.allclose(sent_spheres(page)["batched_positions"], expected(moved), atol=1e-6)
    del moved[4]  # 4 broke
    page.show_states(states_of(moved))
    page.flush()
    assert np.allclose(sent_spheres(page)["batched_positions"], expected(moved), atol=1e-6)
    assert len(sent_spheres(page)["batched_colors"]) == 5
    before = page.messages_sent
    page.show_states(states_of(moved))
    page.flush()
    assert page.messages_sent == before  # nothing has moved
    show(page, InsideWanted(), InsideView())
    assert not inside._balls.visible and not inside._words.content


def test_the_largest_spheres_are_drawn_and_the_others_counted(page: Page) -> None:
    count = MOST_SPHERES + 250
    radii = np.arange(count) * 1e-4  # the first is a single sample, of radius 0
    inside = show(
        page, InsideWanted(level=7), InsideView(Spheres(7, 9, np.full(count, 3), np.zeros((count, 3)), radii))
    )
    assert np.allclose(sent_spheres(page)["batched_scales"], radii[::-1][:MOST_SPHERES])
    assert inside._words.content == f"level 7 of 9: the {MOST_SPHERES} largest of {count - 1} spheres"


def plane_picture(axis: int) -> PlanePicture:
    """Four cells by two: fragment 3 on the left, 4 on the right; lower right corner shared, upper left empty."""
    owners = np.array([[3, 3, 4, 4], [NOBODY, 3, 4, 4]])
    depths = np.array([[0.01, 0.02, 0.03, 0.06], [0.0, 0.01, 0.001, 0.002]])
    shared = np.zeros((2, 4), dtype=bool)
    shared[0, 3] = True
    return PlanePicture(axis, 0.1, np.array([-0.2, 0.3]), 0.05, owners, depths, shared)


@pytest.mark.parametrize("axis", range(3), ids=AXES)
def test_the_picture_of_a_plane_has_its_pose_and_size(page: Page, axis: int) -> None:
    inside = show(page, InsideWanted(plane=PlaneWanted(axis, 0.5)), InsideView(plane=plane_picture(axis)))
    picture = inside._picture
    assert picture.visible and (picture.render_width, picture.render_height) == (pytest.approx(0.2), pytest.approx(0.1))
    w, x, y, z = picture.wxyz
    turn = Rotation.from_quat([x, y, z, w])
    # a viser image has its columns along x and its rows along y, the middle at its origin
    image, across = picture.image, [k for k in range(3) if k != axis]
    for row in range(2):
        for column in range(4):
            at = picture.position + turn.apply([0.05 * (column - 1.5), 0.05 * (row - 0.5), 0.0])
            assert at[axis] == pytest.approx(0.1)
            i, j = ((at[across[k]] - (-0.2, 0.3)[k]) / 0.05 for k in range(2))
            owner = plane_picture(axis).owners[int(j), int(i)]
            assert image[row, column, 3] == (0 if owner == NOBODY else 255)
            if plane_picture(axis).shared[int(j), int(i)]:
                assert np.array_equal(image[row, column, :3], SHARED_COLOUR)
            elif owner != NOBODY:
                colour = np.array(page._scene.colour(int(owner)))
                assert np.argmax(image[row, column, :3]) == np.argmax(colour)
                assert image[row, column, :3].max() <= 255.0 * colour.max()
    assert np.array_equal(np.argwhere(image[..., 3] == 0), [[0, 0]])  # upper left
    assert image[0, 2, :3].max() > image[1, 2, :3].max()  # deeper is darker
    assert f"{AXES[axis]} = 0.100 m: deepest point 60.0 mm, bands of 10 mm" in inside._words.content


def test_fragments_cut_by_the_plane_or_in_front_of_it_are_hidden(page: Page) -> None:
    nodes = page._scene._nodes
    assert all(node.visible for node in nodes.values())
    only_3 = plane_picture(1)._replace(owners=np.full((2, 4), 3))
    wanted = InsideWanted(plane=PlaneWanted(1, 0.5))
    inside = show(page, wanted, InsideView(plane=only_3))
    # seen from smaller y: 4 is behind the plane, the shelf in front of it
    assert not nodes[3].visible and nodes[4].visible and not nodes[2].visible
    page.show_states(states_of(POSES))
    page.flush()
    assert not nodes[3].visible
    # a fragment that arrives while hidden stays hidden
    page._scene._poses.pop(3)
    page.show_states(states_of(POSES))
    page.flush()
    assert not nodes[3].visible
    show(page, wanted, InsideView(plane=None))  # the plane cuts nothing any more
    assert all(node.visible for node in nodes.values()) and not inside._picture.visible
    show(page, wanted, InsideView(plane=only_3))
    show(page, InsideWanted(), InsideView(plane=only_3))  # a view that arrives after switching off is ignored
    assert all(node.visible for node in nodes.values()) and not inside._picture.visible


def test_figures_are_plotted_and_shown_while_requested(page: Page) -> None:
    def figures(time: float, **changes: Any) -> InsideView:
        return InsideView(figures=InsideFigures(time, 12, 1234, 0.03, 0.25, 0.456)._replace(**changes))

    inside = show(page, InsideWanted(colliding=True), figures(0.1))
    (counts, _), (errors, _) = inside._plots._plots
    assert counts.visible and not errors.visible
    assert inside._words.content == "**12** contacts listed of **1,234** colliding points"
    assert [column.tolist() for column in counts.data] == [[0.1], [12.0], [1234.0]]
    show(page, InsideWanted(errors=True), figures(0.3, is_replayed=True))
    assert errors.visible and not counts.visible
    for said in ("up to **0.030 mm**", "**0.250 mm**", "0.46 ms", "by a copy of the service"):
        assert said in inside._words.content
    show(page, InsideWanted(errors=True), figures(0.3, unlisted_mm=0.0))
    rows = list(inside._plots._rows)
    assert [(row.time, row.unlisted_mm) for row in rows] == [(0.1, 0.03), (0.3, 0.0)]  # the newest row per time
    page.new_run()
    page.flush()
    assert not inside._plots._rows and not inside._words.content and errors.visible
