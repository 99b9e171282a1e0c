"""A breakable body by brute force: who owns a point, the exact surface, depth and mass of each fragment.

The rule is the one of the inside test: in a tetrahedron with nodes of several fragments, the margin of fragment f is
the smallest signed distance (positive on f's side) to the planes of the tetrahedron's cut edges between f and another
fragment. A point belongs to the fragment of the largest margin, the smallest id at ties. For any planes, consistent or
not, that divides the body. The margins are not continuous from one tetrahedron to the next when planes are
inconsistent, so a fragment's surface has steps: parts of tetrahedron faces with f on one side and another behind.
"""

from __future__ import annotations

from itertools import product
from typing import NamedTuple

import numpy as np

from fracture_collision.geometry.tetrahedra import EDGE_VERTICES, face_neighbours, unique_edges
from fracture_collision.records import FractureEvent
from oracles.convex_cells import Face, area_vector, clip, clip_polygon, moments, nearest_on_triangles, tetrahedron

ORIGINAL = "original"  # part of the unbroken body's boundary
CRACK = "crack"  # equal margins, inside a tetrahedron
BARE_FACE = "bare face"  # a tetrahedron face whose tetrahedron behind has no node of the fragment
STEP = "step"  # a part of a tetrahedron face with another fragment behind, though that tetrahedron holds some of both
ALL_KINDS = (ORIGINAL, CRACK, BARE_FACE, STEP)

# Polygons below this share of their tetrahedron's longest edge squared are rounding, and border on real ones.
NO_AREA = 1e-14


class SurfacePolygon(NamedTuple):
    points: np.ndarray  # (k, 3) [m], convex, counter-clockwise from outside the fragment
    kind: str
    tetrahedron: int
    other: int  # the fragment behind; 0 outside the body


class Cell(NamedTuple):
    faces: list[Face]
    halfspaces: list[tuple[np.ndarray, float]]  # normal . x >= offset, beside the tetrahedron's own four


class FragmentedBody:
    """A tetrahedral body (vertices (n, 3) [m], tetrahedra (m, 4)) and the fracture events it has seen."""

    def __init__(self, vertices: np.ndarray, tetrahedra: np.ndarray, fragment_id: int = 1) -> None:
        self.vertices = np.asarray(vertices, dtype=np.float64).reshape(-1, 3)
        self.tetrahedra = np.asarray(tetrahedra).reshape(-1, 4).astype(np.int64)
        self.edges = unique_edges(self.tetrahedra)
        self.neighbours = face_neighbours(self.tetrahedra)
        self.labels = np.full(len(self.vertices), fragment_id, dtype=np.int64)
        self.planes: dict[tuple[int, int], np.ndarray] = {}  # (a, b), a < b: (normal from a to b, offset)
        corners = self.vertices[self.tetrahedra]
        self._to_barycentric = np.linalg.inv(np.concatenate((corners, np.ones((*corners.shape[:2], 1))), axis=2))
        self._cell_cache: dict[tuple, dict[int, list[Cell]]] = {}
        self._polygon_cache: dict[int, list[SurfacePolygon]] = {}
        self._surface_cache: dict[tuple, np.ndarray] = {}

    @property
    def fragment_ids(self) -> list[int]:
        return sorted(set(self.labels.tolist()))

    def apply(self, event: FractureEvent) -> None:
        """Take a fracture event over; the planes of earlier events stay."""
        nodes = np.asarray(event.nodes, dtype=np.int64)
        if set(nodes.tolist()) != set(np.flatnonzero(self.labels == event.fragment_id).tolist()):
            raise ValueError(f"nodes: not those of fragment {event.fragment_id}")
        self._polygon_cache.clear()
        self._surface_cache.clear()
        self.labels[nodes] = np.asarray(event.new_fragment_ids, dtype=np.int64)[event.node_fragments]
        cut = np.asarray(event.cut_edges, dtype=np.int64).reshape(-1, 2)
        planes = np.asarray(event.cut_planes, dtype=np.float64).reshape(-1, 4)
        for (a, b), plane in zip(cut.tolist(), planes, strict=True):
            edge = (min(a, b), max(a, b))
            if edge in self.planes:
                raise ValueError(f"cut_edges: {edge} is cut a second time")
            self.planes[edge] = plane if a < b else -plane
        uncut = {(int(a), int(b)) for a, b in self.edges if self.labels[a] != self.labels[b]} ^ set(self.planes)
        if uncut:
            raise ValueError(f"cut_edges: {sorted(uncut)[0]} is missing, or joins one fragment")

    def locate(self, points: np.ndarray) -> np.ndarray:
        """The tetrahedron that holds each point best, -1 outside the body."""
        result = np.empty(len(points), dtype=np.int64)
        for i, x in enumerate(np.column_stack((points, np.ones(len(points))))):
            depth = (x @ self._to_barycentric).min(axis=1)
            best = int(np.argmax(depth))
            result[i] = best if depth[best] >= -1e-13 else -1
        return result

    def owner(self, points: np.ndarray) -> np.ndarray:
        """The fragment that each point (n, 3) belongs to, 0 outside the body."""
        tets = self.locate(points)
        owners = np.zeros(len(points), dtype=np.int64)
        for i, t in enumerate(tets.tolist()):
            if t >= 0:
                margins = self._margins(t, points[i])
                owners[i] = min(margins, key=lambda f: (-margins[f], f))
        return owners

    def _margins(self, t: int, x: np.ndarray) -> dict[int, float]:
        planes = self._planes_of(t)
        return {f: min((x @ p[:3] - p[3] for p in own), default=np.inf) for f, own in planes.items()}

    def _planes_of(self, t: int) -> dict[int, dict[tuple, None]]:
        """For each fragment with a node in tetrahedron t, the planes (normal, offset) of its cut edges, positive on its
        side: an ordered set, so that a plane that several edges share counts once."""
        nodes = self.tetrahedra[t]
        planes: dict[int, dict[tuple, None]] = {int(f): {} for f in sorted(set(self.labels[nodes].tolist()))}
        for a, b in np.sort(nodes[EDGE_VERTICES], axis=1).tolist():
            if self.labels[a] != self.labels[b]:
                for node, sign in ((b, 1.0), (a, -1.0)):
                    plane = tuple((sign * self.planes[a, b] + 0.0).tolist())  # + 0.0: -0.0 is 0.0
                    planes[int(self.labels[node])][plane] = None
        return planes

    def cells(self, t: int) -> dict[int, list[Cell]]:
        """The convex cells that each fragment's region in tetrahedron t is made of.

        For every choice of one plane e_h for each fragment h other than f, the set where e_h gives h's margin and where
        all of f's planes give at least that much is convex. Faces are labelled ("face", i) opposite corner i,
        ("crack", h), or ("inner", 0) between two cells of f.
        """
        key = (t, *self.labels[self.tetrahedra[t]].tolist())
        if key not in self._cell_cache:
            planes = self._planes_of(t)
            whole = tetrahedron(self.vertices[self.tetrahedra[t]])
            self._cell_cache[key] = {f: self._cells_of(f, planes, whole) for f in planes}
        return self._cell_cache[key]

    @staticmethod
    def _cells_of(f: int, planes: dict[int, dict[tuple, None]], whole: list[Face]) -> list[Cell]:
        others = [h for h in planes if h != f]
        result = []
        for choice in product(*(planes[h] for h in others)):
            if any(chosen in planes[f] and f > h for h, chosen in zip(others, choice, strict=True)):
                continue  # equal margins all over: the smaller id has them
            # Fragments that share an old plane give the same half-space more than once; cutting twice by one plane
            # would cut slivers out of rounding. So: each difference of two planes once, with the fragments it concerns.
            rivals: dict[tuple, list[int]] = {}
            for h, chosen in zip(others, choice, strict=True):
                for plane in dict.fromkeys((*planes[h], *planes[f])):
                    if plane != chosen:
                        rivals.setdefault((plane, chosen), []).append(h)
            faces, halfspaces = whole, []
            for (plane, chosen), concerned in rivals.items():
                difference = np.array(plane) - np.array(chosen)
                halfspaces.append((difference[:3], difference[3]))
                faces = clip(faces, *halfspaces[-1], FragmentedBody._label(f, plane, concerned, planes))
                if not faces:
                    break
            else:
                faces = [FragmentedBody._decided(f, face, halfspaces, planes) for face in faces]
                result.append(Cell(faces, halfspaces))
        return result

    @staticmethod
    def _decided(f: int, face: Face, halfspaces: list[tuple[np.ndarray, float]], planes: dict[int, dict]) -> Face:
        """The face, labelled anew where several halfspaces end in it: what lies just behind it has the word."""
        (kind, _), points = face
        if kind == "face" or len(halfspaces) < 2:
            return face
        normals, offsets = np.array([n for n, _ in halfspaces]), np.array([o for _, o in halfspaces])
        size = np.abs(points).max()
        if np.count_nonzero(np.abs(points @ normals.T - offsets).max(axis=0) <= 1e-14 * size) < 2:
            return face
        outward = area_vector(points)
        length = np.linalg.norm(outward)
        if length == 0.0:
            return face
        behind = points.mean(axis=0) + 1e-6 * size * outward / length
        margins = {g: min(behind @ p[:3] - p[3] for p in own) for g, own in planes.items()}
        owner = min(margins, key=lambda g: (-margins[g], g))
        return face._replace(label=("inner", 0) if owner == f else ("crack", owner))

    @staticmethod
    def _label(f: int, plane: tuple, concerned: list[int], planes: dict[int, dict[tuple, None]]) -> tuple:
        """What lies behind the face where `plane` gets smaller than the margin of the concerned fragments."""
        if plane in planes[f]:
            ahead = [h for h in concerned if plane not in planes[h]] or [h for h in concerned if h < f]
            if ahead:
                return ("crack", min(ahead))
        return ("inner", 0)

    def surface_polygons(self, fragment_id: int, kinds: tuple[str, ...] = ALL_KINDS) -> list[SurfacePolygon]:
        """The exact boundary of the fragment's region, in convex polygons, in the order of the tetrahedra."""
        if fragment_id not in self._polygon_cache:
            self._polygon_cache[fragment_id] = self._all_polygons(fragment_id)
        return [p for p in self._polygon_cache[fragment_id] if p.kind in kinds]

    def _all_polygons(self, fragment_id: int) -> list[SurfacePolygon]:
        result = []
        for t in self._tetrahedra_with(fragment_id):
            corners = self.vertices[self.tetrahedra[t]]
            smallest = NO_AREA * max(np.sum((p - q) ** 2) for p in corners for q in corners)
            for cell in self.cells(t)[fragment_id]:
                for (kind, index), points in cell.faces:
                    if kind == "crack":
                        parts = [SurfacePolygon(points, CRACK, t, index)]
                    elif kind == "face":
                        parts = self._parts_of_face(fragment_id, t, index, points)
                    else:
                        continue
                    result += [p for p in parts if _area(p.points) > smallest]
        return result

    def _parts_of_face(self, fragment_id: int, t: int, face: int, points: np.ndarray) -> list[SurfacePolygon]:
        behind = int(self.neighbours[t, face])
        if behind < 0:
            return [SurfacePolygon(points, ORIGINAL, t, 0)]
        kind = STEP if fragment_id in self.labels[self.tetrahedra[behind]] else BARE_FACE
        parts = []
        for other, cells in self.cells(behind).items():
            for cell in cells if other != fragment_id else ():
                common = points
                for normal, offset in cell.halfspaces:
                    common = clip_polygon(common, common @ normal - offset)
                if len(common) >= 3:
                    parts.append(SurfacePolygon(common, kind, t, other))
        return parts

    def surface_triangles(self, fragment_id: int, kinds: tuple[str, ...] = ALL_KINDS) -> np.ndarray:
        """The surface polygons as fans of triangles (t, 3, 3)."""
        if (fragment_id, kinds) in self._surface_cache:
            return self._surface_cache[fragment_id, kinds]
        fans = [
            np.stack((np.broadcast_to(p.points[0], (len(p.points) - 2, 3)), p.points[1:-1], p.points[2:]), axis=1)
            for p in self.surface_polygons(fragment_id, kinds)
        ]
        triangles = np.concatenate(fans)
        a, b, c = (triangles[:, i] for i in range(3))
        triangles = triangles[np.any(np.cross(b - a, c - a) != 0.0, axis=1)]
        self._surface_cache[fragment_id, kinds] = triangles
        return triangles

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

    def distance_outside(
        self, fragment_id: int, points: np.ndarray, kinds: tuple[str, ...] = ALL_KINDS
    ) -> tuple[np.ndarray, np.ndarray]:
        """Distance (n,) [m] of each point outside to the fragment, 0 for those that it owns; nearest surface points."""
        distance, nearest = self.distance_to_surface(fragment_id, points, kinds)
        return np.where(self.owner(points) == fragment_id, 0.0, distance), nearest

    def mass_properties(self, fragment_id: int, density: float = 1.0) -> tuple[float, np.ndarray, np.ndarray]:
        """Mass [kg], centre of mass (3,) [m] and inertia about it (3, 3) [kg m2], body axes."""
        volume, first, second = 0.0, np.zeros(3), np.zeros((3, 3))
        for t in self._tetrahedra_with(fragment_id):
            for cell in self.cells(t)[fragment_id]:
                v, f, s = moments(cell.faces)
                volume, first, second = volume + v, first + f, second + s
        centre = first / volume
        about_centre = second - volume * np.outer(centre, centre)
        inertia = np.trace(about_centre) * np.eye(3) - about_centre
        return density * volume, centre, density * inertia

    def volume(self, fragment_id: int) -> float:
        """[m3]"""
        return self.mass_properties(fragment_id)[0]

    def _tetrahedra_with(self, fragment_id: int) -> list[int]:
        return np.flatnonzero(np.any(self.labels[self.tetrahedra] == fragment_id, axis=1)).tolist()


def _area(points: np.ndarray) -> float:
    return float(np.linalg.norm(area_vector(points)))
