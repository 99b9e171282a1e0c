"""The input of each library compared: one convex hull per fragment; boxes, balls and planes as they are."""

from __future__ import annotations

from abc import ABC, abstractmethod
from enum import Enum, auto
from time import perf_counter
from typing import TYPE_CHECKING

import numpy as np

from fracture_collision.records import BOX, SPHERE, CollisionBody, FragmentStates
from fracture_collision.world import CollisionWorld

if TYPE_CHECKING:
    from benchmarks.peers.method import Contacts
    from benchmarks.peers.worlds import Frame


class Shape(Enum):
    BOX = auto()
    BALL = auto()
    PLANE = auto()
    SURFACE = auto()  # of a rigid body, possibly not convex
    HULL = auto()


def shape_of(whole: CollisionBody | None) -> Shape:
    """`whole`: the unbroken body of a fragment, None for a fragment of a broken one."""
    if whole is None:
        return Shape.HULL
    if whole.primitive.type == BOX:
        return Shape.BOX
    if whole.primitive.type == SPHERE:
        return Shape.BALL
    if np.any(whole.plane):
        return Shape.PLANE
    return Shape.SURFACE if len(whole.triangles) and not len(whole.tetrahedra) else Shape.HULL


def is_fixed(whole: CollisionBody | None) -> bool:
    return whole is not None and whole.is_static


def radius_of(whole: CollisionBody) -> float:
    """R [m]: half the longest side of a body's box; infinite for a plane."""
    match shape_of(whole):
        case Shape.BOX:
            return 0.5 * max(whole.primitive.dimensions)
        case Shape.BALL:
            return whole.primitive.dimensions[0]
        case Shape.PLANE:
            return np.inf
    return 0.5 * float(np.ptp(np.reshape(whole.vertices, (-1, 3)), axis=0).max())


def normal_and_point(whole: CollisionBody) -> tuple[np.ndarray, np.ndarray]:
    """A plane in the body frame: its normal (3,), of any length, and its point (3,) [m] nearest to the origin."""
    normal = np.asarray(whole.plane[:3], float)
    return normal, -whole.plane[3] * normal / (normal @ normal)


def turn_onto(normal: np.ndarray, axis: int) -> list[float]:
    """Quaternion (4) x y z w that turns coordinate axis 0, 1 or 2 onto `normal` (3,), of any length."""
    start, end = np.eye(3)[axis], normal / np.linalg.norm(normal)
    if start @ end < -0.999999:  # half a turn about another axis
        return [*np.eye(3)[axis - 1].tolist(), 0.0]
    quaternion = np.array([*np.cross(start, end), 1.0 + start @ end])
    return (quaternion / np.linalg.norm(quaternion)).tolist()


class Peer(ABC):
    """One library. A CollisionWorld that receives the same recording provides the set of fragments."""

    lists_contacts = False  # True: `contacts` is implemented
    last_registry_only = False  # True: its world cannot be extended; only states after the last fracture are timed

    def __init__(self) -> None:
        self._whole: dict[int, CollisionBody] = {}  # unbroken bodies, by fragment

    def tell(self, bodies: list[CollisionBody]) -> None:
        self._whole |= {body.fragment_id: body for body in bodies}

    @abstractmethod
    def follow(self, world: CollisionWorld, ids: list[int]) -> float:
        """Makes `ids` the fragments that take part; returns the time [s] spent on building hulls and worlds."""

    @abstractmethod
    def step(self, states: FragmentStates) -> float:
        """Time [s] of the collision step at `states`."""

    def contacts(self, ids: np.ndarray, frame: Frame) -> Contacts:
        """Contacts of the last step, at `frame`; fragments are numbered as in `ids`, ascending, those of `follow`."""
        raise NotImplementedError


class GrowingPeer(Peer):
    """A library that can add and remove single bodies."""

    def __init__(self) -> None:
        super().__init__()
        self._handles: dict[int, object] = {}

    def follow(self, world: CollisionWorld, ids: list[int]) -> float:
        new = [i for i in ids if i not in self._handles]
        points = {i: points_of(world, i) for i in new}
        started = perf_counter()
        for i in self._handles.keys() - set(ids):
            self._remove(self._handles.pop(i))
        for i in new:
            self._handles[i] = self._add(self._whole.get(i), points[i])
        return perf_counter() - started

    @abstractmethod
    def _add(self, whole: CollisionBody | None, points: np.ndarray) -> object:
        """Returns a handle of the new body. `points` as returned by points_of."""

    @abstractmethod
    def _remove(self, handle) -> None: ...


def points_of(world: CollisionWorld, fragment_id: int) -> np.ndarray:
    """Surface points of a fragment (n, 3) float32 [m], body frame."""
    return world.fragment_mesh(fragment_id).vertices.reshape(-1, 3)


def poses_of(states: FragmentStates) -> list[tuple[int, list[float], list[float]]]:
    """Id, position (3) [m] and quaternion (4) x y z w of each fragment in the states."""
    return list(zip(
        states.fragment_ids.tolist(), states.positions.reshape(-1, 3).tolist(),
        states.orientations.reshape(-1, 4).tolist(), strict=True,
    ))  # fmt: skip
