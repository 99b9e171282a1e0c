"""A fracture with a fragment of zero volume is rejected as a whole; one with a tiny fragment is accepted."""

from __future__ import annotations

import numpy as np
import pytest
from oracles.fragmented_body import FragmentedBody
from worlds.gate_world import SETTINGS, crack, made_world, refused, tetrahedral
from worlds.hard_worlds import by_labels, lattice_planes

from fracture_collision.geometry.generators import brick
from fracture_collision.records import CollisionBody, FractureEvent, FragmentStates
from fracture_collision.world import CollisionWorld, InvalidMessage


def moved(event: FractureEvent, at: float) -> FractureEvent:
    """The same event with its cut planes moved to x = at."""
    planes = event.cut_planes.reshape(-1, 4).copy()
    planes[:, 3] = planes[:, 0] * at
    return event._replace(cut_planes=planes.ravel())


def masses(world: CollisionWorld, sequence: int, ids: list[int]) -> dict[int, float]:
    still = np.tile([0.0, 0.0, 0.0, 1.0], len(ids))
    world.contacts(FragmentStates(1, sequence, np.array(ids), np.zeros(3 * len(ids)), still))
    told = world.fragments()
    return dict(zip(told.fragment_ids.tolist(), told.masses.tolist(), strict=True))


OUTERMOST = crack(2, 11, (12, 13), 0.4, above=0.1)  # the layer of nodes at x = 0.5
INNER = crack(2, 11, (12, 13), 0.3, above=0.1)  # that at x = 0.25; fragment 11 begins at x = 0.1


def test_a_layer_of_nodes_that_all_planes_pass_through() -> None:
    world = made_world()
    event = moved(OUTERMOST, 0.5)
    refused(world, lambda: world.add_fracture(event), "no_volume", "cut_planes: fragment 13 has no volume")
    world.add_fracture(OUTERMOST)


def test_planes_through_all_nodes_of_a_fragment_that_has_volume_beyond_an_older_crack() -> None:
    world = made_world()
    world.add_fracture(moved(INNER, 0.25))
    found = masses(world, 2, [3, 10, 12, 13])
    assert found[12] == pytest.approx(1000.0 * 0.15 * 0.25)
    assert found[13] == pytest.approx(1000.0 * 0.25 * 0.25)


def test_a_layer_between_an_older_crack_and_a_new_one_through_the_same_nodes() -> None:
    world = CollisionWorld(SETTINGS)
    world.add_body(tetrahedral(1))
    world.add_fracture(moved(crack(1, 1, (10, 11), 0.1), 0.25))
    with pytest.raises(InvalidMessage, match="fragment 12 has no volume"):
        world.add_fracture(moved(INNER, 0.25))
    world.add_fracture(INNER)
    assert masses(world, 2, [10, 12, 13])[12] == pytest.approx(1000.0 * 0.05 * 0.25)


def test_fragments_without_volume_by_the_oracle_are_rejected() -> None:
    body, refusals = brick((2.0, 1.0, 1.0), 0.5), 0
    for seed in range(16):
        cells = (2, 3, 6)[seed % 3]
        labels = np.random.default_rng(seed).integers(0, cells, len(body.vertices))
        oracle = FragmentedBody(body.vertices, body.tetrahedra)
        event = by_labels(labels, lattice_planes(body.vertices, cells))(oracle, 2, 1)
        oracle.apply(event)
        volumes = [oracle.volume(f) for f in oracle.fragment_ids]
        world = CollisionWorld(SETTINGS)
        world.add_body(CollisionBody(1, 1, vertices=body.vertices.ravel(), tetrahedra=body.tetrahedra.ravel()))
        if min(volumes) > 1e-12:
            world.add_fracture(event)
        else:
            with pytest.raises(InvalidMessage, match="has no volume"):
                world.add_fracture(event)
            refusals += 1
    assert 0 < refusals < 16
