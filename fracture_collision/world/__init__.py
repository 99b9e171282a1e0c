"""The collision service as a Python library, without ROS."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from fracture_collision.records import (
    BOX,
    CONE,
    CYLINDER,
    SPHERE,
    CollisionBody,
    ContactConstraintArray,
    ContactPair,
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
    from fracture_collision.world.queries import ClosestPoints, Distances, Overlaps, RayHits, Sweep

__all__ = [
    "BOX",
    "CONE",
    "CYLINDER",
    "SPHERE",
    "ClosestPoints",
    "CollisionBody",
    "CollisionWorld",
    "ContactConstraintArray",
    "ContactPair",
    "Distances",
    "FractureEvent",
    "FragmentMesh",
    "FragmentRegistry",
    "FragmentStates",
    "InvalidMessage",
    "Overlaps",
    "PaperSettings",
    "RayHits",
    "Settings",
    "SolidPrimitive",
    "StatesAhead",
    "Sweep",
]

_ANSWERS = "ClosestPoints", "Distances", "Overlaps", "RayHits", "Sweep"
_LATE = {"CollisionWorld": "collision_world"} | dict.fromkeys(_ANSWERS, "queries")


def __getattr__(name: str) -> Any:
    """Import CollisionWorld and what it returns on first access: it imports numba, which takes half a second.

    A node announces itself before that.
    """
    if name not in _LATE:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_LATE[name]}"), name)
