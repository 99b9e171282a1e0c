"""The fragments that take part in a step, with their poses: those that its states name, and the static ones."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fracture_collision.core.memory.compiled import kernel
from fracture_collision.core.memory.rotations import put_rotation
from fracture_collision.records import documented
from fracture_collision.world.gates.states_gate import CheckedStates
from fracture_collision.world.living_fragments import Columns


@documented
class Present(NamedTuple):
    """The n fragments that take part in a step, by ascending id: those that the states name, and the static ones.

    Fields:
      ids: (n,) int64
      rows: (n,) int64, in the pools of CollisionWorld.geometry
      positions: (n, 3) float64 [m], of the body frame, in the world
      rotations: (n, 3, 3) float64, body frame to world
      linear: (n, 3) float64 [m/s], of the body frame's origin
      angular: (n, 3) float64 [rad/s], world axes
      is_static: (n,) bool
      friction: (n,) float64, Coulomb coefficient
      restitution: (n,) float64, 0 to 1
    """

    ids: np.ndarray
    rows: np.ndarray
    positions: np.ndarray
    rotations: np.ndarray
    linear: np.ndarray
    angular: np.ndarray
    is_static: np.ndarray
    friction: np.ndarray
    restitution: np.ndarray


def take_places(checked: CheckedStates, living: Columns, named: np.ndarray, static_until: int) -> Present:
    """The fragments that take part, with their poses; static ones that the states do not name are at the origin.

    `named` (n,): indices into `living` of the fragments that the states name, in the states' order; `static_until`:
    the last message whose static bodies take part unnamed.
    """
    always = living.is_static & (living.sequences <= np.uint64(static_until))
    fragments = _Fragments(living.ids, living.rows, living.is_static, always, living.friction, living.restitution)
    poses = _Poses(checked.positions, checked.orientations, checked.linear, checked.angular)
    return Present(*_take_places(fragments, named, poses))


class _Fragments(NamedTuple):
    """What a step takes from the living fragments; shapes as in Columns."""

    ids: np.ndarray
    rows: np.ndarray
    is_static: np.ndarray
    always: np.ndarray  # (n,) bool: takes part without being named
    friction: np.ndarray
    restitution: np.ndarray


class _Poses(NamedTuple):
    """What a step takes from the states; shapes as in CheckedStates."""

    positions: np.ndarray
    orientations: np.ndarray
    linear: np.ndarray
    angular: np.ndarray


@kernel
def _take_places(fragments, named, poses):
    ids, rows, is_static, always, friction, restitution = fragments
    positions, orientations, linear, angular = poses
    stands_at = np.full(len(ids), -1)
    for k in range(len(named)):
        stands_at[named[k]] = k
    chosen = np.flatnonzero(always | (stands_at >= 0))
    n = len(chosen)
    placed, rotations, velocities, spins = np.zeros((n, 3)), np.empty((n, 3, 3)), np.zeros((n, 3)), np.zeros((n, 3))
    for i in range(n):
        k = stands_at[chosen[i]]
        x, y, z, w = 0.0, 0.0, 0.0, 1.0
        if k >= 0:
            placed[i], velocities[i], spins[i] = positions[k], linear[k], angular[k]
            x, y, z, w = orientations[k, 0], orientations[k, 1], orientations[k, 2], orientations[k, 3]
        put_rotation(x, y, z, w, rotations[i])
    return (
        ids[chosen], rows[chosen], placed, rotations, velocities, spins, is_static[chosen], friction[chosen],
        restitution[chosen],
    )  # fmt: skip


@kernel
def find_fragments(ids, wanted):
    """Indices (n,) into ascending `ids` of ascending `wanted`; -1 where absent."""
    found, k = np.full(len(wanted), -1), 0
    for i in range(len(wanted)):
        while k < len(ids) and ids[k] < wanted[i]:
            k += 1
        if k < len(ids) and ids[k] == wanted[i]:
            found[i] = k
    return found
