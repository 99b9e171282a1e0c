"""The service through its Python API, one thread."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from benchmarks.peers.libraries.ours_settings import DEFAULTS, SAME_MESHES, SETTINGS, named
from benchmarks.peers.method import EXACT, MESH, Contacts, Method, contacts_of
from benchmarks.peers.worlds import DENSITY, Frame, World, empty_states
from fracture_collision.records import CollisionBody, ContactConstraintArray, FragmentStates
from fracture_collision.world import CollisionWorld, PaperSettings, Settings


class _State(NamedTuple):
    service: CollisionWorld
    ids: np.ndarray


class _OfService(Method):
    def forget(self, state: _State) -> None:
        state.service.forget()


class Ours(_OfService):
    surface = EXACT

    def __init__(self, name: str, is_quick: bool = True, **settings) -> None:
        self.name, self.is_quick = name, is_quick
        self._settings = Settings(threads=1, **settings)

    def prepare(self, world: World) -> CollisionWorld:
        """The unbroken body, queried once."""
        service = CollisionWorld(self._settings)
        service.add_body(world.body)
        service.contacts(empty_states(0))
        return service

    def update(self, world: World, before: CollisionWorld) -> _State:
        before.add_fracture(world.event)
        before.contacts(empty_states(1))
        before.fragments()  # masses, centres, inertias
        return _State(before, np.array([f.fragment_id for f in world.fragments]))

    def query(self, world: World, state: _State, frame: Frame) -> Contacts:
        return _asked(state, FragmentStates(1, 1, state.ids, frame.body_positions.ravel(), frame.quaternions.ravel()))


class OursOnMeshes(_OfService):
    """The fragments as rigid bodies of the closed meshes that the other libraries get."""

    name = SAME_MESHES
    surface = MESH

    def update(self, world: World, before: None) -> _State:
        service = CollisionWorld(Settings(threads=1))
        for k, fragment in enumerate(world.fragments, 1):
            vertices, triangles = fragment.mesh
            body = CollisionBody(k, fragment.fragment_id, vertices=vertices, triangles=triangles, density=DENSITY)
            service.add_body(body)
        service.contacts(empty_states(0))
        service.fragments()
        return _State(service, np.array([f.fragment_id for f in world.fragments]))

    def query(self, world: World, state: _State, frame: Frame) -> Contacts:
        return _asked(state, FragmentStates(1, 0, state.ids, frame.positions.ravel(), frame.quaternions.ravel()))


def _asked(state: _State, states: FragmentStates) -> Contacts:
    answer, timings = state.service.contacts(states), state.service.last_timings
    return listed_contacts(answer, state.ids, timings["broad_phase"] + timings["narrow_phase"])


def listed_contacts(answer: ContactConstraintArray, ids: np.ndarray, native: float = np.nan) -> Contacts:
    """`ids` (n,) ascending: fragment ids, by number."""
    counts = np.diff(answer.pair_begin.astype(np.int64))
    return contacts_of(
        np.searchsorted(ids, np.repeat(answer.fragment_a, counts)),
        np.searchsorted(ids, np.repeat(answer.fragment_b, counts)),
        answer.points_a, answer.points_b, answer.normals, -answer.gaps, native,
    )  # fmt: skip


def methods() -> list[Method]:
    """The defaults, the same on other meshes, and one method for each setting that trades accuracy for time."""
    return [
        Ours("ours"),
        OursOnMeshes(),
        Ours("ours, glondu2014", method="glondu2014", paper=PaperSettings(field="exact")),
        # its first fracture builds the grid of the unbroken body: half a minute for the ball
        Ours("ours, glondu2014, averaged field", is_quick=False, method="glondu2014"),
        Ours("ours, 2 contacts", contacts_per_pair=2),
        Ours("ours, 32 contacts", contacts_per_pair=32),
        Ours("ours, epsilon 0", penetration_tolerance=0.0),
        Ours("ours, epsilon 1 % R", penetration_tolerance=0.01),
        Ours("ours, epsilon 5 % R", penetration_tolerance=0.05),
    ]


def setting_methods() -> list[Method]:
    """The defaults, and one method for each value of SETTINGS."""
    changed = [(setting, value) for setting, values in SETTINGS.items() for value in values]
    return [Ours(DEFAULTS), *(Ours(named(*item), **dict([item])) for item in changed)]
