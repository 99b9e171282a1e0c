"""Fractured bodies for tests: the service's world and the slow oracle, given the same events."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import NamedTuple, TypeVar

import numpy as np
from oracles.fracture_patterns import curved_event, voronoi_event
from oracles.fragmented_body import FragmentedBody

from fracture_collision.core.bodies.collision_geometry import CollisionGeometry
from fracture_collision.core.glondu2014.sphere_tree import SphereTree
from fracture_collision.geometry.generators import TetGeometry
from fracture_collision.records import CollisionBody, FractureEvent, FragmentStates
from fracture_collision.world import CollisionWorld, PaperSettings, Settings

DENSITY = 2500.0
# The paper's method with exact depths: contacts at samples along the shortest way out, as the oracles have them.
SETTINGS = Settings(threads=1, method="glondu2014", paper=PaperSettings(field="exact"))


AnyWorld = TypeVar("AnyWorld", bound=CollisionWorld)


def samples_of(geometry: CollisionGeometry, row: int) -> tuple[np.ndarray, np.ndarray]:
    """Points (n, 3) [m, body frame] and numbers (n,) of a fragment's samples, by its row."""
    fragment, samples = geometry.pools.fragment, geometry.pools.samples
    own = slice(fragment.sample_begin[row], fragment.sample_end[row])
    return samples.points[own], samples.numbers[own]


def tree_of(geometry: CollisionGeometry, row: int) -> SphereTree:
    """A fragment's sphere tree, in a world of the paper's method."""
    assert geometry.paper is not None
    return geometry.paper.sphere_tree(row)


class FracturedWorld(NamedTuple):
    world: CollisionWorld
    oracle: FragmentedBody
    generations: int
    curved: bool
    messages: tuple[list[CollisionBody], list[FractureEvent]]  # what built the world

    def states(self, jitter: float = 0.0, seed: int = 0, step: int = 1) -> FragmentStates:
        """All fragments in place, moved by up to about `jitter` [m] and rotated by as much over the body's size."""
        ids = np.array(self.oracle.fragment_ids)
        random = np.random.default_rng(seed)
        positions = random.uniform(-jitter, jitter, (len(ids), 3))
        half = 0.5 * np.ptp(self.oracle.vertices, axis=0).max()
        turns = random.uniform(-jitter / half, jitter / half, (len(ids), 3)) / 2
        quaternions = np.column_stack([turns, np.ones(len(ids))])
        quaternions /= np.linalg.norm(quaternions, axis=1)[:, None]
        return FragmentStates(step, self.generations, ids, positions.ravel(), quaternions.ravel())

    def row(self, fragment_id: int) -> int:
        return self.world._registry.row_of(fragment_id)

    @property
    def geometry(self):
        return self.world._registry.geometry


def fractured_world(
    body: TetGeometry,
    seeds: int,
    generations: int = 1,
    curved: bool = False,
    settings: Settings = SETTINGS,
    seed: int = 3,
    make: Callable[..., FractureEvent] | None = None,
) -> FracturedWorld:
    """Break a body, then the largest fragment again, and so on, by `make`, else as `curved` says."""
    random = np.random.default_rng(seed)
    world, oracle = CollisionWorld(settings), FragmentedBody(body.vertices, body.tetrahedra)
    bodies = [CollisionBody(1, 1, vertices=body.vertices.ravel(), tetrahedra=body.tetrahedra.ravel(), density=DENSITY)]
    events: list[FractureEvent] = []
    world.add_body(bodies[0])
    make = make or (curved_event if curved else voronoi_event)
    next_id, victim = 2, 1
    for generation in range(generations):
        inside = body.vertices[oracle.labels == victim]
        low, high = inside.min(axis=0), inside.max(axis=0)
        event = make(oracle, victim, random.uniform(low, high, (seeds, 3)), next_id, generation + 1)
        oracle.apply(event)
        world.add_fracture(event)
        events.append(event)
        next_id += len(event.new_fragment_ids)
        ids, counts = np.unique(oracle.labels, return_counts=True)
        victim = int(ids[np.argmax(counts)])
    made = FracturedWorld(world, oracle, generations, curved, (bodies, events))
    world.contacts(made.states())
    return made


def after_each_fracture(case: FracturedWorld) -> Iterator[FracturedWorld]:
    """The same world after its first, second ... fracture; each is valid until the next is requested."""
    oracle = FragmentedBody(case.oracle.vertices, case.oracle.tetrahedra)
    for event in case.messages[1]:
        oracle.apply(event)
        stage = case._replace(oracle=oracle, generations=int(event.sequence))
        case.world.contacts(stage.states())
        yield stage


def with_settings(case: FracturedWorld, settings: Settings) -> CollisionWorld:
    """A world of the same bodies and events with other settings."""
    return with_messages(CollisionWorld(settings), case)


def with_messages(world: AnyWorld, case: FracturedWorld) -> AnyWorld:
    """The world after the bodies and events of `case`."""
    for body in case.messages[0]:
        world.add_body(body)
    for event in case.messages[1]:
        world.add_fracture(event)
    return world
