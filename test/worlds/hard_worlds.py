"""Worlds for the hard cases, cracks with arbitrary labels and planes, and the invariants of each."""

from __future__ import annotations

from collections.abc import Callable, Iterable

import numpy as np
from oracles.brute_force import distances
from oracles.fracture_patterns import CrackPlane, event_of_labels
from oracles.fragmented_body import FragmentedBody, uniform_points
from test_exact_field import assert_equal, compare
from test_fragment_bounds import assert_kept, check_fragments
from truth.contact_truth import FRAMES, ContactTruth, assert_true, check_all_pairs, surface_samples

from fracture_collision.core.field.elementary_queries import inside_tetrahedron
from fracture_collision.geometry.generators import TetGeometry, brick
from fracture_collision.geometry.tetrahedra import tetrahedron_volumes
from fracture_collision.records import BOX, CollisionBody, FractureEvent, FragmentStates, SolidPrimitive
from fracture_collision.world import CollisionWorld, Settings
from worlds.fractured_worlds import DENSITY, SETTINGS, FracturedWorld
from worlds.rigid_shapes import boundary_of

EventMaker = Callable[[FragmentedBody, int, int], FractureEvent]  # the body, first new fragment id, sequence

# Half the longest side, R, is 1 m unless stated otherwise.
ROUNDING = 1e-12
EVERY_CONTACT = SETTINGS._replace(contacts_per_pair=100_000)
UPRIGHT = np.array([0.0, 0.0, 0.0, 1.0])
BRICK = brick((2.0, 1.0, 1.0), 0.25)


def sized(body: TetGeometry) -> TetGeometry:
    """The same body with R = 1 m."""
    return body._replace(vertices=body.vertices / (0.5 * np.ptp(body.vertices, axis=0).max()))


def tetrahedral_body(body: TetGeometry, number: int = 1, **fields) -> CollisionBody:
    return CollisionBody(
        number, number, vertices=body.vertices.ravel(), tetrahedra=body.tetrahedra.ravel(), density=DENSITY
    )._replace(**fields)


def broken_world(
    body: TetGeometry,
    makers: Iterable[EventMaker],
    settings: Settings = SETTINGS,
    kind: type[CollisionWorld] = CollisionWorld,
) -> FracturedWorld:
    """The service's world and the slow oracle after the events of `makers`, in turn."""
    world, oracle = kind(settings), FragmentedBody(body.vertices, body.tetrahedra)
    message = tetrahedral_body(body)
    world.add_body(message)
    events: list[FractureEvent] = []
    for make in makers:
        event = make(oracle, max(oracle.fragment_ids) + 1, len(events) + 1)
        oracle.apply(event)
        world.add_fracture(event)
        events.append(event)
    made = FracturedWorld(world, oracle, len(events), False, ([message], events))
    world.contacts(made.states())
    return made


def by_labels(labels: np.ndarray, plane: CrackPlane) -> EventMaker:
    """Break the whole body where the `labels` (n,) of its mesh nodes change."""

    def make(body: FragmentedBody, first_new_id: int, sequence: int) -> FractureEvent:
        return event_of_labels(body, 1, np.asarray(labels), plane, first_new_id, sequence, 1)

    return make


def common_plane(normal: np.ndarray, offset: float) -> CrackPlane:
    """All edges between label 0 and label 1 carry this plane, with its normal towards 1."""

    def plane(_a: int, _b: int, i: int, j: int) -> tuple[np.ndarray, float]:
        return (normal, offset) if i < j else (-normal, -offset)

    return plane


def lattice_planes(vertices: np.ndarray, seed: int) -> CrackPlane:
    """Each cut edge of a structured brick has a plane across an axis, through its middle or one of its ends."""
    random = np.random.default_rng(seed)

    def plane(a: int, b: int, _i: int, _j: int) -> tuple[np.ndarray, float]:
        along = vertices[b] - vertices[a]
        axis = int(random.choice(np.flatnonzero(along)))
        normal = np.zeros(3)
        normal[axis] = np.sign(along[axis])
        return normal, float(normal @ (vertices[a] + random.choice((0.0, 0.5, 1.0)) * along))

    return plane


def anywhere(case: FracturedWorld, count: int, seed: int) -> np.ndarray:
    """Points (count, 3) [m] distributed uniformly over the body."""
    return uniform_points(case.oracle.vertices, case.oracle.tetrahedra, count, np.random.default_rng(seed))


def fragments_with(case: FracturedWorld, points: np.ndarray) -> np.ndarray:
    """The service's inside test of each point (n, 3) in each fragment, by ascending id: (n, fragments) bool."""
    pools = case.geometry.pools
    rows = [case.row(f) for f in case.oracle.fragment_ids]
    return np.array([[inside_tetrahedron(pools, row, *x) >= 0 for row in rows] for x in points.tolist()])


def assert_partition(case: FracturedWorld, points: int = 500) -> None:
    """Volumes equal the oracle's and add up to the body's; each point of the body is in exactly one fragment."""
    whole = tetrahedron_volumes(case.oracle.vertices, case.oracle.tetrahedra).sum()
    mine = case.world.fragments().masses / DENSITY
    theirs = np.array([case.oracle.volume(f) for f in case.oracle.fragment_ids])
    assert abs(mine.sum() - whole) <= ROUNDING * whole
    assert abs(theirs.sum() - whole) <= ROUNDING * whole
    assert np.abs(mine - theirs).max() <= ROUNDING * whole
    spread = anywhere(case, points, seed=5)
    owner = case.oracle.owner(spread)
    inside = fragments_with(case, spread)
    assert np.array_equal(inside.sum(axis=1), np.ones(points, dtype=int))
    assert np.array_equal(np.array(case.oracle.fragment_ids)[inside.argmax(axis=1)], owner)


def assert_geometry(case: FracturedWorld, points: int = 1000, snug: bool = True) -> None:
    """A partition; depths equal brute force's to 1e-9 R; the guarantees of samples, boxes and grids hold.

    snug: all planes agree, so that no fragment in place has a sample inside another.
    """
    assert_partition(case)
    assert_equal(compare(case, points, seed=1))
    checks = check_fragments(case, seed=1)
    assert_kept(checks)
    if snug:
        assert max(check.samples_astray for check in checks) <= ROUNDING


def assert_contacts(
    case: FracturedWorld, frames: Iterable[str | FragmentStates] = ("touching", "jittered", "deep")
) -> int:
    """Contacts are true in each frame, none is missed, all numbers are finite; returns the number of contacts."""
    truth, found = ContactTruth(case), 0
    for frame in frames:
        states = FRAMES[frame](truth, 1) if isinstance(frame, str) else frame
        checks = check_all_pairs(truth, states)
        assert_true(checks, case.world.settings.penetration_tolerance)
        found += sum(check.contacts for check in checks)
    return found


def samples_within(case: FracturedWorld, own: int, other: int, distance: float) -> np.ndarray:
    """Of the samples (n, 3) of fragment `own` in place, those no farther than `distance` [m] from `other`'s surface."""
    samples, _ = surface_samples(case, own)
    return samples[distances(samples, case.oracle.surface_triangles(other)) <= distance]


def block(kind: str, number: int, size: tuple[float, float, float], edge: float = 0.25) -> CollisionBody:
    """A block of edges `size` [m] as "tetrahedra", "triangles" or "box", with nodes in the same places."""
    if kind == "box":
        return CollisionBody(number, number, primitive=SolidPrimitive(BOX, size), density=DENSITY)
    mesh = brick(size, edge)
    if kind == "tetrahedra":
        return tetrahedral_body(mesh, number)
    vertices, triangles = boundary_of(mesh)
    return CollisionBody(number, number, vertices=vertices.ravel(), triangles=triangles.ravel(), density=DENSITY)
