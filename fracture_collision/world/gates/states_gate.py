"""Validation of fragment states."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fracture_collision.core.memory.compiled import kernel
from fracture_collision.portable_math import lengths
from fracture_collision.records import FragmentStates
from fracture_collision.world.gates.checks import (
    LARGEST_LENGTH,
    UINT64_MAX,
    each_once,
    floats,
    identifier,
    indices,
    refuse,
    same_length,
)

QUATERNION_TOLERANCE = 1e-6
_TYPES = (np.dtype(np.uint32), *[np.dtype(np.float64)] * 4)  # of fragment_ids and the columns after it
_WIDTHS = (0, 3, 4, 3, 3)  # of their rows


class _Columns(NamedTuple):
    """The arrays of states: flat as in the message, or with a row for each fragment as in CheckedStates."""

    ids: np.ndarray
    positions: np.ndarray
    orientations: np.ndarray
    linear: np.ndarray
    angular: np.ndarray


class CheckedStates(NamedTuple):
    """Valid states of n fragments; which ids live is not checked yet."""

    step: int
    fracture_sequence: int
    fragment_ids: np.ndarray  # (n,) int64, ascending
    positions: np.ndarray  # (n, 3) float64 [m]
    orientations: np.ndarray  # (n, 4) float64, x y z w
    linear: np.ndarray  # (n, 3) float64 [m/s] of the frame's origin
    angular: np.ndarray  # (n, 3) float64 [rad/s] world axes
    body_sequence: int  # body messages before them; 0: unknown


def check_states(states: FragmentStates) -> CheckedStates:
    """Raise InvalidMessage unless sizes and numbers of `states` obey the rules; the caller looks up the ids."""
    return _as_they_are(states) or _put_in_order(states)


def _as_they_are(states: FragmentStates) -> CheckedStates | None:
    """Fast path for states that obey every rule and ascend by id, as most do; None: use `_put_in_order`."""
    given = _Columns(
        states.fragment_ids, states.positions, states.orientations, states.linear_velocities, states.angular_velocities
    )
    for column, dtype, width in zip(given, _TYPES, _WIDTHS, strict=True):
        if type(column) is not np.ndarray or column.dtype != dtype or not column.flags.carray:
            return None
        if column.ndim != 1 and column.shape[1:] != (width,):
            return None
    given = _Columns(*(column.reshape(-1) for column in given))
    step = identifier("step", states.step, UINT64_MAX)
    sequence = identifier("fracture_sequence", states.fracture_sequence, UINT64_MAX)
    bodies = identifier("body_sequence", states.body_sequence, UINT64_MAX)
    n = len(states.fragment_ids)
    rows = _Columns(
        np.empty(n, np.int64), np.empty((n, 3)), np.empty((n, 4)), np.zeros((n, 3)), np.zeros((n, 3))
    )  # fmt: skip
    if not _copy_if_sound(given, rows, LARGEST_LENGTH, QUATERNION_TOLERANCE):
        return None
    return CheckedStates(step, sequence, *rows, bodies)


@kernel
def _copy_if_sound(flat, rows, largest, tolerance):
    """Copy columns `flat` to `rows` and return whether all rules hold; absent velocities leave theirs unchanged."""
    given_ids, given_positions, given_orientations, given_linear, given_angular = flat
    ids, positions, orientations, linear, angular = rows
    n = len(ids)
    if len(given_positions) != 3 * n or len(given_orientations) != 4 * n:
        return False
    for given, velocities in ((given_linear, linear), (given_angular, angular)):
        if len(given) != 0 and len(given) != 3 * n:
            return False
        for k in range(len(given)):
            if not np.isfinite(given[k]):
                return False
            velocities[k // 3, k % 3] = given[k]
    for i in range(n):
        ids[i] = given_ids[i]
        if i > 0 and ids[i] <= ids[i - 1]:
            return False
        for d in range(3):
            positions[i, d] = given_positions[3 * i + d]
            if not abs(positions[i, d]) <= largest:
                return False
        squares = 0.0
        for d in range(4):
            v = given_orientations[4 * i + d]
            orientations[i, d] = v
            squares += v * v
        if not abs(np.sqrt(squares) - 1.0) <= tolerance:
            return False
    return True


def _put_in_order(states: FragmentStates) -> CheckedStates:
    step = identifier("step", states.step, UINT64_MAX)
    sequence = identifier("fracture_sequence", states.fracture_sequence, UINT64_MAX)
    bodies = identifier("body_sequence", states.body_sequence, UINT64_MAX)
    ids = indices("fragment_ids", states.fragment_ids)
    each_once("fragment_ids", ids)
    positions = floats("positions", states.positions, 3, LARGEST_LENGTH)
    orientations = floats("orientations", states.orientations, 4)
    same_length("positions", positions, "fragment_ids", len(ids))
    same_length("orientations", orientations, "fragment_ids", len(ids))
    both = []
    for name in ("linear_velocities", "angular_velocities"):
        velocities = floats(name, getattr(states, name), 3)
        if len(velocities):
            same_length(name, velocities, "fragment_ids", len(ids))
        both.append(velocities if len(velocities) else np.zeros((len(ids), 3)))
    with np.errstate(over="ignore"):  # an infinite length is not 1 either
        length = lengths(orientations)
    crooked = np.flatnonzero(~(np.abs(length - 1.0) <= QUATERNION_TOLERANCE))
    if len(crooked):
        i = crooked[0]
        refuse(
            "not_unit",
            f"orientations: the quaternion of fragment {ids[i]} has length {length[i]:.9g}, not 1; divide it by that, "
            "and order it x y z w",
        )
    order = np.argsort(ids, kind="stable")
    positions, orientations, linear, angular = (
        np.ascontiguousarray(column[order]) for column in (positions, orientations, *both)
    )
    return CheckedStates(step, sequence, ids[order], positions, orientations, linear, angular, bodies)
