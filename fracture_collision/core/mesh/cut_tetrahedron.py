"""A tetrahedron crossed by cracks: its nodes, edges and faces, and the points that divide it.

Glondu 2014, section 4.1, stores at most six planes, one per cut edge; how they divide the tetrahedron where several
differ is our addition (docs/numerics.md). The crack runs through the crossings, the points where planes cross their
edges. Each face and then the tetrahedron is divided like a fan: a face of three fragments from a *face point*, the
tetrahedron from a *hub*. Crossings and face points depend on the edge and the face alone, so neighbours agree on their
common face: regions fit without gap, overlap or step. Where planes agree (the bisectors of a Voronoi pattern)
crossings, face points and hubs lie in them.

Neighbours keep what they own: a face or tetrahedron that is crossed again is divided anew within the older crack.
"""

from __future__ import annotations

import numpy as np

from fracture_collision.core.memory.compiled import query_kernel
from fracture_collision.core.memory.struct import Struct

EDGE_FIRST = np.array([0, 0, 0, 1, 1, 2])
EDGE_SECOND = np.array([1, 2, 3, 2, 3, 3])
# Local edge between two local nodes.
EDGE_BETWEEN = np.array([[-1, 0, 1, 2], [0, -1, 3, 4], [1, 3, -1, 5], [2, 4, 5, -1]])
# Face k lies opposite vertex k, counter-clockwise from outside for a tetrahedron of positive volume.
FACE_VERTICES = np.array([[1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1]])

# State of a tetrahedron in a fracture: one fragment, several, or several and known to be divided about its hub.
LONE, CUT, DIVIDED = 1, 2, 3

# Below this share of a determinant's largest value the planes have no common point.
SINGULAR = 1e-6
# A hub with no more than this barycentric weight off a face is on it.
ON_FACE = 1e-9
# A part with no more than this share of a tetrahedron's volume has none.
NO_VOLUME = 1e-13

# The points of a tetrahedron, numbered: its corners, the crossings of its edges, the points of its faces, its hub.
CROSSING, FACE_POINT, HUB, POINTS = 4, 10, 14, 15


class CutScratch(Struct):
    """Working space for one cut tetrahedron."""

    labels: np.ndarray  # (4,) int64 fragment of each node
    points: np.ndarray  # (POINTS, 3) float64 [m]; valid at cut edges and at faces of three fragments only
    corners: np.ndarray  # (4, 3): this and the next three are views of `points`
    crossings: np.ndarray  # (6, 3)
    face_points: np.ndarray  # (4, 3)
    hub: np.ndarray  # (3,)
    cut: np.ndarray  # (6,) uint8: whether a crack crosses the edge
    event: np.ndarray  # (6,) int64: the fracture that cut it, see BodyPool.edge_event
    planes: np.ndarray  # (6, 4) float64, from the edge's first local node to its second
    shares: np.ndarray  # (6,) float64: where the crossing is, from the first local node
    group: np.ndarray  # (4,) int64 working space


def make_cut_scratch() -> CutScratch:
    """CutScratch, zero; corners, crossings, face points and hub share the memory of `points`."""
    points = np.zeros((POINTS, 3))
    return CutScratch(
        np.zeros(4, np.int64), points, points[:CROSSING], points[CROSSING:FACE_POINT], points[FACE_POINT:HUB],
        points[HUB], np.zeros(6, np.uint8), np.zeros(6, np.int64), np.zeros((6, 4)), np.zeros(6), np.zeros(4, np.int64),
    )  # fmt: skip


@query_kernel
def crossing_share(nodes, a, b, plane):
    """Share of the edge from node `a` to `b` where the plane, positive at b, crosses it: 0 .. 1."""
    p, q = nodes[a], nodes[b]
    at_a = plane[0] * p[0] + plane[1] * p[1] + plane[2] * p[2] - plane[3]
    at_b = plane[0] * q[0] + plane[1] * q[1] + plane[2] * q[2] - plane[3]
    return min(max(at_a / (at_a - at_b), 0.0), 1.0)


@query_kernel
def point_on_edge(nodes, a, b, share, out):
    """The crossing of the mesh edge (a, b), a < b: always from its smaller node, so that all callers get one point."""
    p, q = nodes[a], nodes[b]
    for d in range(3):
        out[d] = p[d] + share * (q[d] - p[d])
