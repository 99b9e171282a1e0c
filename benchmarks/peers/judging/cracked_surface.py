"""Closed triangle meshes of the fragments of a labelled tetrahedral body, one vertex a cut edge (marching tetrahedra).

A user of any other library would make these first; their size is as counted by Glondu et al. 2014 (virtual nodes).
Neighbours share their crack to the bit. Where planes differ from edge to edge, the service's own regions have
second-order steps, which such a mesh lacks, and thirty times as many triangles.
"""

from __future__ import annotations

from itertools import combinations

import numpy as np

from fracture_collision.geometry.tetrahedra import face_neighbours

Polygon = list[tuple[int, ...]]  # corners, each named by the nodes whose cut it lies on: 1 node, 2 (edge) to 4


def cracked_surfaces(
    vertices: np.ndarray, tetrahedra: np.ndarray, labels: np.ndarray, crossings: dict[tuple[int, int], np.ndarray]
) -> dict[int, tuple[np.ndarray, np.ndarray]]:
    """For each label its mesh: vertices (n, 3) [m] and triangles (t, 3), counter-clockwise from outside.

    `labels` (v,): the fragment of each vertex; `crossings`: for each edge (a, b), a < b, between two fragments, the
    point where it is cut. Raises KeyError for an edge without one, ValueError if a mesh does not close.
    """
    builder = _Builder(vertices, labels, crossings)
    neighbours = face_neighbours(tetrahedra)
    mixed = np.ptp(labels[tetrahedra], axis=1) > 0
    for t in np.flatnonzero(mixed).tolist():
        builder.cracks(tetrahedra[t].tolist())
    for t, face in np.argwhere(neighbours < 0).tolist():
        nodes = tetrahedra[t].tolist()
        builder.old_face([n for i, n in enumerate(nodes) if i != face], nodes[face])
    return builder.meshes()


class _Builder:
    def __init__(self, vertices, labels, crossings) -> None:
        self._points = vertices
        self._label = labels.tolist()
        self._places: dict[tuple[int, ...], np.ndarray] = {(n,): x for n, x in enumerate(vertices)}
        self._places |= crossings
        self._triangles: dict[int, list[tuple[tuple[int, ...], ...]]] = {}

    def cracks(self, nodes: list[int]) -> None:
        by_label: dict[int, list[int]] = {}
        for n in sorted(nodes):
            by_label.setdefault(self._label[n], []).append(n)
        for one, two in combinations(by_label, 2):
            ahead = self._points[by_label[two]].mean(axis=0) - self._points[by_label[one]].mean(axis=0)
            for polygon in self._interface(by_label[one], by_label[two], len(by_label), sorted(nodes)):
                self._add(one, polygon, ahead)
                self._add(two, polygon, -ahead)

    def _interface(self, own: list[int], other: list[int], labels: int, nodes: list[int]) -> list[Polygon]:
        """Between two of a tetrahedron's labels."""
        if labels == 2:  # a triangle, or a quadrangle around the two uncut edges
            cuts = [_cut(a, b) for a in own for b in (other if a == own[0] else other[::-1])]
            return [cuts]
        if labels == 3 and len(own) + len(other) == 2:  # up to the line where three fragments meet
            return [[_cut(*own, *other), *(self._meeting((*own, *other, n)) for n in nodes if n not in own + other)]]
        third = [n for n in nodes if n not in own + other]
        if labels == 3:
            (a, b), single = (own, other[0]) if len(own) == 2 else (other, own[0])
            return [
                [_cut(a, single), _cut(b, single), self._meeting((b, single, *third)),
                 self._meeting((a, single, *third))]
            ]  # fmt: skip
        edge = (*own, *other)
        return [
            [_cut(*edge), self._meeting((*edge, third[0])), self._meeting(tuple(nodes)),
             self._meeting((*edge, third[1]))]
        ]  # fmt: skip

    def old_face(self, nodes: list[int], behind: int) -> None:
        outward = self._points[nodes].mean(axis=0) - self._points[behind]
        count = len({self._label[n] for n in nodes})
        for i, n in enumerate(nodes):
            a, b = nodes[i - 1], nodes[i - 2]
            same_a, same_b = self._label[a] == self._label[n], self._label[b] == self._label[n]
            if count == 1:
                self._add(self._label[n], [(n,), (a,), (b,)], outward)
                return
            if count == 3:
                self._add(self._label[n], [(n,), _cut(n, a), self._meeting(tuple(nodes)), _cut(n, b)], outward)
            elif not same_a and not same_b:
                self._add(self._label[n], [(n,), _cut(n, a), _cut(n, b)], outward)
                self._add(self._label[a], [(a,), (b,), _cut(n, b), _cut(n, a)], outward)

    def _meeting(self, nodes: tuple[int, ...]) -> tuple[int, ...]:
        """The point where three or four fragments meet: the mean of the cut points of the edges between them."""
        name = tuple(sorted(nodes))
        if name not in self._places:
            cuts = [self._places[edge] for edge in combinations(name, 2) if edge in self._places]
            self._places[name] = np.mean(cuts, axis=0)
        return name

    def _add(self, label: int, polygon: Polygon, outward: np.ndarray) -> None:
        x = np.array([self._places[corner] for corner in polygon])
        fan = [(polygon[0], polygon[i], polygon[i + 1]) for i in range(1, len(polygon) - 1)]
        if np.cross(x[1:-1] - x[0], x[2:] - x[0]).sum(axis=0) @ outward < 0.0:
            fan = [(a, c, b) for a, b, c in fan]
        self._triangles.setdefault(label, []).extend(fan)

    def meshes(self) -> dict[int, tuple[np.ndarray, np.ndarray]]:
        made = {}
        for label, corners in sorted(self._triangles.items()):
            number: dict[tuple[int, ...], int] = {}
            triangles = np.array([[number.setdefault(c, len(number)) for c in t] for t in corners])
            directed = triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
            code = directed @ np.array([len(number), 1])
            back = directed @ np.array([1, len(number)])
            if not np.array_equal(np.sort(code), np.sort(back)):
                raise ValueError(f"fragment {label}: its mesh does not close")
            made[label] = np.array([self._places[c] for c in number]), triangles
        return made


def _cut(a: int, b: int) -> tuple[int, int]:
    return (a, b) if a < b else (b, a)
