"""The geometry after a prefix of the log: which fragments live, their rows in the pools, masses and digests."""

from __future__ import annotations

import hashlib

import numpy as np

from fracture_collision.core.collision_geometry import CollisionGeometry, MassProperties
from fracture_collision.core.pools import ALTERNATING, AVERAGED, EXACT, FACING, NEAREST, QUEUE
from fracture_collision.records import FragmentRegistry
from fracture_collision.world.body_gate import CheckedBody
from fracture_collision.world.fracture_gate import CheckedFracture, apply_fracture
from fracture_collision.world.settings import FIELDS, NORMALS, TRAVERSALS, Settings

# How core calls what the settings name; a tree's name is its own.
_FIELD = dict(zip(FIELDS, (EXACT, AVERAGED), strict=True))
_NORMALS = dict(zip(NORMALS, (FACING, NEAREST), strict=True))
_TRAVERSAL = dict(zip(TRAVERSALS, (ALTERNATING, QUEUE), strict=True))


class Registry:
    def __init__(self, settings: Settings) -> None:
        self.geometry = CollisionGeometry(
            settings.tree, _TRAVERSAL[settings.traversal], _FIELD[settings.field], _NORMALS[settings.normals]
        )
        self.sequence = 0
        self._bodies: dict[int, CheckedBody] = {}
        self._chain = hashlib.sha256().digest()
        self._row: dict[int, int] = {}  # living fragment id -> row
        self._body_of: dict[int, int] = {}
        self._parent: dict[int, int] = {}
        self._mass: dict[int, MassProperties] = {}
        self._lookup: tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray] | None = None

    def add_body(self, body: CheckedBody) -> None:
        if body.mesh is not None:
            row = self.geometry.add_tetrahedra(body.mesh)
        elif body.surface is not None:
            row = self.geometry.add_triangles(body.surface)
        elif body.box is not None:
            row = self.geometry.add_box(body.box)
        elif body.plane is not None:
            row = self.geometry.add_plane(body.plane[:3], body.plane[3])
        else:
            row = self.geometry.add_sphere(body.sphere)
        self._bodies[body.body_id] = body
        self._add_fragment(body.fragment_id, body.body_id, body.fragment_id, row)

    def has_body(self, body_id: int) -> bool:
        return body_id in self._bodies

    def apply(self, event: CheckedFracture) -> None:
        """The next event of the log; one of a removed body only counts."""
        self.sequence += 1
        self._chain = hashlib.sha256(self._chain + event.digest).digest()
        if event.body_id not in self._bodies:
            return
        first = apply_fracture(self.geometry, self._row.pop(event.fragment_id), event)
        for i, new_id in enumerate(event.new_fragment_ids.tolist()):
            self._add_fragment(new_id, event.body_id, event.fragment_id, first + i)

    def lookup(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Living fragments by ascending id: ids, rows, whether static, friction, restitution."""
        if self._lookup is None:
            ids = np.array(sorted(self._row), dtype=np.int64)
            bodies = [self._bodies[self._body_of[f]] for f in ids.tolist()]
            self._lookup = (
                ids,
                np.array([self._row[f] for f in ids.tolist()], dtype=np.int64),
                np.array([b.is_static for b in bodies], dtype=np.bool_),
                np.array([b.friction for b in bodies], dtype=np.float64),
                np.array([b.restitution for b in bodies], dtype=np.float64),
            )
        return self._lookup

    def row_of(self, fragment_id: int) -> int | None:
        return self._row.get(fragment_id)

    def digest(self) -> str:
        """SHA-256 over the bodies, by id, and the chain of events; the order in which bodies came does not matter."""
        whole = hashlib.sha256(self._chain)
        for body_id in sorted(self._bodies):
            whole.update(self._bodies[body_id].digest)
        return whole.hexdigest()

    def record(self) -> FragmentRegistry:
        ids = sorted(self._row)
        masses = self._masses_of(ids)
        count = len(ids)
        return FragmentRegistry(
            fracture_sequence=self.sequence,
            fragment_ids=np.array(ids, dtype=np.uint32),
            body_ids=np.array([self._body_of[f] for f in ids], dtype=np.uint32),
            parent_ids=np.array([self._parent[f] for f in ids], dtype=np.uint32),
            masses=np.array([m.mass for m in masses]),
            centers_of_mass=np.array([m.center for m in masses]).reshape(3 * count),
            inertias=np.array([m.inertia for m in masses]).reshape(6 * count),
            sampling_gaps=np.array([self.geometry.sampling_gap(self._row[f]) for f in ids]),
            digest=self.digest(),
        )

    def _masses_of(self, fragment_ids: list[int]) -> list[MassProperties]:
        new = [f for f in fragment_ids if f not in self._mass]
        if new:
            densities = np.array([self._bodies[self._body_of[f]].density for f in new])
            rows = np.array([self._row[f] for f in new])
            self._mass.update(zip(new, self.geometry.mass_properties(rows, densities), strict=True))
        return [self._mass[f] for f in fragment_ids]

    def _add_fragment(self, fragment_id: int, body_id: int, parent_id: int, row: int) -> None:
        self._row[fragment_id] = row
        self._body_of[fragment_id] = body_id
        self._parent[fragment_id] = parent_id
        self._lookup = None
