"""Worlds are copied, for rollouts, and pickled, to be sent to other processes."""

from __future__ import annotations

import copy
import pickle
from collections.abc import Callable

import pytest
from worlds.broken_bar import BAR, GROUND, STATES, told_world
from worlds.gate_world import FIRST, SECOND, SETTINGS, record_bytes

from fracture_collision.world import CollisionWorld


@pytest.mark.parametrize("copied", [copy.copy, copy.deepcopy, lambda world: pickle.loads(pickle.dumps(world))])
def test_a_copy_answers_alike_and_goes_its_own_way(copied: Callable[[CollisionWorld], CollisionWorld]) -> None:
    world = CollisionWorld(SETTINGS)
    for body in (BAR, GROUND):
        world.add_body(body)
    world.add_fracture(FIRST)
    ids = FIRST.new_fragment_ids
    positions, orientations = STATES.positions[: 3 * len(ids)], STATES.orientations[: 4 * len(ids)]
    before = STATES._replace(fracture_sequence=1, fragment_ids=ids, positions=positions, orientations=orientations)
    here = world.contacts(before)
    other = copied(world)
    assert other.settings == world.settings
    assert record_bytes(other.contacts(before)) == record_bytes(here)
    assert record_bytes(other.fragments()) == record_bytes(world.fragments())
    other.add_fracture(SECOND)
    assert record_bytes(other.contacts(STATES)) == record_bytes(told_world().contacts(STATES))
    assert world.fragments().fracture_sequence == 1  # the first did not break
    world.add_fracture(SECOND)
    assert record_bytes(world.contacts(STATES)) == record_bytes(other.contacts(STATES))
