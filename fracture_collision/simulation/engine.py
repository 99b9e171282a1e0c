"""The physics engine: bodies in, velocities in, states out.

The engine holds the bodies and moves them; it neither finds nor solves contacts. The simulation passes it the contact
solver's velocities, and it integrates the poses. One step of length h moves a body with centre of mass c and
orientation q by the given velocities v, w,

    c += h v,   q = exp(h w / 2) q,

the second of which is exact for a constant w (semi-implicit Euler; the velocities already contain gravity and
gyroscopic terms). Bullet integrates by the same formulas (btTransformUtil::integrateTransform), but takes sin and cos
from glibc, which rounds them differently from processor to processor, and turns no body by more than pi/4 a step.

The velocities of free bodies after one step (`free_velocities`): gravity, and the gyroscopic torque without energy
gain. Euler's equations I w' + w x I w = 0 by the implicit midpoint rule: with m = (w0 + w1) / 2,

    f(w1) = I (w1 - w0) + h m x I m = 0,   f' = I + h/2 ([m]x I - [I m]x)

It keeps the quadratic invariants w.Iw and |Iw|^2 (Hairer, Lubich, Wanner, "Geometric Numerical Integration", IV.2.1);
the explicit rule, Bullet's own, feeds energy to fast spins. I is the world-axes inertia of the pose at the start, w1
turns with the body. So the pose decides where the angular momentum points: mean_spins keeps it.

Hands and hammers push on bodies, beside gravity and contacts; their pushes are evaluated once a step.

Two frames occur: the *body frame* of the records (that of the
original, unbroken body, carried along rigidly by each of its fragments) and the centre of mass, about which velocities
and inertias are given here.
"""

from __future__ import annotations

import math
from typing import NamedTuple, Protocol

import numpy as np

from fracture_collision import portable_math
from fracture_collision.kernel_sources import cached_njit
from fracture_collision.simulation.compiled import uncounted
from fracture_collision.simulation.rotations import (
    crossed,
    quaternion_products,
    rotation_matrices,
    turned,
    turned_along,
    turned_matrices,
    turns_of,
)


class MassProperties(NamedTuple):
    """Of one fragment, in its body frame."""

    mass: float  # [kg]
    center_of_mass: np.ndarray  # (3,) [m]
    inertia: np.ndarray  # (3, 3) [kg m2], about the centre of mass


class FrameState(NamedTuple):
    """Motion of one body frame in the world."""

    position: np.ndarray  # (3,) [m], its origin
    orientation: np.ndarray  # (4,) unit quaternion x y z w, body frame to world
    linear_velocity: np.ndarray  # (3,) [m/s], of its origin
    angular_velocity: np.ndarray  # (3,) [rad/s], world axes


class BodyStates(NamedTuple):
    """All bodies of an engine, ascending by fragment id; world frame."""

    fragment_ids: np.ndarray  # (n,) uint32
    masses: np.ndarray  # (n,) [kg]
    inertias: np.ndarray  # (n, 3, 3) [kg m2], about the centre of mass, world axes
    centers: np.ndarray  # (n, 3) [m], centres of mass
    linear: np.ndarray  # (n, 3) [m/s], of the centre of mass
    angular: np.ndarray  # (n, 3) [rad/s]
    frame_positions: np.ndarray  # (n, 3) [m], body frames' origins
    frame_orientations: np.ndarray  # (n, 4) unit quaternions x y z w, body frame to world

    def frame_velocities(self) -> np.ndarray:
        """Of the body frames' origins: v + w x (origin - c), (n, 3) [m/s]."""
        return self.linear + np.cross(self.angular, self.frame_positions - self.centers)

    def velocities(self) -> np.ndarray:
        """Linear and angular velocities, (n, 6) [m/s, rad/s]."""
        return np.hstack((self.linear, self.angular))

    def frame(self, i: int) -> FrameState:
        """Motion of the body frame of the i-th body."""
        return FrameState(
            self.frame_positions[i], self.frame_orientations[i], self.frame_velocities()[i], self.angular[i]
        )


def rows_of(fragments: np.ndarray, ids: np.ndarray) -> np.ndarray:
    """Positions of `fragments` (m,) in ascending `ids` (n,): (m,) int64; n if not among them."""
    rows, found = np.searchsorted(ids, fragments), np.full(len(fragments), len(ids), np.int64)
    if len(ids):
        known = ids[np.minimum(rows, len(ids) - 1)] == fragments
        found[known] = rows[known]
    return found


class ByFragment(NamedTuple):
    """Values of n fragments."""

    fragment_ids: np.ndarray  # (n,) uint32, ascending
    values: np.ndarray  # (n, ...)

    def of(self, fragment_ids: np.ndarray) -> np.ndarray:
        """(m, ...) the values of `fragment_ids` (m,), ascending; 0 for fragments that are not among these."""
        if fragment_ids is self.fragment_ids:
            return self.values.copy()
        rows = rows_of(fragment_ids, self.fragment_ids)
        values, known = np.zeros((len(rows), *self.values.shape[1:]), self.values.dtype), rows < len(self.values)
        values[known] = self.values[rows[known]]
        return values

    def have(self, fragment_ids: np.ndarray) -> np.ndarray:
        """(m,) bool: whether `fragment_ids` (m,) are among these."""
        return rows_of(fragment_ids, self.fragment_ids) < len(self.fragment_ids)


class _Bodies(NamedTuple):
    """Ascending by fragment id; mass properties in body frames, poses in the world."""

    fragment_ids: np.ndarray  # (n,) uint32
    masses: np.ndarray  # (n,) [kg]
    centers_of_mass: np.ndarray  # (n, 3) [m]
    inertias: np.ndarray  # (n, 3, 3) [kg m2], about the centre of mass
    centers: np.ndarray  # (n, 3) [m]
    orientations: np.ndarray  # (n, 4) unit quaternions x y z w
    linear: np.ndarray  # (n, 3) [m/s]
    angular: np.ndarray  # (n, 3) [rad/s]


_NONE = _Bodies(
    np.zeros(0, np.uint32), np.zeros(0), np.zeros((0, 3)), np.zeros((0, 3, 3)), np.zeros((0, 3)), np.zeros((0, 4)),
    np.zeros((0, 3)), np.zeros((0, 3)),
)  # fmt: skip


class RigidBodyWorld:
    """A world of free rigid bodies without collision shapes."""

    def __init__(self, time_step: float) -> None:
        self._time_step = float(time_step)
        self._bodies = _NONE
        self._newcomers: dict[int, tuple[MassProperties, FrameState]] = {}  # joined to `_bodies` when states are read
        self._states: BodyStates | None = None  # of `_bodies`, None after a change

    def add(self, fragment_id: int, properties: MassProperties, frame: FrameState) -> None:
        """Add a body; ValueError if its id is taken, or its mass or inertia is not positive."""
        if fragment_id in self._newcomers or self._row_of(fragment_id) is not None:
            raise ValueError(f"fragment {fragment_id} is already in the world")
        if not properties.mass > 0.0:
            raise ValueError(f"fragment {fragment_id}: mass {properties.mass} kg is not positive")
        minors = _leading_minors(properties.inertia)
        if not all(minor > 0.0 for minor in minors):
            tensor = properties.inertia.tolist()
            raise ValueError(f"fragment {fragment_id}: inertia {tensor} kg m2 is not positive definite")
        self._newcomers[fragment_id] = properties, frame

    def remove(self, fragment_id: int) -> None:
        """Remove a body; KeyError if there is none of this id."""
        if self._newcomers.pop(fragment_id, None) is not None:
            return
        row = self._row_of(fragment_id)
        if row is None:
            raise KeyError(fragment_id)
        self._bodies = _Bodies(*[np.delete(column, row, axis=0) for column in self._bodies])
        self._states = None

    def states(self) -> BodyStates:
        """Present states of all bodies, ascending by id."""
        if self._newcomers:
            self._take_in()
        if self._states is None:
            self._states = _states_of(self._bodies)
        return self._states

    def advance(
        self, linear: np.ndarray, angular: np.ndarray, drift_linear: np.ndarray, drift_angular: np.ndarray
    ) -> None:
        """One time step: bodies, in the order of `states`, move with `linear` + `drift_linear` (n, 3), keep `linear`.

        Likewise `angular`. The velocities already contain gravity and gyroscopic terms of this step; the drift
        velocities move poses only and do not outlast the step.
        """
        before = self.states()
        turns = turns_of(angular + drift_angular, self._time_step)
        after = quaternion_products(turns, before.frame_orientations)
        self._bodies = self._bodies._replace(
            centers=before.centers + self._time_step * (linear + drift_linear),
            orientations=after,
            linear=np.array(linear),
            # Spins turn with the bodies, which conserves their energies.
            angular=turned_along(before.frame_orientations, after, np.array(angular)),
        )
        self._states = None

    def place(self, rows: np.ndarray, frames: FrameState) -> None:
        """Put bodies, of these rows (m,) of `states`, to other frames: a FrameState of arrays, a row for each."""
        positions, orientations, linear, angular = frames
        columns = [column.copy() for column in self._bodies[4:]]
        arms = turned(rotation_matrices(orientations), self._bodies.centers_of_mass[rows])
        new = positions + arms, orientations, linear + crossed(angular, arms), angular
        for column, values in zip(columns, new, strict=True):
            column[rows] = values
        self._bodies = _Bodies(*self._bodies[:4], *columns)
        self._states = None

    def close(self) -> None:
        """No resources to release."""

    def _row_of(self, fragment_id: int) -> int | None:
        ids = self._bodies.fragment_ids
        row = int(np.searchsorted(ids, fragment_id))
        return row if row < len(ids) and ids[row] == fragment_id else None

    def _take_in(self) -> None:
        ids = np.array(list(self._newcomers), dtype=np.uint32)
        properties, frames = zip(*self._newcomers.values(), strict=True)
        self._newcomers.clear()
        masses, centers_of_mass, inertias = map(np.array, zip(*properties, strict=True))
        positions, orientations, linear, angular = map(np.array, zip(*frames, strict=True))
        arms = turned(rotation_matrices(orientations), centers_of_mass)
        come = _Bodies(
            ids, masses, centers_of_mass, inertias, positions + arms, orientations, linear + crossed(angular, arms),
            angular,
        )  # fmt: skip
        order = np.argsort(np.concatenate((self._bodies.fragment_ids, ids)), kind="stable")
        self._bodies = _Bodies(*[np.concatenate(columns)[order] for columns in zip(self._bodies, come, strict=True)])
        self._states = None


def _states_of(bodies: _Bodies) -> BodyStates:
    rotations = rotation_matrices(bodies.orientations)
    return BodyStates(
        fragment_ids=bodies.fragment_ids,
        masses=bodies.masses,
        inertias=turned_matrices(rotations, bodies.inertias),
        centers=bodies.centers,
        linear=bodies.linear,
        angular=bodies.angular,
        frame_positions=bodies.centers - turned(rotations, bodies.centers_of_mass),
        frame_orientations=bodies.orientations,
    )


def _leading_minors(matrix: np.ndarray) -> tuple[float, float, float]:
    """All positive if and only if a symmetric (3, 3) matrix is positive definite (Sylvester)."""
    two = matrix[0, 0] * matrix[1, 1] - matrix[0, 1] * matrix[1, 0]
    return float(matrix[0, 0]), float(two), float(portable_math.determinants(matrix))


class Pusher(Protocol):
    """An actor outside the scene that pushes bodies in it."""

    def pull(
        self, states: BodyStates, time: float, time_step: float, gravity: np.ndarray
    ) -> tuple[np.ndarray, float]:
        """Its additions in the step at `time` [s]: to all velocities, (n, 6) [m/s, rad/s], and to the energy [J]."""


class Pushes(NamedTuple):
    """What all pushers together add in a step."""

    velocities: np.ndarray  # (n, 6) [m/s, rad/s] that all of them add
    energy: float  # [J] likewise


NO_CHANGES = ByFragment(np.zeros(0, np.uint32), np.zeros((0, 6)))


class Planned(NamedTuple):
    """Pushes planned when the step began, on the bodies in motion then; newer bodies are not pushed in this step."""

    pushes: ByFragment  # (n, 6) [m/s, rad/s]
    energy: float  # [J] that they add
    expected: ByFragment  # (n, 6) estimate of what contacts leave of the pushes


def planned(fragment_ids: np.ndarray, pushes: Pushes, taken: ByFragment) -> Planned:
    """The pushes of a step, and the velocities expected after them.

    taken: (m, 6) by contacts in the last step. They are expected again, as for a hammer that presses against a wall,
    but no larger than the push: the blow of a hammer that has just hit the wall does not repeat.
    """
    left = ByFragment(fragment_ids, _left_of(pushes.velocities, taken.of(fragment_ids)))
    return Planned(ByFragment(fragment_ids, pushes.velocities), pushes.energy, left)


@cached_njit
def _left_of(pushed, taken):
    """Pushes (n, 6) and what contacts take (n, 6) of them, no more than they are."""
    left = pushed + taken
    for i in range(len(pushed)):
        for part in (0, 3):
            p, t = pushed[i, part : part + 3], taken[i, part : part + 3]
            lost = math.sqrt(t[0] * t[0] + t[1] * t[1] + t[2] * t[2])
            share = math.sqrt(p[0] * p[0] + p[1] * p[1] + p[2] * p[2]) / lost if lost > 0.0 else 0.0
            for k in range(3):
                left[i, part + k] = p[k] + t[k] * min(1.0, share)
    return left


def pushes_of(
    pushers: list[Pusher], states: BodyStates, time: float, time_step: float, gravity: np.ndarray
) -> Pushes:
    """Sum over all pushers in the step at `time` [s]."""
    velocities, energy = np.zeros((len(states.fragment_ids), 6)), 0.0
    for pusher in pushers:
        more, gain = pusher.pull(states, time, time_step, gravity)
        velocities, energy = velocities + more, energy + gain
    return Pushes(velocities, energy)


NEWTON_STEPS = 12
# A step in which a body turns by many radians is divided into parts, doubled in number while one does not converge.
MOST_PARTS = 1024
# Square of an angular momentum [(kg m2/s)2] whose own square is not a number any more: such a body does not turn.
STILL = 1.0e-140
# Residual relative to |I w|; quadratic convergence gets from a thousandth to here in two steps.
CONVERGED = 1.0e-15
# Accepted after the last step: rounding may keep the residual a little above.
NEARLY = 1.0e-12


_arctangent2 = cached_njit(portable_math.arctangent2)


@cached_njit
def free_velocities(velocities, inertias, gravity, spans):
    """(n, 6) v [m/s] and w [rad/s] `spans` (n,) [s] on, under `gravity` (3,) [m/s2]; inertias (n, 3, 3) [kg m2]."""
    result = velocities.copy()
    for i in range(len(velocities)):
        for k in range(3):
            result[i, k] += spans[i] * gravity[k]
        spin = _spin_after(
            (velocities[i, 3], velocities[i, 4], velocities[i, 5]), _columns(inertias[i]), spans[i]
        )
        result[i, 3], result[i, 4], result[i, 5] = spin
    return result


@cached_njit
def mean_spins(velocities, free, inertias, spans):
    """Constant spins (n, 3) [rad/s] that turn free bodies within `spans` (n,) [s] so that momentum keeps its direction.

    velocities, free (n, 6): before and after, see free_velocities. It is the mean of both spins, corrected by the least
    turn that brings the momentum after the step to that before.
    """
    before, after = velocities[:, 3:], free[:, 3:]
    middles = 0.5 * (before + after)
    turns = turns_of(spans.reshape(-1, 1) * middles, 1.0)
    rotations = rotation_matrices(turns)
    momenta, moved = turned(inertias, before), turned(rotations, turned(inertias, after))
    align = np.empty_like(turns)
    for i in range(len(before)):
        was, now = _row(momenta, i), _row(moved, i)
        size = math.sqrt(_dot(was, was)) * math.sqrt(_dot(now, now))
        axis, w = _cross(now, was), _dot(now, was) + size
        if not (w > 0.5 * size and size > STILL):
            axis, w = (0.0, 0.0, 0.0), 1.0
        length = math.sqrt(_dot(axis, axis) + w * w)
        align[i, 0], align[i, 1], align[i, 2] = axis[0] / length, axis[1] / length, axis[2] / length
        align[i, 3] = w / length
    combined = quaternion_products(align, turns)
    spins = np.empty_like(middles)
    for i in range(len(before)):
        middle = _row(middles, i)
        x, y, z = _rotation_vector(combined[i])
        angle, along = math.sqrt(_dot((x, y, z), (x, y, z))), spans[i] * _dot((x, y, z), middle)
        scale = 1.0 / spans[i]
        if angle > 0.0:
            rounds = np.rint((along / angle - angle) / (2.0 * np.pi))
            scale = (1.0 + 2.0 * np.pi * rounds / angle) / spans[i]
        is_steady = before[i, 0] == after[i, 0] and before[i, 1] == after[i, 1] and before[i, 2] == after[i, 2]
        for k, value in enumerate((x, y, z)):
            spins[i, k] = after[i, k] if is_steady else value * scale
    return spins


@uncounted
def _rotation_vector(quaternion):
    """portable_math.rotation_vectors of one."""
    sign = -1.0 if quaternion[3] < 0.0 else 1.0
    x, y, z = sign * quaternion[0], sign * quaternion[1], sign * quaternion[2]
    size = math.sqrt(_dot((x, y, z), (x, y, z)))
    scale = 2.0 * _arctangent2(size, sign * quaternion[3]) / size if size > 0.0 else 2.0
    return scale * x, scale * y, scale * z


@uncounted
def _row(vectors, i):
    return vectors[i, 0], vectors[i, 1], vectors[i, 2]


@uncounted
def _spin_after(before, inertia, time_step):
    parts = 1
    while parts <= MOST_PARTS:
        spin, has_converged = before, True
        for _ in range(parts):
            spin, has_converged = _spin_after_part(spin, inertia, time_step / parts)
            if not has_converged:
                break
        if has_converged:
            return spin
        parts *= 2
    return before


@uncounted
def _spin_after_part(before, inertia, time_step):
    """The spin after `time_step` [s], and whether Newton's method has converged."""
    spin = before
    momentum = _times(inertia, before)
    scale = math.sqrt(_dot(momentum, momentum))
    for _ in range(NEWTON_STEPS):
        middle = _sum(0.5, before, 0.5, spin)
        middle_momentum = _times(inertia, middle)
        residual = _sum(
            1.0, _times(inertia, _sum(1.0, spin, -1.0, before)), time_step, _cross(middle, middle_momentum)
        )
        size = math.sqrt(_dot(residual, residual))
        if size <= CONVERGED * scale:
            return spin, True
        # Columns of f', its products with the axes.
        x = _column(inertia[0], (1.0, 0.0, 0.0), middle, middle_momentum, time_step)
        y = _column(inertia[1], (0.0, 1.0, 0.0), middle, middle_momentum, time_step)
        z = _column(inertia[2], (0.0, 0.0, 1.0), middle, middle_momentum, time_step)
        # Cramer's rule.
        volume = _dot(x, _cross(y, z))
        spin = (
            spin[0] - _dot(residual, _cross(y, z)) / volume,
            spin[1] - _dot(residual, _cross(z, x)) / volume,
            spin[2] - _dot(residual, _cross(x, y)) / volume,
        )
    return spin, size <= NEARLY * scale


@uncounted
def _column(inertia, axis, middle, middle_momentum, time_step):
    change = _sum(1.0, _cross(middle, inertia), -1.0, _cross(middle_momentum, axis))
    return _sum(1.0, inertia, 0.5 * time_step, change)


@uncounted
def _columns(matrix):
    return (
        (matrix[0, 0], matrix[1, 0], matrix[2, 0]),
        (matrix[0, 1], matrix[1, 1], matrix[2, 1]),
        (matrix[0, 2], matrix[1, 2], matrix[2, 2]),
    )


@uncounted
def _times(columns, x):
    return _sum(1.0, _sum(x[0], columns[0], x[1], columns[1]), x[2], columns[2])


@uncounted
def _sum(a, x, b, y):
    return a * x[0] + b * y[0], a * x[1] + b * y[1], a * x[2] + b * y[2]


@uncounted
def _dot(x, y):
    return x[0] * y[0] + x[1] * y[1] + x[2] * y[2]


@uncounted
def _cross(x, y):
    return x[1] * y[2] - x[2] * y[1], x[2] * y[0] - x[0] * y[2], x[0] * y[1] - x[1] * y[0]
