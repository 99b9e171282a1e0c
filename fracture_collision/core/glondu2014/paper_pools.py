"""The arrays that only the paper's method has, beside the pools of all methods."""

from __future__ import annotations

from typing import Annotated

import numpy as np

from fracture_collision.core.memory.pools import BODY_NODE, FRAGMENT, MESH, f8, i4
from fracture_collision.core.memory.struct import Struct
from fracture_collision.core.memory.tables import Column

AVERAGED = "averaged"
RESTRUCTURED, PLAIN, REBUILT = "restructured", "plain", "rebuilt"
QUEUE = "queue"


TREE_ENTRY, GRID_POINT = "tree entry", "grid point"


class TreePool(Struct):
    """Sphere trees in preorder (sphere_tree.py); the values that a visit reads are adjacent."""

    spheres: Annotated[np.ndarray, Column(TREE_ENTRY, f8, 4)]  # [m], centre in the body frame, radius
    entries: Annotated[np.ndarray, Column(TREE_ENTRY, i4, 3)]  # SIZE, SAMPLE, SURFACE
    # first entry of each fragment, end; equal for planes and spheres
    ranges: Annotated[np.ndarray, Column(FRAGMENT, i4, 2, TREE_ENTRY)]


# Columns of TreePool.entries.
SIZE = 0  # entries of the subtree including this one
SAMPLE = 1  # number of the sample point within its body, sample_numbers.py
SURFACE = 2  # OWN_SAMPLE if the point samples the fragment's surface, NONE_BELOW if nothing in the subtree does, else 0
OWN_SAMPLE = 1
NONE_BELOW = -1


class FieldPool(Struct):
    """The averaged field of broken bodies (4.1 - 4.4); no rows under the exact field."""

    # d [m] and unit n of eq. 1-2, then a point [m] that is certainly not inside
    node_field: Annotated[np.ndarray, Column(BODY_NODE, f8, 7)]
    grid: Annotated[np.ndarray, Column(MESH, f8, 4)]  # first point of the dense grid [m], cell [m]
    # grid points along x, y, z; first entry in grid_depth
    grid_dims: Annotated[np.ndarray, Column(MESH, i4, 4, (None, None, None, GRID_POINT))]
    # [m] signed distance of the unbroken body, positive inside
    grid_depth: Annotated[np.ndarray, Column(GRID_POINT, f8)]


class PaperPools(Struct):
    """All of them, and two of the paper's variants."""

    trees: TreePool
    field: FieldPool
    is_averaged: bool  # depth in a broken body from one averaged distance per node, not by local flood
    in_a_row: bool  # all children of a parent in a row, as in the paper's earlier version [27], not alternating (5.3)
