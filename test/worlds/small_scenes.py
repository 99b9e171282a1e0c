"""Scenes of a few bodies of one material, for tests."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from fracture_collision.simulation.scene.scene import Scene, parse_scene

GROUND = {"name": "ground", "static": True, "shape": {"plane": {"coefficients": [0.0, 0.0, 1.0, 0.0]}}}
TIME_STEP = 0.0025  # [s]


def box(name: str, size: Sequence[float], position: Sequence[float] = (0.0, 0.0, 0.0), **more: Any) -> dict[str, Any]:
    return {"name": name, "shape": {"box": {"size": list(size)}}, "position": list(position), **more}


def ball(name: str, radius: float, position: Sequence[float] = (0.0, 0.0, 0.0), **more: Any) -> dict[str, Any]:
    return {"name": name, "shape": {"sphere": {"radius": radius}}, "position": list(position), **more}


def brick(
    name: str, size: Sequence[float], edge_length: float, position: Sequence[float] = (0.0, 0.0, 0.0), **more: Any
) -> dict[str, Any]:
    shape = {"brick": {"size_xyz": list(size), "edge_length": edge_length}}
    return {"name": name, "shape": shape, "position": list(position), **more}


def small_scene(material: dict[str, Any], *bodies: dict[str, Any], gravity: float = 9.81, **more: Any) -> Scene:
    """`more`: other fields of the scene; bodies may name another of its materials."""
    content = {
        "time_step": TIME_STEP, "duration": 1.0, "gravity": [0.0, 0.0, -gravity],
        "bodies": [{"material": "stone", **body} for body in bodies], **more,
    }  # fmt: skip
    return parse_scene(content | {"materials": {"stone": material} | more.get("materials", {})}, "small")
