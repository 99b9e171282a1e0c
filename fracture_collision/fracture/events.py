"""From the pieces of a fragment to the event that the service reads."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fracture_collision.fracture.pattern import Pattern
from fracture_collision.portable_math import dots, lengths
from fracture_collision.records import FractureEvent

# A crack no farther than this share of a cut edge from the edge's end counts as running through the node there: what it
# cuts off is no fragment to simulate.
AT_NODE = 1e-3


OTHER_CORNERS = np.array([(1, 2, 3), (0, 2, 3), (0, 1, 3), (0, 1, 2)])


class CrackedMesh(NamedTuple):
    """A body's mesh of n nodes, with the cracks of earlier events."""

    points: np.ndarray  # (n, 3) float64 [m], body frame
    tetrahedra: np.ndarray  # (m, 4) int64
    pinched: np.ndarray  # (p, 2) int64, see pinched_ends


class Naming(NamedTuple):
    """The numbers of an event."""

    sequence: int
    body_id: int
    fragment_id: int  # that breaks
    first_new_id: int  # the new fragments are numbered from here


def event_of(pattern: Pattern, nodes: np.ndarray, naming: Naming) -> FractureEvent:
    """The event by which a fragment with mesh nodes (k,), numbered 0 .. k - 1 in `pattern`, breaks into its pieces."""
    return FractureEvent(
        sequence=naming.sequence,
        body_id=naming.body_id,
        fragment_id=naming.fragment_id,
        new_fragment_ids=(naming.first_new_id + np.arange(pattern.piece_count)).astype(np.uint32),
        nodes=nodes.astype(np.uint32),
        node_fragments=pattern.pieces.astype(np.uint32),
        cut_edges=nodes[pattern.cut_edges].astype(np.uint32).ravel(),
        cut_planes=np.ascontiguousarray(pattern.cut_planes).ravel(),
    )


def pinched_ends(points: np.ndarray, edges: np.ndarray, planes: np.ndarray) -> np.ndarray:
    """Ends (p, 2) of cut edges (c, 2) at which their planes (c, 4) pass: the node there first, the other end second.

    points (n, 3) [m]. The space beside such a node, along this edge, is not the node's.
    """
    sides = dots(points[edges], planes[:, None, :3]) - planes[:, 3:]
    slack = AT_NODE * lengths(points[edges[:, 1]] - points[edges[:, 0]])
    return np.concatenate((edges[sides[:, 0] >= -slack], edges[sides[:, 1] <= slack][:, ::-1]))


def without_flat_pieces(pattern: Pattern, nodes: np.ndarray, mesh: CrackedMesh) -> Pattern:
    """The pattern with each piece that has hardly any volume joined to the neighbour with which it shares most edges.

    A piece with mesh nodes (k,) is flat if cracks pass through all its nodes and, in each tetrahedron, cut off the
    corner there: a plane along a face of the body leaves such a piece behind it.
    """
    pieces, cut, planes = pattern.pieces, pattern.cut_edges, pattern.cut_planes
    new = pinched_ends(mesh.points[nodes], cut, planes)
    while True:
        pieces = _numbered(pieces)
        count = int(pieces.max()) + 1
        still = new[pieces[new[:, 0]] != pieces[new[:, 1]]]
        flat = _flat_pieces(pieces, nodes, mesh, np.concatenate((mesh.pinched, nodes[still])))
        ends = pieces[cut]
        if not len(flat) or count == 1:
            break
        beside = ends[(ends == flat[0]).any(axis=1) & (ends[:, 0] != ends[:, 1])]
        neighbours = np.where(beside[:, 0] == flat[0], beside[:, 1], beside[:, 0])
        pieces = np.where(pieces == flat[0], np.bincount(neighbours).argmax(), pieces)
    kept = ends[:, 0] != ends[:, 1]
    return Pattern(pieces, count, cut[kept], planes[kept])


def _flat_pieces(pieces: np.ndarray, nodes: np.ndarray, mesh: CrackedMesh, pinched: np.ndarray) -> np.ndarray:
    """The pieces, ascending, of which every node and every tetrahedron's corner is `pinched` (p, 2)."""
    is_pinched = np.zeros(len(mesh.points), np.bool_)
    is_pinched[pinched[:, 0]] = True
    free = np.bincount(pieces[~is_pinched[nodes]], minlength=int(pieces.max()) + 1)
    doubtful = np.flatnonzero(free == 0)
    if not len(doubtful):
        return doubtful
    piece_of_node = np.full(len(mesh.points), -1)
    piece_of_node[nodes] = pieces
    ends = mesh.tetrahedra[:, OTHER_CORNERS]  # (m, 4, 3) the ends of the three edges at each corner
    base = len(mesh.points)
    cut_off = np.isin(mesh.tetrahedra[:, :, None] * base + ends, pinched[:, 0] * base + pinched[:, 1]).any(axis=2)
    return np.setdiff1d(doubtful, piece_of_node[mesh.tetrahedra[~cut_off]])


def _numbered(pieces: np.ndarray) -> np.ndarray:
    """The pieces numbered 0, 1 ... in the order of their first nodes."""
    _, first, inverse = np.unique(pieces, return_index=True, return_inverse=True)
    rank = np.empty(len(first), np.int64)
    rank[np.argsort(first, kind="stable")] = np.arange(len(first))
    return rank[inverse.ravel()]
