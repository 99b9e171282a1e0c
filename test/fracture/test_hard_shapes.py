"""Hard shapes, each with its required accuracy: concave fragments, and penetration past the middle."""

from __future__ import annotations

import numpy as np
import pytest
from oracles.fracture_patterns import voronoi_event
from scipy.spatial.transform import Rotation
from worlds.fractured_worlds import FracturedWorld, samples_of, with_settings
from worlds.hard_worlds import (
    BRICK,
    EVERY_CONTACT,
    ROUNDING,
    UPRIGHT,
    assert_contacts,
    assert_geometry,
    block,
    broken_world,
    by_labels,
    common_plane,
)

from fracture_collision.geometry.generators import ball, brick
from fracture_collision.records import FragmentStates
from fracture_collision.world import CollisionWorld

# --- concave fragments ------------------------------------------------------------------------------------------------


def sphere_cracks(vertices: np.ndarray, radius: float):
    """Each cut edge carries the tangent plane of the sphere about the origin at the edge's crossing."""

    def plane(a: int, b: int, _i: int, _j: int) -> tuple[np.ndarray, float]:
        start, along = vertices[a], vertices[b] - vertices[a]
        p, q, r = along @ along, start @ along, start @ start - radius**2
        outwards = r < 0.0
        crossing = start + (-q + (1.0 if outwards else -1.0) * np.sqrt(q * q - p * r)) / p * along
        normal = crossing / np.linalg.norm(crossing)
        normal *= np.sign(normal @ along)
        return normal, float(normal @ crossing)

    return plane


def test_shell_around_small_fragments() -> None:
    """One fragment surrounds the others and shares their box and centre: true contacts, in place, jittered, deep."""
    body = ball(1.0, 0.3)
    labels = np.linalg.norm(body.vertices, axis=1) > 0.7
    random = np.random.default_rng(6)
    case = broken_world(body, [
        by_labels(labels, sphere_cracks(body.vertices, 0.7)),
        lambda whole, first, sequence: voronoi_event(
            whole, whole.labels[0] if not labels[0] else whole.labels[~labels][0], random.uniform(-0.5, 0.5, (6, 3)),
            first, sequence,
        ),
    ])  # fmt: skip
    shell = case.oracle.labels[labels][0]
    assert len(case.oracle.fragment_ids) >= 6
    assert_geometry(case, snug=False)
    assert assert_contacts(case) > 0
    answer = case.world.contacts(case.states(jitter=0.01, seed=3))
    of_shell = (answer.fragment_a == shell) | (answer.fragment_b == shell)
    assert np.count_nonzero(of_shell) == len(case.oracle.fragment_ids) - 1


def pixels(*rows: str):
    """Labels of points of the brick below by a picture in x and y, first row on top, each letter 1/4 wide and high."""
    picture = np.array([list(row) for row in rows[::-1]]) == "A"

    def label(points: np.ndarray) -> np.ndarray:
        # borders half an edge beside the nodes
        at = np.floor((points[..., :2] + [1.0, 0.5]) / 0.25 - 0.25 + 1e-9).astype(int)
        i, j = np.clip(at, 0, np.array(picture.T.shape) - 1).T
        return picture.T[i, j].astype(int)

    return label


HOOKS = pixels("AAAAAAAA", "BBBBBBAA", "BBAAAAAA", "BBBBBBBB")
COMBS = pixels("AAAAAAAA", "ABBABBAB", "ABBABBAB", "BBBBBBBB")
SPIRALS = pixels("AAAAAAAA", "ABBBBBBA", "ABAAAAAA", "ABBBBBBB")


@pytest.mark.parametrize("label", [HOOKS, COMBS, SPIRALS], ids=["hooks", "combs", "spirals"])
def test_interlocked_fragments(label) -> None:
    """Each fragment reaches around the other, so hulls and boxes overlap: true contacts, in place and moved."""
    case = interlocked(label)
    assert len(case.oracle.fragment_ids) == 2
    assert_geometry(case, snug=False)
    assert assert_contacts(case) > 0


def interlocked(label) -> FracturedWorld:
    body = brick((2.0, 1.0, 0.25), 0.125)

    def plane(a: int, b: int, i: int, _j: int) -> tuple[np.ndarray, float]:
        start, along = body.vertices[a], body.vertices[b] - body.vertices[a]
        # across the axis along which the label changes; at corners one of them
        axes = [k for k in np.flatnonzero(along) if label(start + along * (np.arange(3) == k)) != i]
        axis = axes[0] if axes else np.flatnonzero(along)[0]
        normal = np.sign(along) * (np.arange(3) == axis)
        return normal, float(normal @ (start + 0.5 * along))

    return broken_world(body, [by_labels(label(body.vertices), plane)])


def test_hooks_cannot_be_pulled_apart() -> None:
    """A hull-based method would report penetration in place; here pulling by 0.05 R makes contacts of 0.05 R.

    To 1e-12 R, with normals against the pull: lip on lip.
    """
    case = interlocked(HOOKS)
    upper = int(case.oracle.labels[np.argmax(case.oracle.vertices[:, 1])])
    ids = np.array(case.oracle.fragment_ids)
    positions = np.outer(ids == upper, [0.0, 0.05, 0.0])
    states = FragmentStates(1, 1, ids, positions.ravel(), np.tile(UPRIGHT, len(ids)))
    assert assert_contacts(case, [states]) > 0
    answer = with_settings(case, EVERY_CONTACT).contacts(states)
    towards = 1.0 if answer.fragment_a[0] == upper else -1.0
    normals = answer.normals.reshape(-1, 3)
    lips = np.abs(normals - [0.0, towards, 0.0]).max(axis=1) <= ROUNDING
    assert np.count_nonzero(lips) >= 20
    assert answer.gaps[lips].min() == pytest.approx(-0.05, abs=ROUNDING)


# --- penetration past the middle --------------------------------------------------------------------------------------


def depth_in_box(points: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    return np.minimum(points - low, high - points).min(axis=1)


def test_fragments_pushed_past_the_middle() -> None:
    """The nearest exit is no longer where the fragment entered: depth is the box's, to 1e-12 R, none is missed."""
    case = broken_world(BRICK, [by_labels(BRICK.vertices[:, 0] > 0.1, common_plane(np.array([1.0, 0.0, 0.0]), 0.1))])
    left = int(case.oracle.labels[0])
    ids = np.array(case.oracle.fragment_ids)
    shift = np.array([-0.8, 0.03, -0.07])
    states = FragmentStates(1, 1, ids, np.outer(ids != left, shift).ravel(), np.tile(UPRIGHT, 2))
    assert assert_contacts(case, [states]) > 0
    answer = with_settings(case, EVERY_CONTACT).contacts(states)
    # both fragments are boxes
    limits = {left: np.array([[-1.0, -0.5, -0.5], [0.1, 0.5, 0.5]])}
    limits[int(ids[ids != left][0])] = np.array([[0.1, -0.5, -0.5], [1.0, 0.5, 0.5]]) + shift
    # a sample of one is deep in the other, its witness on that one's surface
    in_a, in_b = (
        depth_in_box(answer.points_b.reshape(-1, 3), *limits[ids[0]]),
        depth_in_box(answer.points_a.reshape(-1, 3), *limits[ids[1]]),
    )
    assert np.abs(np.maximum(in_a, in_b).max() + answer.gaps.min()) <= ROUNDING
    assert -answer.gaps.min() > 0.29


@pytest.mark.parametrize("kind", ["tetrahedra", "triangles", "box"])
def test_a_block_in_the_middle_of_another(kind: str) -> None:
    """All samples of one are far inside the other: all are listed, with the box's depth to 1e-12 R."""
    world = CollisionWorld(EVERY_CONTACT)
    world.add_body(block(kind, 1, (2.0, 2.0, 1.0)))
    world.add_body(block("tetrahedra", 2, (1.0, 0.75, 0.5)))
    shift = np.array([0.03, 0.02, -0.11])
    turn = Rotation.from_rotvec([0.1, 0.2, 0.3])
    answer = world.contacts(
        FragmentStates(1, 0, np.array([1, 2]), np.append(np.zeros(3), shift), np.append(UPRIGHT, turn.as_quat()))
    )
    samples = turn.apply(samples_of(world.geometry, world._registry.row_of(2))[0]) + shift
    half = np.array([1.0, 1.0, 0.5])
    expected = np.sort(-depth_in_box(samples, -half, half))
    assert expected.min() < -0.45 and expected.max() < 0.0
    assert np.abs(np.sort(answer.gaps) - expected).max() <= ROUNDING
