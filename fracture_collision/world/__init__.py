"""The collision service as a Python library, without ROS."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from fracture_collision.records import (
    BOX,
    CONE,
    CYLINDER,
    SPHERE,
    CollisionBody,
    ContactConstraintArray,
    FractureEvent,
    FragmentMesh,
    FragmentRegistry,
    FragmentStates,
    SolidPrimitive,
)
from fracture_collision.world.gates.errors import InvalidMessage, StatesAhead
from fracture_collision.world.settings import PaperSettings, Settings

if TYPE_CHECKING:
    from fracture_collision.world.collision_world import CollisionWorld

__all__ = [
    "BOX",
    "CONE",
    "CYLINDER",
    "SPHERE",
    "CollisionBody",
    "CollisionWorld",
    "ContactConstraintArray",
    "FractureEvent",
    "FragmentMesh",
    "FragmentRegistry",
    "FragmentStates",
    "InvalidMessage",
    "PaperSettings",
    "Settings",
    "SolidPrimitive",
    "StatesAhead",
]


def __getattr__(name: str) -> Any:
    """Import CollisionWorld on first access: it imports numba, which takes half a second.

    A node announces itself before that.
    """
    if name != "CollisionWorld":
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from fracture_collision.world.collision_world import CollisionWorld

    return CollisionWorld
