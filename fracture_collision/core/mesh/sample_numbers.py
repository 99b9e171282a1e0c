"""Sample numbers of a body of tetrahedra, and the points that a fracture adds to them.

A body of n nodes, e edges and m tetrahedra has, in this order: its n nodes; two crossings per edge, n + 2 edge + side,
of the fragment that owns the edge's first end (side 0) or its second (side 1); and five corners per tetrahedron,
n + 2 e + 5 t + which: its hub (0) and the points of its faces (1 + face), where cracks meet. A fragment's samples are
those of its points that are on its surface.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fracture_collision.core.memory.compiled import query_kernel

CORNERS_EACH = 5
OF_HUB, OF_FACE = 0, 1
# Numbers of contacts without a sample start beyond all sample numbers: of crossing ridges, of patches.
FIRST_OF_RIDGES, FIRST_OF_PATCHES = 1 << 42, 1 << 60
# Columns of MeshPool.first.
FIRST_NODE, FIRST_EDGE, NODES, FIRST_TETRAHEDRON, EDGES = 0, 1, 2, 3, 4


class NewSamples(NamedTuple):
    """Points that a fracture adds to the surfaces of its fragments."""

    points: np.ndarray  # (q, 3) float64 [m]
    samples: np.ndarray  # (q,) int32
    parents: np.ndarray  # (q,) int32 nearby mesh nodes of the same fragment
    parts: np.ndarray  # (q,) int32 index of the new fragment


@query_kernel
def crossing_number(first, edge, side):
    """Number of a crossing of a mesh edge, given by its row in the pool; first (5,): MeshPool.first of the mesh."""
    return first[NODES] + 2 * (edge - first[FIRST_EDGE]) + side


@query_kernel
def corner_number(first, tetrahedron, which):
    """Number of a corner of a tetrahedron, given by its row in the pool."""
    return first[NODES] + 2 * first[EDGES] + CORNERS_EACH * (tetrahedron - first[FIRST_TETRAHEDRON]) + which


@query_kernel
def is_node(first, sample):
    """Whether a sample is a node of the mesh."""
    return sample < first[NODES]


@query_kernel
def is_crossing(first, sample):
    """Whether a sample is a crossing of a mesh edge."""
    return first[NODES] <= sample < first[NODES] + 2 * first[EDGES]


@query_kernel
def edge_of(first, sample):
    """(row in the pool, side) of the mesh edge of a crossing."""
    return first[FIRST_EDGE] + (sample - first[NODES]) // 2, (sample - first[NODES]) % 2


@query_kernel
def tetrahedron_of(first, sample):
    """Row in the pool of the tetrahedron of a corner."""
    return first[FIRST_TETRAHEDRON] + (sample - first[NODES] - 2 * first[EDGES]) // CORNERS_EACH


@query_kernel
def is_crossing_of_ridges(number):
    """Whether a contact's number denotes two crossing ridges instead of a sample."""
    return number >= FIRST_OF_RIDGES
