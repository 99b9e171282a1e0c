"""A breakable bar over the ground, its two fractures, the states of its pieces, and the library's answer to them."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from fracture_collision.records import CollisionBody, ContactConstraintArray, FragmentStates
from fracture_collision.world import CollisionWorld, Settings
from worlds.gate_world import FIRST, SECOND, SETTINGS, tetrahedral

if TYPE_CHECKING:
    from stages.ros_client import ServiceClient

BAR = tetrahedral(1)
GROUND = CollisionBody(2, 2, plane=np.array([0.0, 0.0, 1.0, 0.0]), is_static=True)
STATES = FragmentStates(
    5, 2, np.array([2, 10, 12, 13]), np.tile([0.0, 0.0, 0.24], 4) * np.repeat([0.0, 1.0, 1.0, 1.0], 3),
    np.tile([0.0, 0.0, 0.0, 1.0], 4),
)  # fmt: skip


def told_world(settings: Settings = SETTINGS) -> CollisionWorld:
    world = CollisionWorld(settings)
    for body in (BAR, GROUND):
        world.add_body(body)
    for event in (FIRST, SECOND):
        world.add_fracture(event)
    return world


def tell_all(client: ServiceClient, run_id: int) -> None:
    for body in (BAR, GROUND):
        client.publish("bodies", body, run_id)
    for event in (FIRST, SECOND):
        client.publish("fracture_events", event, run_id)


def expected_contacts(settings: Settings = SETTINGS) -> ContactConstraintArray:
    contacts = told_world(settings).contacts(STATES)
    assert len(contacts.gaps) > 0
    return contacts
