"""A tetrahedral body in the simulator: which node belongs to which fragment."""

from __future__ import annotations

import copy
from typing import Any

import numpy as np

from fracture_collision.fracture.pattern import Naming, PatternSettings, event_of, voronoi_pattern
from fracture_collision.fracture.pieces import inside_fragment
from fracture_collision.geometry.generators import TetGeometry
from fracture_collision.geometry.tetrahedra import unique_edges
from fracture_collision.portable_math import lengths
from fracture_collision.records import FractureEvent


class BreakableBody:
    """Node labels of one body, kept up to date through its fractures."""

    def __init__(self, body_id: int, fragment_id: int, mesh: TetGeometry) -> None:
        self._body_id = body_id
        self._vertices = mesh.vertices
        self._edges = unique_edges(mesh.tetrahedra)
        self._node_fragments = np.full(len(mesh.vertices), fragment_id, dtype=np.int64)
        self._node_counts = {fragment_id: len(mesh.vertices)}

    def __deepcopy__(self, _memo: dict[int, Any]) -> BreakableBody:
        """A body that breaks independently; it shares the mesh, which never changes."""
        made = copy.copy(self)
        made._node_fragments, made._node_counts = self._node_fragments.copy(), dict(self._node_counts)
        return made

    def node_count(self, fragment_id: int) -> int:
        """Number of nodes that a fragment owns."""
        return self._node_counts[fragment_id]

    def nearest_node(self, fragment_id: int, point: np.ndarray) -> tuple[int, np.ndarray]:
        """The fragment's node nearest to `point` (3,) [m], the first of several, and its position; body frame."""
        nodes = np.flatnonzero(self._node_fragments == fragment_id)
        node = int(nodes[np.argmin(lengths(self._vertices[nodes] - point))])
        return node, self._vertices[node]

    def owner(self, node: int) -> int:
        """Id of the fragment that a node belongs to."""
        return int(self._node_fragments[node])

    def fracture(
        self,
        fragment_id: int,
        sequence: int,
        first_new_id: int,
        impact_point: np.ndarray,
        overload: float,
        settings: PatternSettings,
        generator: np.random.Generator,
    ) -> FractureEvent | None:
        """Break a fragment at `impact_point` (3,) [m], body frame; None if it holds together.

        `overload` is the impulse of the blow over the strength: a blow of twice the strength sows twice the seeds of
        one that just suffices, up to `settings.seeds`.
        """
        nodes, edges = inside_fragment(self._node_fragments, self._edges, fragment_id)
        seeds = int(np.clip(round(settings.seeds_per_overload * overload), 2, settings.seeds))
        pattern = voronoi_pattern(self._vertices[nodes], edges, impact_point, seeds, settings, generator)
        if pattern is None:
            return None
        new_ids = first_new_id + np.arange(pattern.piece_count)
        self._node_fragments[nodes] = new_ids[pattern.pieces]
        del self._node_counts[fragment_id]
        counts = np.bincount(pattern.pieces, minlength=pattern.piece_count)
        self._node_counts.update(zip(new_ids.tolist(), counts.tolist(), strict=True))
        return event_of(pattern, nodes, Naming(sequence, self._body_id, fragment_id, first_new_id))
