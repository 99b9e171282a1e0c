"""Scenes derived from others, with other cracks or with a random drop, and the scene of any one breakable mesh."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from fracture_collision.geometry.generators import TetGeometry
from fracture_collision.geometry.tetrahedra import tetrahedron_volumes
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


# Of the scene of a mesh: it drops onto a floor, and a ball hits its remains; or it stands there.
DENSITY = 1200.0  # [kg/m3] plaster
RELEASE_SPEED = 3.0  # [m/s] when it is released
BALL_SPEED = 6.0  # [m/s]
STRENGTH_SPEED = 0.7  # [m/s] impact speed that the body bears
CLEARANCE = 0.001  # of its size: from the floor, where it stands
SMALLEST_SHARE = 1.0 / 30.0  # of its mass: lighter fragments do not break


def write_own_scene(scene: Path, mesh_name: str, mesh: TetGeometry, stands: bool = False) -> None:
    """Write a scene file and, beside it, its mesh [m]; `stands`: as in own_body_scene."""
    np.savez(scene.with_name(mesh_name), vertices=mesh.vertices, tetrahedra=mesh.tetrahedra)
    content = own_body_scene(Path(mesh_name), mesh, stands)
    scene.write_text(yaml.safe_dump(content, sort_keys=False), encoding="utf-8")


def own_body_scene(file: Path, mesh: TetGeometry, stands: bool = False) -> dict[str, Any]:
    """Content of a scene file (scene/scene.py). `file`: where `mesh` [m] is stored, relative to the scene file.

    stands: on the floor, for a user to break; otherwise it drops, and a ball comes.
    """
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    size = float((high - low).max())
    mass = DENSITY * float(tetrahedron_volumes(*mesh).sum())
    radius = size / 8.0
    height = (CLEARANCE if stands else 1.0) * size - low[2]
    ball = {
        "name": "ball", "material": "stone", "shape": {"sphere": {"radius": radius}}, "start_time": 0.5,
        "position": [0.0, -2.0 * size, 3.0 * radius],
        "linear_velocity": [0.0, BALL_SPEED, -0.5],
    }  # fmt: skip
    return {
        "time_step": 0.0025,
        "duration": 2.5,
        "materials": {
            "plaster": {
                "density": DENSITY, "friction": 0.6, "restitution": 0.05, "rolling_arm": 0.005 * size,
                "fracture": {
                    "strength": STRENGTH_SPEED * mass,
                    "minimum_mass": SMALLEST_SHARE * mass,
                    "pattern": {"seeds": 12, "seeds_per_overload": 3.0, "concentration": 1.0, "minimum_nodes": 8},
                },
            },
            "stone": {"density": 2000.0, "friction": 0.7},
        },
        "bodies": [
            {
                "name": "floor", "material": "stone", "static": True,
                "shape": {"plane": {"coefficients": [0.0, 0.0, 1.0, 0.0]}},
            },
            {
                "name": "body", "material": "plaster", "shape": {"stored_mesh": {"file": str(file)}},
                "position": [0.0, 0.0, float(np.round(height, 6))],
                "linear_velocity": [0.0, 0.0, 0.0 if stands else -RELEASE_SPEED],
            },
            *([] if stands else [ball]),
        ],
    }  # fmt: skip
