"""Cost of removing a body from a run with a long log of events."""

from __future__ import annotations

import heapq
from time import perf_counter
from typing import NamedTuple

import numpy as np

from benchmarks.scaling.growth import Progress, silent
from fracture_collision.geometry.generators import TetGeometry, brick
from fracture_collision.geometry.tetrahedra import unique_edges
from fracture_collision.records import REMOVE, SPHERE, CollisionBody, FractureEvent, FragmentStates, SolidPrimitive
from fracture_collision.world import CollisionWorld, Settings

SIDE, CELL = 3.0, 0.1  # [m] of a cube with about 30,000 nodes
BALLS = 21


class RemovalRow(NamedTuple):
    """Times [ms]. `remove`: until the registry without the body is available, and states are answered as before."""

    nodes: int
    events: int
    fragments: int
    remove_median: float
    remove_worst: float
    registry: float  # median of fragments(), which lists all live fragments, without any preceding change
    remove_the_broken_body: float
    from_the_log: float  # cost of a registry rebuilt from the log
    equal: bool  # digest and masses equal those of a registry rebuilt from the log


def halvings(body: TetGeometry, count: int) -> list[FractureEvent]:
    """`count` events, each of which splits the fragment with the most nodes by a plane across its longest side."""
    edges = unique_edges(body.tetrahedra)
    vertices = body.vertices
    heap = [(-len(vertices), 1)]
    nodes_of, edges_of = {1: np.arange(len(vertices))}, {1: edges}
    beyond = np.zeros(len(vertices), bool)
    events: list[FractureEvent] = []
    for sequence in range(1, count + 1):
        _, victim = heapq.heappop(heap)
        nodes, inside = nodes_of.pop(victim), edges_of.pop(victim)
        places = vertices[nodes]
        axis = int(np.argmax(np.ptp(places, axis=0)))
        levels = np.unique(places[:, axis].round(9))
        at = 0.5 * (levels[len(levels) // 2 - 1] + levels[len(levels) // 2])
        beyond[nodes] = places[:, axis] > at
        is_cut = beyond[inside[:, 0]] != beyond[inside[:, 1]]
        cut = inside[is_cut]
        towards = np.where(beyond[cut[:, 1]], 1.0, -1.0)
        planes = np.zeros((len(cut), 4))
        planes[:, axis], planes[:, 3] = towards, towards * at
        new_ids = 2 * sequence, 2 * sequence + 1
        parts = beyond[nodes].astype(np.int64)
        events.append(
            FractureEvent(sequence, 1, victim, np.array(new_ids), nodes, parts, cut.ravel(), planes.ravel())
        )
        kept = inside[~is_cut]
        for part, new_id in enumerate(new_ids):
            nodes_of[new_id] = nodes[parts == part]
            edges_of[new_id] = kept[beyond[kept[:, 0]] == bool(part)]
            heapq.heappush(heap, (-len(nodes_of[new_id]), new_id))
    return events


def measure_removal(events: int = 1000, cell: float = CELL, progress: Progress = silent) -> RemovalRow:
    """Balls are added next to a body that broke `events` times, and removed one by one."""
    body = brick((SIDE, SIDE, SIDE), cell)
    settings = Settings(threads=1)
    whole = CollisionBody(1, 1, vertices=body.vertices, tetrahedra=body.tetrahedra)
    first_ball = 2 * events + 10
    ball = SolidPrimitive(SPHERE, (0.1,))
    balls = [CollisionBody(n, n, primitive=ball) for n in range(first_ball, first_ball + BALLS)]
    log = halvings(body, events)
    nobody = FragmentStates(1, events, np.empty(0, int), np.empty(0), np.empty(0))

    def told(bodies: list[CollisionBody]) -> CollisionWorld:
        world = CollisionWorld(settings)
        for each in bodies:
            world.add_body(each)
        for i, event in enumerate(log):
            if not i % 50:
                progress(f"event {i} of {len(log)}")
            world.add_fracture(event)
        return world

    world = told([whole, *balls])
    world.contacts(nobody)
    count = len(world.fragments().fragment_ids)
    times, registry = [], []
    for ball in balls[:-1]:
        began = perf_counter()
        world.fragments()
        registry.append(perf_counter() - began)
        began = perf_counter()
        world.add_body(CollisionBody(ball.body_id, 0, operation=REMOVE))
        world.contacts(nobody)
        world.fragments()
        times.append(perf_counter() - began)
    twin = told([whole, balls[-1]])
    began = perf_counter()
    twin.contacts(nobody)
    from_the_log = perf_counter() - began
    mine, theirs = world.fragments(), twin.fragments()
    is_equal = mine.digest == theirs.digest and np.array_equal(mine.masses, theirs.masses)
    began = perf_counter()
    world.add_body(CollisionBody(1, 0, operation=REMOVE))
    world.contacts(nobody)
    world.fragments()
    broken = perf_counter() - began
    return RemovalRow(
        len(body.vertices), events, count, 1e3 * float(np.median(times)), 1e3 * max(times),
        1e3 * float(np.median(registry)), 1e3 * broken, 1e3 * from_the_log, is_equal,
    )  # fmt: skip
