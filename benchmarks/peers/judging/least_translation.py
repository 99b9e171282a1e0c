"""The smallest translation of one body against another that satisfies the contacts reported between them.

Minimise |d|^2 subject to n_i . d >= depth_i: least distance programming, by its dual, a non-negative least-squares
problem of four rows (Lawson & Hanson, Solving Least Squares Problems, 1974, chapter 23, "LDP"). d: translation of the
second body; n_i: unit normals from the first to the second.
"""

from __future__ import annotations

import numpy as np
from scipy.optimize import nnls

SATISFIED = 1e-9  # of the deepest contact: smaller violations count as satisfied
INCOMPATIBLE = 1e-9  # length of the dual's residual that counts as zero: no translation satisfies all contacts
# In multiples of the deepest contact. Contacts that need more face each other within a few degrees, as in a slot; a
# solver resolves these by turning bodies, or not at all.
FARTHEST = 10.0
NEWTON_STEPS, HALVINGS = 50, 30
DAMPING = 1e-9, 1e4  # from almost undamped to almost no translation


def least_translation(normals: np.ndarray, depths: np.ndarray) -> np.ndarray:
    """(3,) [m] of the second body. normals (n, 3), unit, from the first; depths (n,) [m], negative: a gap.

    If no translation up to FARTHEST times the deepest contact satisfies all contacts: the translation within that
    length that minimises the sum of squared violations.
    """
    deepest = depths.max(initial=0.0)
    if deepest <= 0.0:
        return np.zeros(3)
    needed = depths / deepest
    # few of many contacts bind: start with the deepest, then add the most violated one until none is violated
    rows = [int(np.argmax(needed))]
    while True:
        shift = _least_distance(normals[rows], needed[rows])
        if shift is None or shift @ shift > FARTHEST**2:
            return deepest * _least_violation(normals, needed)
        violation = needed - normals @ shift
        worst = int(np.argmax(violation))
        if violation[worst] <= SATISFIED or worst in rows:
            return deepest * shift
        rows.append(worst)


def _least_distance(normals: np.ndarray, needed: np.ndarray) -> np.ndarray | None:
    """(3,); None if there is none."""
    system = np.vstack([normals.T, needed])
    target = np.array([0.0, 0.0, 0.0, 1.0])
    weights, distance = nnls(system, target)
    if distance <= INCOMPATIBLE:
        return None
    residual = system @ weights - target
    return -residual[:3] / residual[3]


def _least_violation(normals: np.ndarray, needed: np.ndarray) -> np.ndarray:
    """(3,) no longer than FARTHEST, minimising the sum of max(0, needed - normals . d)^2.

    The damping is chosen to meet that length.
    """
    low, high = DAMPING
    shift = _damped(normals, needed, low)
    if shift @ shift <= FARTHEST**2:
        return shift
    for _ in range(HALVINGS):
        middle = np.sqrt(low * high)
        shift = _damped(normals, needed, middle)
        low, high = (middle, high) if shift @ shift > FARTHEST**2 else (low, middle)
    return _damped(normals, needed, high)


def _damped(normals: np.ndarray, needed: np.ndarray, damping: float) -> np.ndarray:
    """(3,) minimum of the sum of squared violations + damping |d|^2, by Newton's method with step halving.

    The function is convex, and quadratic while the set of violated contacts stays the same.
    """
    shift = np.zeros(3)
    violation = np.maximum(needed, 0.0)
    for _ in range(NEWTON_STEPS):
        violated = normals[violation > 0.0]
        curvature = violated.T @ violated + damping * np.eye(3)
        step = np.linalg.solve(curvature, violated.T @ violation[violation > 0.0] - damping * shift)
        if step @ step < SATISFIED**2:
            break
        cost = violation @ violation + damping * shift @ shift
        for _ in range(HALVINGS):
            tried = shift + step
            violation = np.maximum(needed - normals @ tried, 0.0)
            if violation @ violation + damping * tried @ tried < cost:
                break
            step *= 0.5
        else:
            break
        shift = tried
    return shift
