"""A breakable body by brute force: the owner of a point; the exact surface, depth and mass of each fragment.

The rule is the one of the inside test (docs/numerics.md): cracks run through the points where they cross the mesh
edges. Each tetrahedron with nodes of several fragments is divided into 24 small tetrahedra, one for each of its nodes
i, an edge i-j at it and a face i-j-l at that: of the node, the edge's crossing, the face's point and the tetrahedron's
hub. Each belongs to the fragment of its node. Crossings and face points are the same in all tetrahedra that meet there,
so that the regions fit together, for any planes.
"""

from __future__ import annotations

from functools import cached_property
from itertools import permutations
from typing import NamedTuple

import numpy as np

from fracture_collision.geometry.tetrahedra import (
    FACE_VERTICES,
    face_neighbours,
    tetrahedron_edges,
    tetrahedron_volumes,
    unique_edges,
)
from fracture_collision.records import FractureEvent
from oracles.brute_force import NO_VOLUME, Partition, nearest_on_triangles, owners, partition_of
from oracles.convex_cells import area_vector
from oracles.crack_surface import EDGE_BETWEEN, CrackSurface, Cuts, crack_surface

ORIGINAL = "original"  # part of the unbroken body's boundary
CRACK = "crack"  # between two fragments, inside a tetrahedron
ALL_KINDS = (ORIGINAL, CRACK)

# Polygons below this share of their tetrahedron's longest edge squared are rounding, and border on real ones.
NO_AREA = 1e-14

# The parts of a tetrahedron: their node, the edge's other node, the edge, the face (by the node opposite), and whether
# node, edge, face and hub are positively oriented in this order.
NODE, OTHER, FACE = (np.array([p[k] for p in permutations(range(4))]) for k in (0, 1, 3))
EDGE = EDGE_BETWEEN[NODE, OTHER]
IS_POSITIVE = np.array([np.linalg.det(np.eye(4)[list(p)]) > 0.0 for p in permutations(range(4))])


class SurfacePolygon(NamedTuple):
    points: np.ndarray  # (3, 3) [m], counter-clockwise from outside the fragment
    kind: str
    tetrahedron: int
    other: int  # the fragment behind; 0 outside the body


class Parts(NamedTuple):
    """The 24 parts of each of the c tetrahedra with nodes of several fragments."""

    tetrahedra: np.ndarray  # (c,) ascending
    row: np.ndarray  # (m,) of each tetrahedron of the body, -1 if it belongs to one fragment
    surface: CrackSurface
    labels: np.ndarray  # (c, 24)
    behind: np.ndarray  # (c, 24) the fragment beyond the edge's crossing, perhaps the same
    weights: np.ndarray  # (c, 24, 4, 4) of node, edge, face and hub in the tetrahedron's nodes
    corners: np.ndarray  # (c, 24, 4, 3) [m] the same
    share: np.ndarray  # (c, 24) of the tetrahedron's volume
    to_part: np.ndarray  # (c, 24, 4, 4) weights in a tetrahedron @ to_part are weights in a part


def uniform_points(
    vertices: np.ndarray, tetrahedra: np.ndarray, count: int, random: np.random.Generator
) -> np.ndarray:
    """Points (count, 3) [m] uniform over the volume of a body."""
    volumes = tetrahedron_volumes(vertices, tetrahedra)
    corners = vertices[tetrahedra[random.choice(len(volumes), count, p=volumes / volumes.sum())]]
    return np.einsum("nij,ni->nj", corners, random.dirichlet(np.ones(4), count))


class FragmentedBody:
    """A tetrahedral body (vertices (n, 3) [m], tetrahedra (m, 4)) and the fracture events it has seen."""

    def __init__(self, vertices: np.ndarray, tetrahedra: np.ndarray, fragment_id: int = 1) -> None:
        self.vertices = np.asarray(vertices, dtype=np.float64).reshape(-1, 3)
        self.tetrahedra = np.asarray(tetrahedra).reshape(-1, 4).astype(np.int64)
        self.edges = unique_edges(self.tetrahedra)
        self.neighbours = face_neighbours(self.tetrahedra)
        self.labels = np.full(len(self.vertices), fragment_id, dtype=np.int64)
        self.planes: dict[tuple[int, int], np.ndarray] = {}  # (a, b), a < b: (normal from a to b, offset)
        self.events: dict[tuple[int, int], int] = {}  # (a, b), a < b: number of events including the one that cut it
        self._event_count = 0
        self._edges_of = tetrahedron_edges(self.tetrahedra, self.edges)
        self._volumes = tetrahedron_volumes(self.vertices, self.tetrahedra)
        corners = self.vertices[self.tetrahedra]
        self._to_barycentric = np.linalg.inv(np.concatenate((corners, np.ones((*corners.shape[:2], 1))), axis=2))
        self._polygon_cache: dict[int, list[SurfacePolygon]] = {}
        self._surface_cache: dict[tuple, np.ndarray] = {}

    @property
    def fragment_ids(self) -> list[int]:
        return sorted(set(self.labels.tolist()))

    def apply(self, event: FractureEvent) -> None:
        """Applies a fracture event; the planes of earlier events stay."""
        nodes = np.asarray(event.nodes, dtype=np.int64)
        if set(nodes.tolist()) != set(np.flatnonzero(self.labels == event.fragment_id).tolist()):
            raise ValueError(f"nodes: not those of fragment {event.fragment_id}")
        self._polygon_cache.clear()
        self._surface_cache.clear()
        for kept in ("parts", "partition"):
            self.__dict__.pop(kept, None)
        self._event_count += 1
        self.labels[nodes] = np.asarray(event.new_fragment_ids, dtype=np.int64)[event.node_fragments]
        cut = np.asarray(event.cut_edges, dtype=np.int64).reshape(-1, 2)
        planes = np.asarray(event.cut_planes, dtype=np.float64).reshape(-1, 4)
        for (a, b), plane in zip(cut.tolist(), planes, strict=True):
            edge = (min(a, b), max(a, b))
            if edge in self.planes:
                raise ValueError(f"cut_edges: {edge} is cut a second time")
            self.planes[edge] = plane if a < b else -plane
            self.events[edge] = self._event_count
        uncut = {(int(a), int(b)) for a, b in self.edges if self.labels[a] != self.labels[b]} ^ set(self.planes)
        if uncut:
            raise ValueError(f"cut_edges: {sorted(uncut)[0]} is missing, or joins one fragment")

    @cached_property
    def parts(self) -> Parts:
        """The present parts of the tetrahedra with nodes of several fragments."""
        labels = self.labels[self.tetrahedra]
        cut = np.flatnonzero(np.any(labels != labels[:, :1], axis=1))
        row = np.full(len(self.tetrahedra), -1)
        row[cut] = np.arange(len(cut))
        ends = [tuple(ends) for ends in self.edges.tolist()]
        cuts = Cuts(
            self.edges,
            np.array([self.planes.get(edge, np.zeros(4)) for edge in ends]),
            np.array([self.events.get(edge, 0) for edge in ends]),
        )
        surface = crack_surface(self.vertices, self.tetrahedra[cut], self._edges_of[cut], cuts)
        weights = np.zeros((len(cut), 24, 4, 4))
        weights[:, np.arange(24), 0, NODE] = 1.0
        weights[:, :, 1] = surface.edge_points[:, EDGE]
        weights[:, :, 2] = surface.face_points[:, FACE]
        weights[:, :, 3] = surface.hubs[:, None]
        share = np.where(IS_POSITIVE, 1.0, -1.0) * np.linalg.det(weights)
        regular = np.where((share > NO_VOLUME)[..., None, None], weights, np.eye(4))
        corners = weights @ self.vertices[self.tetrahedra[cut]][:, None]
        return Parts(cut, row, surface, labels[cut][:, NODE], labels[cut][:, OTHER], weights, corners, share,
                     np.linalg.inv(regular))  # fmt: skip

    def locate(self, points: np.ndarray) -> np.ndarray:
        """The tetrahedron that best contains each point, -1 outside the body."""
        result = np.empty(len(points), dtype=np.int64)
        for i, x in enumerate(np.column_stack((points, np.ones(len(points))))):
            depth = (x @ self._to_barycentric).min(axis=1)
            best = int(np.argmax(depth))
            result[i] = best if depth[best] >= -1e-13 else -1
        return result

    @cached_property
    def partition(self) -> Partition:
        """The present parts, for the search of owners."""
        return partition_of(self)

    def owner(self, points: np.ndarray) -> np.ndarray:
        """The fragment that each point (n, 3) belongs to, 0 outside the body."""
        return owners(self.partition, points)[0]

    def surface_polygons(self, fragment_id: int, kinds: tuple[str, ...] = ALL_KINDS) -> list[SurfacePolygon]:
        """The exact boundary of the fragment's region, in triangles, in the order of the tetrahedra."""
        if fragment_id not in self._polygon_cache:
            self._polygon_cache[fragment_id] = self._all_polygons(fragment_id)
        return [p for p in self._polygon_cache[fragment_id] if p.kind in kinds]

    def _all_polygons(self, fragment_id: int) -> list[SurfacePolygon]:
        result = []
        for t in self._tetrahedra_with(fragment_id):
            corners = self.vertices[self.tetrahedra[t]]
            smallest = NO_AREA * max(np.sum((p - q) ** 2) for p in corners for q in corners)
            result += [p for p in self._polygons_in(fragment_id, t) if _area(p.points) > smallest]
        return result

    def _polygons_in(self, fragment_id: int, t: int) -> list[SurfacePolygon]:
        nodes, row = self.tetrahedra[t], int(self.parts.row[t])
        is_free = self.neighbours[t] < 0
        is_whole = [set(self.labels[nodes[FACE_VERTICES[k]]].tolist()) == {fragment_id} for k in range(4)]
        result = [
            SurfacePolygon(self.vertices[nodes[FACE_VERTICES[k]]], ORIGINAL, t, 0)
            for k in range(4)
            if is_free[k] and is_whole[k]
        ]
        if row < 0:
            return result
        for p in np.flatnonzero(self.parts.labels[row] == fragment_id).tolist():
            node, edge, face, hub = self.parts.corners[row, p]
            turn = 1 if IS_POSITIVE[p] else -1  # opposite its corners in order, the triangle's are seen from outside
            if is_free[FACE[p]] and not is_whole[FACE[p]]:
                result.append(SurfacePolygon(np.array((node, face, edge))[::turn], ORIGINAL, t, 0))
            if self.parts.behind[row, p] != fragment_id:
                other = int(self.parts.behind[row, p])
                result.append(SurfacePolygon(np.array((edge, face, hub))[::turn], CRACK, t, other))
        return result

    def surface_triangles(self, fragment_id: int, kinds: tuple[str, ...] = ALL_KINDS) -> np.ndarray:
        """The surface polygons' corners (t, 3, 3)."""
        if (fragment_id, kinds) not in self._surface_cache:
            triangles = np.array([p.points for p in self.surface_polygons(fragment_id, kinds)]).reshape(-1, 3, 3)
            a, b, c = (triangles[:, i] for i in range(3))
            triangles = triangles[np.any(np.cross(b - a, c - a) != 0.0, axis=1)]
            self._surface_cache[fragment_id, kinds] = triangles
        return self._surface_cache[fragment_id, kinds]

    def distance_to_surface(
        self, fragment_id: int, points: np.ndarray, kinds: tuple[str, ...] = ALL_KINDS
    ) -> tuple[np.ndarray, np.ndarray]:
        """Distance (n,) [m] of points on either side to the fragment's surface, and the nearest points on it."""
        return nearest_on_triangles(np.asarray(points, dtype=np.float64), self.surface_triangles(fragment_id, kinds))

    def depth(
        self, fragment_id: int, points: np.ndarray, kinds: tuple[str, ...] = ALL_KINDS
    ) -> tuple[np.ndarray, np.ndarray]:
        """Depth (n,) [m] of each point in the fragment, 0 for those that it does not own; nearest surface points."""
        distance, nearest = self.distance_to_surface(fragment_id, points, kinds)
        return np.where(self.owner(points) == fragment_id, distance, 0.0), nearest

    def mass_properties(self, fragment_id: int, density: float = 1.0) -> tuple[float, np.ndarray, np.ndarray]:
        """Mass [kg], centre of mass (3,) [m] and inertia about it (3, 3) [kg m2], body axes."""
        corners, volumes = self._pieces(fragment_id)
        totals = corners.sum(axis=1)
        volume, first = volumes.sum(), volumes @ totals / 4.0
        second = np.einsum("t,tki,tkj->ij", volumes / 20.0, corners, corners)
        second += np.einsum("t,ti,tj->ij", volumes / 20.0, totals, totals)
        centre = first / volume
        about_centre = second - volume * np.outer(centre, centre)
        inertia = np.trace(about_centre) * np.eye(3) - about_centre
        return density * float(volume), centre, density * inertia

    def volume(self, fragment_id: int) -> float:
        """The volume [m3]."""
        return float(self._pieces(fragment_id)[1].sum())

    def _pieces(self, fragment_id: int) -> tuple[np.ndarray, np.ndarray]:
        """The tetrahedra that make up the fragment: corners (k, 4, 3) [m] and volumes (k,) [m3]."""
        own, parts = self.parts.labels == fragment_id, self.parts
        whole = np.flatnonzero((parts.row < 0) & (self.labels[self.tetrahedra[:, 0]] == fragment_id))
        corners = np.concatenate((self.vertices[self.tetrahedra[whole]], parts.corners[own]))
        volumes = np.concatenate((self._volumes[whole], (parts.share * self._volumes[parts.tetrahedra, None])[own]))
        return corners, volumes

    def _tetrahedra_with(self, fragment_id: int) -> list[int]:
        return np.flatnonzero(np.any(self.labels[self.tetrahedra] == fragment_id, axis=1)).tolist()


def _area(points: np.ndarray) -> float:
    return float(np.linalg.norm(area_vector(points)))
