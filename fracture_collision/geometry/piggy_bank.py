"""A hollow pig: the thin-walled body with ears, snout and legs of Glondu et al. 2014, Fig. 10, made without a mesher.

The outside is star-shaped: one radius for each direction from the middle, that of an ellipsoid with smooth bumps.
Prisms over a geodesic sphere fill the wall between it and the hollow, a smaller ellipsoid. Each of a prism's three
tetrahedra over directions a, b, c has a volume of det(a, b, c) / 6 times two radii and the difference of two along one
ray: none is inverted, whatever the bumps.
"""

from __future__ import annotations

import numpy as np

from fracture_collision.geometry.generators import (
    TetGeometry,
    geodesic_sphere,
    oriented,
    prisms,
    require_affordable,
    require_positive,
)
from fracture_collision.portable_math import arccosine, dots, exponential, lengths, power

# Half axes of the outside without bumps; x is forwards, z up. The unit is half the body's length.
_BODY = np.array([1.0, 0.78, 0.78])
# Direction, height above the ellipsoid, half width [rad], and flatness of the top (power of the falloff).
_SNOUT = (((1.0, 0.0, -0.05), 0.22, 0.30, 4),)
_EARS = tuple(((0.62, side * 0.52, 0.72), 0.34, 0.20, 2) for side in (-1.0, 1.0))
_LEGS = tuple(((x, y, -0.80), 0.34, 0.24, 4) for x in (-0.50, 0.50) for y in (-0.42, 0.42))
_TAIL = (((-1.0, 0.0, 0.18), 0.20, 0.13, 2),)
_BUMPS = (*_SNOUT, *_EARS, *_LEGS, *_TAIL)


def piggy_bank(length: float, wall: float, edge_length: float, layers: int = 2) -> TetGeometry:
    """A hollow pig of `length` [m] from snout to tail, facing +x; its origin is the middle of its belly.

    `wall` [m] is the thickness of its wall between the bumps; ears, snout, legs and tail are solid. `layers` of prisms
    fill the wall; `edge_length` [m] is that of the triangles on the belly. 0.25, 0.01, 0.02 give 2,900 nodes.
    """
    require_positive(length=length, wall=wall, edge_length=edge_length)
    if layers < 1:
        raise ValueError(f"layers: {layers} is not at least 1")
    reach = sum(1.0 + bump[1] for bump in (_SNOUT[0], _TAIL[0]))
    unit = length / reach
    if wall >= 0.5 * unit * _BODY.min():
        raise ValueError(f"wall: {wall} m leaves no hollow in a pig of {length} m")
    frequency = max(4, round(1.107 * unit * _BODY.mean() / edge_length))
    require_affordable(60 * frequency * frequency * layers)
    directions, triangles = geodesic_sphere(frequency)
    body = 1.0 / lengths(directions / _BODY)
    outer = unit * (body + _bumps(directions))
    inner = 1.0 / lengths(directions / (unit * _BODY - wall))
    radii = inner + np.linspace(0.0, 1.0, layers + 1)[:, None] * (outer - inner)
    vertices = (radii[:, :, None] * directions).reshape(-1, 3)
    return oriented(vertices, prisms(triangles, len(directions), layers))


def _bumps(directions: np.ndarray) -> np.ndarray:
    """Height above the ellipsoid in each of the unit `directions` (n, 3): (n,)."""
    height = np.zeros(len(directions))
    for towards, rise, width, flatness in _BUMPS:
        axis = np.array(towards) / lengths(np.array(towards))
        angle = arccosine(np.clip(dots(directions, axis), -1.0, 1.0))
        height = np.maximum(height, rise * exponential(-power(angle / width, flatness)))
    return height
