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
from fracture_collision.core.pool_tables import PoolTables
from fracture_collision.core.pools import SAMPLE
from fracture_collision.core.sample_leaves import count_leaves, fill_leaves, most_leaves
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


def split_trees(tables: PoolTables, row: int, edges: np.ndarray, first: int, count: int, ordered: bool) -> None:
    """Append the RESTRUCTURED (`ordered`) or PLAIN trees of fragments first .. first + count - 1, into which fragment
    `row` broke, and their leaves. edges (k,): mesh edges that this fracture cuts, ascending.
    """
    fragment = tables.fragment
    old = slice(int(fragment["tree_begin"].view[row]), int(fragment["tree_end"].view[row]))
    leaves = int(fragment["leaf_end"].view[row] - fragment["leaf_begin"].view[row])
    room = rows_of_split(tables.tree["entries"].view[old], 2 * len(edges))
    for column in tables.tree.values():
        column.reserve(room)  # this may move what is in the pool
    for column in tables.samples.values():
        column.reserve(most_leaves(leaves, 2 * len(edges), count))
    pools = tables.roomy
    trees, leaves = _split_trees(
        pools.mesh, pools.body.node_fragment, pools.body.edge_share, pools.fragment, pools.tree, row, edges, first,
        first + count, ordered, tables.tree["entries"].used, tables.samples["values"].whole,
        tables.samples["entries"].whole, tables.samples["entries"].used,
    )  # fmt: skip
    for column in tables.tree.values():
        column.advance(trees)
    for column in tables.samples.values():
        column.advance(leaves)


@kernel
def _split_trees(
    mesh, node_fragment, edge_share, fragment, tree, row, edges, low, high, ordered, begin, values, entries, first_leaf
):  # fmt: skip
    """split_trees, into the rows from `begin` and `first_leaf` on; returns how many of each."""
    k = fragment.mesh[row]
    first_node, first_edge, nodes = mesh.first[k, 0], mesh.first[k, 1], mesh.first[k, 2]
    labels = node_fragment[first_node + fragment.node_shift[row] :]
    share = edge_share[first_edge + fragment.edge_shift[row] :]  # a shift may be negative
    new = _crack_samples(mesh.nodes, mesh.edges, labels, edges, share, first_node, first_edge, nodes, low)
    old = tree.entries[fragment.tree_begin[row] : fragment.tree_end[row]]
    parts = _parts_of_entries(old, nodes, mesh.edges, first_edge, first_node, labels, low)
    ends = split_sphere_tree(
        tree.spheres[fragment.tree_begin[row] : fragment.tree_end[row]], old, parts, high - low, new.points,
        new.samples, new.parents, new.parts, ordered, tree.spheres[begin:], tree.entries[begin:],
    )  # fmt: skip
    trees = ends[high - low]
    for f in range(len(ends)):
        ends[f] += begin
    counts = count_leaves(tree.entries, ends)
    fill_leaves(
        tree.spheres, tree.entries, ends, counts, values[first_leaf:], entries[first_leaf:], fragment.middle[low:high]
    )
    leaf = first_leaf
    for f in range(low, high):
        fragment.tree_begin[f], fragment.tree_end[f] = ends[f - low], ends[f - low + 1]
        fragment.leaf_begin[f], leaf = leaf, leaf + counts[f - low]
        fragment.leaf_end[f] = leaf
    return trees, leaf - first_leaf


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
def _crack_samples(nodes, edges, labels, cut, share, first_node, first_edge, count_of_nodes, low):
    """_CrackSamples at the edges `cut` (k,), ascending, of a mesh whose rows of MeshPool `nodes` and `edges` begin at
    first_node and first_edge.

    labels (n,): fragments of its nodes, the new ones from `low` on; share (mesh edges,): where cut ones are crossed, in
    parts of them from their first node.
    """
    count = 2 * len(cut)
    new = _CrackSamples(
        np.empty((count, 3)), np.empty(count, np.int32), np.empty(count, np.int32), np.empty(count, np.int32)
    )
    for q in range(count):
        e = cut[q // 2] + first_edge
        node = edges[e, q % 2] - first_node
        point_on_edge(nodes, edges[e, 0], edges[e, 1], share[cut[q // 2]], new.points[q])
        new.samples[q], new.parents[q] = count_of_nodes + 2 * cut[q // 2] + q % 2, node
        new.parts[q] = labels[node] - low
    return new


@kernel
def _parts_of_entries(entries, nodes, edges, first_edge, first_node, labels, low):
    """The part (s,) int32 of each tree entry's point, rows of TreePool.entries; `nodes`: how many the mesh has."""
    parts = np.empty(len(entries), np.int32)
    for i in range(len(entries)):
        node = entries[i, SAMPLE]
        if node >= nodes:
            node = edges[first_edge + (node - nodes) // 2, (node - nodes) % 2] - first_node
        parts[i] = labels[node] - low
    return parts


@kernel
def _edge_points(nodes, edges, share, samples):
    """Positions (q, 3) [m] of crack samples: where their edges are crossed."""
    points = np.empty((len(samples), 3))
    for i in range(len(samples)):
        e = (samples[i] - len(nodes)) // 2
        point_on_edge(nodes, edges[e, 0], edges[e, 1], share[e], points[i])
    return points
