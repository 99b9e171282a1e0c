"""Connectivity and volumes of tetrahedral meshes.

A mesh is `vertices` (n, 3) float64 [m] and `tetrahedra` (m, 4) integer, each of positive volume: seen from vertex 3
the vertices 0, 1, 2 run counter-clockwise, so that (v1 - v0) x (v2 - v0) . (v3 - v0) > 0. All results are
deterministic and independent of the platform's sort: rows ascend lexicographically.
"""

from __future__ import annotations

import numpy as np

from fracture_collision.portable_math import dots

# Local vertices of the six edges of a tetrahedron and of its four faces; face i lies opposite vertex i and is
# counter-clockwise from outside.
EDGE_VERTICES = np.array([(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)], dtype=np.int32)
FACE_VERTICES = np.array([(1, 2, 3), (0, 3, 2), (0, 1, 3), (0, 2, 1)], dtype=np.int32)


def unique_edges(tetrahedra: np.ndarray) -> np.ndarray:
    """All edges of the mesh, each once: (e, 2) int32, smaller index first, rows ascending."""
    base, keys = _edge_keys(tetrahedra)
    unique = np.unique(keys)
    return np.column_stack((unique // base, unique % base)).astype(np.int32)


def tetrahedron_edges(tetrahedra: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """For each tetrahedron the rows in `edges` of its edges, in the local order of EDGE_VERTICES: (m, 6) int32.

    `edges` is the result of `unique_edges` for these tetrahedra, or for a mesh that contains them.
    """
    base, keys = _edge_keys(tetrahedra, int(edges.max(initial=0)) + 1)
    known = edges[:, 0].astype(np.int64) * base + edges[:, 1]
    rows = np.searchsorted(known, keys)
    if keys.size and (rows.max() >= len(known) or not np.array_equal(known[rows], keys)):
        raise ValueError("edges: an edge of a tetrahedron is not among them")
    return rows.reshape(-1, 6).astype(np.int32)


def face_neighbours(tetrahedra: np.ndarray) -> np.ndarray:
    """The tetrahedron across the face opposite vertex i, -1 at the boundary: (m, 4) int32.

    Raises ValueError if more than two tetrahedra share a face.
    """
    order, same = _matched_faces(tetrahedra)
    neighbours = np.full(len(order), -1, dtype=np.int32)
    first, second = order[:-1][same], order[1:][same]
    neighbours[first] = second // 4
    neighbours[second] = first // 4
    return neighbours.reshape(-1, 4)


def boundary_triangles(tetrahedra: np.ndarray) -> np.ndarray:
    """Faces that belong to one tetrahedron only, counter-clockwise from outside: (t, 3) int32.

    Ordered by tetrahedron and local face.
    """
    free = face_neighbours(tetrahedra).ravel() < 0
    faces = np.asarray(tetrahedra)[:, FACE_VERTICES].reshape(-1, 3)
    return np.ascontiguousarray(faces[free], dtype=np.int32)


def tetrahedron_volumes(vertices: np.ndarray, tetrahedra: np.ndarray) -> np.ndarray:
    """Signed volumes [m3]: (m,) float64, positive for well oriented tetrahedra."""
    corner = vertices[tetrahedra]
    a, b, c = (corner[:, i] - corner[:, 0] for i in (1, 2, 3))
    return dots(np.cross(a, b), c) / 6.0


def pyramid_volumes(corners: np.ndarray) -> np.ndarray:
    """Signed volumes (t,) [m3] over triangles (t, 3, 3) [m] with one apex, in the middle of their box.

    Those of a closed surface, counter-clockwise from outside, add up to the volume that it encloses.
    """
    a, b, c = np.moveaxis(corners - 0.5 * (corners.min(axis=(0, 1)) + corners.max(axis=(0, 1))), 1, 0)
    return dots(np.cross(a, b), c) / 6.0


def _edge_keys(tetrahedra: np.ndarray, base: int = 1) -> tuple[int, np.ndarray]:
    ends = np.sort(np.asarray(tetrahedra)[:, EDGE_VERTICES].reshape(-1, 2).astype(np.int64), axis=1)
    base = max(base, int(ends.max(initial=0)) + 1)
    return base, ends[:, 0] * base + ends[:, 1]


def _matched_faces(tetrahedra: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """All faces (4 x tetrahedron + local face) sorted by their vertices, and whether each equals its successor."""
    faces = np.sort(np.asarray(tetrahedra)[:, FACE_VERTICES].reshape(-1, 3).astype(np.int64), axis=1)
    pair_key = faces[:, 0] * (faces.max(initial=0) + 1) + faces[:, 1]
    order = np.lexsort((faces[:, 2], pair_key))
    same = (pair_key[order][:-1] == pair_key[order][1:]) & (faces[order, 2][:-1] == faces[order, 2][1:])
    if np.any(same[:-1] & same[1:]):
        face = faces[order[:-2][same[:-1] & same[1:]][0]]
        raise ValueError(f"tetrahedra: more than two share the face {face.tolist()}")
    return order, same
