"""Tetrahedral meshes of closed surfaces without a mesher: isosurface stuffing.

F. Labelle, J. Shewchuk, "Isosurface stuffing: fast tetrahedral meshes with good dihedral angles", SIGGRAPH 2007, with a
uniform lattice: the tetrahedra of a body-centred cubic lattice, of which those on the surface are cut. A lattice point
that a cut comes near is moved to it, so that no sliver is left. Distances to the surface are exact
(core/mesh/triangle_field.py), and so are the cuts of plane faces; what was moved or cut is at last put on the surface.

The paper chooses diagonals of cut faces by the parity of the lattice, for better angles; here they begin at the smaller
number. Sharp edges and corners of the surface are rounded, to within a part of the edge length. Equal arguments give
equal bytes, on any machine.

Around each vertex and each edge, the tetrahedra of the result are connected through faces (`without_pinches`): an edge
of the boundary belongs to two triangles, and a vertex to one fan of them, as normals at edges and vertices need.
"""

from __future__ import annotations

import math

import numpy as np

from fracture_collision.core.memory.compiled import kernel
from fracture_collision.core.mesh.connected_pieces import connected_pieces, joined
from fracture_collision.core.mesh.triangle_field import (
    STACK,
    build_triangle_mesh,
    triangle_distance,
    triangle_pool,
)
from fracture_collision.geometry.generators import TetGeometry, oriented, require_affordable, require_positive
from fracture_collision.geometry.surface_files import require_closed_surface
from fracture_collision.geometry.tetrahedra import (
    EDGE_VERTICES,
    face_neighbours,
    tetrahedron_edges,
    tetrahedron_volumes,
    unique_edges,
)
from fracture_collision.portable_math import lengths

# Of a lattice of cubes with sides of 1, edges have lengths 1 (two of a tetrahedron) and sqrt(3) / 2 (four): on average
MEAN_EDGE = (2.0 + 4.0 * math.sqrt(0.75)) / 6.0
# A point moves to a cut that is nearer than this share of an edge (Labelle 2007, table 1, safe for positive volumes).
LONG_EDGE, SHORT_EDGE = 0.24999, 0.41189
# A point is not put on the surface if a tetrahedron would lose more of its volume than this leaves.
LEAST_VOLUME_LEFT = 0.3
# Parts of the mesh that are not connected with the rest are dropped up to this share of the volume.
NEGLIGIBLE = 0.01


def tetrahedralize_by_lattice(vertices: np.ndarray, triangles: np.ndarray, edge_length: float) -> TetGeometry:
    """Fill a closed surface with tetrahedra of about `edge_length` [m].

    vertices (n, 3) [m] and triangles (t, 3), counter-clockwise from outside, closed. Parts of the surface that are
    thinner than an edge may be lost.

    Raises ValueError for a surface that is open or inside out, and where it is so thin that nothing is left or the mesh
    falls into pieces.
    """
    require_positive(edge_length=edge_length)
    vertices = np.require(vertices, np.float64, ("C", "A", "W"))
    triangles = np.require(triangles, np.int32, ("C", "A", "W"))
    require_closed_surface(vertices, triangles)
    surface = _Surface(vertices, triangles)
    points, tetrahedra = _lattice(vertices.min(axis=0), vertices.max(axis=0), edge_length / MEAN_EDGE)
    depth = surface.depths(points)
    tetrahedra = tetrahedra[(depth[tetrahedra] > 0.0).any(axis=1)]
    edges = unique_edges(tetrahedra)
    _move_to_cuts(points, depth, edges)
    points, on_surface, tetrahedra = _stuffed(points, depth, edges, tetrahedra)
    if not len(tetrahedra):
        raise ValueError(f"edge_length: {edge_length} m is too long, no lattice point is well inside the surface")
    used, tetrahedra = np.unique(tetrahedra, return_inverse=True)
    mesh = oriented(points[used], tetrahedra.reshape(-1, 4))
    vertices, tetrahedra = _put_on(surface, mesh, on_surface[used])
    return _in_one_piece(*without_pinches(vertices, tetrahedra), edge_length)


class _Surface:
    """Exact distances from a closed surface."""

    def __init__(self, vertices: np.ndarray, triangles: np.ndarray) -> None:
        self._meshes = triangle_pool(build_triangle_mesh(vertices, triangles))
        self._radius = 0.5 * float(np.ptp(vertices, axis=0).max())

    def depths(self, points: np.ndarray) -> np.ndarray:
        """(n,) [m] of points (n, 3), positive inside."""
        return self._measured(points)[:, 0]

    def nearest(self, points: np.ndarray) -> np.ndarray:
        """(n, 3) [m] the nearest points of the surface."""
        return self._measured(points)[:, 1:]

    def _measured(self, points: np.ndarray) -> np.ndarray:
        found = np.empty((len(points), 4))
        _measure(self._meshes, self._radius, points, found, np.empty(STACK, np.int32))
        return found


@kernel
def _measure(meshes, radius, points, found, stack):
    """Fill found (n, 4): depth and nearest point of points (n, 3)."""
    for i in range(len(points)):
        d, _, _, _, x, y, z = triangle_distance(meshes, 0, radius, points[i, 0], points[i, 1], points[i, 2], stack)
        found[i, 0], found[i, 1], found[i, 2], found[i, 3] = -d, x, y, z


def _lattice(low: np.ndarray, high: np.ndarray, side: float) -> tuple[np.ndarray, np.ndarray]:
    """Points and tetrahedra of a body-centred cubic lattice around a box, with a cell of air.

    A tetrahedron joins the centres of two neighbouring cubes with an edge of the square between them.
    """
    cells = np.ceil((high - low) / side).astype(np.int64) + 2
    require_affordable(12 * int(np.prod(cells.astype(object))))
    origin = 0.5 * (low + high) - 0.5 * side * cells
    corners = _grid(cells + 1)
    centres = _grid(cells)
    points = origin + side * np.concatenate((corners, centres + 0.5))
    found = []
    for axis in range(3):
        along, left, up = np.roll(np.eye(3, dtype=np.int64), -axis, axis=0)
        first = centres[centres[:, axis] < cells[axis] - 1]
        pair = [len(corners) + _number(first + step, cells) for step in (0 * along, along)]
        ring = [_number(first + along + step, cells + 1) for step in (0 * left, left, left + up, up)]
        found += [np.column_stack((*pair, ring[k], ring[(k + 1) % 4])) for k in range(4)]
    return points, np.concatenate(found)


def _grid(counts: np.ndarray) -> np.ndarray:
    """Places (n, 3) of a grid of `counts` (3,) points, the last axis fastest."""
    return np.stack(np.meshgrid(*map(np.arange, counts), indexing="ij"), axis=-1).reshape(-1, 3)


def _number(places: np.ndarray, counts: np.ndarray) -> np.ndarray:
    return (places[:, 0] * counts[1] + places[:, 1]) * counts[2] + places[:, 2]


def _move_to_cuts(points: np.ndarray, depth: np.ndarray, edges: np.ndarray) -> None:
    """Move each point near a cut to the nearest one of its edges, and make its depth 0; in the order of the points."""
    cut = edges[depth[edges[:, 0]] * depth[edges[:, 1]] < 0.0]
    ends = np.concatenate((cut, cut[:, ::-1]))
    here, there = ends.T
    share = depth[here] / (depth[here] - depth[there])
    length = lengths(points[there] - points[here])
    is_near = share < np.where(length > 0.95 * length.max(initial=0.0), LONG_EDGE, SHORT_EDGE)
    here, there, share, way = here[is_near], there[is_near], share[is_near], (share * length)[is_near]
    for i in np.lexsort((there, way, here)).tolist():
        a, b = here[i], there[i]
        if depth[a] != 0.0 and depth[b] != 0.0:
            points[a] += share[i] * (points[b] - points[a])
            depth[a] = 0.0


def _stuffed(
    points: np.ndarray, depth: np.ndarray, edges: np.ndarray, tetrahedra: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points with those of the cuts behind them, which of them are on the surface, and the tetrahedra inside."""
    cut = edges[depth[edges[:, 0]] * depth[edges[:, 1]] < 0.0].astype(np.int64)
    base = len(points)
    keys = cut[:, 0] * base + cut[:, 1]  # ascending, as the rows of `edges`
    share = depth[cut[:, 0]] / (depth[cut[:, 0]] - depth[cut[:, 1]])
    new_points = points[cut[:, 0]] + share[:, None] * (points[cut[:, 1]] - points[cut[:, 0]])

    # Corners inside first, then those outside, then those on the surface; ascending in each group.
    group = np.where(depth > 0.0, 0, np.where(depth < 0.0, 1, 2))[tetrahedra]
    tetrahedra = np.take_along_axis(tetrahedra, np.argsort(group * base + tetrahedra, axis=1, kind="stable"), axis=1)
    inside, outside = (group == 0).sum(axis=1), (group == 1).sum(axis=1)

    def between(a: np.ndarray, b: np.ndarray) -> np.ndarray:
        return base + np.searchsorted(keys, np.minimum(a, b) * base + np.maximum(a, b))

    def of(inside_count: int, outside_count: int) -> np.ndarray:
        return tetrahedra[(inside == inside_count) & (outside == outside_count)].T

    found = [tetrahedra[(inside > 0) & (outside == 0)]]
    for count in (1, 2, 3):
        p, *others = of(1, count)
        others[:count] = [between(p, n) for n in others[:count]]
        found.append(np.column_stack((p, *others)))
    # Quadrangles on faces are divided from the smaller of the two corners inside, on both sides alike.
    p, q, n, z = of(2, 1)
    pn, qn = between(p, n), between(q, n)
    found += [np.column_stack(t) for t in ((p, q, qn, z), (p, qn, pn, z))]
    p, q, m, n = of(2, 2)
    pm, pn, qm, qn = between(p, m), between(p, n), between(q, m), between(q, n)
    found += [np.column_stack(t) for t in ((p, pm, pn, qn), (p, pm, qm, qn), (p, q, qm, qn))]
    p, q, r, n = of(3, 1)
    pn, qn, rn = between(p, n), between(q, n), between(r, n)
    found += [np.column_stack(t) for t in ((p, q, r, rn), (p, q, qn, rn), (p, pn, qn, rn))]
    is_on = np.concatenate((depth == 0.0, np.ones(len(cut), np.bool_)))
    return np.concatenate((points, new_points)), is_on, np.concatenate(found)


def _put_on(surface: _Surface, mesh: TetGeometry, on_surface: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Vertices and tetrahedra, with what is `on_surface` moved there unless a tetrahedron would lose too much."""
    before = tetrahedron_volumes(*mesh)
    solid = before > 1e-6 * before.max()
    tetrahedra, before = mesh.tetrahedra[solid], before[solid]
    moved = np.flatnonzero(on_surface)
    vertices = mesh.vertices.copy()
    vertices[moved] = surface.nearest(vertices[moved])
    while True:
        bad = tetrahedron_volumes(vertices, tetrahedra) < LEAST_VOLUME_LEFT * before
        back = np.unique(tetrahedra[bad])
        back = back[(vertices[back] != mesh.vertices[back]).any(axis=1)]
        if not len(back):
            return vertices, tetrahedra
        vertices[back] = mesh.vertices[back]


def _in_one_piece(vertices: np.ndarray, tetrahedra: np.ndarray, edge_length: float) -> TetGeometry:
    piece = connected_pieces(unique_edges(tetrahedra), np.zeros(len(vertices), np.int64))[tetrahedra[:, 0]]
    volumes = np.bincount(piece, tetrahedron_volumes(vertices, tetrahedra))
    largest = int(volumes.argmax())
    if volumes[largest] < (1.0 - NEGLIGIBLE) * volumes.sum():
        count = np.count_nonzero(volumes)
        raise ValueError(f"edge_length: at {edge_length} m thin parts are lost and {count} pieces are left; shorten it")
    used, tetrahedra = np.unique(tetrahedra[piece == largest], return_inverse=True)
    return TetGeometry(np.ascontiguousarray(vertices[used]), tetrahedra.reshape(-1, 4).astype(np.int32))


def without_pinches(vertices: np.ndarray, tetrahedra: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The mesh without places where its boundary touches itself.

    Few tetrahedra are left out along pinched edges, pinched vertices are doubled.
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
