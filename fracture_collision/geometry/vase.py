"""A vase: a body of revolution with a foot, a belly, a neck and a lip, hollow and open above, made without a mesher.

Prisms over the wall's middle surface fill the wall. That surface is a disc for the bottom, then rings of equally many
vertices up to the lip; layers of vertices are offset from it along its normals.
"""

from __future__ import annotations

import numpy as np

from fracture_collision.geometry.generators import (
    TetGeometry,
    disc,
    oriented,
    prisms,
    require_affordable,
    require_positive,
)
from fracture_collision.portable_math import cosine, lengths, sine

# Radius and height of the wall's middle surface, from the middle of the bottom to the lip; the height of the vase is 1.
# Monotone cubics between the points keep the bottom flat and add no bulges.
PROFILE = np.array(
    [
        (0.0, 0.0), (0.11, 0.0), (0.145, 0.025), (0.20, 0.14), (0.255, 0.30), (0.265, 0.40), (0.235, 0.54),
        (0.165, 0.69), (0.118, 0.80), (0.112, 0.88), (0.13, 0.95), (0.165, 1.0),
    ]
)  # fmt: skip
FOOT = 1  # the point of the profile where the disc ends
BELLY = PROFILE[:, 0].max()
NARROWEST = PROFILE[FOOT:, 0].min()


def vase(height: float, wall: float, edge_length: float, layers: int = 2) -> TetGeometry:
    """A vase of `height` [m] that stands on z = 0, its axis +z through the origin.

    `wall` [m] is its thickness, filled by `layers` of prisms; `edge_length` [m] that of the triangles on the belly.
    0.3, 0.008, 0.015 give 2,800 nodes and 10,900 tetrahedra.
    """
    require_positive(height=height, wall=wall, edge_length=edge_length)
    if layers < 1:
        raise ValueError(f"layers: {layers} is not at least 1")
    if wall >= 0.5 * NARROWEST * height:
        raise ValueError(f"wall: {wall} m leaves no hollow in a vase of {height} m")
    points = PROFILE * (height - wall)
    distances = np.concatenate(([0.0], np.cumsum(lengths(np.diff(points, axis=0)))))
    from scipy.interpolate import PchipInterpolator  # late: half a second

    profile = PchipInterpolator(distances, points)
    rings = max(2, round(2.0 * np.pi * BELLY * height / (6.0 * edge_length)))
    steps = max(4, round((distances[-1] - distances[FOOT]) / edge_length))
    require_affordable(3 * layers * 6 * rings * (rings + 2 * steps))

    ring, azimuth, triangles = disc(rings)
    around = 6 * rings
    wall_azimuth = np.tile(azimuth[-around:], steps)
    wall_lengths = np.repeat(np.linspace(distances[FOOT], distances[-1], steps + 1)[1:], around)
    along = np.concatenate((distances[FOOT] * ring / rings, wall_lengths))
    azimuth = np.concatenate((azimuth, wall_azimuth))
    triangles = np.concatenate((triangles, _rows_of_triangles(len(ring) - around, around, steps)))

    middle, slope = profile(along), profile(along, 1)
    normal = np.column_stack((slope[:, 1], -slope[:, 0]))
    normal /= lengths(normal)[:, None]
    offsets = np.linspace(-0.5 * wall, 0.5 * wall, layers + 1)
    r, z = (middle + offsets[:, None, None] * normal).reshape(-1, 2).T
    azimuth = np.tile(azimuth, layers + 1)
    vertices = np.column_stack((r * cosine(azimuth), r * sine(azimuth), z + 0.5 * wall))
    return oriented(vertices, prisms(triangles, len(along), layers))


def _rows_of_triangles(first: int, around: int, rows: int) -> np.ndarray:
    """Two triangles for each of `around` quadrangles between consecutive rings of vertices, starting at `first`."""
    here = first + np.arange(rows)[:, None] * around + np.arange(around)
    after = first + np.arange(rows)[:, None] * around + (np.arange(around) + 1) % around
    below = np.stack((here, after, after + around), axis=-1)
    above = np.stack((here, after + around, here + around), axis=-1)
    return np.concatenate((below.reshape(-1, 3), above.reshape(-1, 3)))
