"""The arrays that only the paper's method has, beside the pools of all methods."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

AVERAGED = "averaged"
RESTRUCTURED, PLAIN, REBUILT = "restructured", "plain", "rebuilt"
QUEUE = "queue"


class TreePool(NamedTuple):
    """Sphere trees in preorder (sphere_tree.py); the values that a visit reads are adjacent."""

    spheres: np.ndarray  # (S, 4) float64 [m], centre in the body frame, radius
    entries: np.ndarray  # (S, 3) int32: SIZE, SAMPLE, SURFACE
    ranges: np.ndarray  # (F, 2) int32: first entry of each fragment, end; equal for planes and spheres


# Columns of TreePool.entries.
SIZE = 0  # entries of the subtree including this one
SAMPLE = 1  # number of the sample point within its body, sample_numbers.py
SURFACE = 2  # OWN_SAMPLE if the point samples the fragment's surface, NONE_BELOW if nothing in the subtree does, else 0
OWN_SAMPLE = 1
NONE_BELOW = -1


class FieldPool(NamedTuple):
    """The averaged field of broken bodies (4.1 - 4.4); no rows under the exact field."""

    # rows as BodyPool.node_fragment: d [m] and unit n of eq. 1-2, then a point [m] that is certainly not inside
    node_field: np.ndarray  # (., 7) float64
    grid: np.ndarray  # (meshes, 4) float64: first point of the dense grid [m], cell [m]
    grid_dims: np.ndarray  # (meshes, 4) int32: grid points along x, y, z; first entry in grid_depth
    grid_depth: np.ndarray  # float64 [m] signed distance of the unbroken body, positive inside


class PaperPools(NamedTuple):
    """All of them, and two of the paper's variants."""

    trees: TreePool
    field: FieldPool
    is_averaged: bool  # depth in a broken body from one averaged distance per node, not by local flood
    in_a_row: bool  # all children of a parent in a row, as in the paper's earlier version [27], not alternating (5.3)
