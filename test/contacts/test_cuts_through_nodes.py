"""Cracks through nodes, edges and faces of the mesh: no fragment in place has a contact within another one.

Such cracks leave fragments parts without volume, whose planes are borders of nothing. Lengths in units of R = 1 m.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import islice, permutations, product

import numpy as np
import pytest
from worlds.fractured_worlds import samples_of
from worlds.hard_worlds import UPRIGHT, sized, tetrahedral_body
from worlds.sampled_worlds import SampledWorld

from fracture_collision.core.bodies.body_validator import validate_body
from fracture_collision.core.field.crack_normal import FARTHER
from fracture_collision.core.field.elementary_queries import INSIDE, probe
from fracture_collision.core.patches.pair_contacts import MOVED
from fracture_collision.core.search.scratch import make_scratch
from fracture_collision.fracture import planes
from fracture_collision.geometry.generators import TetGeometry, ball, brick
from fracture_collision.records import FragmentStates
from fracture_collision.world import CollisionWorld, Settings

Cut = tuple[TetGeometry, list[np.ndarray], list[float]]  # a body, normals and offsets of planes

DEEP = 1e-9
MESHES = [sized(brick(size, edge)) for size, edge in (((1, 1, 1), 1), ((1, 1, 1), 0.5), ((2, 1, 1), 0.5))]
BALL = sized(ball(0.5, 0.3))
DIRECTIONS = [np.array(d, float) for d in product((-1, 0, 1), repeat=3) if any(d)]
# Two planes that leave two fragments a part without volume along an edge, deep inside a third fragment.
NEEDLE = (
    ball(0.5, 0.3),
    [np.array([0.6881909602355868, -0.42532540417601994, -0.5877852522924731]),
     np.array([-0.6974565623330552, 0.6974565623330552, 0.16464716006392027])],
    [-2.1425592375830868e-17, -0.3487282811665276],
)  # fmt: skip


def lattice_cuts() -> Iterator[Cut]:
    """Every two planes through the middles of three bricks, along their mesh."""
    for mesh in MESHES:
        for two in permutations(DIRECTIONS, 2):
            yield mesh, list(two), [0.0, 0.0]


def random_cuts(seed: int) -> Iterator[Cut]:
    """One to three planes, each through three random nodes."""
    random = np.random.default_rng(seed)
    while True:
        for mesh in (*MESHES, BALL):
            normals, offsets = [], []
            for _ in range(random.integers(1, 4)):
                p, q, r = mesh.vertices[random.choice(len(mesh.vertices), 3, replace=False)]
                normal = np.cross(q - p, r - p)
                if np.linalg.norm(normal) > 1e-9:
                    normals.append(normal / np.linalg.norm(normal))
                    offsets.append(float(normals[-1] @ p))
            if normals:
                yield mesh, normals, offsets


def world_of(
    cut: Cut, kind: type[CollisionWorld] = CollisionWorld, **settings: int
) -> tuple[CollisionWorld, np.ndarray] | None:
    """The world after the fracture, and the ids of its fragments; None: no plane separates nodes."""
    mesh, normals, offsets = cut
    world, body = kind(Settings(threads=1, **settings)), tetrahedral_body(mesh)
    try:
        event = planes(body, normals, offsets)
    except ValueError:
        return None
    world.add_body(body)
    world.add_fracture(event)
    ids = np.sort(event.new_fragment_ids)
    world.contacts(states(ids))
    return world, ids


def states(ids: np.ndarray, places: np.ndarray | float = 0.0) -> FragmentStates:
    return FragmentStates(1, 1, ids, (np.zeros((len(ids), 3)) + places).ravel(), np.tile(UPRIGHT, len(ids)))


def check(cuts: Iterator[Cut], kind: type[CollisionWorld] = CollisionWorld) -> int:
    """In place, no contact is deeper than DEEP; all stored data agree. Returns the number of worlds."""
    worlds = 0
    for cut in cuts:
        made = world_of(cut, kind)
        if made is None:
            continue
        world, ids = made
        answer = world.contacts(states(ids))
        assert answer.gaps.min(initial=0.0) >= -DEEP, (answer.gaps.min(), cut[1:])
        assert answer.missed_depth_bound.max(initial=0.0) <= DEEP, cut[1:]
        geometry = world._registry.geometry
        validate_body(geometry, [world._registry.row_of(int(i)) for i in ids])
        worlds += 1
    return worlds


def deepest_sample(world: CollisionWorld, ids: np.ndarray) -> float:
    """Largest depth [m] of a sample in place within another fragment, by its exact field alone."""
    geometry = world._registry.geometry
    rows = [world._registry.row_of(int(i)) for i in ids]
    scratch, deepest = make_scratch(len(geometry.pools.mesh.tetrahedra), 1), 0.0
    for own, other in permutations(rows, 2):
        for x, y, z in samples_of(geometry, own)[0].tolist():
            answer = probe(geometry.pools, other, (x, y, z), 0.0, math.inf, scratch)
            if answer[0] == INSIDE:
                deepest = max(deepest, -answer[1])
    return deepest


def test_two_diagonal_planes_through_the_nodes_of_a_cube() -> None:
    """A point of a tie belonged to a fragment whose part has no volume: a contact of 0.7 m, with a bound of 5e-13."""
    cut = sized(brick((1, 1, 1), 1)), [np.array([0.0, 1, -1]), np.array([-1.0, -1, 0])], [0.0, 0.0]
    assert check(iter([cut])) == 1
    made = world_of(cut)
    assert made and deepest_sample(*made) <= DEEP


@pytest.mark.parametrize("kind", [CollisionWorld, pytest.param(SampledWorld, marks=pytest.mark.slow)])
def test_fragments_of_cuts_through_nodes_do_not_penetrate_in_place(kind: type[CollisionWorld]) -> None:
    assert check(islice(lattice_cuts(), 0, None, 13), kind) > 100
    assert check(islice(random_cuts(1), 100), kind) > 60


@pytest.mark.slow
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("kind", [CollisionWorld, SampledWorld])
def test_fragments_of_thousands_of_cuts_do_not_penetrate_in_place(kind: type[CollisionWorld]) -> None:
    assert check(lattice_cuts(), kind) > 1900
    assert check(islice(random_cuts(2), 4000), kind) > 3000


@pytest.mark.parametrize("kind", [CollisionWorld, SampledWorld])
@pytest.mark.parametrize("step", [0.0, 1e-6, 1e-4, 1e-2])
def test_no_contact_is_deeper_than_the_two_have_moved(step: float, kind: type[CollisionWorld]) -> None:
    """Also a sample on a part without volume: the other's field alone would make it 0.11 m deep in place."""
    made = world_of(NEEDLE, kind, contacts_per_pair=10_000)
    assert made is not None
    world, ids = made
    assert deepest_sample(world, ids) > 0.1
    for seed in range(5):
        places = step * np.random.default_rng(seed).normal(size=(len(ids), 3))
        answer = world.contacts(states(ids, places))
        of_pair = np.repeat(np.arange(len(answer.fragment_a)), np.diff(answer.pair_begin))
        where = [np.searchsorted(ids, side)[of_pair] for side in (answer.fragment_a, answer.fragment_b)]
        moved = np.linalg.norm(places[where[0]] - places[where[1]], axis=1)
        # along a normal that is turned to the crack, or that of a patch, somewhat more
        assert (-answer.gaps <= MOVED * moved + FARTHER).all()
