"""The geometry after a prefix of the event log: living fragments, their rows in the pools, masses and digests."""

from __future__ import annotations

import hashlib

import numpy as np

from fracture_collision.core.bodies.collision_geometry import CollisionGeometry
from fracture_collision.core.glondu2014.paper_geometry import PaperGeometry
from fracture_collision.core.memory.tables import Moves
from fracture_collision.records import FragmentRegistry
from fracture_collision.world.gates.body_gate import CheckedBody
from fracture_collision.world.gates.checks import UINT64_MAX
from fracture_collision.world.gates.fracture_gate import CheckedFracture, apply_fracture
from fracture_collision.world.living_fragments import Columns, LivingFragments
from fracture_collision.world.settings import GLONDU2014, Settings


class Registry:
    """Adds and removes bodies, applies events in order; reclaiming a removed body costs its size, amortized."""

    def __init__(self, settings: Settings) -> None:
        self.geometry = CollisionGeometry(
            PaperGeometry(*settings.paper) if settings.method == GLONDU2014 else None
        )
        self.sequence = 0
        self.renumbered = 0  # number of times the rows of all fragments were renumbered
        self.moves: Moves | None = None  # of these rows, the last time
        self.changes = 0  # number of changes of any kind
        self._centers, self._centers_at = np.zeros((0, 3)), 0  # of mass, of all living; `changes` when computed
        self._bodies: dict[int, CheckedBody] = {}
        self._last_static = 0  # sequence of the last message that added a static body
        self._chain = hashlib.sha256().digest()
        self._living = LivingFragments()
        self._fragments_of: dict[int, set[int]] = {}  # body id -> its living fragments
        self._broke_at: dict[int, int] = {}  # body id -> `changes` when it last broke

    def add_body(self, body: CheckedBody) -> None:
        """Add a body with its one fragment before any fracture."""
        self.changes += 1
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
        if body.is_static:
            self._last_static = max(self._last_static, body.sequence)
        self._bodies[body.body_id] = body
        self._fragments_of[body.body_id] = set()
        self._add_fragment(body.fragment_id, body, body.fragment_id, row)

    def remove_body(self, body_id: int) -> None:
        """Replays nothing: other bodies stay as they are. Memory is reclaimed once half of it is garbage."""
        self.changes += 1
        del self._bodies[body_id]
        self._broke_at.pop(body_id, None)
        for fragment_id in self._fragments_of.pop(body_id):
            self._living.remove(fragment_id)
        self.geometry.retire_body()
        self._reclaim_memory()

    def apply(self, event: CheckedFracture) -> None:
        """Apply the next event of the log; one of a removed body only advances the sequence and the digest."""
        self.changes += 1
        self.sequence += 1
        self._chain = hashlib.sha256(self._chain + event.digest).digest()
        body = self._bodies.get(event.body_id)
        if body is None:
            return
        self._broke_at[body.body_id] = self.changes
        self._fragments_of[body.body_id].remove(event.fragment_id)
        first = apply_fracture(self.geometry, self._living.remove(event.fragment_id), event)
        for i, new_id in enumerate(event.new_fragment_ids.tolist()):
            self._add_fragment(new_id, body, event.fragment_id, first + i)
        self._reclaim_memory()

    def _reclaim_memory(self) -> None:
        if self.geometry.is_mostly_garbage():
            rows = self._living.columns().rows
            self.moves = self.geometry.keep_only(rows)
            self._living.renumber(self.moves.of(rows))
            self.renumbered += 1

    def rows_broken_since(self, changes: int) -> np.ndarray:
        """Rows of the fragments (n,) of bodies that broke since there were so many `changes`."""
        broken = [body for body, at in self._broke_at.items() if at > changes]
        rows = [self._living.row_of(fragment) for body in broken for fragment in self._fragments_of[body]]
        return np.array(rows, np.int64)

    def living(self) -> Columns:
        """Living fragments by ascending id."""
        return self._living.columns()

    def static_until(self, body_sequence: int) -> int:
        """Static bodies of later messages than this do not take part in states after `body_sequence` messages.

        UINT64_MAX where all take part, so states of another sequence with the same bodies are the same query.
        """
        return body_sequence if 0 < body_sequence < self._last_static else UINT64_MAX

    def row_of(self, fragment_id: int) -> int | None:
        """Row of a fragment in the pools; None if it does not live."""
        return self._living.row_of(fragment_id)

    def digest(self) -> str:
        """SHA-256 over the bodies, by id, and the chain of events; independent of the order in which bodies arrived."""
        whole = hashlib.sha256(self._chain)
        for body_id in sorted(self._bodies):
            whole.update(self._bodies[body_id].digest)
        return whole.hexdigest()

    def record(self, settings: str) -> FragmentRegistry:
        """The registry as it is published, with the `settings_text`; computes masses of new fragments."""
        living = self._living.columns()
        masses = self._masses(living)
        return FragmentRegistry(
            fracture_sequence=self.sequence,
            fragment_ids=living.ids.astype(np.uint32),
            body_ids=living.bodies.astype(np.uint32),
            parent_ids=living.parents.astype(np.uint32),
            masses=masses[:, 0].copy(),
            centers_of_mass=np.ascontiguousarray(masses[:, 1:4]),
            inertias=np.ascontiguousarray(masses[:, 4:]),
            sampling_gaps=self.geometry.sampling_gaps(living.rows),
            digest=self.digest(),
            settings=settings,
        )

    def centers_of_mass(self, ids: np.ndarray) -> np.ndarray:
        """Of living fragments `ids` (n,), ascending: (n, 3) [m], body frame."""
        living = self._living.columns()
        if self._centers_at != self.changes:
            self._centers, self._centers_at = np.ascontiguousarray(self._masses(living)[:, 1:4]), self.changes
        if len(ids) == len(living.ids):
            return self._centers
        return self._centers[np.searchsorted(living.ids, ids)]

    def _masses(self, living: Columns) -> np.ndarray:
        """(n, MASS_VALUES) of all living fragments; computes those of new ones."""
        new = np.flatnonzero(np.isnan(living.masses[:, 0]))
        if len(new):
            for i, one in zip(new, self.geometry.mass_properties(living.rows[new], living.density[new]), strict=True):
                living.masses[i] = one.mass, *one.center, *one.inertia
        return living.masses

    def _add_fragment(self, fragment_id: int, body: CheckedBody, parent_id: int, row: int) -> None:
        self._fragments_of[body.body_id].add(fragment_id)
        self._living.add(fragment_id, row, body, parent_id)
