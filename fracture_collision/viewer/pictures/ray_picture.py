"""Pictures of triangles by ray tracing on the CPU (Intel Embree): no display, no GPU, soft shadows."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fracture_collision.viewer.pictures.shading import (
    FLOOR_FADE,
    Blockers,
    Hits,
    LightRays,
    add_light,
    camera_rays,
    light_rays,
)

FLOOR_HALF = 60.0  # [m] half the side of the square that represents an unbounded floor


class TriangleScene(NamedTuple):
    """The scene to render, in world coordinates [m], z up."""

    triangles: np.ndarray  # (t, 3, 3), counter-clockwise from outside
    normals: np.ndarray  # (t, 3, 3) unit, one a corner
    colours: np.ndarray  # (t, 3) linear RGB, 0..1
    shine: np.ndarray  # (t,) strength of the highlight, 0..1
    ground_height: float | None  # z of an unbounded tiled floor; None: no floor


class Camera(NamedTuple):
    """A pinhole camera; z points up."""

    position: np.ndarray  # (3,) [m]
    target: np.ndarray  # (3,) [m]
    opening: float  # vertical angle of view [rad]


def render(
    scene: TriangleScene, camera: Camera, width: int, height: int, sun: np.ndarray, samples: int = 8
) -> np.ndarray:
    """A picture (height, width, 3) uint8; `sun` (3,) points towards it.

    Each sample of a pixel traces a ray into the scene and, from the hit, one ray to a point of the sun's disc and one,
    cosine-distributed, to the sky. Raises ModuleNotFoundError with the command that installs Embree.
    """
    try:
        from embreex.mesh_construction import TriangleMesh
        from embreex.rtcore_scene import EmbreeScene
    except ModuleNotFoundError as missing:
        raise ModuleNotFoundError("pictures need Embree: pip install embreex", name=missing.name) from missing

    triangles = scene.triangles
    if scene.ground_height is not None:
        triangles = np.concatenate((triangles, _floor(camera.target, scene.ground_height)))
    embree = EmbreeScene()
    TriangleMesh(embree, np.ascontiguousarray(triangles, dtype=np.float32))

    pixels = width * height
    axes, scale = _camera_axes(camera), 2.0 * np.tan(0.5 * camera.opening) / height
    eye = camera.position.astype(np.float32)
    eyes = np.tile(eye, (pixels, 1))
    towards_sun = sun / np.linalg.norm(sun)
    rays, *outgoing = np.zeros((5, pixels, 3), dtype=np.float32)
    light = LightRays._make(outgoing)
    horizon = FLOOR_FADE * float(np.linalg.norm(camera.target - camera.position))
    total = np.zeros((pixels, 3))
    for k in range(samples):
        camera_rays(axes, scale, width, height, k, rays)
        hit = embree.run(eyes, rays, output=True)
        hits = Hits(hit["tfar"], hit["primID"], hit["u"], hit["v"], hit["Ng"])
        light_rays(eye, rays, hits, scene.normals, towards_sun, k, light)
        of_sun = embree.run(light.starts, light.to_sun, query="OCCLUDED")
        blockers = Blockers(of_sun, embree.run(light.starts, light.to_sky))
        add_light(rays, hits, light, blockers, scene.colours, scene.shine, horizon, total)
    return _developed(total / samples).reshape(height, width, 3)


def _camera_axes(camera: Camera) -> np.ndarray:
    ahead = (camera.target - camera.position) / np.linalg.norm(camera.target - camera.position)
    right = np.cross(ahead, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    return np.array([right, np.cross(right, ahead), ahead])


def _floor(middle: np.ndarray, height: float) -> np.ndarray:
    signs = np.array([(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)])
    corners = np.column_stack((middle[:2] + FLOOR_HALF * signs, np.full(4, height)))
    return corners[[[0, 1, 2], [0, 2, 3]]]


def _developed(radiance: np.ndarray) -> np.ndarray:
    """Filmic tone curve (Narkowicz 2015), then sRGB's gamma."""
    x = 0.75 * radiance
    toned = np.clip(x * (2.51 * x + 0.03) / (x * (2.43 * x + 0.59) + 0.14), 0.0, 1.0)
    return np.round(255.0 * toned ** (1.0 / 2.2)).astype(np.uint8)
