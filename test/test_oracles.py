"""The oracles themselves: partition, closed surfaces, volumes, and independent cross-checks of all three."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from oracles.fracture_patterns import curved_event, voronoi_event
from oracles.fragmented_body import BARE_FACE, CRACK, ORIGINAL, STEP, FragmentedBody
from scipy.spatial import ConvexHull, HalfspaceIntersection, QhullError

from fracture_collision.geometry.generators import TetGeometry, ball, brick, plate
from fracture_collision.geometry.tetrahedra import tetrahedron_volumes

BODIES = {
    "ball": ball(0.05, 0.017),
    "brick": brick((0.2, 0.12, 0.08), 0.04),
    "plate": plate(0.2, 0.02, 0.045, 0.03),
}
EVENTS = {"flat": voronoi_event, "curved": curved_event}
every_case = pytest.mark.parametrize(("shape", "crack"), [(s, c) for s in BODIES for c in EVENTS])


@cache
def broken(shape: str, crack: str, generations: int = 2) -> FragmentedBody:
    """Three cells, then the largest fragment into two: many fragments share tetrahedra."""
    mesh = BODIES[shape]
    body = FragmentedBody(*mesh)
    rng = np.random.default_rng(11)
    for generation in range(generations):
        labels, counts = np.unique(body.labels, return_counts=True)
        largest = int(labels[np.argmax(counts)])
        nodes = mesh.vertices[body.labels == largest]
        seeds = rng.uniform(nodes.min(axis=0), nodes.max(axis=0), size=(3 if generation == 0 else 2, 3))
        body.apply(EVENTS[crack](body, largest, seeds, max(body.fragment_ids) + 1, generation + 1))
    assert len(body.fragment_ids) >= generations + 2
    return body


def points_inside(mesh: TetGeometry, n: int) -> np.ndarray:
    rng = np.random.default_rng(5)
    volumes = tetrahedron_volumes(*mesh)
    tets = rng.choice(len(volumes), n, p=volumes / volumes.sum())
    return np.einsum("ni,nij->nj", rng.dirichlet(np.ones(4), n), mesh.vertices[mesh.tetrahedra[tets]])


def cell_distance(cell, x: np.ndarray) -> float:
    """How far x is inside a convex cell [m], negative outside; faces without area have no say."""
    inward = []
    for face in cell.faces:
        edges = face.points[1:] - face.points[0]
        vector = np.cross(edges[:-1], edges[1:]).sum(axis=0)
        if np.linalg.norm(vector) > 1e-14:
            inward.append((face.points[0] - x) @ vector / np.linalg.norm(vector))
    return min(inward, default=-np.inf)


@every_case
def test_volumes_add_up(shape: str, crack: str) -> None:
    body = broken(shape, crack)
    whole = tetrahedron_volumes(*BODIES[shape]).sum()
    volumes = [body.volume(f) for f in body.fragment_ids]
    assert min(volumes) > 0.0
    assert sum(volumes) == pytest.approx(whole, rel=1e-12)


@every_case
def test_every_point_has_one_owner_and_lies_in_one_cell_of_it(shape: str, crack: str) -> None:
    body = broken(shape, crack)
    points = points_inside(BODIES[shape], 300)
    owners = body.owner(points)
    assert set(owners.tolist()) <= set(body.fragment_ids)
    tets = body.locate(points)
    for x, owner, t in zip(points, owners, tets, strict=True):
        inside = {f: max((cell_distance(c, x) for c in cells), default=-1.0) for f, cells in body.cells(int(t)).items()}
        assert inside[owner] >= -1e-15
        assert all(distance <= 1e-15 for f, distance in inside.items() if f != owner)
    far = np.array([[1.0, 0, 0], [0, 0, 0.3]])
    assert body.owner(far).tolist() == [0, 0]


@every_case
def test_surface_is_closed_and_encloses_the_volume(shape: str, crack: str) -> None:
    """Steps included: for inconsistent planes they are what closes the surface."""
    body = broken(shape, crack)
    for fragment in body.fragment_ids:
        triangles = body.surface_triangles(fragment)
        a, b, c = (triangles[:, i] for i in range(3))
        area = 0.5 * np.cross(b - a, c - a)
        assert np.abs(area.sum(axis=0)).max() < 1e-12 * np.abs(area).sum()
        assert np.einsum("ij,ij->", np.cross(a, b), c) / 6.0 == pytest.approx(body.volume(fragment), rel=1e-11)


def test_flat_cracks_have_no_steps_and_curved_ones_do() -> None:
    def area(body: FragmentedBody, kind: str) -> float:
        polygons = [p for f in body.fragment_ids for p in body.surface_polygons(f, (kind,))]
        corners = [(p.points[0], b, c) for p in polygons for b, c in zip(p.points[1:-1], p.points[2:], strict=True)]
        return float(sum(np.linalg.norm(np.cross(b - a, c - a)) / 2.0 for a, b, c in corners))

    two = FragmentedBody(*BODIES["ball"])
    two.apply(voronoi_event(two, 1, np.array([[0.01, 0.002, 0.003], [-0.012, 0.001, -0.004]]), 2))
    assert area(two, STEP) == 0.0 and area(two, BARE_FACE) == 0.0
    # one flat cut: the two crack faces are the disc of the plane in the body, seen twice
    normal = np.array([0.022, 0.001, 0.007]) / np.linalg.norm([0.022, 0.001, 0.007])
    plane_to_centre = abs(normal @ np.array([-0.001, 0.0015, -0.0005]))
    disc = np.pi * (0.05**2 - plane_to_centre**2)
    assert 0.85 * 2 * disc < area(two, CRACK) < 2 * disc
    curved = broken("ball", "curved")
    assert area(curved, STEP) > 0.0
    assert area(curved, ORIGINAL) == pytest.approx(area(two, ORIGINAL), rel=1e-12)


@every_case
def test_depth_against_many_samples_of_the_owner_function(shape: str, crack: str) -> None:
    """No point of another fragment is nearer than the depth, and just behind the nearest point there is one."""
    body = broken(shape, crack)
    points = points_inside(BODIES[shape], 12)
    owners = body.owner(points)
    rng = np.random.default_rng(3)
    directions = rng.normal(size=(60, 3))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    for x, f in zip(points, owners.tolist(), strict=True):
        depth, nearest = body.depth(f, x[None])
        assert depth[0] > 0.0
        around = x + directions * depth[0] * rng.uniform(0.0, 1.0 - 1e-9, size=(60, 1)) ** (1 / 3)
        assert np.all(body.owner(around) == f)
        spread = nearest[0] + directions * 1e-5 * np.ptp(body.vertices)
        assert np.any(body.owner(spread) != f)
        for other in set(body.fragment_ids) - {f}:
            assert body.depth(other, x[None])[0][0] == 0.0
            assert body.distance_outside(other, x[None])[0][0] >= depth[0] * (1.0 - 1e-12)


@pytest.mark.parametrize("shape", BODIES)
def test_flat_cracks_give_voronoi_cells(shape: str) -> None:
    """Against scipy's half-space intersection, wherever each cell that meets the tetrahedron has a node in it."""
    mesh = BODIES[shape]
    body = FragmentedBody(*mesh)
    rng = np.random.default_rng(2)
    seeds = rng.uniform(mesh.vertices.min(axis=0), mesh.vertices.max(axis=0), size=(5, 3))
    event = voronoi_event(body, 1, seeds, 2)
    body.apply(event)
    seed_of_node = np.argmin(np.linalg.norm(mesh.vertices[:, None] - seeds, axis=2), axis=1)
    points = points_inside(mesh, 1000)
    nearest = np.argmin(np.linalg.norm(points[:, None] - seeds, axis=2), axis=1)
    tets = body.locate(points)
    present = np.any(seed_of_node[mesh.tetrahedra[tets]] == nearest[:, None], axis=1)
    assert np.count_nonzero(present) > 900
    owners = body.owner(points)
    for i in np.flatnonzero(present):
        node_of_cell = np.flatnonzero(seed_of_node[mesh.tetrahedra[tets[i]]] == nearest[i])[0]
        assert owners[i] == body.labels[mesh.tetrahedra[tets[i], node_of_cell]]

    compared = 0
    for t, tet in enumerate(mesh.tetrahedra):
        cells_here = sorted(set(seed_of_node[tet].tolist()))
        if len(cells_here) == 1 or compared == 40:
            continue
        corners = mesh.vertices[tet]
        expected = {k: voronoi_cell_volume(corners, seeds, k) for k in range(len(seeds))}
        if any(expected[k] > 0.0 for k in expected if k not in cells_here):
            continue
        compared += 1
        for k in cells_here:
            label = int(body.labels[tet[seed_of_node[tet] == k][0]])
            volume = sum(_volume(cell) for cell in body.cells(t)[label])
            assert volume == pytest.approx(expected[k], abs=1e-9 * np.abs(np.linalg.det(corners[1:] - corners[0])))
    assert compared > 20


def _volume(cell) -> float:
    return ConvexHull(np.concatenate([f.points for f in cell.faces]), qhull_options="QJ").volume


def voronoi_cell_volume(corners: np.ndarray, seeds: np.ndarray, k: int) -> float:
    """Volume of a tetrahedron's part that is nearest to seed k, by linear programming and Qhull."""
    from scipy.optimize import linprog

    halfspaces = ConvexHull(corners).equations.tolist()
    for other in seeds[np.arange(len(seeds)) != k]:
        normal = (other - seeds[k]) / np.linalg.norm(other - seeds[k])
        halfspaces.append([*normal, -normal @ (0.5 * (other + seeds[k]))])
    halfspaces = np.array(halfspaces)
    size = np.ptp(corners, axis=0).max()
    # the deepest inner point, in units of the tetrahedron
    a, b = halfspaces[:, :3], -(halfspaces[:, 3] + halfspaces[:, :3] @ corners[0]) / size
    deepest = linprog([0, 0, 0, -1], np.column_stack((a, np.ones(len(a)))), b, bounds=[(None, None)] * 3 + [(None, 1)])
    if deepest.status != 0 or deepest.x[3] < 1e-6:
        return 0.0
    try:
        local = np.column_stack((a, -b))
        return ConvexHull(HalfspaceIntersection(local, deepest.x[:3]).intersections).volume * size**3
    except QhullError:
        return 0.0


def test_mass_properties_of_a_cut_brick() -> None:
    """A slab cut off by a plane x = const: closed form."""
    mesh = BODIES["brick"]
    body = FragmentedBody(*mesh)
    body.apply(voronoi_event(body, 1, np.array([[-0.07, 0.0, 0.0], [0.03, 0.0, 0.0]]), 2))
    assert body.fragment_ids == [2, 3]
    mass, centre, inertia = body.mass_properties(2, density=2500.0)
    a, b, c = 0.08, 0.12, 0.08  # the slab from x = -0.1 to -0.02
    assert mass == pytest.approx(2500.0 * a * b * c, rel=1e-12)
    assert centre == pytest.approx([-0.06, 0.0, 0.0], abs=1e-15)
    expected = mass / 12.0 * np.diag([b * b + c * c, a * a + c * c, a * a + b * b])
    assert inertia == pytest.approx(expected, rel=1e-12, abs=1e-15)


@every_case
def test_mass_properties_add_up(shape: str, crack: str) -> None:
    body, whole = broken(shape, crack), FragmentedBody(*BODIES[shape])
    mass, centre, inertia = whole.mass_properties(1)
    parts = [body.mass_properties(f) for f in body.fragment_ids]
    assert sum(m * x for m, x, _ in parts) / mass == pytest.approx(centre, abs=1e-14)
    arms = [x - centre for _, x, _ in parts]
    moved = sum(i + m * (r @ r * np.eye(3) - np.outer(r, r)) for (m, _, i), r in zip(parts, arms, strict=True))
    assert moved == pytest.approx(inertia, rel=1e-11, abs=1e-12 * inertia.max())


@every_case
def test_events_keep_the_rules_of_the_message(shape: str, crack: str) -> None:
    body = FragmentedBody(*BODIES[shape])
    rng = np.random.default_rng(8)
    low, high = body.vertices.min(axis=0), body.vertices.max(axis=0)
    event = EVENTS[crack](body, 1, rng.uniform(low, high, size=(4, 3)), 2)
    cut, planes = event.cut_edges.reshape(-1, 2), event.cut_planes.reshape(-1, 4)
    assert np.allclose(np.linalg.norm(planes[:, :3], axis=1), 1.0, atol=1e-14)
    first = np.einsum("ij,ij->i", body.vertices[cut[:, 0]], planes[:, :3]) - planes[:, 3]
    second = np.einsum("ij,ij->i", body.vertices[cut[:, 1]], planes[:, :3]) - planes[:, 3]
    assert np.all(first < 0.0) and np.all(second > 0.0)
    assert sorted(event.nodes.tolist()) == list(range(len(body.vertices)))
    assert set(event.node_fragments.tolist()) == set(range(len(event.new_fragment_ids)))
    again = EVENTS[crack](body, 1, np.random.default_rng(8).uniform(low, high, size=(4, 3)), 2)
    assert again.cut_planes.tobytes() == event.cut_planes.tobytes()
    body.apply(event)
    with pytest.raises(ValueError, match="not those of fragment"):
        body.apply(event)
