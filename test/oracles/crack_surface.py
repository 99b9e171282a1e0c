"""The crack surface of one tetrahedron: the points where cracks cross its edges, meet in its faces and inside it.

Written from docs/numerics.md alone. All points are barycentric weights. Those of an edge's crossing or a face's point
depend on that edge or face alone, so that neighbouring tetrahedra get the same point. An event is a number above 0
that increases with each fracture, 0 where nothing is cut.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fracture_collision.geometry.tetrahedra import EDGE_VERTICES, FACE_VERTICES

ON_FACE = 1e-9  # largest weight off a face of a hub that lies on it
FLAT = 1e-6  # normal equations with a smaller determinant, against their trace, have no one solution

EDGE_BETWEEN = np.full((4, 4), -1)  # local nodes to local edge
EDGE_BETWEEN[tuple(EDGE_VERTICES.T)] = EDGE_BETWEEN[tuple(EDGE_VERTICES[:, ::-1].T)] = range(6)
FACE_ENDS = np.array([(0, 1), (0, 2), (1, 2)])  # of a face's edges, in its nodes
FACE_EDGES = np.array([[e for e, ends in enumerate(EDGE_VERTICES) if k not in ends] for k in range(4)])


class CrackSurface(NamedTuple):
    """Of c tetrahedra: barycentric weights in their four nodes, in the order of their rows."""

    edge_points: np.ndarray  # (c, 6, 4) crossings; the middle of an uncut edge
    face_points: np.ndarray  # (c, 4, 4) of the face opposite each node
    hubs: np.ndarray  # (c, 4)


class Cuts(NamedTuple):
    """The edges (e, 2) of a mesh, smaller node first, and the planes and events that cut them."""

    ends: np.ndarray  # (e, 2)
    planes: np.ndarray  # (e, 4) unit normal from the first node to the second, offset [m]
    events: np.ndarray  # (e,) 0: not cut


def crossing_shares(vertices: np.ndarray, cuts: Cuts) -> np.ndarray:
    """Where each cut edge is crossed, from its first node 0 to its second 1: (e,); 1/2 for edges that are not cut."""
    first, second = (np.einsum("ij,ij->i", vertices[cuts.ends[:, i]], cuts.planes[:, :3]) for i in (0, 1))
    first, second = first - cuts.planes[:, 3], second - cuts.planes[:, 3]
    shares = np.full(len(cuts.ends), 0.5)
    is_cut = cuts.events > 0
    shares[is_cut] = np.clip(first[is_cut] / (first[is_cut] - second[is_cut]), 0.0, 1.0)
    return shares


def crack_surface(
    vertices: np.ndarray, tetrahedra: np.ndarray, tetrahedron_edges: np.ndarray, cuts: Cuts
) -> CrackSurface:
    """Of the tetrahedra (c, 4), each with cut edges among its `tetrahedron_edges` (c, 6), rows of `cuts`."""
    shares, is_cut = crossing_shares(vertices, cuts)[tetrahedron_edges], cuts.events[tetrahedron_edges] > 0
    is_turned = tetrahedra[:, EDGE_VERTICES[:, 0]] > tetrahedra[:, EDGE_VERTICES[:, 1]]
    edge_points = np.zeros((len(tetrahedra), 6, 4))
    for e, (a, b) in enumerate(EDGE_VERTICES):
        edge_points[:, e, b] = np.where(is_turned[:, e], 1.0 - shares[:, e], shares[:, e])
        edge_points[:, e, a] = np.where(is_turned[:, e], shares[:, e], 1.0 - shares[:, e])
    face_points = np.zeros((len(tetrahedra), 4, 4))
    for k in range(4):
        face_cut = is_cut[:, FACE_EDGES[k]]
        crossings = np.einsum("ce,cew->cw", face_cut, edge_points[:, FACE_EDGES[k]])
        face_points[:, k] = crossings / np.maximum(face_cut.sum(axis=1), 1)[:, None]
        face_points[face_cut.sum(axis=1) == 0, k] = np.where(np.arange(4) == k, 0.0, 1.0 / 3.0)
        for c in np.flatnonzero(face_cut.all(axis=1)).tolist():
            local = FACE_VERTICES[k][np.argsort(tetrahedra[c, FACE_VERTICES[k]])]
            rows = tetrahedron_edges[c, EDGE_BETWEEN[local[FACE_ENDS[:, 0]], local[FACE_ENDS[:, 1]]]]
            face = Cuts(FACE_ENDS, cuts.planes[rows], cuts.events[rows])
            face_points[c, k, local] = face_point(vertices[tetrahedra[c, local]], face)
    hubs = np.einsum("ce,cew->cw", is_cut, edge_points) / is_cut.sum(axis=1)[:, None]
    for c in np.flatnonzero(is_cut.sum(axis=1) > 4).tolist():  # three or four fragments
        rows = tetrahedron_edges[c]
        planes = np.where(is_turned[c][:, None], -cuts.planes[rows], cuts.planes[rows])
        tetrahedron = Cuts(EDGE_VERTICES, planes, cuts.events[rows])
        hubs[c] = _hub(vertices[tetrahedra[c]], tetrahedron, edge_points[c], face_points[c])
    return CrackSurface(edge_points, face_points, hubs)


def face_point(corners: np.ndarray, face: Cuts) -> np.ndarray:
    """The weights (3,) of the point where three fragments meet in a face.

    corners: (3, 3) [m] of its nodes, ascending; face: its edges (0, 1), (0, 2), (1, 2), all cut.
    """
    newest = int(np.argmax(face.events))
    if face.events.min() < face.events.max():
        return _on_the_older_crack(corners, face, newest)
    shares = crossing_shares(corners, face)
    crossings = np.zeros((3, 3))
    for e, share in enumerate(shares):
        crossings[e, face.ends[e]] = 1.0 - share, share
    crossings = crossings[[0, 2, 1]]  # the order of the least squares affects rounding, visibly
    end = _nearest_to_planes(crossings @ corners, face.planes)
    of_nodes = end @ crossings
    if of_nodes.min() < 0.0:  # beyond an edge: at its crossing
        beyond = (1, 2, 0)[int(np.argmin(of_nodes))]
        end = np.where(np.arange(3) == beyond, 1.0, 0.0)
    return _as_far_as_allowed(end) @ crossings


def _on_the_older_crack(corners: np.ndarray, face: Cuts, newest: int) -> np.ndarray:
    """Where the newer crack between nodes j and l ends at the older one, which runs from edge i-j to edge i-l."""
    crossings = np.zeros((3, 3))
    for e, share in enumerate(crossing_shares(corners, face)):
        crossings[e, face.ends[e]] = 1.0 - share, share
    from_j, from_l = face.ends[newest]  # an edge is opposite the node 2 - its row
    p, r = crossings[2 - from_l], crossings[2 - from_j]
    normal, offset = face.planes[newest, :3], face.planes[newest, 3]
    h_p, h_r = (normal @ (weights @ corners) - offset for weights in (p, r))
    share = np.clip(h_p / (h_p - h_r), 0.0, 1.0) if h_r - h_p > 0.0 else 0.5
    return p + share * (r - p)


def _hub(corners: np.ndarray, cuts: Cuts, edge_points: np.ndarray, face_points: np.ndarray) -> np.ndarray:
    """The weights (4,) of the hub, the point inside a tetrahedron of three or four fragments where its cracks meet."""
    ages = np.unique(cuts.events[cuts.events > 0])
    groups = _groups(cuts.events, ages[0])
    oldest = cuts.events == ages[0]
    if len(set(groups)) == 2:
        if np.count_nonzero(oldest) == 4 and not _is_one_plane(cuts, oldest, groups):
            return edge_points[oldest].mean(axis=0)
        first, groups = groups, _groups(cuts.events, ages[1])
        lone = [v for v in range(4) if first.count(first[v]) == 1 and len(set(groups)) == 4]
    else:
        lone = []
    faces = _faces_of_three(groups)
    if len(set(groups)) == 4 and not lone:
        hub = _as_far_as_allowed(_nearest_to_planes(face_points @ corners, cuts.planes)) @ face_points
    else:
        hub = face_points[[k for k in faces if k not in lone]].mean(axis=0)
    on_it = [k for k in faces if hub[k] <= ON_FACE]  # on a face: at its point, so that both sides divide it alike
    return face_points[on_it[0]] if on_it else hub


def _groups(events: np.ndarray, newest: int) -> list[int]:
    """For each node of a tetrahedron, the smallest node that no event up to `newest` has separated from it."""
    group = list(range(4))
    for a, b in EDGE_VERTICES[(events == 0) | (events > newest)].tolist():
        joined = {group[a], group[b]}
        group = [min(joined) if g in joined else g for g in group]
    return group


def _faces_of_three(groups: list[int]) -> list[int]:
    return [k for k in range(4) if len({groups[v] for v in FACE_VERTICES[k].tolist()}) == 3]


def _is_one_plane(cuts: Cuts, chosen: np.ndarray, groups: list[int]) -> bool:
    """Whether the chosen edges between two groups carry one plane, bit for bit, with the same orientation."""
    from_first = np.array([groups[a] == groups[0] for a in cuts.ends[:, 0]])
    planes = np.where(from_first[:, None], cuts.planes, -cuts.planes)[chosen]
    return bool(np.all(planes == planes[0]))


def _nearest_to_planes(corners: np.ndarray, planes: np.ndarray) -> np.ndarray:
    """Weights in the corners (k, 3) [m] of the point with the least sum of squared distances from the planes.

    The centroid's weights if that point is not unique.
    """
    slopes = planes[:, :3] @ (corners[1:] - corners[0]).T
    heights = planes[:, :3] @ corners[0] - planes[:, 3]
    matrix = slopes.T @ slopes
    if np.linalg.det(matrix) <= FLAT * np.trace(matrix) ** len(matrix):
        return np.full(len(corners), 1.0 / len(corners))
    rest = np.linalg.solve(matrix, -slopes.T @ heights)
    return np.array([1.0 - rest.sum(), *rest])


def _as_far_as_allowed(end: np.ndarray) -> np.ndarray:
    """The last non-negative weights on the straight line from the centroid to `end`."""
    centroid = np.full(len(end), 1.0 / len(end))
    low = end < 0.0
    share = (centroid[low] / (centroid[low] - end[low])).min(initial=1.0)
    return centroid + share * (end - centroid)
