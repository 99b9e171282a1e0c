"""The interface of a method: it can be updated at a fracture and queried for contacts."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from benchmarks.peers.worlds import Frame, World

EXACT = "exact"
MESH = "mesh"


class Contacts(NamedTuple):
    """The result of one query. Fragments are numbered as in `World.fragments`."""

    first: np.ndarray  # (n,) fragment
    second: np.ndarray  # (n,) fragment
    points_first: np.ndarray  # (n, 3) [m], world: witness on the first
    points_second: np.ndarray  # (n, 3) [m], world: witness on the second
    normals: np.ndarray  # (n, 3) unit, from the first to the second
    depths: np.ndarray  # (n,) [m], positive if they overlap
    native: float = np.nan  # [s] in the library's own calls; nan: not measured separately


class Method:
    """One library in one setting. `update` and `query` are timed; `prepare`, `forget` and `release` are not.

    The constructor raises ImportError if the library is not installed.
    """

    name: str
    # the surface it works on and is judged against: EXACT, of the service's regions, or MESH, the closed mesh
    surface = MESH
    is_quick = True  # False: left out by default
    answers = True  # False: supports updates only

    def prepare(self, world: World) -> Any:
        """The state before the fracture."""

    def update(self, world: World, before: Any) -> Any:
        """From the fracture to all fragments ready for queries; returns what `query` needs."""
        raise NotImplementedError

    def forget(self, state: Any) -> None:
        """Drops what it keeps from one query to the next: each frame is queried as if everything had moved."""

    def query(self, world: World, state: Any, frame: Frame) -> Contacts:
        raise NotImplementedError

    def release(self, state: Any) -> None:
        """Frees what `update` made."""


def no_contacts(native: float = np.nan) -> Contacts:
    none = np.zeros((0, 3))
    return Contacts(np.zeros(0, int), np.zeros(0, int), none, none, none, np.zeros(0), native)


def contacts_of(first, second, points_first, points_second, normals, depths, native: float = np.nan) -> Contacts:
    """From lists or arrays."""
    if not len(depths):
        return no_contacts(native)
    vectors = (np.asarray(v, dtype=np.float64).reshape(-1, 3) for v in (points_first, points_second, normals))
    return Contacts(np.asarray(first, int), np.asarray(second, int), *vectors, np.asarray(depths, float), native)


def usable(contacts: Contacts) -> Contacts:
    """Without those that have no direction or depth: coal's hulls report NaN in some pairs that barely touch."""
    fine = np.isfinite(contacts.depths) & np.isfinite(contacts.normals).all(axis=1)
    return contacts if fine.all() else Contacts(*(column[fine] for column in contacts[:-1]), contacts.native)


def about_middle(first, second, middles, normals, depths, native: float = np.nan) -> Contacts:
    """From points (n, 3) halfway between the witnesses."""
    if not len(depths):
        return no_contacts(native)
    half = 0.5 * np.asarray(depths, float)[:, None] * np.asarray(normals, float)
    middles = np.asarray(middles, float)
    # the first's witness is ahead, inside the second
    return contacts_of(first, second, middles + half, middles - half, normals, depths, native)
