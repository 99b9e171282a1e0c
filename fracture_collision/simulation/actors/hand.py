"""A hand that takes hold of bodies and drags them by an implicit spring with a damper, live or recorded.

The spring pulls the held point, x = c + r, to the hand, x_h. It is implicit in the velocity after the step, so that it
is stable at any stiffness and time step h. The impulse J at x obeys

    J = -h (k (x + h v' - x_h) + d (v' - v_h)),   v' = v + K J,   K = 1/m - [r] I^-1 [r]
    (1 + (h d + h^2 k) K) J = -h (k (x + h v - x_h) + d (v - v_h))

with k = m (2 pi f)^2 and d = 2 zeta m (2 pi f), m the mass of the held fragment: light and heavy ones follow alike.
"""

from __future__ import annotations

import csv
import math
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from fracture_collision.portable_math import images, inverses, lengths, products, solutions
from fracture_collision.records import documented
from fracture_collision.simulation.config.scene_fields import Fields, SceneError, meaning, quoted
from fracture_collision.simulation.config.scene_files import MAX_TRACK_BYTES, read_text

COLUMNS = ["time", "x", "y", "z", "holds"]


@documented
class HandSettings(NamedTuple):
    """The spring between the hand and the fragment that it holds.

    Fields:
      frequency: [Hz] f, natural frequency of the held fragment about the hand
      damping_ratio: zeta of the spring; 1: critical
      force_limit: [N] largest pull of the hand
    """

    frequency: float = 4.0
    damping_ratio: float = 1.0
    force_limit: float = 200.0


class HandTrack(NamedTuple):
    """Recorded positions of a hand, and the body it held; between two times it moves at constant velocity."""

    times: np.ndarray  # (k,) [s], ascending
    positions: np.ndarray  # (k, 3) [m], world
    holds: tuple[str, ...]  # (k,) name of the body held from this time on; "": none

    def at(self, time: float) -> tuple[np.ndarray, np.ndarray, str]:
        """Position [m], velocity [m/s] and body held at `time` [s]; outside the track's times the hand rests, empty."""
        i = int(np.searchsorted(self.times, time, side="right")) - 1
        if i < 0 or i + 1 >= len(self.times):
            return self.positions[min(max(i, 0), len(self.times) - 1)], np.zeros(3), ""
        span = self.times[i + 1] - self.times[i]
        velocity = (self.positions[i + 1] - self.positions[i]) / span
        return self.positions[i] + (time - self.times[i]) * velocity, velocity, self.holds[i]


class Hand(NamedTuple):
    """A hand in a scene."""

    settings: HandSettings
    track: HandTrack


class Grip(NamedTuple):
    """What a hand holds, and where."""

    fragment_id: int
    point: np.ndarray  # (3,) [m], body frame
    node: int  # of the body's mesh, at that point: after a fracture the hand keeps the piece that owns it; -1: no mesh


def parse_hand(fields: Fields, folder: Path | None, names: list[str]) -> Hand:
    """`track` is a CSV file beside the scene, or a list of its rows; `names`: the bodies that the hand may hold."""
    default = HandSettings()
    settings = HandSettings(
        fields.number("frequency", meaning(default, "frequency"), default.frequency, above=0.0),
        fields.number("damping_ratio", meaning(default, "damping_ratio"), default.damping_ratio, minimum=0.0),
        fields.number("force_limit", meaning(default, "force_limit"), default.force_limit, above=0.0),
    )
    words = "rows of time [s], x, y, z [m] of the hand, and the name of the body that it holds from then on, or nothing"
    track, path = fields.take("track", words, kind="CSV file, or list of rows"), fields.name("track")
    if isinstance(track, str):
        rows = rows_of_file((folder or Path()) / track, path, COLUMNS)
    elif isinstance(track, list):
        rows = track
    else:
        raise SceneError(f"{path}: needs the name of a CSV file, or a list of rows, got {quoted(track)}")
    fields.finish()
    return Hand(settings, _track(rows, path, names))


class HeldBody(NamedTuple):
    """A body that a hand pulls, and where; world frame."""

    mass: float  # [kg]
    inertia: np.ndarray  # (3, 3) [kg m2] about its centre of mass
    center: np.ndarray  # (3,) [m]
    velocity: np.ndarray  # (6,) v [m/s], w [rad/s]
    point: np.ndarray  # (3,) [m] where it is held


def kick(
    settings: HandSettings, body: HeldBody, hand_position: np.ndarray, hand_velocity: np.ndarray, time_step: float
) -> np.ndarray:
    """Change (6,) of v [m/s] and w [rad/s] of a body that a hand pulls for one `time_step` [s].

    hand_position (3,) [m], hand_velocity (3,) [m/s]; world frame.
    """
    mass, inertia, center, velocity, point = body
    x, y, z = point - center
    arm = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    inverse = inverses(inertia)
    mobility = np.eye(3) / mass - products(arm, products(inverse, arm))
    swing = 2.0 * math.pi * settings.frequency
    stiffness, damping = mass * swing * swing, 2.0 * settings.damping_ratio * mass * swing
    at_point = velocity[:3] - images(arm, velocity[3:])
    pull = stiffness * (point + time_step * at_point - hand_position) + damping * (at_point - hand_velocity)
    softness = time_step * (damping + time_step * stiffness)
    impulse = -time_step * solutions(np.eye(3) + softness * mobility, pull)
    size = float(lengths(impulse))
    impulse *= min(1.0, settings.force_limit * time_step / size) if size > 0.0 else 1.0
    return np.concatenate((impulse / mass, images(inverse, images(arm, impulse))))


def rows_of_file(file: Path, path: str, columns: list[str]) -> list[list[str]]:
    """Rows of a CSV file with the header `columns`; `path` is the field that names the file. Raises SceneError."""
    try:
        lines = read_text(file, MAX_TRACK_BYTES).splitlines(keepends=True)
        rows = [row for row in csv.reader(line for line in lines if not line.startswith("#")) if row]
    except (SceneError, csv.Error) as error:
        raise SceneError(f"{path}: {error}") from error
    if not rows or rows[0] != columns:
        raise SceneError(f"{path}: {file} does not begin with the columns {','.join(columns)}")
    return rows[1:]


def _track(rows: list[Any], path: str, names: list[str]) -> HandTrack:
    if len(rows) < 2:
        raise SceneError(f"{path}: needs at least two rows")
    values, holds = np.empty((len(rows), 4)), []
    for i, row in enumerate(rows):
        try:
            *numbers, name = row
            values[i] = [float(number) for number in numbers]
        except (ValueError, TypeError) as error:
            raise SceneError(f"{path}[{i}]: needs {', '.join(COLUMNS)}, got {quoted(row)}") from error
        if not np.all(np.isfinite(values[i])):
            raise SceneError(f"{path}[{i}]: needs finite numbers, got {quoted(row)}")
        if i and values[i, 0] <= values[i - 1, 0]:
            raise SceneError(f"{path}[{i}]: time {values[i, 0]} s does not follow {values[i - 1, 0]} s")
        if name and name not in names:
            raise SceneError(f"{path}[{i}]: no body {quoted(name)} that can move")
        holds.append(str(name or ""))
    return HandTrack(values[:, 0].copy(), values[:, 1:].copy(), tuple(holds))
