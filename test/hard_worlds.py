"""Worlds for the hard cases: cracks given by any labels and planes, and all pairs checked at any scale."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from itertools import combinations

import numpy as np
from contact_truth import ContactTruth, PairCheck, Poses, check_pair, pairs_of
from fractured_worlds import DENSITY, SETTINGS, FracturedWorld
from oracles.fracture_patterns import CrackPlane, event_of_labels
from oracles.fragmented_body import FragmentedBody

from fracture_collision.geometry.generators import TetGeometry
from fracture_collision.records import CollisionBody, FractureEvent, FragmentStates
from fracture_collision.world import CollisionWorld, Settings

EventMaker = Callable[[FragmentedBody, int, int], FractureEvent]  # the body, first new fragment id, sequence


def broken_world(body: TetGeometry, makers: Iterable[EventMaker], settings: Settings = SETTINGS) -> FracturedWorld:
    """The service's world and the slow oracle after the events that `makers` make one after the other."""
    world, oracle = CollisionWorld(settings), FragmentedBody(body.vertices, body.tetrahedra)
    message = CollisionBody(1, 1, vertices=body.vertices.ravel(), tetrahedra=body.tetrahedra.ravel(), density=DENSITY)
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


def by_labels(labels: np.ndarray, plane: CrackPlane, victim: int | None = None) -> EventMaker:
    """Break a fragment (the largest id if none is given) where the `labels` (n,) of the mesh nodes change."""

    def make(body: FragmentedBody, first_new_id: int, sequence: int) -> FractureEvent:
        fragment = max(body.fragment_ids) if victim is None else victim
        return event_of_labels(body, fragment, np.asarray(labels), plane, first_new_id, sequence, 1)

    return make


def bisecting(vertices: np.ndarray) -> CrackPlane:
    """Each cut edge has a plane of its own, through its middle and across it; no two of a tetrahedron agree."""

    def plane(a: int, b: int, _i: int, _j: int) -> tuple[np.ndarray, float]:
        normal = (vertices[b] - vertices[a]) / np.linalg.norm(vertices[b] - vertices[a])
        return normal, float(normal @ (0.5 * (vertices[a] + vertices[b])))

    return plane
