"""The sphere trees of new fragments, in the three variants that Glondu 2014, section 7.3 compares.

RESTRUCTURED: split, restructured and extended (6.2, 6.3). PLAIN: split without regard to the maximum-distance order, as
in the paper's earlier version, its reference [27]. REBUILT: built from scratch on the samples of the new surface. A
rebuilt tree has no interior nodes, so the next fracture builds again from the mesh and its cut edges. The body before
its first fracture has the same tree in all three. Sample numbers: sample_numbers.py.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fracture_collision.core.bodies.pool_tables import PoolTables
from fracture_collision.core.fracture.surface_rows import Broken
from fracture_collision.core.fracture.touched_tetrahedra import Cut
from fracture_collision.core.memory.compiled import kernel
from fracture_collision.core.memory.pools import SAMPLE
from fracture_collision.core.mesh.cut_tetrahedron import point_on_edge
from fracture_collision.core.mesh.sample_numbers import (
    FIRST_EDGE,
    FIRST_NODE,
    NewSamples,
    crossing_number,
    edge_of,
    is_crossing,
    is_node,
)
from fracture_collision.core.mesh.tet_mesh import TetMesh
from fracture_collision.core.tree.sample_leaves import count_leaves, fill_leaves, most_leaves
from fracture_collision.core.tree.sphere_tree import SphereTree, build_sphere_tree
from fracture_collision.core.tree.sphere_tree_deal import NOBODYS
from fracture_collision.core.tree.sphere_tree_split import TreeArrays, rows_of_split, split_sphere_tree
from fracture_collision.grouping import begins_of

RESTRUCTURED = "restructured"
PLAIN = "plain"
REBUILT = "rebuilt"
TREES = (RESTRUCTURED, PLAIN, REBUILT)


class Forest(NamedTuple):
    """Consecutive trees: fragment f has entries begin[f] .. begin[f + 1] - 1."""

    trees: SphereTree
    begin: np.ndarray  # (fragments + 1,) int64


class _Room(NamedTuple):
    """Where new trees and leaves are written."""

    begin: int  # first free row of TreePool
    values: np.ndarray  # of SamplePool, with the rows behind
    entries: np.ndarray  # likewise
    first_leaf: int  # first free row of these


def split_trees(tables: PoolTables, broken: Broken, edges: np.ndarray, corners: NewSamples, ordered: bool) -> None:
    """Append the RESTRUCTURED (`ordered`) or PLAIN trees of the new fragments of a Broken, and their leaves.

    edges (k,): mesh edges that this fracture cuts, ascending; corners: all corners of the new fragments, including
    those of earlier cracks.
    """
    fragment, row, new = tables.fragment, broken.parent, 2 * len(edges) + len(corners.points)
    old = slice(int(fragment["tree_begin"].view[row]), int(fragment["tree_end"].view[row]))
    leaves = int(fragment["leaf_end"].view[row] - fragment["leaf_begin"].view[row])
    room = rows_of_split(tables.tree["entries"].view[old], new)
    for column in tables.tree.values():
        column.reserve(room)  # this may reallocate the pool
    for column in tables.samples.values():
        column.reserve(most_leaves(leaves, new, broken.end - broken.first))
    pools, samples = tables.roomy, tables.samples
    free = _Room(
        tables.tree["entries"].used, samples["values"].whole, samples["entries"].whole, samples["entries"].used
    )
    of_nodes = pools.body.node_fragment, pools.body.edge_share
    trees, leaves = _split_trees(
        (pools.mesh, pools.fragment, pools.tree), of_nodes, broken, edges, corners, ordered, free
    )
    for column in tables.tree.values():
        column.advance(trees)
    for column in tables.samples.values():
        column.advance(leaves)


@kernel
def _split_trees(pools, cut, broken, edges, corners, ordered, room):
    """split_trees on the parts of the pools that it needs, to the rows of a _Room.

    pools: mesh, fragment and tree; cut: BodyPool's node_fragment and edge_share; ordered: see split_trees. Returns
    (number of tree entries written, number of leaves written).
    """
    mesh, fragment, tree = pools
    node_fragment, edge_share = cut
    row, low, high = broken.parent, broken.first, broken.end
    first = mesh.first[broken.mesh]
    labels = node_fragment[first[FIRST_NODE] + broken.node_shift :]
    # a shift may be negative
    share = edge_share[first[FIRST_EDGE] + broken.edge_shift :]
    new = _new_samples(mesh, first, labels, share, edges, corners, low)
    old = slice(fragment.tree_begin[row], fragment.tree_end[row])
    rows = TreeArrays(tree.spheres[old], tree.entries[old])
    out = TreeArrays(tree.spheres[room.begin :], tree.entries[room.begin :])
    parts = _parts_of_entries(mesh, first, rows.entries, labels, low)
    ends = split_sphere_tree(rows, parts, high - low, new, ordered, out)
    trees = ends[high - low]
    for f in range(len(ends)):
        ends[f] += room.begin
    counts = count_leaves(tree.entries, ends)
    values, entries = room.values[room.first_leaf :], room.entries[room.first_leaf :]
    fill_leaves(tree.spheres, tree.entries, ends, counts, values, entries, fragment.middle[low:high])
    leaf = room.first_leaf
    for f in range(low, high):
        fragment.tree_begin[f], fragment.tree_end[f] = ends[f - low], ends[f - low + 1]
        fragment.leaf_begin[f], leaf = leaf, leaf + counts[f - low]
        fragment.leaf_end[f] = leaf
    return trees, leaf - room.first_leaf


def append_rebuilt_trees(
    tables: PoolTables, broken: Broken, mesh: TetMesh, first_edge: int, cut: Cut, corners: NewSamples
) -> None:
    """Append REBUILT trees of the new fragments; first_edge: row of the mesh's first edge."""
    first, count = broken.first, broken.end - broken.first
    begin = first_edge + broken.edge_shift
    own = slice(begin, begin + len(mesh.edges))
    part_of_node = np.full(len(mesh.nodes), -1, dtype=np.int32)
    part_of_node[cut.nodes] = cut.parts
    sampled = (tables.body["edge_plane"].view[own] >= 0)[:, None] & (part_of_node[mesh.edges] >= 0)
    forest = rebuilt_trees(mesh, part_of_node, tables.body["edge_share"].view[own], sampled, corners, count)
    begins = forest.begin + tables.append_tree(forest.trees)
    leaves, middles = tables.append_leaves(begins)
    for name, rows_of in (("tree", begins), ("leaf", leaves)):
        tables.fragment[f"{name}_begin"].view[first : first + count] = rows_of[:-1]
        tables.fragment[f"{name}_end"].view[first : first + count] = rows_of[1:]
    tables.fragment["middle"].view[first : first + count] = middles


def rebuilt_trees(
    mesh: TetMesh, part_of_node: np.ndarray, share: np.ndarray, sampled: np.ndarray, corners: NewSamples, count: int
) -> Forest:
    """REBUILT trees of parts 0 .. count - 1.

    part_of_node (n,) int32, -1: another fragment's; share (mesh edges,): where cut edges are crossed, as a share of
    their length from their first node; sampled (mesh edges, 2): which ends of edges are crack samples of these parts;
    corners: as in split_trees.
    """
    n = len(mesh.nodes)
    nodes = np.flatnonzero((part_of_node >= 0) & (mesh.on_surface != 0))
    edge, side = np.nonzero(sampled)
    cracks = (n + 2 * edge + side).astype(np.int32)
    samples = np.concatenate([nodes.astype(np.int32), cracks, corners.samples])
    points = np.vstack([mesh.nodes[nodes], _edge_points(mesh.nodes, mesh.edges, share, cracks), corners.points])
    part = np.concatenate([part_of_node[np.concatenate([nodes, mesh.edges[edge, side]])], corners.parts])
    by_part = np.argsort(part, kind="stable")
    trees = []
    for own in np.split(by_part, np.searchsorted(part[by_part], np.arange(1, count))):
        tree = build_sphere_tree(points[own], np.ones(len(own), np.uint8))
        trees.append(tree._replace(sample=samples[own][tree.sample]))
    joined = SphereTree(*(np.concatenate(columns) for columns in zip(*trees, strict=True)))
    return Forest(joined, begins_of(np.array([len(tree.size) for tree in trees])))


@kernel
def _new_samples(mesh, first, labels, share, cut, corners, low):
    """NewSamples: two at each of the edges `cut` (k,), ascending, and `corners`.

    first (5,): MeshPool.first of the mesh; labels (n,): fragments of its nodes, the new ones from `low` on; share
    (mesh edges,): where cut edges are crossed, as a share of their length from their first node.
    """
    crossings = 2 * len(cut)
    count = crossings + len(corners.points)
    new = NewSamples(
        np.empty((count, 3)), np.empty(count, np.int32), np.empty(count, np.int32), np.empty(count, np.int32)
    )
    for q in range(crossings):
        e, side = cut[q // 2] + first[FIRST_EDGE], q % 2
        node = mesh.edges[e, side] - first[FIRST_NODE]
        point_on_edge(mesh.nodes, mesh.edges[e, 0], mesh.edges[e, 1], share[cut[q // 2]], new.points[q])
        new.samples[q], new.parents[q], new.parts[q] = crossing_number(first, e, side), node, labels[node] - low
    for c in range(len(corners.points)):
        q = crossings + c
        for d in range(3):
            new.points[q, d] = corners.points[c, d]
        new.samples[q], new.parents[q], new.parts[q] = corners.samples[c], corners.parents[c], corners.parts[c]
    return new


@kernel
def _parts_of_entries(mesh, first, entries, labels, low):
    """The part (s,) int32 of the point of each of `entries`, rows of TreePool.entries.

    NOBODYS for corners, which depend on all cracks around them and are made anew for the new fragments.
    """
    parts = np.empty(len(entries), np.int32)
    for i in range(len(entries)):
        sample = entries[i, SAMPLE]
        if is_node(first, sample):
            parts[i] = labels[sample] - low
        elif is_crossing(first, sample):
            edge, side = edge_of(first, sample)
            parts[i] = labels[mesh.edges[edge, side] - first[FIRST_NODE]] - low
        else:
            parts[i] = NOBODYS
    return parts


@kernel
def _edge_points(nodes, edges, share, samples):
    """Positions (q, 3) [m] of crack samples: the crossings of their edges."""
    points = np.empty((len(samples), 3))
    for i in range(len(samples)):
        e = (samples[i] - len(nodes)) // 2
        point_on_edge(nodes, edges[e, 0], edges[e, 1], share[e], points[i])
    return points
