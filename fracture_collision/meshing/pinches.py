"""Places where the boundary of a tetrahedral mesh touches itself, in a vertex or along an edge, and their removal.

Around each vertex and each edge, tetrahedra shall be connected through faces: then each edge of the boundary belongs
to two triangles, and each vertex to one fan of them, as normals at edges and vertices need.
"""

from __future__ import annotations

import numpy as np

from fracture_collision.core.mesh.connected_pieces import joined
from fracture_collision.geometry.tetrahedra import EDGE_VERTICES, face_neighbours, tetrahedron_edges, unique_edges


def without_pinches(vertices: np.ndarray, tetrahedra: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The mesh without those: few tetrahedra are left out along pinched edges, pinched vertices are doubled.

    vertices (n, 3) and tetrahedra (m, 4); unused vertices may be left.
    """
    while True:
        edges = unique_edges(tetrahedra)
        at_edge = tetrahedron_edges(tetrahedra, edges)  # (m, 6)
        # face i lies opposite vertex i: the edges that do not end there
        of_face = np.array([np.flatnonzero(np.not_equal(EDGE_VERTICES, i).all(axis=1)) for i in range(4)])
        fan = _connected_over_faces(tetrahedra, at_edge, of_face)
        sizes = np.bincount(fan)
        first = np.unique(fan, return_index=True)[1]
        edge_of_fan = at_edge.ravel()[first]
        # Of fans of one size the first is kept.
        ranked = np.lexsort((np.arange(len(sizes)), -sizes, edge_of_fan))
        is_kept = np.zeros(len(sizes), np.bool_)
        is_kept[ranked[np.append(True, edge_of_fan[ranked][1:] != edge_of_fan[ranked][:-1])]] = True
        left = np.all(is_kept[fan].reshape(-1, 6), axis=1)
        if np.all(left):
            break
        tetrahedra = tetrahedra[left]
    of_face = np.array([[k for k in range(4) if k != i] for i in range(4)])
    star = _connected_over_faces(tetrahedra, tetrahedra, of_face)
    first = np.unique(star, return_index=True)[1]
    return vertices[tetrahedra.ravel()[first]], star.reshape(-1, 4)


def _connected_over_faces(tetrahedra: np.ndarray, parts: np.ndarray, of_face: np.ndarray) -> np.ndarray:
    """Pieces (m * k,) of the parts (m, k) of tetrahedra, joined where two tetrahedra share a face and the part in it.

    of_face (4, j): which of its k parts lie in the face opposite vertex i.
    """
    count = parts.shape[1]
    neighbours = face_neighbours(tetrahedra)
    tetrahedron, face = np.nonzero(neighbours >= 0)
    other = neighbours[tetrahedron, face]
    mine = of_face[face]  # (f, j)
    value = parts[tetrahedron[:, None], mine]
    theirs = (parts[other][:, None, :] == value[:, :, None]).argmax(axis=2)
    return joined(
        (tetrahedron[:, None] * count + mine).ravel(), (other[:, None] * count + theirs).ravel(), parts.size
    )
