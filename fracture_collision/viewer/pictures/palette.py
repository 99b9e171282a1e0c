"""Colours that distinguish bodies, their fragments and their cracks."""

from __future__ import annotations

import colorsys
from typing import NamedTuple

import numpy as np

from fracture_collision.records import CollisionBody

# Each breakable body has a family of colours, by hue (HLS); other bodies have muted colours, in linear RGB.
FAMILY_HUES = (0.56, 0.03, 0.11, 0.43, 0.78, 0.33, 0.93, 0.64)
BALL_COLOUR = (0.012, 0.012, 0.015)  # of what else moves: black and polished
STEEL_COLOUR = (0.60, 0.62, 0.66)
STEEL_DENSITY = 7000.0  # [kg/m3] and more: steel, such as a hammer
# How the names of a robot's parts begin.
ROBOT, ROBOT_COLOUR = "robot ", (0.55, 0.56, 0.55)
STATIC_COLOURS = ((0.46, 0.29, 0.16), (0.34, 0.21, 0.12), (0.62, 0.60, 0.56), (0.40, 0.42, 0.44))
# Gap [m] -> display colour: penetration red, touching yellow, about to touch green.
GAP_SCALE = 5e-4  # [m] at this gap or more the colour is saturated
PENETRATING, TOUCHING, APART = (
    np.array(colour) / 255.0 for colour in ((226, 26, 28), (250, 214, 40), (50, 180, 90))
)
GLAZE_SHINE, PLAIN_SHINE, POLISH_SHINE = 0.35, 0.06, 0.6


class Paint(NamedTuple):
    """Colours of a fragment."""

    outside: tuple[float, float, float]  # linear RGB, 0..1
    crack: tuple[float, float, float]
    shine: float  # of the outside, 0..1; cracks are matt
    is_metal: bool = False


class Palette:
    """Colours of the bodies added to it: a family for each breakable body, in the order of `add`.

    What moves and cannot break has no hue, by its material: balls are black, a hammer is of steel, a robot is white.
    """

    def __init__(self) -> None:
        self._family: dict[int, int] = {}
        self._static_rank: dict[int, int] = {}
        self._steel: set[int] = set()
        self._robot: set[int] = set()

    def add(self, body: CollisionBody) -> None:
        """Give a body its colours."""
        if len(body.tetrahedra):
            self._family.setdefault(body.body_id, len(self._family))
        elif body.is_static and not np.any(body.plane):
            self._static_rank.setdefault(body.body_id, len(self._static_rank))
        elif body.name.startswith(ROBOT):
            self._robot.add(body.body_id)
        elif body.density >= STEEL_DENSITY:
            self._steel.add(body.body_id)

    def is_breakable(self, body_id: int) -> bool:
        """Whether the body, added before, can break."""
        return body_id in self._family

    def paint(self, fragment_id: int, body_id: int) -> Paint:
        """Fragments of a body are shades of one hue; their cracks all have the same, much paler shade."""
        if body_id in self._family:
            # Neighbouring ids differ visibly: the golden ratio spreads them over the family's range of lightness.
            spread = (fragment_id * 0.6180339887) % 1.0
            hue = FAMILY_HUES[self._family[body_id] % len(FAMILY_HUES)]
            outside = colorsys.hls_to_rgb(hue + 0.02 * (spread - 0.5), 0.42 + 0.12 * spread, 0.62)
            crack = colorsys.hls_to_rgb(hue, 0.80, 0.45)
            return Paint(_linear(outside), _linear(crack), GLAZE_SHINE)
        if body_id in self._static_rank:
            colour = STATIC_COLOURS[self._static_rank[body_id] % len(STATIC_COLOURS)]
            return Paint(colour, colour, PLAIN_SHINE)
        if body_id in self._steel:
            return Paint(STEEL_COLOUR, STEEL_COLOUR, GLAZE_SHINE, is_metal=True)
        if body_id in self._robot:
            return Paint(ROBOT_COLOUR, ROBOT_COLOUR, GLAZE_SHINE)
        return Paint(BALL_COLOUR, BALL_COLOUR, POLISH_SHINE)


def gap_colours(gaps: np.ndarray) -> np.ndarray:
    """RGB (n, 3) of gaps (n,) [m], 0..1 in display values."""
    share = np.clip(gaps / GAP_SCALE, -1.0, 1.0)[:, None]
    return np.where(
        share < 0.0, TOUCHING - share * (PENETRATING - TOUCHING), TOUCHING + share * (APART - TOUCHING)
    )


def display_colour(linear: tuple[float, float, float]) -> tuple[float, float, float]:
    """A Paint's colour in display values, by a gamma of 2."""
    return linear[0] ** 0.5, linear[1] ** 0.5, linear[2] ** 0.5


def _linear(colour: tuple[float, float, float]) -> tuple[float, float, float]:
    """From display values, by a gamma of 2."""
    return colour[0] ** 2, colour[1] ** 2, colour[2] ** 2
