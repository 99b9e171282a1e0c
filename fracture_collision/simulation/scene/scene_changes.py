"""Scenes derived from others: with other cracks, or with a random drop, for studies of many trials."""

from __future__ import annotations

import math

import numpy as np

from fracture_collision.portable_math import normal_numbers
from fracture_collision.simulation.rotations import random_quaternion
from fracture_collision.simulation.scene.scene import Scene

# Of a random drop: standard deviation of each coordinate.
DROP_SPEED = 0.5  # [m/s]
DROP_SPIN = 5.0  # [rad/s]


def with_curvature(scene: Scene, curvature: float) -> Scene:
    """The scene with all cracks of this `curvature` (see PatternSettings): 0 flat, 0.25 as in porcelain."""
    if not (math.isfinite(curvature) and curvature >= 0.0):
        raise ValueError(f"curvature: {curvature} is not a number of at least 0")
    bodies = []
    for body in scene.bodies:
        fracture = body.material.fracture
        if fracture is not None:
            fracture = fracture._replace(pattern=fracture.pattern._replace(curvature=float(curvature)))
            body = body._replace(material=body.material._replace(fracture=fracture))
        bodies.append(body)
    return scene._replace(bodies=tuple(bodies))


def random_drop(scene: Scene, seed: int) -> Scene:
    """The scene with each movable body at a random orientation and velocity; equal seeds give equal drops.

    Positions stay. Normally distributed velocities, DROP_SPEED and DROP_SPIN per coordinate, are added to those of the
    file; the vertical one is made downwards, so that it is a drop (Glondu et al. 2014, 7.4).
    """
    generator = np.random.default_rng(seed)
    bodies = []
    for body in scene.bodies:
        if not body.is_static:
            throw = DROP_SPEED * normal_numbers(generator, (3,))
            throw[2] = -abs(throw[2])
            body = body._replace(
                orientation=random_quaternion(generator),
                linear_velocity=body.linear_velocity + throw,
                angular_velocity=body.angular_velocity + DROP_SPIN * normal_numbers(generator, (3,)),
            )
        bodies.append(body)
    return scene._replace(bodies=tuple(bodies), seed=seed)
