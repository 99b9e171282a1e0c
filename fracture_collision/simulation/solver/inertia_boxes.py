"""Bodies as boxes of equal mass and inertia tensor: an estimate of a shape without its mesh."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from fracture_collision.kernel_sources import cached_njit
from fracture_collision.simulation.compiled import uncounted

# Jacobi's method converges quadratically: six sweeps are enough for 3 x 3, more change nothing.
SWEEPS = 8


class Boxes(NamedTuple):
    """Of n bodies."""

    axes: np.ndarray  # (n, 3, 3) unit vectors along their sides, as rows, world
    halves: np.ndarray  # (n, 3) [m] half of these sides

    def reach(self) -> np.ndarray:
        """(n,) [m] from their centres to their corners."""
        return np.sqrt((self.halves * self.halves).sum(axis=1))

    def thickness(self) -> np.ndarray:
        """(n,) [m] their shortest sides."""
        return 2.0 * self.halves.min(axis=1, initial=np.inf)


def boxes_of(masses: np.ndarray, inertias: np.ndarray) -> Boxes:
    """Boxes of n bodies.

    masses (n,) [kg], inertias (n, 3, 3) [kg m2] about the centres of mass, world axes.
    """
    return Boxes(*_boxes(masses, inertias))


@cached_njit
def _boxes(masses, inertias):
    n = len(masses)
    axes, halves = np.zeros((n, 3, 3)), np.zeros((n, 3))
    work = np.empty((3, 3))
    for i in range(n):
        for j in range(3):
            axes[i, j, j] = 1.0
            for k in range(3):
                work[j, k] = inertias[i, j, k]
        for _ in range(SWEEPS):
            for p, q in ((0, 1), (0, 2), (1, 2)):
                _rotate(work, axes[i], p, q)
        total = work[0, 0] + work[1, 1] + work[2, 2]
        for k in range(3):
            # of a box with sides x, y, z the moment about x is m (y^2 + z^2) / 12
            halves[i, k] = 0.5 * math.sqrt(max(6.0 * (total - 2.0 * work[k, k]) / masses[i], 0.0))
    return axes, halves


@uncounted
def _rotate(matrix, axes, p, q):
    """One of Jacobi's rotations: matrix[p, q] becomes 0, and rows p, q of `axes` turn with it.

    Golub and Van Loan, "Matrix Computations", 8.5.2.
    """
    if matrix[p, q] == 0.0:
        return
    tau = (matrix[q, q] - matrix[p, p]) / (2.0 * matrix[p, q])
    t = 1.0 / (abs(tau) + math.sqrt(1.0 + tau * tau))
    if tau < 0.0:
        t = -t
    c = 1.0 / math.sqrt(1.0 + t * t)
    s = t * c
    for k in range(3):
        a, b = matrix[p, k], matrix[q, k]
        matrix[p, k], matrix[q, k] = c * a - s * b, s * a + c * b
    for k in range(3):
        a, b = matrix[k, p], matrix[k, q]
        matrix[k, p], matrix[k, q] = c * a - s * b, s * a + c * b
        a, b = axes[p, k], axes[q, k]
        axes[p, k], axes[q, k] = c * a - s * b, s * a + c * b
    matrix[p, q] = matrix[q, p] = 0.0
