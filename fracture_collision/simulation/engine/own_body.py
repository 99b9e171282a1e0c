"""A scene for any one breakable mesh: it drops onto a floor, and a ball hits its remains; or it stands there."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import yaml

from fracture_collision.geometry.generators import TetGeometry
from fracture_collision.geometry.tetrahedra import tetrahedron_volumes

DENSITY = 1200.0  # [kg/m3] plaster
DROP_SPEED = 3.0  # [m/s] when it is released
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
                "linear_velocity": [0.0, 0.0, 0.0 if stands else -DROP_SPEED],
            },
            *([] if stands else [ball]),
        ],
    }  # fmt: skip
