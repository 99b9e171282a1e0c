"""The averaged field straight from eq. 1 and 2 of Glondu 2014: dictionaries, loops, brute-force distances."""

from __future__ import annotations

import numpy as np

from fracture_collision.geometry.tetrahedra import EDGE_VERTICES, boundary_triangles
from fracture_collision.records import FractureEvent
from oracles.brute_force import nearest_on_triangles
from oracles.fragmented_body import FragmentedBody

SHORTER = 1e-12  # of R: a smaller reduction is rounding


class AveragedField:
    """Distance [m] and direction of every node of an unbroken body, updated by fractures."""

    def __init__(self, body: FragmentedBody) -> None:
        self.body = body
        self.radius = 0.5 * float(np.ptp(body.vertices, axis=0).max())
        self.distance: dict[int, float] = {}
        self.direction: dict[int, np.ndarray] = {}
        self.neighbours: dict[int, list[int]] = {v: [] for v in range(len(body.vertices))}
        for a, b in body.edges.tolist():
            self.neighbours[a].append(b)
            self.neighbours[b].append(a)
        surface = boundary_triangles(body.tetrahedra)
        normals: dict[int, np.ndarray] = {}
        for triangle in surface.tolist():
            for i in range(3):
                a, b, c = (body.vertices[triangle[(i + k) % 3]] for k in range(3))
                u, v = (b - a) / np.linalg.norm(b - a), (c - a) / np.linalg.norm(c - a)
                face = np.cross(u, v) / np.linalg.norm(np.cross(u, v))
                normals[triangle[i]] = normals.get(triangle[i], np.zeros(3)) + np.arccos(u @ v) * face
        for node, normal in normals.items():
            self.distance[node], self.direction[node] = 0.0, normal / np.linalg.norm(normal)
        for node in sorted(set(self.neighbours) - set(normals)):
            self._measure(node, body.vertices[surface])

    def apply(self, event: FractureEvent) -> int:
        """Break the body and update the nodes of the broken fragment; returns the number of steps of the fronts."""
        body = self.body
        body.apply(event)
        new_edges = {tuple(sorted(e)) for e in np.asarray(event.cut_edges).reshape(-1, 2).tolist()}
        polygons = {
            f: body.surface_polygons(f) for f in np.asarray(event.new_fragment_ids, dtype=int).tolist()
        }
        front: set[int] = set()
        for t, nodes in enumerate(body.tetrahedra):
            if not new_edges.isdisjoint(tuple(sorted(e)) for e in nodes[EDGE_VERTICES].tolist()):
                for node in nodes.tolist():
                    if int(body.labels[node]) in polygons:
                        front.add(node)
                        local = _triangles([p for p in polygons[int(body.labels[node])] if p.tetrahedron == t])
                        if len(local):
                            self._measure(node, local)
        steps = 0
        while front:
            steps += 1
            candidates = {p for j in front for p in self.neighbours[j] if body.labels[p] == body.labels[j]}
            averages = {p: self._average(body.vertices[p], self._front_of(p, front)) for p in candidates}
            front = {p for p, (d, _) in averages.items() if 0.0 <= d < self.distance[p] - SHORTER * self.radius}
            for p in front:
                self.distance[p], self.direction[p] = averages[p]
        return steps

    def penetration(self, fragment: int, t: int, x: np.ndarray) -> tuple[float, np.ndarray]:
        """Depth [m] and direction in tetrahedron t that holds x, before the grid of the whole body caps it."""
        nodes = self.body.tetrahedra[t].tolist()
        if len({int(f) for f in self.body.labels[nodes]}) > 1:
            surface = [p for p in self.body.surface_polygons(fragment) if p.tetrahedron == t]
            if surface:
                distance, nearest = nearest_on_triangles(x[None], _triangles(surface))
                return float(distance[0]), (nearest[0] - x) / distance[0]
            nodes = [v for v in nodes if self.body.labels[v] == fragment]
        distance, direction = self._average(x, nodes)
        return max(distance, 0.0), direction

    def _measure(self, node: int, triangles: np.ndarray) -> None:
        """Keep the distance to the nearest of some triangles (t, 3, 3) if it is shorter than the stored one."""
        x = self.body.vertices[node]
        distance, nearest = nearest_on_triangles(x[None], triangles)
        if distance[0] < self.distance.get(node, np.inf):
            self.distance[node], self.direction[node] = float(distance[0]), (nearest[0] - x) / distance[0]

    def _front_of(self, p: int, front: set[int]) -> list[int]:
        return [j for j in sorted(self.neighbours[p]) if j in front and self.body.labels[j] == self.body.labels[p]]

    def _average(self, x: np.ndarray, nodes: list[int]) -> tuple[float, np.ndarray]:
        offsets = [self.body.vertices[j] - x for j in nodes]
        weights = [1.0 / float(o @ o) for o in offsets]
        distance = sum(
            w * (self.distance[j] + self.direction[j] @ o) for w, j, o in zip(weights, nodes, offsets, strict=True)
        )
        direction = sum(w * self.direction[j] for w, j in zip(weights, nodes, strict=True))
        return float(distance / sum(weights)), direction / np.linalg.norm(direction)


def _triangles(polygons: list) -> np.ndarray:
    triangles = np.array([p.points for p in polygons]).reshape(-1, 3, 3)
    areas = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    return triangles[np.any(areas != 0.0, axis=1)]
