"""Fracture within a simulation: when bodies break, conservation of motion, the pieces of a pattern and the events."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from truth.counted_work import calls_of
from worlds.small_scenes import ball, small_scene

from fracture_collision.fracture.pattern import PatternSettings, draw_warp, voronoi_pattern
from fracture_collision.fracture.pieces import bisector_crossings, connected_pieces
from fracture_collision.geometry import generators
from fracture_collision.geometry.tetrahedra import unique_edges
from fracture_collision.portable_math import dots, products, sine
from fracture_collision.records import CollisionBody, ContactConstraintArray
from fracture_collision.simulation.breakable_body import BreakableBody
from fracture_collision.simulation.own_dynamics import OwnDynamics
from fracture_collision.simulation.simulation import Simulation
from fracture_collision.world import CollisionWorld, Settings


class WatchedDynamics(OwnDynamics):
    """Records its contents before and after its last step."""

    def advance(self, *velocities):
        self.before = self.states()
        super().advance(*velocities)
        self.after = self.states()


def breaking_scene(plates=1):
    porcelain = {
        "density": 2400.0, "friction": 0.5,
        "fracture": {"strength": 0.2, "minimum_mass": 0.02, "pattern": {"seeds": 8, "minimum_nodes": 6}},
    }  # fmt: skip
    plate = {"diameter": 0.25, "thickness": 0.008, "edge_length": 0.0125, "rim_height": 0.018, "layers": 2}
    bodies = [
        {"name": f"plate {i}", "shape": {"plate": plate}, "position": [0.5 * i, 0.1, 0.2],
         "rotation": [30.0, 20.0, 10.0], "linear_velocity": [0.3, -0.2, 1.0], "angular_velocity": [3.0, 7.0, -5.0]}
        for i in range(plates)
    ] + [
        ball(f"ball {i}", 0.03, [0.5 * i, 0.1, 0.24], material="steel", linear_velocity=[0.0, 0.0, -20.0])
        for i in range(plates)
    ]  # fmt: skip
    steel = {"density": 7800.0, "friction": 0.3}
    return small_scene(porcelain, *bodies, gravity=0.0, seed=5, materials={"steel": steel})


def touching(states, pairs):
    """One contact for each (a, b, point, normal), without a gap."""
    count = len(pairs)
    points = np.array([point for _, _, point, _ in pairs]).reshape(-1, 3)
    normals = np.array([normal for *_, normal in pairs]).reshape(-1, 3)
    return ContactConstraintArray(
        states.step, states.fracture_sequence, 0,
        np.array([a for a, *_ in pairs], np.uint32), np.array([b for _, b, *_ in pairs], np.uint32),
        np.arange(count + 1, dtype=np.uint32), np.zeros(count), np.full(count, 0.5), np.zeros(count),
        points, points, normals, np.zeros(count), np.zeros(count, np.uint64),
    )  # fmt: skip


def momenta(states, fragment_ids):
    """Total linear and angular momentum of these fragments, about the world's origin, and their mass."""
    rows = np.isin(states.fragment_ids, fragment_ids)
    linear = states.masses[rows, None] * states.linear[rows]
    angular = np.cross(states.centers[rows], linear)
    angular += np.einsum("nij,nj->ni", states.inertias[rows], states.angular[rows])
    return np.concatenate((linear.sum(axis=0), angular.sum(axis=0), [states.masses[rows].sum()]))


class Run:
    """A simulation with contacts that the test chooses; the service has the masses."""

    def __init__(self, scene, **more):
        self.world = WatchedDynamics(scene.time_step, scene.gravity, scene.solver)
        self.simulation = Simulation(scene, dynamics=self.world, **more)
        self.service = CollisionWorld(Settings(threads=1))
        for body in self.simulation.start_bodies():
            self.service.add_body(body)

    def step(self, find_pairs=lambda states: []):
        request = self.simulation.begin_step()
        for event in request.events:
            self.service.add_fracture(event)
        contacts = touching(request.states, find_pairs(request.states))
        return request, self.simulation.finish_step(contacts, self.service.fragments())


@pytest.fixture
def start_run():
    runs = []

    def start(*arguments, **more):
        runs.append(Run(*arguments, **more))
        return runs[-1]

    yield start
    for run in runs:
        run.simulation.close()


UP = np.array([0.0, 0.0, 1.0])


def balls_on_plates(states, plates=1):
    """Each ball falls and touches its plate from above."""
    positions = states.positions.reshape(-1, 3)
    return [(1 + i, 1 + plates + i, positions[plates + i] - 0.03 * UP, UP) for i in range(plates)]


def test_pieces_keep_the_momentum_of_the_whole_and_the_blow_is_its_strength(start_run):
    run = start_run(breaking_scene())
    _, report = run.step(balls_on_plates)
    assert [event.sequence for event in report.events] == [1]
    ball_mass = 7800.0 * 4.0 / 3.0 * np.pi * 0.03**3
    striker = run.world.after.linear[np.flatnonzero(run.world.after.fragment_ids == 2)[0]]
    assert ball_mass * (striker[2] + 20.0) == pytest.approx(0.2, rel=1e-9)
    whole = momenta(run.world.after, [1])
    request, _ = run.step()
    pieces = request.events[0].new_fragment_ids
    assert set(pieces) <= set(request.states.fragment_ids)
    assert 1 not in request.states.fragment_ids
    np.testing.assert_allclose(momenta(run.world.before, pieces), whole, rtol=0, atol=1e-12)

    # The ball hits the heaviest piece next.
    now = run.world.after
    row = max(np.flatnonzero(np.isin(now.fragment_ids, pieces)), key=lambda i: now.masses[i])
    victim = int(now.fragment_ids[row])
    _, report = run.step(lambda states: [(2, victim, now.centers[row], -UP)])
    assert [(event.sequence, event.fragment_id) for event in report.events] == [(2, victim)]
    whole = momenta(run.world.after, [victim])
    request, _ = run.step()
    pieces = request.events[0].new_fragment_ids
    np.testing.assert_allclose(momenta(run.world.before, pieces), whole, rtol=0, atol=1e-12)


def test_two_bodies_break_in_one_step(start_run):
    run = start_run(breaking_scene(plates=2))
    _, report = run.step(lambda states: balls_on_plates(states, 2))
    assert [(event.sequence, event.body_id) for event in report.events] == [(1, 1), (2, 2)]
    request, _ = run.step()
    assert request.states.fracture_sequence == 2
    new_ids = np.concatenate([event.new_fragment_ids for event in request.events])
    np.testing.assert_array_equal(np.sort(new_ids), np.arange(5, 5 + len(new_ids)))
    run.step()


def test_a_blow_below_the_strength_breaks_nothing(start_run):
    scene = breaking_scene()
    slow = scene.bodies[1]._replace(linear_velocity=np.array([0.0, 0.0, 1.0]))
    run = start_run(scene._replace(bodies=(scene.bodies[0], slow)))
    for _ in range(3):
        _, report = run.step(balls_on_plates)
        assert report.events == []


def test_the_pattern_depends_on_the_seed(start_run):
    events = []
    for seed in (None, 5, 6):
        run = start_run(breaking_scene(), seed=seed)
        events.append(run.step(balls_on_plates)[1].events[0])
    assert events[0].cut_planes.tobytes() == events[1].cut_planes.tobytes() != events[2].cut_planes.tobytes()


def test_a_body_joins_at_its_start_time(start_run):
    scene = breaking_scene()
    thrown = scene.bodies[1]._replace(start_time=2 * scene.time_step)
    run = start_run(scene._replace(bodies=(scene.bodies[0], thrown)))
    named = [run.step()[0].states.fragment_ids.tolist() for _ in range(4)]
    assert named == [[1], [1], [1, 2], [1, 2]]


PLATE = generators.plate(0.25, 0.008, 0.0125, 0.018, 2)
BRICK = generators.brick((0.2, 0.1, 0.06), 0.02)
MESHES = {"plate": PLATE, "brick": BRICK, "shell": generators.shell(0.1, 0.085, 0.02)}
CURVATURES = [0.0, 0.4]


def pieces_by_scipy(labels, edges, minimum_nodes):
    """The slow twin of connected_pieces."""
    inside = edges[labels[edges[:, 0]] == labels[edges[:, 1]]]
    graph = coo_array((np.ones(len(inside), dtype=np.int8), inside.T), shape=(len(labels), len(labels)))
    pieces = connected_components(graph, directed=False)[1]
    alone = set()
    while True:
        sizes = np.bincount(pieces)
        small = [i for i in np.argsort(sizes, kind="stable") if 0 < sizes[i] < minimum_nodes and i not in alone]
        if not small:
            break
        across = pieces[edges]
        across = across[(across == small[0]).any(axis=1) & (across[:, 0] != across[:, 1])]
        if not len(across):
            alone.add(small[0])
            continue
        neighbours = np.where(across[:, 0] == small[0], across[:, 1], across[:, 0])
        pieces[pieces == small[0]] = np.bincount(neighbours).argmax()
    first = np.sort(np.unique(pieces, return_index=True)[1])
    return np.argmax(pieces[:, None] == pieces[first], axis=1)


@pytest.mark.parametrize("minimum_nodes", [1, 4, 30])
@pytest.mark.parametrize("shape", MESHES)
def test_pieces_are_those_that_scipy_finds(shape, minimum_nodes):
    mesh, rng = MESHES[shape], np.random.default_rng(5)
    edges = unique_edges(mesh.tetrahedra).astype(np.int64)
    for seeds in (2, 9, 60):
        centers = mesh.vertices[rng.choice(len(mesh.vertices), seeds, replace=False)]
        distances = np.linalg.norm(mesh.vertices[:, None] - centers, axis=2)
        # some nodes get another seed, so that seeds have more than one piece
        labels = np.where(rng.random(len(distances)) < 0.05, rng.integers(seeds), distances.argmin(axis=1))
        pieces, count, cut = connected_pieces(labels, edges, minimum_nodes)
        expected = pieces_by_scipy(labels, edges, minimum_nodes)
        np.testing.assert_array_equal(pieces, expected)
        assert count == expected.max() + 1
        np.testing.assert_array_equal(cut, edges[expected[edges[:, 0]] != expected[edges[:, 1]]])


def break_once(mesh, seed, curvature=0.0, overload=4.0, **settings):
    body = BreakableBody(3, 5, mesh)
    pattern = PatternSettings(curvature=curvature, **settings)
    return body, body.fracture(5, 1, 100, mesh.vertices[7], overload, pattern, np.random.default_rng(seed))


def cuts_of(event):
    """Of each cut edge of a whole body's event: the two pieces beside it, in order, and its plane."""
    piece_of = np.zeros(len(event.nodes), int)
    piece_of[event.nodes] = event.node_fragments
    return np.sort(piece_of[event.cut_edges.reshape(-1, 2)], axis=1), event.cut_planes.reshape(-1, 4)


@pytest.mark.parametrize("curvature", CURVATURES)
@pytest.mark.parametrize("shape", MESHES)
def test_three_generations_of_events_keep_the_rules(shape, curvature):
    """The service checks them."""
    mesh = MESHES[shape]
    body, service = BreakableBody(3, 5, mesh), CollisionWorld(Settings(threads=1))
    of_node = np.full(len(mesh.vertices), 5)
    service.add_body(CollisionBody(3, 5, vertices=mesh.vertices, tetrahedra=mesh.tetrahedra))
    settings = PatternSettings(seeds=6, seeds_per_overload=3.0, curvature=curvature)
    next_id, living = 6, [5]
    for sequence in range(1, 6):
        victim = max(living, key=body.node_count)
        impact = mesh.vertices[np.flatnonzero(of_node == victim)[0]]
        event = body.fracture(victim, sequence, next_id, impact, 2.0, settings, np.random.default_rng([1, sequence]))
        service.add_fracture(event)
        of_node[event.nodes] = event.new_fragment_ids[event.node_fragments]
        living.remove(victim)
        living += event.new_fragment_ids.tolist()
        next_id += len(event.new_fragment_ids)
    assert len(living) > 12
    assert min(map(body.node_count, living)) >= settings.minimum_nodes


def test_flat_cracks_share_one_plane_bit_for_bit():
    between, planes = cuts_of(break_once(PLATE, 1, minimum_nodes=1)[1])
    pairs = np.unique(between, axis=0)
    for pair in pairs:
        those = planes[(between == pair).all(axis=1)]
        assert len(np.unique(np.vstack((those, -those)).round(12), axis=0)) == 2 * len(np.unique(those, axis=0))
    # A pair of pieces has one plane, unless separate pieces of one seed add their own.
    assert len(np.unique(planes, axis=0)) <= len(pairs) + 2


def test_curved_cracks_are_curved_and_smooth():
    between, planes = cuts_of(break_once(PLATE, 1, curvature=0.4)[1])
    pairs, sizes = np.unique(between, axis=0, return_counts=True)
    pair = pairs[sizes.argmax()]
    normals = planes[(between == pair).all(axis=1), :3]
    bend = normals @ normals.mean(axis=0) / np.linalg.norm(normals.mean(axis=0))
    assert bend.min() < 0.999
    assert np.median(bend) > 0.8


def test_bisectors_are_crossed_where_halvings_in_numpy_find_them():
    """To the last bit: the slow twin of the kernel."""
    random = np.random.default_rng(3)
    warp = draw_warp(random.uniform(-1.0, 1.0, (100, 3)), 12, 0.3, random)

    def image(points):
        return points + products(sine(products(points, warp.waves.T) + warp.phases), warp.amplitudes)

    start = random.uniform(-1.0, 1.0, (200, 3))
    way = random.uniform(-0.1, 0.1, start.shape)
    s, t = image(start - 0.5 * way), image(start + 1.8 * way)
    low, high = np.zeros(len(start)), np.ones(len(start))
    for _ in range(40):
        middle = 0.5 * (low + high)
        place = image(start + middle[:, None] * way)
        nearer_s = dots(place - s, place - s) <= dots(place - t, place - t)
        low, high = np.where(nearer_s, middle, low), np.where(nearer_s, high, middle)
    found = bisector_crossings(*(np.ascontiguousarray(rows.T) for rows in (start, way, s, t)), warp.each)
    assert np.array_equal(found, 0.5 * (low + high)) and np.array_equal(warp(start), image(start))
    assert np.ptp(found) > 0.1


def test_a_harder_blow_makes_more_pieces_and_equal_blows_equal_bytes():
    few, many = (len(break_once(PLATE, 3, overload=x)[1].new_fragment_ids) for x in (1.0, 3.0))
    assert few < many
    first, second = break_once(PLATE, 3, 0.3)[1], break_once(PLATE, 3, 0.3)[1]
    assert all(np.asarray(x).tobytes() == np.asarray(y).tobytes() for x, y in zip(first, second, strict=True))
    assert break_once(PLATE, 4, 0.3)[1].cut_planes.tobytes() != first.cut_planes.tobytes()


def test_a_body_too_small_for_two_pieces_does_not_break():
    assert break_once(generators.brick((0.1, 0.1, 0.1), 0.1), 1, minimum_nodes=5)[1] is None


def test_python_calls_do_not_grow_with_the_mesh():
    """So no loop in Python is over nodes or edges: the finer mesh has fourteen times as many nodes."""
    coarse, fine = (generators.plate(0.25, 0.008, edge_length, 0.018, 2) for edge_length in (0.025, 0.00625))
    assert len(fine.vertices) > 10 * len(coarse.vertices)
    for mesh in (coarse, fine):
        break_once(mesh, 1, 0.3)  # loads kernels
    few, many = (calls_of(lambda mesh=mesh: break_once(mesh, 1, 0.3)) for mesh in (coarse, fine))
    assert many < 1.5 * few


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("count", [1, 2, 3, 6])
def test_curved_cracks_divide_nodes_on_a_line(axis: int, count: int) -> None:
    """A piece may have its nodes on a line parallel to an axis, or one node; equal arguments give equal patterns."""
    points = np.zeros((count, 3))
    points[:, axis] = np.arange(count)
    edges = np.column_stack((np.arange(count - 1), np.arange(1, count)))
    settings = PatternSettings(curvature=0.25, minimum_nodes=1)
    for seed in range(20):
        twice = [
            voronoi_pattern(points, edges, points[0], 4, settings, np.random.default_rng(seed)) for _ in range(2)
        ]
        if twice[0] is None:
            assert twice[1] is None
            continue
        for one, other in zip(*twice, strict=True):
            assert np.array_equal(one, other)
        pattern = twice[0]
        assert np.isfinite(pattern.cut_planes).all()
        start, end = points[pattern.cut_edges[:, 0]], points[pattern.cut_edges[:, 1]]
        normals, offsets = pattern.cut_planes[:, :3], pattern.cut_planes[:, 3]
        assert ((start * normals).sum(axis=1) <= offsets).all() and ((end * normals).sum(axis=1) > offsets).all()
