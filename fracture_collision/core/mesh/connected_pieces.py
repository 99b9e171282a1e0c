"""What hangs together: nodes of a mesh through its edges, corners and triangles of a surface through its sides.

By union-find (Tarjan 1975) with the smallest node as root, so that pieces come out in order. scipy has it too, and
takes a quarter of a second to be imported, which a service that was killed has not got.
"""

from __future__ import annotations

import numpy as np

from fracture_collision.core.memory.compiled import inlined_kernel, kernel


def connected_pieces(edges: np.ndarray, labels: np.ndarray) -> np.ndarray:
    """Number the pieces of equal label that hang together through edges: (n,) int32, one piece index a node.

    Two nodes are in one piece if a path of edges joins them along nodes of their own label. Pieces are numbered as by
    `joined`; a node without edges is a piece of its own.
    """
    labels = np.asarray(labels)
    kept = edges[labels[edges[:, 0]] == labels[edges[:, 1]]]
    return joined(kept[:, 0], kept[:, 1], len(labels))


def joined(first: np.ndarray, second: np.ndarray, count: int) -> np.ndarray:
    """The pieces of 0 .. count - 1 if first[i] and second[i] are in one, for all i: (count,) int32, numbered from 0 in
    the order of their smallest members.
    """
    first, second = (np.ascontiguousarray(each, dtype=np.int64) for each in (first, second))
    return _joined(first, second, count)


@inlined_kernel
def _root(parent, node):
    """Halves the way for who comes next."""
    while parent[node] != node:
        parent[node] = parent[parent[node]]
        node = parent[node]
    return node


@kernel
def _joined(first, second, count):
    parent = np.arange(count)
    for i in range(first.size):
        a, b = _root(parent, first[i]), _root(parent, second[i])
        parent[max(a, b)] = min(a, b)
    piece = np.empty(count, np.int32)
    found = 0
    for node in range(count):
        root = _root(parent, node)
        if root == node:
            piece[node] = found
            found += 1
        else:
            piece[node] = piece[root]
    return piece
