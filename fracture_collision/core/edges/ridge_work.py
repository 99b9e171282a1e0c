"""Working memory of ridge_contacts.py."""

from __future__ import annotations

import numpy as np

from fracture_collision.core.edges.ridges import RIDGE
from fracture_collision.core.memory.pools import LEAF
from fracture_collision.core.memory.struct import Struct

# Lower and upper corners of a leaf's box, the greatest length and turn in it.
BOX_AND_MOST = 8


class RidgeWork(Struct):
    """Working memory of one thread for a search for crossings of ridges."""

    worst: np.ndarray  # (n,) float32 [m]: how far leaves are beyond half-spaces
    of_a: np.ndarray  # (n,) int32: ridges of a that may reach b
    of_b: np.ndarray  # (2, n) int32: leaves of b that may reach a; those that may reach a leaf of a
    boxes: np.ndarray  # (2, BOX_AND_MOST, n) float32 [m]: of these leaves, see Ridges.boxes and most
    excess: np.ndarray  # (n,) float32 [m]: by how much leaves miss a ridge of a
    lanes: np.ndarray  # (LEAF + padding,) float32 [m]: by how much ridges of a leaf miss a ridge of a
    ends: np.ndarray  # (LEAF + 1 + padding, 8) float64: ridges of a leaf of a in b's frame, see carry_leaf
    row: np.ndarray  # (RIDGE + padding,) float64: a ridge of a in b's frame
    meeting: np.ndarray  # (10 + padding,) float64 [m], see ridge_crossing.crossing


def make_ridge_work(room: int) -> RidgeWork:
    """Working memory for fragments with up to `room` ridges."""
    f4, n = np.float32, LEAF * (room // LEAF + 1)
    return RidgeWork(
        np.zeros(n, f4), np.zeros(n, np.int32), np.zeros((2, n), np.int32),
        np.zeros((2, BOX_AND_MOST, n), f4), np.zeros(n, f4), np.zeros(LEAF + 32, f4),
        np.zeros((LEAF + 3, 8)), np.zeros(RIDGE + 16), np.zeros(32),
    )  # fmt: skip
