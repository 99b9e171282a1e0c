"""A scene for any one breakable mesh: it drops onto a floor, and a ball hits its remains."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from fracture_collision.geometry.generators import TetGeometry
from fracture_collision.geometry.tetrahedra import tetrahedron_volumes

DENSITY = 1200.0  # [kg/m3] plaster
DROP_SPEED = 3.0  # [m/s] when it is released
BALL_SPEED = 6.0  # [m/s]
STRENGTH_SPEED = 0.7  # [m/s] impact speed that the body bears
SMALLEST_SHARE = 1.0 / 30.0  # of its mass: lighter fragments do not break


def own_body_scene(file: Path, mesh: TetGeometry) -> dict[str, Any]:
    """Content of a scene file (scene/scene.py). `file`: where `mesh` [m] is stored, relative to the scene file."""
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    size = float((high - low).max())
    mass = DENSITY * float(tetrahedron_volumes(*mesh).sum())
    radius = size / 8.0
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
                "position": [0.0, 0.0, float(np.round(size - low[2], 6))],
                "linear_velocity": [0.0, 0.0, -DROP_SPEED],
            },
            {
                "name": "ball", "material": "stone", "shape": {"sphere": {"radius": radius}}, "start_time": 0.5,
                "position": [0.0, -2.0 * size, 3.0 * radius],
                "linear_velocity": [0.0, BALL_SPEED, -0.5],
            },
        ],
    }  # fmt: skip
