"""The collision service as a Python library, without ROS."""

from fracture_collision.records import CollisionBody, FractureEvent, FragmentStates
from fracture_collision.world.collision_world import CollisionWorld
from fracture_collision.world.errors import InvalidMessage, StatesAhead
from fracture_collision.world.settings import Settings

__all__ = [
    "CollisionBody",
    "CollisionWorld",
    "FractureEvent",
    "FragmentStates",
    "InvalidMessage",
    "Settings",
    "StatesAhead",
]
