"""Cylinder, cone and capsule about the z axis as closed convex surfaces of triangles.

A profile turns about the axis in SIDES steps. Its distance from the axis is enlarged so that the polygons have the area
of the circles: volumes and masses are those of the round bodies, and the surface leaves theirs by less than 0.04 % of
the radius, a fifth of the service's penetration tolerance.
"""

from __future__ import annotations

import numpy as np

from fracture_collision.geometry.generators import require_positive
from fracture_collision.portable_math import cosine, sine
from fracture_collision.records import CONE, CYLINDER

SIDES = 96
CAP_RINGS = SIDES // 4  # of half a sphere


def cylinder(height: float, radius: float) -> tuple[np.ndarray, np.ndarray]:
    """A cylinder of `height` and `radius` [m] about the origin: vertices (n, 3) [m], triangles (t, 3)."""
    require_positive(height=height, radius=radius)
    return _turned([(0.0, -0.5 * height), (radius, -0.5 * height), (radius, 0.5 * height), (0.0, 0.5 * height)])


def cone(height: float, radius: float) -> tuple[np.ndarray, np.ndarray]:
    """A cone with a base of `radius` [m], tip up, its origin half-way: vertices (n, 3) [m], triangles (t, 3)."""
    require_positive(height=height, radius=radius)
    return _turned([(0.0, -0.5 * height), (radius, -0.5 * height), (0.0, 0.5 * height)])


def capsule(straight_length: float, radius: float) -> tuple[np.ndarray, np.ndarray]:
    """What is within `radius` [m] of a segment on the z axis: vertices (n, 3) [m], triangles (t, 3)."""
    require_positive(straight_length=straight_length, radius=radius)
    angles, top = 0.5 * np.pi * np.arange(CAP_RINGS + 1) / CAP_RINGS, 0.5 * straight_length
    arc = list(zip((radius * cosine(angles)).tolist(), (radius * sine(angles) + top).tolist(), strict=True))
    arc[-1] = (0.0, radius + top)
    return _turned([*((x, -z) for x, z in reversed(arc)), *arc])


# Of a SolidPrimitive's dimensions.
BY_PRIMITIVE = {CYLINDER: cylinder, CONE: cone}


def _turned(profile: list[tuple[float, float]]) -> tuple[np.ndarray, np.ndarray]:
    """The surface of a profile (distance from the axis, height) from the axis below to the axis above."""
    turns = 2.0 * np.pi / SIDES * np.arange(SIDES)
    around = np.column_stack((cosine(turns), sine(turns)))
    step = 2.0 * np.pi / SIDES
    larger = float(np.sqrt(step / sine(np.array(step))))  # of a polygon's corners than its circle of equal area
    rings = [np.column_stack((larger * x * around, np.full(SIDES, z))) for x, z in profile[1:-1]]
    ends = np.array([[0.0, 0.0, profile[0][1]], [0.0, 0.0, profile[-1][1]]])
    here, there = np.arange(SIDES), (np.arange(SIDES) + 1) % SIDES
    low, high = SIDES * len(rings), SIDES * len(rings) + 1
    triangles = [np.column_stack((np.full(SIDES, low), there, here))]
    for ring in range(len(rings) - 1):
        a, b = SIDES * ring, SIDES * (ring + 1)
        triangles += [
            np.column_stack((a + here, a + there, b + there)), np.column_stack((a + here, b + there, b + here))
        ]  # fmt: skip
    last = SIDES * (len(rings) - 1)
    triangles.append(np.column_stack((last + here, last + there, np.full(SIDES, high))))
    return np.concatenate((*rings, ends)), np.concatenate(triangles).astype(np.uint32)
