"""Ground truth for contacts, from closed surfaces alone: libigl's winding numbers and distances, none of our own code.

Depth: over all vertices (and samples) of either surface that lie inside the other, the largest distance to the other.
Two directions from the first fragment to the second are kept, because the correct one depends on the purpose:

- `nearest`: from that deepest vertex to the nearest point of the other's surface. Near rims that is often not the crack
  but the adjacent outer surface, so even the exact answer need not separate the pair.
- `parting`: along which the common volume shrinks fastest. Its derivative under a translation of one body is the area
  vector of that body's surface inside the other, summed here over triangles whose centroid is inside.
"""

from __future__ import annotations

from typing import NamedTuple

import igl
import numpy as np

from benchmarks.peers.boxes import all_vertices, candidates
from benchmarks.peers.worlds import Frame, Surface

INSIDE = 1e-9  # [m] a vertex less deep counts as on the surface
EDGES_AT_ONCE = 2_000_000  # edge-triangle pairs


class PairTruth(NamedTuple):
    depth: float  # [m], 0 if no vertex of either is inside the other
    sample_depth: float  # [m] the same from the service's samples alone, the upper limit for a hierarchy of samples
    nearest: np.ndarray  # (3,) unit, zero if depth is
    parting: np.ndarray  # (3,) unit, zero if no triangle's centroid is inside


class Solids:
    """All fragments of a world, with one kind of surface, ready for queries."""

    def __init__(self, surfaces: list[Surface], samples: list[np.ndarray] | None = None) -> None:
        """`samples`: for each fragment (s, 3) [m], relative to its centre."""
        self.surfaces = surfaces
        self._trees = [igl.AABB() for _ in surfaces]
        middles, self._areas = [], []
        for tree, s in zip(self._trees, surfaces, strict=True):
            tree.init(s.vertices, s.triangles)
            a, b, c = (s.vertices[s.triangles[:, i]] for i in range(3))
            middles.append((a + b + c) / 3.0)
            self._areas.append(0.5 * np.cross(b - a, c - a))
        samples = samples or [np.zeros((0, 3))] * len(surfaces)
        # one pass queries all points: vertices first, then samples, then triangle centroids
        self._first_sample = np.array([len(s.vertices) for s in surfaces])
        self._first_middle = self._first_sample + [len(s) for s in samples]
        parts = [s.vertices for s in surfaces], samples, middles
        self._asked = all_vertices([np.concatenate(points) for points in zip(*parts, strict=True)])

    def points(self, fragment: int) -> np.ndarray:
        """Its vertices and samples (n, 3) [m], relative to its centre."""
        begin = self._asked.begin[fragment]
        return self._asked.points[begin : begin + self._first_middle[fragment]]

    def nearest(self, fragment: int, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Distance (n,) [m] from points, relative to its centre, to its surface, and the nearest points (n, 3)."""
        s = self.surfaces[fragment]
        squared, _, closest = self._trees[fragment].squared_distance(s.vertices, s.triangles, points)
        return np.sqrt(np.atleast_1d(squared)), np.atleast_2d(closest)

    def inside(self, fragment: int, points: np.ndarray) -> np.ndarray:
        s = self.surfaces[fragment]
        return np.atleast_1d(igl.fast_winding_number(s.vertices, s.triangles, points)) > 0.5

    def truth(self, frame: Frame) -> dict[tuple[int, int], PairTruth]:
        """All pairs (first < second) where one has a vertex, sample or centroid inside the other."""
        near = candidates(self._asked, frame)
        index = near.row - self._asked.begin[near.own]  # among its fragment's vertices, samples and centroids
        found: dict[tuple[int, int], _Pair] = {}
        for v in np.unique(near.other).tolist():
            rows = np.flatnonzero(near.other == v)
            rows = rows[self.inside(v, np.ascontiguousarray(near.local[rows]))]
            if not len(rows):
                continue
            distance, closest = self.nearest(v, np.ascontiguousarray(near.local[rows]))
            outward = (closest - near.local[rows]) @ frame.rotations[v].T
            for u in np.unique(near.own[rows]).tolist():
                mine = near.own[rows] == u
                pair = found.setdefault((min(u, v), max(u, v)), _Pair())
                sign = 1.0 if u < v else -1.0
                local = index[rows[mine]]
                is_middle = local >= self._first_middle[u]
                is_sample = (local >= self._first_sample[u]) & ~is_middle
                # a point of the first leaves the second along `outward`, so the second lies in the opposite direction
                pair.add_points(distance[mine][~is_middle], -sign * outward[mine][~is_middle])
                pair.sample_depth = max(pair.sample_depth, distance[mine][is_sample].max(initial=0.0))
                area = self._areas[u][local[is_middle] - self._first_middle[u]].sum(axis=0)
                pair.parting += sign * frame.rotations[u] @ area
        return {pair: found[pair].truth() for pair in sorted(found)}

    def edges_cross(self, first: int, second: int, frame: Frame) -> bool:
        """Whether an edge of either crosses a triangle of the other."""
        world = [self.surfaces[f].vertices @ frame.rotations[f].T + frame.positions[f] for f in (first, second)]
        triangles = [world[i][self.surfaces[f].triangles] for i, f in enumerate((first, second))]
        low = np.maximum(world[0].min(axis=0), world[1].min(axis=0))
        high = np.minimum(world[0].max(axis=0), world[1].max(axis=0))
        common = [t[np.all((t.min(axis=1) <= high) & (t.max(axis=1) >= low), axis=1)] for t in triangles]
        return any(_crosses(common[i], common[1 - i]) for i in range(2))


class _Pair:
    """Accumulates the results of both directions."""

    def __init__(self) -> None:
        self.depth, self.sample_depth = 0.0, 0.0
        self.direction, self.parting = np.zeros(3), np.zeros(3)

    def add_points(self, distance: np.ndarray, direction: np.ndarray) -> None:
        if len(distance) and distance.max() > max(self.depth, INSIDE):
            deepest = int(np.argmax(distance))
            self.depth, self.direction = float(distance[deepest]), direction[deepest]

    def truth(self) -> PairTruth:
        return PairTruth(self.depth, float(self.sample_depth), _unit(self.direction), _unit(self.parting))


def _unit(vector: np.ndarray) -> np.ndarray:
    length = np.linalg.norm(vector)
    return vector / length if length > 0.0 else vector


def _crosses(of_edges: np.ndarray, triangles: np.ndarray) -> bool:
    """Whether an edge of the triangles (e, 3, 3) crosses the interior of one of `triangles` (t, 3, 3)."""
    starts, ends = of_edges.reshape(-1, 3), of_edges[:, [1, 2, 0]].reshape(-1, 3)
    a, u, v = triangles[:, 0], triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    normal = np.cross(u, v)
    offset = np.sum(a * normal, axis=1)
    step = EDGES_AT_ONCE // max(len(triangles), 1) + 1
    for i in range(0, len(starts), step):
        start, end = starts[i : i + step], ends[i : i + step]
        before, behind = start @ normal.T - offset, end @ normal.T - offset
        e, t = np.nonzero(before * behind < 0.0)
        share = before[e, t] / (before[e, t] - behind[e, t])
        x = start[e] + share[:, None] * (end - start)[e] - a[t]
        square = np.sum(normal[t] ** 2, axis=1)
        along_u = np.sum(np.cross(x, v[t]) * normal[t], axis=1) / square
        along_v = np.sum(np.cross(u[t], x) * normal[t], axis=1) / square
        if np.any((along_u > 0.0) & (along_v > 0.0) & (along_u + along_v < 1.0)):
            return True
    return False
