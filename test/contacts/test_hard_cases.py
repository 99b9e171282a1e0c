"""Hard cases of cracks and fragments, each with its required accuracy. Lengths in units of R = 1 m.

Scales, positions and rotations: test_hard_scales.py. The truth is the slow oracle's: all polygons of FragmentedBody,
all samples. Flat and inverted tetrahedra are not covered here; the gate rejects both (test_world_gate.py).
"""

from __future__ import annotations

from itertools import combinations, product

import numpy as np
import pytest
from oracles.brute_force import owners
from oracles.fracture_patterns import own_planes, voronoi_event
from scipy.spatial.transform import Rotation
from truth.contact_truth import COARSE_SHAPES, FRAMES, ContactTruth, Poses, assert_true, check_pair, pairs_of
from worlds.fractured_worlds import DENSITY, FracturedWorld, fractured_world, samples_of, with_settings
from worlds.hard_worlds import (
    BRICK,
    EVERY_CONTACT,
    ROUNDING,
    SETTINGS,
    UPRIGHT,
    anywhere,
    assert_contacts,
    assert_geometry,
    block,
    broken_world,
    by_labels,
    common_plane,
    fragments_with,
    lattice_planes,
    samples_within,
    sized,
)
from worlds.sampled_worlds import EVERY, SampledWorld

from fracture_collision.geometry.generators import TetGeometry, ball, brick, plate
from fracture_collision.geometry.tetrahedra import tetrahedron_volumes
from fracture_collision.records import FragmentStates
from fracture_collision.world import CollisionWorld, Settings

# --- parallel faces at exactly zero gap -------------------------------------------------------------------------------


@pytest.mark.parametrize(("lower", "upper"), [*product(("tetrahedra", "triangles", "box"), repeat=2)])
def test_parallel_faces_of_two_blocks_at_zero_gap(lower: str, upper: str) -> None:
    """Every sample of the common face is neither inside nor outside: all listed, gaps 0 to 1e-12 R, normals upright."""
    world = CollisionWorld(EVERY_CONTACT)
    world.add_body(block(lower, 1, (2.0, 2.0, 1.0)))
    world.add_body(block(upper, 2, (1.0, 0.75, 0.5)))
    shift = np.array([0.07, -0.11, 0.75])  # no sample of either is on a rim of the other's face
    answer = world.contacts(FragmentStates(1, 0, np.array([1, 2]), np.append(np.zeros(3), shift), np.tile(UPRIGHT, 2)))
    reach = SETTINGS.detection_tolerance * 0.5  # of the smaller R
    expected = 0
    for own, half in ((1, np.array([0.5, 0.375, 0.25])), (2, np.array([1.0, 1.0, 0.5]))):
        points = samples_of(world.geometry, world._registry.row_of(own))[0] + (shift if own == 2 else -shift)
        expected += int(np.count_nonzero(np.all(np.abs(points) <= half + reach, axis=1)))
    assert len(answer.gaps) == expected >= 4
    assert np.abs(answer.gaps).max() <= ROUNDING
    assert np.abs(answer.normals.reshape(-1, 3) - [0.0, 0.0, 1.0]).max() <= ROUNDING
    assert np.abs(answer.points_a - answer.points_b).max() <= ROUNDING
    assert answer.missed_depth_bound.max() <= SETTINGS.penetration_tolerance


@pytest.mark.parametrize("deep", [0.0, 1e-6, 1e-3, -1e-3])
@pytest.mark.parametrize(("lower", "upper"), [*product(("tetrahedra", "triangles", "box"), repeat=2)])
def test_contacts_of_flush_equal_blocks_are_upright(lower: str, upper: str, deep: float) -> None:
    """Two blocks stacked flush, just apart or slightly penetrating, separate along their common face: all normals up.

    The nearest surface of a rim's sample is the other's side, at distance 0: along the shortest way out, 25 % point
    sideways for tetrahedra, 40 % for triangles, all for boxes, and the upper block sinks in.
    """
    world = SampledWorld(Settings(threads=1, contacts_per_pair=EVERY))
    for number, kind in ((1, lower), (2, upper)):
        world.add_body(block(kind, number, (2.0, 2.0, 1.0)))
    states = FragmentStates(1, 0, np.array([1, 2]), np.array([0.0, 0, 0, 0, 0, 1.0 - deep]), np.tile(UPRIGHT, 2))
    answer = world.contacts(states)
    assert np.abs(answer.normals.reshape(-1, 3) - [0.0, 0.0, 1.0]).max() <= ROUNDING
    assert np.abs(answer.gaps + deep).max() <= ROUNDING
    assert len(answer.gaps) >= 8


@pytest.mark.parametrize("name", ["between nodes", "through nodes", "tilted"])
def test_flat_fragments_face_to_face_at_zero_gap(name: str) -> None:
    """A fresh crack is closed to the last bit: all of its samples are contacts, gaps 0 to 1e-12 R, none is inside.

    Normals are the crack's, but for samples on its rim, which lie on the old outside as well.
    """
    normal, offset = {
        "between nodes": (np.array([1.0, 0.0, 0.0]), 0.1),
        "through nodes": (np.array([1.0, 0.0, 0.0]), 0.25),
        "tilted": (np.array([6.0, 2.0, 3.0]) / 7.0, 0.05),
    }[name]
    case = broken_world(BRICK, [by_labels(BRICK.vertices @ normal > offset, common_plane(normal, offset))])
    answer = with_settings(case, EVERY_CONTACT).contacts(case.states())
    first, second = case.oracle.fragment_ids
    reach = SETTINGS.detection_tolerance
    near = [samples_within(case, first, second, reach), samples_within(case, second, first, reach)]
    assert len(answer.gaps) == len(near[0]) + len(near[1])
    points = answer.points_a.reshape(-1, 3)
    closed = np.abs(points @ normal - offset) <= ROUNDING
    assert np.count_nonzero(closed) >= 50
    assert np.abs(answer.gaps[closed]).max() <= ROUNDING
    assert answer.gaps.min() >= -ROUNDING
    on_rim = np.abs(np.abs(points) - np.array([1.0, 0.5, 0.5])).min(axis=1) <= ROUNDING
    flat = closed & ~on_rim
    assert np.count_nonzero(flat) >= 10
    assert np.abs(answer.normals.reshape(-1, 3)[flat] - normal).max() <= ROUNDING


# --- cracks through nodes and along faces -----------------------------------------------------------------------------


def turned(body: TetGeometry) -> tuple[TetGeometry, np.ndarray]:
    rotation = Rotation.from_rotvec([0.3, 0.7, -0.4]).as_matrix()
    return sized(body._replace(vertices=body.vertices @ rotation.T)), rotation


@pytest.mark.parametrize("aligned", [True, False], ids=["exact", "rounded"])
@pytest.mark.parametrize("side", ["left", "right"])
def test_crack_through_nodes_and_along_faces(aligned: bool, side: str) -> None:
    """The nodes in the plane belong to one side only, though all their tetrahedra lie on the other.

    Exactly, margins are equal all over a face; turned, rounding makes them differ by 1e-17. Each half has half the
    volume to 1e-12, no sample within the other, and depth to 1e-9 R.
    """
    body, rotation = (BRICK, np.eye(3)) if aligned else turned(BRICK)
    labels = BRICK.vertices[:, 0] >= 0.0 if side == "right" else BRICK.vertices[:, 0] > 0.0
    case = broken_world(body, [by_labels(labels, common_plane(rotation[:, 0], 0.0))])
    masses = case.world.fragments().masses
    assert np.abs(masses / masses.sum() - 0.5).max() <= ROUNDING
    assert_geometry(case)
    assert assert_contacts(case) > 0


def test_crack_along_the_diagonal_faces_of_a_brick() -> None:
    """The plane x = y holds a face of every tetrahedron that it meets: a partition, exact depth, snug fragments."""
    x, y, _ = BRICK.vertices.T
    case = broken_world(BRICK, [by_labels(x > y, common_plane(np.array([1.0, -1.0, 0.0]) / np.sqrt(2.0), 0.0))])
    assert_geometry(case)
    assert assert_contacts(case) > 0


def test_cracks_that_cross_in_nodes_and_edges() -> None:
    """Two cracks cross in an edge of the mesh, with seeds so even that three or four cells are equally near there."""
    seeds = np.array([[x, y, 0.0] for x in (-0.5, 0.5) for y in (-0.25, 0.25)])
    case = broken_world(BRICK, [lambda body, first, sequence: voronoi_event(body, 1, seeds, first, sequence)])
    assert np.abs(case.world.fragments().masses / case.world.fragments().masses.sum() - 0.25).max() <= ROUNDING
    assert_geometry(case)
    assert assert_contacts(case) > 0


# --- planes that do not agree -----------------------------------------------------------------------------------------


# with label seeds that give every fragment a volume: others are rejected (test_world_volume.py)
@pytest.mark.parametrize(("cells", "seed"), [(2, 2), (3, 6), (6, 14)])
@pytest.mark.parametrize("kind", ["any", "lattice"])
def test_planes_that_do_not_agree_still_make_a_partition(kind: str, cells: int, seed: int) -> None:
    """Random labels and a plane of its own for each cut edge: volumes add up to 1e-12, each point has one owner.

    With planes of a lattice many margins are equal, on faces, planes, and in all of a tetrahedron. Depth to 1e-9 R.
    """
    body = brick((2.0, 1.0, 1.0), 0.5)
    labels = np.random.default_rng(seed).integers(0, cells, len(body.vertices))
    random = np.random.default_rng(cells)
    planes = own_planes(body.vertices, random, 0.7) if kind == "any" else lattice_planes(body.vertices, cells)
    case = broken_world(body, [by_labels(labels, planes)])
    assert_geometry(case, snug=False)
    # in place, samples lie on faces whose two sides assign them to different fragments
    assert assert_contacts(case, ("jittered", "deep")) > 0


# --- slivers, plates, single nodes, many fragments, generations -------------------------------------------------------


@pytest.mark.parametrize("thickness", [0.05, 1e-4, 1e-7], ids=str)
def test_plate_one_tetrahedron_thick(thickness: float) -> None:
    """No node and no room inside: all depths are below half the thickness, far below the tolerances. Same numbers.

    1e-7 R is near the limit at which the gate calls a tetrahedron flat.
    """
    body = sized(plate(2.0, thickness, 0.3, 0.0, layers=1))
    case = broken_world(body, [
        lambda whole, first, sequence: voronoi_event(
            whole, 1, np.random.default_rng(4).uniform(-0.7, 0.7, (6, 3)) * [1, 1, 0], first, sequence
        )
    ])  # fmt: skip
    assert_geometry(case)
    assert assert_contacts(case) > 0


@pytest.mark.parametrize("flatness", [1e-3, 1e-7], ids=str)
def test_slivers_have_true_contacts(flatness: float) -> None:
    """Inner nodes pushed almost into the opposite face of a tetrahedron: weights lose digits, answers must not."""
    body = brick((2.0, 1.0, 1.0), 0.5)
    vertices = body.vertices.copy()
    inner = np.flatnonzero(np.all(np.abs(vertices) < [0.9, 0.4, 0.4], axis=1))
    around = [t for t in body.tetrahedra.tolist() if inner[0] in t]
    a, b, c = (vertices[v] for v in around[0] if v != inner[0])
    normal = np.cross(b - a, c - a)
    normal /= np.linalg.norm(normal)
    # the foot of the node on that face, and slightly back
    height = normal @ (vertices[inner[0]] - a)
    vertices[inner[0]] -= (height - np.sign(height) * flatness) * normal
    case = broken_world(body._replace(vertices=vertices), [
        lambda whole, first, sequence: voronoi_event(
            whole, 1, np.random.default_rng(2).uniform(-0.5, 0.5, (5, 3)), first, sequence
        )
    ])  # fmt: skip
    assert_geometry(case)
    assert assert_contacts(case) > 0


@pytest.mark.parametrize("place", ["corner", "face", "inside"])
def test_fragment_of_a_single_node(place: str) -> None:
    """No edge and no tetrahedron of its own, and inside not even a sample of the old surface. Same numbers."""
    body = brick((2.0, 1.0, 1.0), 0.5)
    target = {"corner": [1.0, 0.5, 0.5], "face": [0.0, 0.0, 0.5], "inside": [0.0, 0.0, 0.0]}[place]
    node = int(np.argmin(np.linalg.norm(body.vertices - target, axis=1)))
    labels = (np.arange(len(body.vertices)) == node).astype(int)

    def across(a: int, b: int, i: int, _j: int) -> tuple[np.ndarray, float]:
        along = body.vertices[b] - body.vertices[a]
        normal = along / np.linalg.norm(along)
        return normal, float(normal @ (body.vertices[a] + (0.4 if i else 0.6) * along))

    case = broken_world(body, [by_labels(labels, across)])
    assert sorted(np.unique(case.oracle.labels, return_counts=True)[1].tolist())[0] == 1
    assert_geometry(case, snug=False)
    assert assert_contacts(case, ("jittered", "deep")) > 0


def broken_to_pieces(edge_length: float, seed: int) -> FracturedWorld:
    """A ball in 400 Voronoi cells, each about a node but not quite, so that no two nodes are equally near to a seed."""
    body, random = ball(1.0, edge_length), np.random.default_rng(seed)
    nodes = random.choice(len(body.vertices), 400, replace=False)
    seeds = body.vertices[nodes] + random.uniform(-0.02, 0.02, (400, 3))
    case = broken_world(body, [lambda whole, first, sequence: voronoi_event(whole, 1, seeds, first, sequence)])
    assert len(case.oracle.fragment_ids) >= 400
    return case


def test_four_hundred_fragments_of_one_body() -> None:
    """Two or three nodes a fragment, up to four fragments in every tetrahedron.

    Volumes add up to 1e-12, each point has one owner, and the contacts among the dozen fragments about a point are true
    and complete.
    """
    case = broken_to_pieces(0.17, 3)
    whole = tetrahedron_volumes(case.oracle.vertices, case.oracle.tetrahedra).sum()
    assert case.world.fragments().masses.sum() == pytest.approx(DENSITY * whole, rel=ROUNDING)
    truth = ContactTruth(case)
    points = anywhere(case, 100, seed=5)
    owner, certain = owners(truth.partition, points)
    assert certain.all()
    inside = fragments_with(case, points)
    assert np.array_equal(inside.sum(axis=1), np.ones(len(points), dtype=int))
    assert np.array_equal(np.array(case.oracle.fragment_ids)[inside.argmax(axis=1)], owner)
    middles = case.world.fragments().centers_of_mass.reshape(-1, 3)
    dozen = np.array(case.oracle.fragment_ids)[np.argsort(np.linalg.norm(middles - [0.5, 0.3, 0.4], axis=1))[:12]]
    for frame in ("touching", "jittered", "deep"):
        states = FRAMES[frame](truth, 1)
        answer = case.world.contacts(states)
        listed, epsilon = pairs_of(answer), SETTINGS.penetration_tolerance
        pairs = combinations(sorted(dozen.tolist()), 2)
        checks = [check_pair(truth, Poses(states), answer, pair, listed, epsilon) for pair in pairs]
        assert_true(checks, epsilon)
        assert sum(check.contacts for check in checks) > 50


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_four_hundred_fragments_all_of_them() -> None:
    """As above with the slow oracle's volumes, all depths, samples, boxes and pairs."""
    case = broken_to_pieces(0.17, 3)
    assert_geometry(case)
    assert assert_contacts(case) > 400


@pytest.mark.parametrize("cracks", ["flat", "curved"])
def test_contacts_of_the_fifth_generation(cracks: str) -> None:
    """Cracks that end at cracks that end at cracks: contacts are true where five fractures met in a tetrahedron."""
    case = fractured_world(COARSE_SHAPES["ball"](), seeds=3, generations=5, curved=cracks == "curved")
    assert len(case.oracle.fragment_ids) >= 8
    assert assert_contacts(case) > 0


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
