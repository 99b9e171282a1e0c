"""Contacts of one direction in the elementary situations: flush, overhanging, crossing, sliding and falling boxes."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from fracture_collision.core.memory.tables import Table
from fracture_collision.core.patches.pair_contacts import Patch, Placing, Wanted, mesh_patch
from fracture_collision.core.patches.shapes import Shapes, append_shapes, hull_of

UP = (0.0, 0.0, 1.0)


def shapes_of(*meshes: trimesh.Trimesh) -> Shapes:
    table = Table(Shapes)
    for mesh in meshes:
        triangles = mesh.triangles.reshape(-1, 9).copy()
        append_shapes(table, triangles, np.array([0, len(triangles)]))
    return table.view


def box(*sides: float) -> trimesh.Trimesh:
    return trimesh.creation.box(sides)


def patch(
    shapes: Shapes, now, end=None, tolerance: float = 1e-4, moved: float = np.inf,
    turn: np.ndarray | None = None, most: int = 8,
) -> Patch:  # fmt: skip
    """The second at `now`, and at `end` after the step, turned by `turn`; the first does not move."""
    eye, rest = np.eye(3), np.zeros(3)
    turned = eye if turn is None else turn
    # the frame of the query is b's of now
    b = Placing(np.array([eye] * 3), np.array([rest, *[turned.T @ np.subtract(now if end is None else end, now)] * 2]))
    a = Placing(np.array([turned.T] * 3), np.array([turned.T @ -np.asarray(now, float)] * 3))
    hulls = hull_of(shapes, 0), hull_of(shapes, 1)
    return mesh_patch(shapes, (0, 1), hulls, (a, b), 0, Wanted(tolerance, moved, most), np.zeros(3))


@pytest.mark.parametrize("gap", [0.0, 5e-5, -1e-3, -0.04])
def test_a_cube_on_an_equal_cube_has_its_four_corners(gap: float) -> None:
    found = patch(shapes_of(box(0.1, 0.1, 0.1), box(0.1, 0.1, 0.1)), [0.0, 0.0, 0.1 + gap])
    assert tuple(found.normal) == UP
    assert np.allclose(found.gaps, gap, atol=1e-15) and len(found.gaps) == 4
    at = np.sort((found.points + [0.0, 0.0, 0.1 + gap])[:, :2], axis=0)
    assert np.allclose(np.abs(at), 0.05)


def test_a_cube_in_the_air_has_none() -> None:
    assert len(patch(shapes_of(box(0.1, 0.1, 0.1), box(0.1, 0.1, 0.1)), [0.0, 0.0, 0.1002]).gaps) == 0


@pytest.mark.parametrize("share", [0.1, 0.3, 0.45])
def test_an_overhanging_box_has_the_corners_of_the_overlap(share: float) -> None:
    found = patch(shapes_of(box(1.0, 1.0, 0.1), box(0.2, 0.2, 0.2)), [0.5 - 0.1 + 0.2 * share, 0.0, 0.15])
    assert tuple(found.normal) == UP and len(found.gaps) == 4
    x = (found.points + [0.4 + 0.2 * share, 0.0, 0.15])[:, 0]
    assert np.allclose(np.sort(x), [0.3 + 0.2 * share] * 2 + [0.5] * 2)


def test_crossed_bars_have_their_four_crossings() -> None:
    found = patch(shapes_of(box(0.2, 0.02, 0.02), box(0.02, 0.2, 0.02)), [0.013, 0.004, 0.0199])
    assert tuple(found.normal) == UP and len(found.gaps) == 4 and np.allclose(found.gaps, -0.0001)


def test_a_cylinder_of_many_facets_across_an_edge_is_found() -> None:
    """Its corners are at its ends only."""
    rod = trimesh.creation.cylinder(0.02, 1.0, sections=128)
    rod.apply_transform(trimesh.transformations.rotation_matrix(np.pi / 2, [0.0, 1.0, 0.0]))
    edge = box(0.1, 0.4, 0.1)
    edge.apply_transform(trimesh.transformations.rotation_matrix(np.pi / 4, [0.0, 1.0, 0.0]))
    top = 0.05 * np.sqrt(2.0)
    found = patch(shapes_of(edge, rod), [0.003, 0.0, top + 0.02 - 0.002])
    assert np.allclose(found.normal, UP, atol=0.03) and found.gaps.min() == pytest.approx(-0.002, abs=2e-5)


def test_a_falling_cube_has_contacts_ahead() -> None:
    shapes = shapes_of(box(0.1, 0.1, 0.1), box(0.1, 0.1, 0.1))
    for end in (0.09, 0.02, -0.2):  # also all through it
        found = patch(shapes, [0.0, 0.0, 0.13], [0.0, 0.0, end])
        assert tuple(found.normal) == UP and len(found.gaps) == 4 and np.allclose(found.gaps, 0.03)


def test_a_sliding_box_is_not_held_by_the_next_tile() -> None:
    """From 0.05 mm above a seam and 0.05 mm before it: the direction does not lean."""
    shapes = shapes_of(box(1.0, 1.0, 0.1), box(0.2, 0.2, 0.1))
    before = [-0.6 - 5e-5, 0.0, 0.1 + 5e-5]
    assert len(patch(shapes, before).gaps) == 0
    entering = patch(shapes, before, [before[0] + 0.0025, 0.0, before[2]])
    assert tuple(entering.normal) == UP
    assert not len(entering.gaps) or np.allclose(entering.gaps, 5e-5)


def test_fragments_of_one_body_in_place_have_no_depth() -> None:
    """Whatever faces what: nothing is deeper than they have moved."""
    found = patch(shapes_of(trimesh.creation.icosphere(2), trimesh.creation.icosphere(2)), [1.9, 0.0, 0.0], moved=0.0)
    assert found.gaps.min(initial=0.0) >= -2e-6
