"""fracture_collision.fracture: a CollisionWorld accepts every event, and the fragments divide the body."""

from __future__ import annotations

import doctest

import numpy as np
import pytest

from fracture_collision import fracture
from fracture_collision.fracture import breaking
from fracture_collision.geometry.generators import ball, brick, l_block, plate, torus
from fracture_collision.geometry.tetrahedra import tetrahedron_volumes
from fracture_collision.records import CollisionBody, FractureEvent, FragmentStates
from fracture_collision.world import CollisionWorld

MESHES = {
    "ball": ball(0.1, 0.02),
    "torus": torus(0.1, 0.04, 0.015),
    "l_block": l_block((0.2, 0.2, 0.05), (0.1, 0.1), 0.02),
    "plate": plate(0.25, 0.008, 0.0125, 0.018),
}
BRICK = brick((0.2, 0.1, 0.06), 0.02)  # node planes at x = -0.1, -0.08 ... and z = -0.03, -0.01, 0.01, 0.03


def body_of(mesh, body_id=1, fragment_id=1) -> CollisionBody:
    return CollisionBody(body_id, fragment_id, vertices=mesh.vertices, tetrahedra=mesh.tetrahedra, density=1000.0)


def masses_after(body: CollisionBody, events: list[FractureEvent]) -> dict[int, float]:
    """Masses of the living fragments; the world has accepted and applied all events."""
    world = CollisionWorld()
    world.add_body(body)
    for event in events:
        world.add_fracture(event)
    world.contacts(FragmentStates(1, len(events), [], [], []))
    registry = world.fragments()
    return dict(zip(registry.fragment_ids.tolist(), registry.masses.tolist(), strict=True))


def assert_divides(mesh, events: list[FractureEvent]) -> dict[int, float]:
    masses = masses_after(body_of(mesh), events)
    whole = 1000.0 * tetrahedron_volumes(mesh.vertices, mesh.tetrahedra).sum()
    assert abs(sum(masses.values()) / whole - 1.0) < 1e-12
    assert min(masses.values()) > 0.0
    owner = np.full(len(mesh.vertices), 1)
    for event in events:
        assert np.array_equal(np.sort(event.nodes), np.flatnonzero(owner == event.fragment_id))
        owner[event.nodes] = event.new_fragment_ids[event.node_fragments]
    assert set(owner.tolist()) == set(masses)
    return masses


@pytest.mark.parametrize("curvature", [0.0, 0.25])
@pytest.mark.parametrize("name", MESHES)
def test_two_generations_of_cells_divide_the_body(name: str, curvature: float) -> None:
    mesh = MESHES[name]
    body = body_of(mesh)
    for random in (1, 2, 3):
        first = fracture.voronoi(body, 6, random, curvature)
        masses = assert_divides(mesh, [first])
        heaviest = max(masses, key=lambda i: masses[i])
        second = fracture.voronoi(body, 4, random, curvature, fragment_id=heaviest, after=first)
        assert second.sequence == 2 and second.new_fragment_ids.min() > first.new_fragment_ids.max()
        assert_divides(mesh, [first, second])


def test_equal_arguments_give_equal_events_and_other_numbers_others() -> None:
    body = body_of(MESHES["ball"])
    one, again = (fracture.voronoi(body, 8, 5, 0.2) for _ in range(2))
    assert all(np.array_equal(a, b) for a, b in zip(one, again, strict=True))
    generated = fracture.voronoi(body, 8, np.random.default_rng(5), 0.2)
    assert all(np.array_equal(a, b) for a, b in zip(one, generated, strict=True))
    assert not np.array_equal(one.node_fragments, fracture.voronoi(body, 8, 6, 0.2).node_fragments)
    flat = body._replace(vertices=body.vertices.ravel().tolist(), tetrahedra=body.tetrahedra.ravel().tolist())
    assert all(np.array_equal(a, b) for a, b in zip(one, fracture.voronoi(flat, 8, 5, 0.2), strict=True))


def test_each_node_joins_its_nearest_seed() -> None:
    mesh = MESHES["ball"]
    seeds = np.array([(-0.05, 0.01, 0.0), (0.06, 0.0, 0.02), (0.0, 0.05, -0.03)])
    event = fracture.voronoi(body_of(mesh), seeds)
    nearest = np.argmin(np.linalg.norm(mesh.vertices[:, None] - seeds, axis=2), axis=1)
    assert len(event.new_fragment_ids) == 3
    assert len(np.unique(3 * nearest + event.node_fragments)) == 3  # the same partition


def test_an_impact_point_draws_the_seeds_near() -> None:
    """Averaged over many draws: the fragments at the impact are smaller than those opposite."""
    mesh = MESHES["ball"]
    at_impact = opposite = 0
    for random in range(20):
        event = fracture.voronoi(body_of(mesh), 12, random, impact_point=(0.1, 0.0, 0.0))
        sizes = np.bincount(event.node_fragments)[event.node_fragments]
        at_impact += sizes[mesh.vertices[:, 0] > 0.07].mean()
        opposite += sizes[mesh.vertices[:, 0] < -0.07].mean()
    assert at_impact < 0.7 * opposite


def test_planes_halve_a_brick_between_and_through_its_nodes() -> None:
    whole = 1000.0 * 0.2 * 0.1 * 0.06
    for offset in (0.01, 0.0, -0.0799, 0.08):
        event = fracture.planes(body_of(BRICK), (1.0, 0.0, 0.0), offset)
        low, high = assert_divides(BRICK, [event]).values()
        assert sorted((low, high)) == pytest.approx(sorted((whole * (0.5 + 5 * offset), whole * (0.5 - 5 * offset))))


def test_several_planes_make_the_parts_between_them() -> None:
    normals, offsets = [(2.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)], [0.033, 0.011, 0.003]
    event = fracture.planes(body_of(BRICK), normals, offsets)
    masses = assert_divides(BRICK, [event])
    assert len(masses) == 8
    volumes = [x * y * z for x in (0.133, 0.067) for y in (0.061, 0.039) for z in (0.033, 0.027)]
    # Where three cells meet, regions follow the mesh (docs/numerics.md): some per cent of a piece change hands.
    assert sorted(masses.values()) == pytest.approx([1000.0 * v for v in sorted(volumes)], rel=0.1)


@pytest.mark.parametrize("seed", range(5))
def test_random_planes_are_valid(seed: int) -> None:
    random = np.random.default_rng(seed)
    for mesh in MESHES.values():
        reach = 0.3 * np.ptp(mesh.vertices, axis=0).max()
        event = fracture.planes(body_of(mesh), random.normal(size=(4, 3)), random.uniform(-reach, reach, 4))
        assert_divides(mesh, [event])


def test_a_plane_along_a_face_takes_off_nothing() -> None:
    """Such a piece would have nodes, but no volume: it stays with its neighbour."""
    with pytest.raises(ValueError, match="offsets: no plane separates nodes of fragment 1"):
        fracture.planes(body_of(BRICK), (1.0, 0.0, 0.0), -0.1)
    event = fracture.planes(body_of(BRICK), [(1.0, 0.0, 0.0), (0.0, 0.0, 1.0), (1, 0, 0)], [-0.1, -0.03, 0.0])
    assert len(assert_divides(BRICK, [event])) == 2


@pytest.mark.parametrize("share", [0.0, 1e-12, 1e-9, 1e-6, 5e-4])
def test_a_plane_that_hardly_touches_a_corner_takes_off_nothing(share: float) -> None:
    normal = np.array([1.0, 1.3, 0.7]) / np.linalg.norm([1.0, 1.3, 0.7])
    offset = float(normal @ BRICK.vertices[0])
    with pytest.raises(ValueError, match="no plane separates"):
        fracture.planes(body_of(BRICK), normal, offset + 0.3 * share * 0.02)
    event = fracture.planes(body_of(BRICK), normal, offset + 0.02)
    assert len(assert_divides(BRICK, [event])) == 2


def test_cuts_through_the_nodes_of_earlier_cuts_are_valid() -> None:
    """The slab between x = 0 and x = 0.02 has the nodes of its upper face alone, where two cracks pass."""
    first = fracture.planes(body_of(BRICK), (1.0, 0.0, 0.0), 0.0)
    low, high = first.new_fragment_ids
    second = fracture.planes(body_of(BRICK), (1.0, 0.0, 0.0), 0.02, fragment_id=high, after=first)
    third = fracture.planes(body_of(BRICK), (0.0, 0.0, 1.0), 0.01, 4, [first, second])
    masses = assert_divides(BRICK, [first, second, third])
    assert sorted(masses.values())[2:] == pytest.approx([0.48, 0.6])
    with pytest.raises(ValueError, match="no plane separates"):
        fracture.planes(body_of(BRICK), (1.0, 0.0, 0.0), -0.1, fragment_id=low, after=first)


def test_seeds_mirrored_in_a_face_take_off_nothing() -> None:
    seeds = [(-0.12, 0.0, 0.0), (-0.08, 0.0, 0.0), (0.08, 0.0, 0.0)]
    event = fracture.voronoi(body_of(BRICK), seeds)
    assert len(assert_divides(BRICK, [event])) == 2


@pytest.mark.parametrize("name", MESHES)
def test_any_labels_are_valid(name: str) -> None:
    mesh, random = MESHES[name], np.random.default_rng(1)
    coarse = np.floor(mesh.vertices / 0.05).astype(int) @ (1, 10, 100)
    first = fracture.labels(body_of(mesh), coarse)
    assert_divides(mesh, [first])
    noise = random.integers(-2, 2, len(mesh.vertices))
    target = int(first.new_fragment_ids[np.bincount(first.node_fragments).argmax()])
    second = fracture.labels(body_of(mesh), noise, fragment_id=target, after=[first])
    assert_divides(mesh, [first, second])


def test_planes_of_pairs_of_labels_are_used_from_either_side() -> None:
    mesh = MESHES["ball"]
    label = np.where(mesh.vertices[:, 2] > 0.033, 7, -4)
    up, down = {(-4, 7): (0, 0, 2, 0.066)}, {(7, -4): (0, 0, -1, -0.033)}
    events = [fracture.labels(body_of(mesh), label, planes=planes) for planes in (up, down)]
    by_plane = fracture.planes(body_of(mesh), (0.0, 0.0, 1.0), 0.033)
    for event in events:
        assert np.array_equal(event.cut_edges, by_plane.cut_edges)
        assert np.allclose(event.cut_planes, by_plane.cut_planes, atol=1e-15)
    assert_divides(mesh, events[:1])


def test_an_edge_that_the_plane_of_its_pair_misses_is_cut_in_its_middle() -> None:
    mesh = MESHES["ball"]
    label = mesh.vertices[:, 2] + 0.1 * np.abs(mesh.vertices[:, 0]) > 0.033
    event = fracture.labels(body_of(mesh), label, planes={(0, 1): (0.0, 0.0, 1.0, 0.033)})
    is_given = np.abs(event.cut_planes.reshape(-1, 4)[:, 2]) == 1.0
    assert 0 < is_given.sum() < len(is_given)
    assert_divides(mesh, [event])


def test_ids_and_sequence_follow_the_events_of_all_bodies() -> None:
    one, other = body_of(BRICK), body_of(MESHES["ball"], body_id=2, fragment_id=2)
    first = fracture.voronoi(one, 3, 1, first_new_id=10)
    second = fracture.voronoi(other, 3, 1, after=[first])
    third = fracture.planes(one, (1, 0, 0), 0.0, fragment_id=11, after=[first, second], first_new_id=100)
    assert [event.sequence for event in (first, second, third)] == [1, 2, 3]
    assert first.new_fragment_ids.tolist() == [10, 11, 12]
    assert second.new_fragment_ids.tolist() == [13, 14, 15]
    assert third.new_fragment_ids[0] == 100
    world = CollisionWorld()
    for body in (one, other):
        world.add_body(body)
    for event in (first, second, third):
        world.add_fracture(event)
    world.contacts(FragmentStates(1, 3, [], [], []))
    assert set(world.fragments().fragment_ids.tolist()) >= {10, 12, 13, 14, 15, 100, 101}


BODY = body_of(BRICK)
TWO = [(-0.05, 0.0, 0.0), (0.05, 0.0, 0.0)]
HALVES = fracture.voronoi(BODY, TWO)
SHEET = CollisionBody(1, 1, vertices=BRICK.vertices, triangles=[0, 1, 2])
REJECTED = {
    r"body: ndarray instead of a CollisionBody": lambda: fracture.voronoi(BRICK.vertices, TWO),
    r"body: has no tetrahedra and cannot break; fracture_collision.meshing fills": lambda: fracture.voronoi(SHEET, TWO),
    r"body.vertices: shape \(3, 264\); needs \(n, 3\)": lambda: fracture.voronoi(
        BODY._replace(vertices=BRICK.vertices.T), TWO
    ),
    r"body.tetrahedra: float64 instead of integers": lambda: fracture.voronoi(
        BODY._replace(tetrahedra=BRICK.tetrahedra.astype(float)), TWO
    ),
    r"body.tetrahedra: index 264 is not in 0 .. 263; indices start at 0": lambda: fracture.voronoi(
        BODY._replace(tetrahedra=BRICK.tetrahedra + 1), TWO
    ),
    r"body.vertices: not all finite": lambda: fracture.voronoi(BODY._replace(vertices=BRICK.vertices * np.nan), TWO),
    r"random: random seeds need a number .*random=1": lambda: fracture.voronoi(BODY, 5),
    r"random: -1 is neither a whole number": lambda: fracture.voronoi(BODY, 5, -1),
    r"random: 'dice' is neither": lambda: fracture.voronoi(BODY, 5, "dice"),
    r"after: NoneType instead of the events so far": lambda: fracture.voronoi(BODY, TWO, after=None),
    r"random: curved cracks need": lambda: fracture.voronoi(BODY, TWO, curvature=0.2),
    r"seeds: 1; a fracture needs at least 2": lambda: fracture.voronoi(BODY, 1, random=1),
    r"seeds: 1; ": lambda: fracture.voronoi(BODY, [(0.0, 0.0, 0.0)]),
    r"seeds: shape \(2, 2\); needs rows of 3": lambda: fracture.voronoi(BODY, [(0.0, 0.0), (1.0, 1.0)]),
    r"seeds: not numbers": lambda: fracture.voronoi(BODY, "many"),
    r"seeds: all nodes of fragment 1 lie in one cell": lambda: fracture.voronoi(BODY, [(9.0, 0, 0), (10.0, 0, 0)]),
    r"curvature: -1 is not a number of at least 0": lambda: fracture.voronoi(BODY, TWO, 1, -1),
    r"impact_point: shape \(2,\)": lambda: fracture.voronoi(BODY, 3, 1, impact_point=(0.0, 0.0)),
    r"fragment_id: body 1 has several fragments; choose one of 2, 3": lambda: fracture.voronoi(BODY, TWO, after=HALVES),
    r"fragment_id: no living fragment 1 of body 1; there are 2, 3": lambda: fracture.voronoi(
        BODY, TWO, fragment_id=1, after=HALVES
    ),
    r"after\[1\].nodes: node 0 belongs to fragment 2, not 1": lambda: fracture.voronoi(BODY, TWO, after=[HALVES] * 2),
    r"after\[0\]: str instead of a FractureEvent": lambda: fracture.voronoi(BODY, TWO, after=["last"]),
    r"first_new_id: 3 is not above 3": lambda: fracture.voronoi(
        BODY, TWO, fragment_id=2, after=HALVES, first_new_id=3
    ),
    r"first_new_id: 4294967290 leaves no room": lambda: fracture.voronoi(BODY, TWO, first_new_id=4294967290),
    r"normals: row 1 is \(0, 0, 0\)": lambda: fracture.planes(BODY, [(1, 0, 0), (0, 0, 0)], [0, 0]),
    r"offsets: shape \(\) for 2 normals": lambda: fracture.planes(BODY, [(1, 0, 0), (0, 1, 0)], 0.0),
    r"offsets: no plane separates": lambda: fracture.planes(BODY, (1, 0, 0), 3.0),
    r"labels: int64 of shape \(3,\); needs an integer for each of the 264": lambda: fracture.labels(BODY, [0, 1, 2]),
    r"labels: float64 of shape \(264,\)": lambda: fracture.labels(BODY, BRICK.vertices[:, 0]),
    r"labels: the nodes of fragment 1 have one label": lambda: fracture.labels(BODY, np.zeros(264, int)),
    r"planes: 1 is not a pair of labels": lambda: fracture.labels(BODY, np.arange(264) % 2, {1: (1, 0, 0, 0)}),
    r"planes\[\(0, 1\)\]: shape \(3,\)": lambda: fracture.labels(BODY, np.arange(264) % 2, {(0, 1): (1, 0, 0)}),
    r"planes\[\(0, 1\)\]: crosses none of the \d+ edges": lambda: fracture.labels(
        BODY, np.arange(264) % 2, {(0, 1): (1, 0, 0, 5)}
    ),
    r"planes\[\(0, 1\)\]: the normal is \(0, 0, 0\)": lambda: fracture.labels(
        BODY, np.arange(264) % 2, {(0, 1): (0, 0, 0, 5)}
    ),
}  # fmt: skip


@pytest.mark.parametrize("words", REJECTED)
def test_an_error_names_the_argument_and_says_what_to_pass(words: str) -> None:
    with pytest.raises(ValueError, match="^" + words):
        REJECTED[words]()


def test_the_examples_in_the_docstrings_run() -> None:
    done = doctest.testmod(breaking)
    assert done.attempted > 10 and not done.failed


@pytest.mark.parametrize("curvature", [0.0, 0.25])
@pytest.mark.parametrize("mesh", [brick((1.0, 1.0, 1.0), 0.25), brick((2.0, 1.0, 1.0), 0.5)], ids=["cube", "brick"])
def test_seeds_at_nodes_make_events_that_the_service_accepts(mesh, curvature: float) -> None:
    """Where cells are equally far, rounding may put both ends of an edge into the bisector of two seeds."""
    for random in range(30):
        generator = np.random.default_rng(random)
        nodes = generator.choice(len(mesh.vertices), generator.integers(2, 9), replace=False)
        seeds = mesh.vertices[nodes]
        assert_divides(mesh, [fracture.voronoi(body_of(mesh), seeds, random=random, curvature=curvature)])


def test_nodes_within_rounding_of_a_plane_are_on_it() -> None:
    """Three nodes give a plane with the rounding of its numbers; those behind its normal get all nodes on it."""
    mesh = ball(0.5, 0.3)
    for random in range(30):
        p, q, r = mesh.vertices[np.random.default_rng(random).choice(len(mesh.vertices), 3, replace=False)]
        normal = np.cross(q - p, r - p) / np.linalg.norm(np.cross(q - p, r - p))
        for offset in (normal @ p, np.nextafter(normal @ p, 1.0), np.nextafter(normal @ p, -1.0)):
            try:
                event = fracture.planes(body_of(mesh), normal, offset)
            except ValueError:  # no node is in front of it
                continue
            heights = mesh.vertices[event.cut_edges.reshape(-1, 2)] @ normal - normal @ p
            assert (np.abs(heights).max(axis=1) > 1e-9).all(), "an edge in the plane is cut"
