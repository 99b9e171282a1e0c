"""Motion of a robot's joints to commanded angles: as fast as their speeds and accelerations allow, and to rest."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np


class JointLimits(NamedTuple):
    """Of the k joints that take commands. Units are those of prismatic joints after the comma."""

    names: tuple[str, ...]
    lower: np.ndarray  # (k,) [rad], [m]; -inf of a joint without an end
    upper: np.ndarray  # (k,) [rad], [m]; inf likewise
    speeds: np.ndarray  # (k,) [rad/s], [m/s]
    acceleration: float  # [rad/s2], [m/s2] of all of them
    units: tuple[str, ...]  # of their positions: rad, m


class JointGoals(NamedTuple):
    """Where the motors of k joints aim at, between two steps, and where they are to end."""

    angles: np.ndarray  # (k,) [rad], [m]
    speeds: np.ndarray  # (k,) [rad/s], [m/s]
    ends: np.ndarray  # (k,) [rad], [m]

    def commanded(self, limits: JointLimits, names: Sequence[str], positions: Sequence[float]) -> JointGoals:
        """The same with new ends: `positions` of the joints `names`, or of all in order without names.

        Raises ValueError, with an explanation, for a command that no joint can follow.
        """
        names = names or limits.names
        if len(positions) != len(names):
            raise ValueError(f"position: {len(positions)} values for {len(names)} joints")
        ends = self.ends.copy()
        for name, position in zip(names, positions, strict=True):
            if name not in limits.names:
                raise ValueError(f"name: no joint {name!r}; there are {', '.join(limits.names)}")
            if not math.isfinite(position):
                raise ValueError(f"position: {name}: {position} is not finite")
            i = limits.names.index(name)
            if not limits.lower[i] <= position <= limits.upper[i]:
                unit, between = limits.units[i], f"{limits.lower[i]:.4g} and {limits.upper[i]:.4g}"
                raise ValueError(f"{name}: {position:.4g} {unit} is not between {between} {unit}")
            ends[i] = position
        if len(set(names)) < len(names):
            raise ValueError("name: a joint occurs twice")
        return self._replace(ends=ends)

    def advanced(self, limits: JointLimits, time_step: float) -> JointGoals:
        """The goals a step later."""
        left, most = self.ends - self.angles, limits.acceleration * time_step
        # From this speed a joint can stop at its end, slowing down by `most` each step.
        stopping = 0.5 * most * (np.sqrt(1.0 + 8.0 * np.abs(left) / (most * time_step)) - 1.0)
        wanted = np.sign(left) * np.minimum(stopping, limits.speeds)
        speeds = self.speeds + np.clip(wanted - self.speeds, -most, most)
        arrived = np.abs(left) <= np.abs(time_step * speeds)
        angles = np.clip(self.angles + time_step * speeds, limits.lower, limits.upper)
        return JointGoals(np.where(arrived, self.ends, angles), np.where(arrived, 0.0, speeds), self.ends)
