"""Connected components: nodes of a mesh through its edges, corners and triangles of a surface through its sides.

Union-find (Tarjan 1975) with the smallest node as root, so that pieces come out in order. scipy has it too, but takes a
quarter of a second to import, too long for the restart of a killed service.
"""

from __future__ import annotations

import numpy as np

from fracture_collision.core.memory.compiled import kernel, query_kernel


def connected_pieces(edges: np.ndarray, labels: np.ndarray) -> np.ndarray:
    """Number the connected pieces of equal label: (n,) int32, one piece index per node.

    Two nodes are in one piece if a path of edges joins them along nodes of their own label. Pieces are numbered as in
    `joined`; a node without edges is a piece of its own.
    """
    labels = np.asarray(labels)
    kept = edges[labels[edges[:, 0]] == labels[edges[:, 1]]]
    return joined(kept[:, 0], kept[:, 1], len(labels))


def joined(first: np.ndarray, second: np.ndarray, count: int) -> np.ndarray:
    """Connected pieces of 0 .. count - 1 with links (first[i], second[i]).

    Returns (count,) int32, numbered from 0 in the order of their smallest members.
    """
    first, second = (np.ascontiguousarray(each, dtype=np.int64) for each in (first, second))
    return _joined(first, second, count)


@query_kernel
def root_of(parent, node):
    """Find the root, with path halving."""
    while parent[node] != node:
        parent[node] = parent[parent[node]]
        node = parent[node]
    return node


@kernel
def _joined(first, second, count):
    parent = np.arange(count)
    for i in range(first.size):
        a, b = root_of(parent, first[i]), root_of(parent, second[i])
        parent[max(a, b)] = min(a, b)
    piece = np.empty(count, np.int32)
    found = 0
    for node in range(count):
        root = root_of(parent, node)
        if root == node:
            piece[node] = found
            found += 1
        else:
            piece[node] = piece[root]
    return piece
