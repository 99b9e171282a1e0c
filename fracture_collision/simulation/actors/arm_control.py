"""Control of an arm: the motion of its joints, and how its parts follow them.

A robot under position control is stiff, but its force is limited. A body of prescribed motion in the contact solver is
stiff without limit: it pushes through whatever is in its way, and presses what is caught between it and the ground into
both. So each part is a heavy body, held to its place on its link by an implicit spring with a damper (equations in
hand.py) of limited force. In free motion the controller feeds the joints' motion forward, so that the parts lag by
rounding alone; an impact deflects them by millimetres for some hundredths of a second. Where a part is blocked for
longer, all joints wait, as they do at a real controller's following-error limit: the arm presses with no more than its
force limit, and stays in one piece.

    dv = a - h (k (x + h (v + a) - x1) + d (v + a - v1)) / (1 + h d + h^2 k),   a = v1 - v0,   k = (2 pi f)^2

with v0 and v1 the velocity of the place in the last step and in this one, x1 the place at the end of this one,
d = 2 zeta (2 pi f), h the step. Likewise for rotations, by rotation vectors.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from fracture_collision.grouping import begins_of
from fracture_collision.portable_math import dots, images, lengths, rotation_vectors
from fracture_collision.records import ContactConstraintArray
from fracture_collision.simulation.actors.arm import JOINTS, Arm, ArmKinematics, JointLimits, require_within
from fracture_collision.simulation.engine import BodyStates
from fracture_collision.simulation.rotations import INVERSE, quaternion_products
from fracture_collision.simulation.solver.contact_solver import kinetic_energy

LEVER = 0.1  # [m] lever arm by which the force limit becomes the torque limit of a part


class ArmControl:
    """Drives the bodies of an arm in a simulation, a pushes.Pusher; follows the arm's swing until commanded."""

    def __init__(self, arm: Arm, fragment_ids: Sequence[int]) -> None:
        """`fragment_ids`: of all PARTS, in their order; none of them breaks."""
        self._settings = arm.settings
        self._own = np.array(fragment_ids, np.uint32)
        self._kinematics = ArmKinematics(arm.position, arm.orientation)
        self._most_speeds = np.minimum(self.limits.speeds, self._settings.speed_limit)
        self._clock = 0.0  # [s] of the swing
        self._goal: np.ndarray | None = None
        self._swing = arm.swing()
        self._angles, self._speeds = self._swing(0.0), np.zeros(JOINTS)
        self._places, self._turns = self._kinematics.places(self._angles)
        self._velocities = np.zeros((len(self._places), 6))

    @property
    def limits(self) -> JointLimits:
        """Names and limits of the joints, in their order."""
        return self._kinematics.limits

    @property
    def angles(self) -> np.ndarray:
        """The controller's joint angles, (7,) [rad]."""
        return self._angles.copy()

    @property
    def speeds(self) -> np.ndarray:
        """The controller's joint speeds, (7,) [rad/s]."""
        return self._speeds.copy()

    def command(self, names: Sequence[str], positions: Sequence[float]) -> None:
        """Go to `positions` [rad] of the joints `names`, or of all in order without names; the others keep their goal.

        Ends the swing. Raises ValueError, with an explanation, for a command that no joint can follow.
        """
        names = names or self.limits.names
        if len(positions) != len(names):
            raise ValueError(f"position: {len(positions)} values for {len(names)} joints")
        goal = self._angles.copy() if self._goal is None else self._goal.copy()
        for name, position in zip(names, positions, strict=True):
            if name not in self.limits.names:
                raise ValueError(f"name: no joint {name!r}; there are {', '.join(self.limits.names)}")
            if not math.isfinite(position):
                raise ValueError(f"position: {name}: {position} is not finite")
            goal[self.limits.names.index(name)] = position
        if len(set(names)) < len(names):
            raise ValueError("name: a joint occurs twice")
        require_within(self.limits, goal)
        self._goal = goal

    def pull(
        self, states: BodyStates, time: float, time_step: float, gravity: np.ndarray
    ) -> tuple[np.ndarray, float]:
        """Additions in the step at `time` [s]: to all velocities, (n, 6) [m/s, rad/s], and to the energy [J]."""
        rows = np.searchsorted(states.fragment_ids, self._own[1:])
        h, settings = time_step, self._settings
        before = np.hstack((states.linear[rows], states.angular[rows]))
        behind = lengths(states.centers[rows] - self._places).max()
        self._advance(h, float(np.clip(2.0 - 2.0 * behind / settings.lag_limit, 0.0, 1.0)))
        places, turns = self._kinematics.places(self._angles)
        velocities = np.hstack((places - self._places, _turn_between(self._turns, turns))) / h
        off = np.hstack((states.centers[rows] - places, _turn_between(turns, states.frame_orientations[rows])))
        ahead = velocities - self._velocities
        swing = 2.0 * math.pi * settings.frequency
        stiffness, damping = swing * swing, 2.0 * settings.damping_ratio * swing
        led = before + ahead
        spring = stiffness * (off + h * led) + damping * (led - velocities)
        kicks = ahead - h * spring / (1.0 + h * damping + h * h * stiffness)
        impulses = states.masses[rows, None] * kicks[:, :3]
        twists = images(states.inertias[rows], kicks[:, 3:])
        kicks[:, :3] *= _shares(impulses, h * settings.force_limit)
        kicks[:, 3:] *= _shares(twists, h * settings.force_limit * LEVER)
        kicks[:, :3] -= h * gravity  # the arm always bears its own weight
        self._places, self._turns, self._velocities = places, turns, velocities
        pushes = np.zeros((len(states.fragment_ids), 6))
        pushes[rows] = kicks
        return pushes, _work(states.masses[rows], states.inertias[rows], before, kicks, h * gravity)

    def without_own(self, contacts: ContactConstraintArray) -> ContactConstraintArray:
        """Contacts without those between the arm's own parts, which overlap where links meet."""
        others = ~(np.isin(contacts.fragment_a, self._own) & np.isin(contacts.fragment_b, self._own))
        if others.all():
            return contacts
        counts = np.diff(contacts.pair_begin)
        kept = np.repeat(others, counts)
        pairs = {
            name: getattr(contacts, name)[others]
            for name in ("fragment_a", "fragment_b", "missed_depth_bound", "friction", "restitution")
        }
        points = {
            name: getattr(contacts, name)[kept] for name in ("points_a", "points_b", "normals")
        }
        begin = begins_of(counts[others]).astype(contacts.pair_begin.dtype)
        return contacts._replace(
            **pairs, **points, pair_begin=begin, gaps=contacts.gaps[kept], contact_ids=contacts.contact_ids[kept]
        )

    def _advance(self, time_step: float, share: float) -> None:
        """Advance the joints by this share of a step."""
        before = self._angles
        if self._goal is None:
            self._clock += share * time_step
            self._angles = self._swing(self._clock)
            self._speeds = (self._angles - before) / time_step
            return
        left = self._goal - before
        most = self._settings.acceleration_limit * time_step
        # From this speed a joint can stop at the goal, slowing down by `most` each step.
        stopping = 0.5 * most * (np.sqrt(1.0 + 8.0 * np.abs(left) / (most * time_step)) - 1.0)
        wanted = np.sign(left) * np.minimum(stopping, self._most_speeds)
        speeds = self._speeds + np.clip(wanted - self._speeds, -most, most)
        step = share * time_step * speeds
        arrived = np.abs(left) <= np.abs(step)
        self._speeds = np.where(arrived, 0.0, speeds)
        self._angles = np.clip(np.where(arrived, self._goal, before + step), self.limits.lower, self.limits.upper)


def _turn_between(before: np.ndarray, after: np.ndarray) -> np.ndarray:
    """Rotation vectors (n, 3) [rad], world axes, from unit quaternions (n, 4) to others."""
    return rotation_vectors(quaternion_products(after, INVERSE * before))


def _work(
    masses: np.ndarray, inertias: np.ndarray, before: np.ndarray, kicks: np.ndarray, fall: np.ndarray
) -> float:
    """Kinetic and potential energy [J] that `kicks` add to bodies to which gravity adds `fall` (3,) [m/s]."""
    after = before + kicks
    after[:, :3] += fall
    gain = kinetic_energy(masses, inertias, after) - kinetic_energy(masses, inertias, before)
    return gain - float((masses * dots(after[:, :3], fall)).sum())


def _shares(vectors: np.ndarray, most: float) -> np.ndarray:
    """Factors (n, 1), at most 1, that limit the lengths of vectors (n, 3) to `most`."""
    return np.minimum(1.0, most / np.maximum(lengths(vectors)[..., None], 1e-300))
