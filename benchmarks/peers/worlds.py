"""The work: a body of 5,200 nodes broken once, its fragments' surfaces, and the poses at which they are queried.

The reference sphere of Glondu et al. 2014, section 7.2, and a hollow one, broken by Voronoi seeds clustered around an
impact. R is 1 m, so lengths in metres are in units of R. Nothing here is timed, and nothing is stored on disk.
"""

from __future__ import annotations

import re
import sys
from importlib.util import find_spec
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pybullet
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from benchmarks.peers.judging.cracked_surface import cracked_surfaces
from fracture_collision.geometry.generators import TetGeometry
from fracture_collision.geometry.sampled_bodies import sampled_ball, sampled_shell
from fracture_collision.records import CollisionBody, FractureEvent, FragmentStates
from fracture_collision.world import CollisionWorld, Settings

sys.path.append(str(Path(__file__).resolve().parents[2] / "test"))  # the fracture patterns live with the tests

from oracles.fracture_patterns import curved_event, voronoi_event  # noqa: E402
from oracles.fragmented_body import FragmentedBody  # noqa: E402
from truth.contact_truth import surface_samples  # noqa: E402
from worlds.fractured_worlds import FracturedWorld  # noqa: E402

WORLDS = ("ball8", "ball20", "ball60", "shell20", "ball20w", "shell20w", "ball8w")
SHELL_INNER = 0.85
DENSITY = 2500.0  # [kg/m3]
BODY_ID, WHOLE = 1, 1
# Source of the meshes for other libraries: planar_cells, or cracked_surface, if cracks are curved (or manifold3d is
# not installed).
PLANES, EDGES = "planes", "cut edges"
IMPACT = np.array([0.3, 0.2, 0.93])  # the direction it came from
DRAWS = 20  # of seeds
REACH = 0.6  # [R] seed density falls by a factor e at this distance from the impact
# Of the body's longest side: hulls then hold about half as much again as fragments, as in the curved worlds
# that these are compared with.
AMPLITUDE = 0.08
JITTERS, JITTER_SHIFT, JITTER_TURN = 5, 0.01, np.deg2rad(1.0)
PILE_STEPS = (120, 240, 360)  # of 1/240 s
PILE_MARGIN = 0.002  # [R] by which Bullet keeps hulls apart; its default, 0.04, would leave hardly a pair in contact
PILE_SHIFT = 0.01  # Bullet leaves shapes a margin apart, or overlapping; shifts up to this along each axis undo that


class Surface(NamedTuple):
    """A closed surface."""

    vertices: np.ndarray  # (n, 3) [m]
    triangles: np.ndarray  # (t, 3) int64, counter-clockwise from outside


class Fragment(NamedTuple):
    """All but the centre itself is relative to the centre, in the body's axes."""

    fragment_id: int
    centre: np.ndarray  # (3,) [m] in the body's frame: centre of its box
    exact: Surface  # of the service's region, as published
    samples: np.ndarray  # (s, 3) [m] points on it that the service can turn into contacts
    mesh: Surface  # input of other libraries: a closed mesh made by World.mesher
    nodes: np.ndarray  # (k, 3) [m] the tetrahedral mesh's nodes in it


class Frame(NamedTuple):
    """The fragments' poses, in every form that a method may need."""

    kind: str  # touch, jitter or pile
    positions: np.ndarray  # (n, 3) [m] of the centres
    rotations: np.ndarray  # (n, 3, 3)
    quaternions: np.ndarray  # (n, 4) x y z w
    body_positions: np.ndarray  # (n, 3) [m] of the body's origin, for the same pose


class World(NamedTuple):
    name: str
    is_curved: bool
    mesher: str  # PLANES or EDGES
    body: CollisionBody
    event: FractureEvent
    fragments: list[Fragment]
    frames: list[Frame]


def make_world(name: str, mesher: str | None = None) -> World:
    """One of WORLDS, or another that follows the pattern: ball or shell, number of seeds, w for curved cracks.

    mesher: for flat cracks, PLANES or EDGES; None: flat_mesher().
    """
    kind, count, curved = re.fullmatch(r"(ball|shell)(\d+)(w?)", name).groups()
    inner = SHELL_INNER if kind == "shell" else 0.0
    geometry = sampled_shell(1.0, inner, 10, 7, 4000) if inner else sampled_ball(1.0, 11, 4000)
    for seed in range(1, DRAWS):
        seeds = clustered_seeds(geometry.vertices, inner, int(count), seed)
        world = break_body(name, geometry, seeds, bool(curved), EDGES if curved else mesher or flat_mesher())
        if curved or len(world.fragments) == len(seeds):  # cells in several pieces would not be the same work for all
            return world
    raise ValueError(f"{name}: no draw of seeds in {DRAWS} leaves every cell in one piece")


def flat_mesher() -> str:
    return PLANES if find_spec("manifold3d") else EDGES


def clustered_seeds(vertices: np.ndarray, inner: float, count: int, seed: int = 1) -> np.ndarray:
    """Points (count, 3) [m] in the unit ball, farther than `inner` from its centre, dense near the impact."""
    random = np.random.default_rng(seed)
    points = random.uniform(-1.0, 1.0, (60_000, 3))
    distance = np.linalg.norm(points, axis=1)
    points = points[(distance < 1.0) & (distance > inner)]
    impact = vertices[np.argmax(vertices @ IMPACT)]
    weight = np.exp(-np.linalg.norm(points - impact, axis=1) / REACH)
    return points[random.choice(len(points), count, replace=False, p=weight / weight.sum())]


def break_body(name: str, geometry: TetGeometry, seeds: np.ndarray, curved: bool, mesher: str) -> World:
    """Breaks a body into the cells of `seeds` (k, 3) [m] and places the pieces."""
    vertices, tetrahedra = geometry
    body = CollisionBody(BODY_ID, WHOLE, vertices=vertices, tetrahedra=tetrahedra, density=DENSITY)
    oracle = FragmentedBody(vertices, tetrahedra, WHOLE)
    if curved:
        event = curved_event(oracle, WHOLE, seeds, WHOLE + 1, amplitude=AMPLITUDE)
    else:
        event = voronoi_event(oracle, WHOLE, seeds, WHOLE + 1)
    oracle.apply(event)
    service = CollisionWorld(Settings(threads=1))
    service.add_body(body)
    service.add_fracture(event)
    service.contacts(empty_states(1))
    case = FracturedWorld(service, oracle, 1, curved, ([body], [event]))
    meshes = _meshes(geometry, oracle.labels, seeds, event, mesher)
    fragments = [_fragment(case, fragment_id, meshes[fragment_id]) for fragment_id in event.new_fragment_ids.tolist()]
    return World(name, curved, mesher, body, event, fragments, make_frames(fragments))


def empty_states(sequence: int) -> FragmentStates:
    """States without fragments: querying them brings a CollisionWorld to its `sequence`-th event."""
    return FragmentStates(1, sequence, np.zeros(0, int), np.zeros(0), np.zeros(0))


def _meshes(
    geometry: TetGeometry, labels: np.ndarray, seeds: np.ndarray, event: FractureEvent, mesher: str
) -> dict[int, tuple[np.ndarray, np.ndarray]]:
    if mesher == EDGES:
        return cracked_surfaces(*geometry, labels, _crossings(geometry.vertices, event))
    from benchmarks.peers.judging.planar_cells import planar_cells  # manifold3d is optional

    cells = planar_cells(*geometry, seeds)
    first_node = {f: geometry.vertices[np.argmax(labels == f)] for f in event.new_fragment_ids.tolist()}
    return {f: cells[np.argmin(np.linalg.norm(seeds - node, axis=1))] for f, node in first_node.items()}


def _fragment(case: FracturedWorld, fragment_id: int, mesh: tuple[np.ndarray, np.ndarray]) -> Fragment:
    exact = published_surface(case.world, fragment_id)
    centre = 0.5 * (mesh[0].min(axis=0) + mesh[0].max(axis=0))
    return Fragment(
        fragment_id, centre, Surface(exact.vertices - centre, exact.triangles),
        surface_samples(case, fragment_id)[0] - centre, Surface(mesh[0] - centre, mesh[1]),
        case.oracle.vertices[case.oracle.labels == fragment_id] - centre,
    )  # fmt: skip


def published_surface(service: CollisionWorld, fragment_id: int) -> Surface:
    """The surface that viewers get, less triangles whose corners coincide in single precision.

    It differs from the fragment by up to fragment_mesh.THIN of its size.
    """
    published = service.fragment_mesh(fragment_id)
    triangles = published.triangles.reshape(-1, 3).astype(np.int64)
    a, b, c = triangles.T
    return Surface(published.vertices.reshape(-1, 3).astype(np.float64), triangles[(a != b) & (b != c) & (c != a)])


def _crossings(vertices: np.ndarray, event: FractureEvent) -> dict[tuple[int, int], np.ndarray]:
    edges = event.cut_edges.reshape(-1, 2).astype(np.int64)
    normals, offsets = event.cut_planes.reshape(-1, 4)[:, :3], event.cut_planes.reshape(-1, 4)[:, 3]
    start, along = vertices[edges[:, 0]], vertices[edges[:, 1]] - vertices[edges[:, 0]]
    share = (offsets - np.sum(normals * start, axis=1)) / np.sum(normals * along, axis=1)
    points = start + share[:, None] * along
    return {(min(e), max(e)): x for e, x in zip(edges.tolist(), points, strict=True)}


def volume(surface: Surface) -> float:
    """The volume [m3]."""
    a, b, c = (surface.vertices[surface.triangles[:, i]] for i in range(3))
    return float(np.sum(a * np.cross(b, c)) / 6.0)


def hull_points(surface: Surface) -> np.ndarray:
    return surface.vertices[ConvexHull(surface.vertices).vertices]


def make_frames(fragments: list[Fragment], seed: int = 2) -> list[Frame]:
    """All in place; five times moved and turned slightly; three moments of a heap in a box."""
    random = np.random.default_rng(seed)
    centres = np.array([f.centre for f in fragments])
    unturned = Rotation.from_quat(np.tile([0.0, 0.0, 0.0, 1.0], (len(fragments), 1)))
    frames = [_frame("touch", centres, unturned, centres)]
    for _ in range(JITTERS):
        shift = _directions(random, len(fragments)) * random.uniform(0.0, JITTER_SHIFT, (len(fragments), 1))
        turn = _directions(random, len(fragments)) * random.uniform(0.0, JITTER_TURN, (len(fragments), 1))
        frames.append(_frame("jitter", centres + shift, Rotation.from_rotvec(turn), centres))
    for positions, rotations in _piled(fragments):
        shift = random.uniform(-PILE_SHIFT, PILE_SHIFT, positions.shape)
        frames.append(_frame("pile", positions + shift, rotations, centres))
    return frames


def _frame(kind: str, positions: np.ndarray, rotations: Rotation, centres: np.ndarray) -> Frame:
    return Frame(
        kind, positions, rotations.as_matrix(), rotations.as_quat(), positions - rotations.apply(centres)
    )  # fmt: skip


def _directions(random: np.random.Generator, count: int) -> np.ndarray:
    directions = random.normal(size=(count, 3))
    return directions / np.linalg.norm(directions, axis=1)[:, None]


def _piled(fragments: list[Fragment]) -> list[tuple[np.ndarray, Rotation]]:
    """Hulls dropped into a box by Bullet, at PILE_STEPS."""
    client = pybullet.connect(pybullet.DIRECT)
    pybullet.setGravity(0.0, 0.0, -9.81, physicsClientId=client)

    def wall(half: list[float], position: list[float]) -> None:
        shape = pybullet.createCollisionShape(pybullet.GEOM_BOX, halfExtents=half, physicsClientId=client)
        pybullet.createMultiBody(0.0, shape, basePosition=position, physicsClientId=client)

    wall([3.0, 3.0, 0.1], [0.0, 0.0, -1.3])
    for side in (-1.4, 1.4):
        wall([0.1, 3.0, 6.0], [side, 0.0, 0.0])
        wall([3.0, 0.1, 6.0], [0.0, side, 0.0])
    bodies = []
    for fragment in fragments:
        points = hull_points(fragment.mesh).tolist()
        shape = pybullet.createCollisionShape(pybullet.GEOM_MESH, vertices=points, physicsClientId=client)
        start = (1.25 * fragment.centre).tolist()
        mass = DENSITY * volume(fragment.mesh)
        body = pybullet.createMultiBody(mass, shape, basePosition=start, physicsClientId=client)
        pybullet.changeDynamics(body, -1, collisionMargin=PILE_MARGIN, physicsClientId=client)
        bodies.append(body)
    piles = []
    for step in range(1, max(PILE_STEPS) + 1):
        pybullet.stepSimulation(physicsClientId=client)
        if step in PILE_STEPS:
            poses = [pybullet.getBasePositionAndOrientation(b, physicsClientId=client) for b in bodies]
            piles.append((np.array([p for p, _ in poses]), Rotation.from_quat([q for _, q in poses])))
    pybullet.disconnect(physicsClientId=client)
    return piles
