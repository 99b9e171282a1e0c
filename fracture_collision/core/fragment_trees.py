"""The sphere trees of the fragments that a fracture makes, in the three ways that Glondu 2014, section 7.3 compares.

RESTRUCTURED: split, restructured and extended (6.2, 6.3). PLAIN: split without regard to the maximum-distance order, as
in the paper's earlier version, its reference [27]. REBUILT: built from nothing on the samples of the new surface. A
rebuilt tree has no interior nodes, so the next fracture builds again from the mesh and its cut edges. The body before
its first fracture has the same tree in all three.

Samples of a body are numbered: its n mesh nodes, then two for each mesh edge, n + 2 edge + side.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fracture_collision.core.compiled import kernel
from fracture_collision.core.cut_tetrahedron import point_on_edge
from fracture_collision.core.pools import SAMPLE, GrowableArray
from fracture_collision.core.sphere_tree import SphereTree, build_sphere_tree
from fracture_collision.core.sphere_tree_split import rows_of_split, split_sphere_tree
from fracture_collision.core.tet_mesh import TetMesh

RESTRUCTURED = "restructured"
PLAIN = "plain"
REBUILT = "rebuilt"
TREES = (RESTRUCTURED, PLAIN, REBUILT)


class Forest(NamedTuple):
    """Trees one behind the other: fragment f's are entries begin[f] .. begin[f + 1] - 1."""

    trees: SphereTree
    begin: np.ndarray  # (fragments + 1,) int64


class _CrackSamples(NamedTuple):
    """The points that a fracture adds to the surfaces of its fragments: two a cut edge, one a side."""

    points: np.ndarray  # (q, 3) float64 [m]
    samples: np.ndarray  # (q,) int32
    parents: np.ndarray  # (q,) int32 mesh nodes: each side's own end of the edge
    parts: np.ndarray  # (q,) int32


def split_trees(
    table: dict[str, GrowableArray], old: slice, mesh: TetMesh, part_of_node: np.ndarray, edges: np.ndarray,
    share: np.ndarray, count: int, ordered: bool,
) -> np.ndarray:  # fmt: skip
    """Append to the tree pool the RESTRUCTURED (`ordered`) or PLAIN trees of parts 0 .. count - 1, from the tree in its
    rows `old` of what broke; returns where each begins, (count + 1,).

    part_of_node (n,) int32, -1: another fragment's; edges (k,): mesh edges that this fracture cuts, ascending; share
    (mesh edges,): where cut edges are crossed, in parts of them from their first node.
    """
    new = _crack_samples(mesh.nodes, mesh.edges, part_of_node, edges, share)
    room = rows_of_split(table["entries"].view[old], len(new.points))
    # these may move what is in the pool
    out_spheres, out_entries = table["spheres"].reserve(room), table["entries"].reserve(room)
    entries = table["entries"].view[old]
    begin = split_sphere_tree(
        table["spheres"].view[old], entries, _parts_of_entries(entries, len(mesh.nodes), mesh.edges, part_of_node),
        count, new.points, new.samples, new.parents, new.parts, ordered, out_spheres, out_entries,
    )  # fmt: skip
    table["spheres"].advance(int(begin[-1]))
    return begin + table["entries"].advance(int(begin[-1]))


def rebuilt_trees(
    mesh: TetMesh, part_of_node: np.ndarray, share: np.ndarray, sampled: np.ndarray, count: int
) -> Forest:
    """REBUILT trees of parts 0 .. count - 1.

    part_of_node (n,) int32, -1: another fragment's; share (mesh edges,): where cut edges are crossed, in parts of them
    from their first node; sampled (mesh edges, 2): which ends of edges are crack samples of these parts.
    """
    n = len(mesh.nodes)
    nodes = np.flatnonzero((part_of_node >= 0) & (mesh.on_surface != 0))
    edge, side = np.nonzero(sampled)
    cracks = (n + 2 * edge + side).astype(np.int32)
    samples = np.concatenate([nodes.astype(np.int32), cracks])
    points = np.vstack([mesh.nodes[nodes], _edge_points(mesh.nodes, mesh.edges, share, cracks)])
    part = part_of_node[np.concatenate([nodes, mesh.edges[edge, side]])]
    by_part = np.argsort(part, kind="stable")
    trees = []
    for own in np.split(by_part, np.searchsorted(part[by_part], np.arange(1, count))):
        tree = build_sphere_tree(points[own], np.ones(len(own), np.uint8))
        trees.append(tree._replace(sample=samples[own][tree.sample]))
    joined = SphereTree(*(np.concatenate(columns) for columns in zip(*trees, strict=True)))
    return Forest(joined, np.cumsum([0, *(len(tree.size) for tree in trees)]))


@kernel
def _crack_samples(nodes, edges, part_of_node, cut, share):
    """_CrackSamples at the edges `cut` (k,), ascending, of a mesh: nodes (n, 3) [m], edges (e, 2).

    part_of_node (n,) int32; share (e,): where cut edges are crossed, in parts of them from their first node.
    """
    count = 2 * len(cut)
    new = _CrackSamples(
        np.empty((count, 3)), np.empty(count, np.int32), np.empty(count, np.int32), np.empty(count, np.int32)
    )
    for q in range(count):
        e = cut[q // 2]
        node = edges[e, q % 2]
        point_on_edge(nodes, edges[e, 0], edges[e, 1], share[e], new.points[q])
        new.samples[q], new.parents[q], new.parts[q] = len(nodes) + 2 * e + q % 2, node, part_of_node[node]
    return new


@kernel
def _parts_of_entries(entries, nodes, edges, part_of_node):
    """The part (s,) int32 of each tree entry's point, rows of TreePool.entries; `nodes`: how many the mesh has."""
    parts = np.empty(len(entries), np.int32)
    for i in range(len(entries)):
        node = entries[i, SAMPLE]
        if node >= nodes:
            node = edges[(node - nodes) // 2, (node - nodes) % 2]
        parts[i] = part_of_node[node]
    return parts


@kernel
def _edge_points(nodes, edges, share, samples):
    """Positions (q, 3) [m] of crack samples: where their edges are crossed."""
    points = np.empty((len(samples), 3))
    for i in range(len(samples)):
        e = (samples[i] - len(nodes)) // 2
        point_on_edge(nodes, edges[e, 0], edges[e, 1], share[e], points[i])
    return points
