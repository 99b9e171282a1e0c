"""Tetrahedral meshes that come with the package, because the mesher that made them gives no two equal ones.

Files of two arrays in config/meshes; their origin and licence stand beside them.
"""

from __future__ import annotations

import numpy as np

from fracture_collision.geometry.generators import TetGeometry, require_positive
from fracture_collision.share import share_directory


def bunny(longest_side: float = 0.2) -> TetGeometry:
    """The Stanford bunny, 2,010 nodes, in a box about the origin whose longest side, along z, is `longest_side` [m]."""
    require_positive(longest_side=longest_side)
    with np.load(share_directory() / "config" / "meshes" / "bunny.npz", allow_pickle=False) as stored:
        vertices, tetrahedra = stored["vertices"].astype(np.float64), stored["tetrahedra"]
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    scale = longest_side / (high - low).max()
    return TetGeometry((vertices - 0.5 * (low + high)) * scale, tetrahedra)
