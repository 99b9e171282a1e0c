"""The gate for fragment states."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fracture_collision.portable_math import lengths
from fracture_collision.records import FragmentStates
from fracture_collision.world.checks import (
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


class CheckedStates(NamedTuple):
    step: int
    fracture_sequence: int
    fragment_ids: np.ndarray  # (n,) int64, ascending
    positions: np.ndarray  # (n, 3) float64 [m]
    orientations: np.ndarray  # (n, 4) float64, x y z w


def check_states(states: FragmentStates) -> CheckedStates:
    """Raise InvalidMessage unless sizes and numbers of `states` keep the rules; ids are the caller's to look up."""
    step = identifier("step", states.step, UINT64_MAX)
    sequence = identifier("fracture_sequence", states.fracture_sequence, UINT64_MAX)
    ids = indices("fragment_ids", states.fragment_ids)
    each_once("fragment_ids", ids)
    positions = floats("positions", states.positions, 3, LARGEST_LENGTH)
    orientations = floats("orientations", states.orientations, 4)
    same_length("positions", positions, "fragment_ids", len(ids))
    same_length("orientations", orientations, "fragment_ids", len(ids))
    for name in ("linear_velocities", "angular_velocities"):
        velocities = floats(name, getattr(states, name), 3)
        if len(velocities):
            same_length(name, velocities, "fragment_ids", len(ids))
    with np.errstate(over="ignore"):  # infinite is not 1 either
        length = lengths(orientations)
    crooked = np.flatnonzero(~(np.abs(length - 1.0) <= QUATERNION_TOLERANCE))
    if len(crooked):
        i = crooked[0]
        refuse("not_unit", f"orientations: the quaternion of fragment {ids[i]} has length {length[i]:.9g}, not 1")
    order = np.argsort(ids, kind="stable")
    return CheckedStates(
        step, sequence, ids[order], np.ascontiguousarray(positions[order]), np.ascontiguousarray(orientations[order])
    )
