"""Shading kernels of a picture: rays from the camera, rays from the hits to sun and sky, and the light they bring.

One sun with a visible disc, one sky. A surface that blocks the sky reflects part of its own colour. Sample points come
from the R2 sequence (Roberts 2018), shifted for each pixel: the same scene gives the same picture.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from fracture_collision import grouping
from fracture_collision.kernel_sources import cached_njit

_grouped = cached_njit(grouping.grouped)
SUN_RADIANCE = (2.6, 2.4, 2.1)
SKY_RADIANCE = (0.78, 0.86, 1.0)
HORIZON = (0.80, 0.84, 0.88)
ZENITH = (0.42, 0.58, 0.80)
FLOOR_COLOUR = (0.52, 0.53, 0.55)
FLOOR_TILE = 0.5  # [m]
FLOOR_FADE = 6.0  # camera distances; at this distance the floor is two thirds horizon
SUN_DISC = 0.05  # tangent of the sun's angular radius; larger than the real one, for soft shadows
DIFFUSE = 0.62
BOUNCED = 0.4  # share of its colour that a surface blocking the sky reflects
GLOSS = 60.0  # exponent of the highlight


class Hits(NamedTuple):
    """First hits of the camera rays of n pixels."""

    distance: np.ndarray  # (n,) [m] along the ray
    primitive: np.ndarray  # (n,) the triangle, -1: none
    u: np.ndarray  # (n,) barycentric coordinates in it
    v: np.ndarray  # (n,)
    facing: np.ndarray  # (n, 3) its normal, of any length and side


class LightRays(NamedTuple):
    """Rays from the hits of n pixels."""

    starts: np.ndarray  # (n, 3) [m] the hits, moved off the surface
    shading: np.ndarray  # (n, 3) unit normals
    to_sun: np.ndarray  # (n, 3) unit
    to_sky: np.ndarray  # (n, 3) unit


class Blockers(NamedTuple):
    """The triangles that light rays hit, -1: none."""

    of_sun: np.ndarray  # (n,)
    of_sky: np.ndarray  # (n,)


@cached_njit
def _sample(pixel: int, index: int, stream: int) -> tuple[float, float]:
    """Point `index` of a low-discrepancy sequence in the unit square, for one pixel and one purpose."""
    state = np.uint32(pixel) * np.uint32(747796405) + np.uint32(2891336453 + 97 * stream)  # PCG hash (Jarzynski 2020)
    word = ((state >> ((state >> np.uint32(28)) + np.uint32(4))) ^ state) * np.uint32(277803737)
    word = (word >> np.uint32(22)) ^ word
    u = (word & np.uint32(0xFFFF)) / 65536.0 + (index + 1) * 0.7548776662466927
    v = (word >> np.uint32(16)) / 65536.0 + (index + 1) * 0.5698402909980532
    return u - math.floor(u), v - math.floor(v)


@cached_njit
def _turned(x: float, y: float, z: float, radius: float, angle: float) -> tuple[float, float, float]:
    """The unit vector (x, y, z), deflected by `radius` (a tangent) in the direction `angle` [rad] across it."""
    if abs(x) < 0.7:
        ax, ay, az = 0.0, z, -y
    else:
        ax, ay, az = -z, 0.0, x
    size = math.sqrt(ax * ax + ay * ay + az * az)
    ax, ay, az = ax / size, ay / size, az / size
    bx, by, bz = y * az - z * ay, z * ax - x * az, x * ay - y * ax
    c, s = radius * math.cos(angle), radius * math.sin(angle)
    x, y, z = x + c * ax + s * bx, y + c * ay + s * by, z + c * az + s * bz
    size = math.sqrt(x * x + y * y + z * z)
    return x / size, y / size, z / size


@cached_njit
def camera_rays(axes, scale, width, height, index, directions):
    """Directions (width * height, 3) through the pixels; axes (3, 3): right, up, ahead; scale: a pixel's tangent."""
    for pixel in range(width * height):
        u, v = _sample(pixel, index, 0)
        x = (pixel % width + u - 0.5 * width) * scale
        y = (0.5 * height - pixel // width - v) * scale
        size = math.sqrt(1.0 + x * x + y * y)
        for i in range(3):
            directions[pixel, i] = (x * axes[0, i] + y * axes[1, i] + axes[2, i]) / size


@cached_njit
def light_rays(eye, rays, hits, normals, sun, index, light):
    """Write the LightRays `light` of each pixel.

    rays (n, 3): directions of the camera rays from `eye`; normals (t, 3, 3): corner normals; triangles from t on belong
    to the floor; index: number of the sample.
    """
    distance, primitive, u, v, facing = hits
    starts, shading, to_sun, to_sky = light
    for pixel in range(len(rays)):
        if primitive[pixel] < 0:  # the sky: light rays repeat the camera ray, which hits nothing
            starts[pixel] = eye
            to_sun[pixel] = to_sky[pixel] = rays[pixel]
            continue
        nx, ny, nz = facing[pixel, 0], facing[pixel, 1], facing[pixel, 2]
        size = math.sqrt(nx * nx + ny * ny + nz * nz)
        if nx * rays[pixel, 0] + ny * rays[pixel, 1] + nz * rays[pixel, 2] > 0.0:
            size = -size
        nx, ny, nz = nx / size, ny / size, nz / size
        lift = 1e-4 * distance[pixel]
        starts[pixel, 0] = eye[0] + distance[pixel] * rays[pixel, 0] + lift * nx
        starts[pixel, 1] = eye[1] + distance[pixel] * rays[pixel, 1] + lift * ny
        starts[pixel, 2] = eye[2] + distance[pixel] * rays[pixel, 2] + lift * nz
        shading[pixel, 0], shading[pixel, 1], shading[pixel, 2] = nx, ny, nz
        t = primitive[pixel]
        if t < len(normals):
            p, q = u[pixel], v[pixel]
            x = (1.0 - p - q) * normals[t, 0, 0] + p * normals[t, 1, 0] + q * normals[t, 2, 0]
            y = (1.0 - p - q) * normals[t, 0, 1] + p * normals[t, 1, 1] + q * normals[t, 2, 1]
            z = (1.0 - p - q) * normals[t, 0, 2] + p * normals[t, 1, 2] + q * normals[t, 2, 2]
            size = math.sqrt(x * x + y * y + z * z)
            if x * nx + y * ny + z * nz > 0.0:
                shading[pixel, 0], shading[pixel, 1], shading[pixel, 2] = x / size, y / size, z / size
        a, b = _sample(pixel, index, 1)
        to_sun[pixel] = _turned(sun[0], sun[1], sun[2], SUN_DISC * math.sqrt(a), 2.0 * math.pi * b)
        a, b = _sample(pixel, index, 2)  # a cosine lobe: a point of the unit disc, lifted to the hemisphere
        to_sky[pixel] = _turned(nx, ny, nz, math.sqrt(a / max(1.0 - a, 1e-6)), 2.0 * math.pi * b)


@cached_njit
def add_light(rays, hits, light, blockers, colours, shine, horizon, total):
    """Add each pixel's radiance to `total` (n, 3); horizon: where the floor fades [m]."""
    distance, primitive = hits.distance, hits.primitive
    starts, shading, to_sun, to_sky = light
    in_shadow, hidden_by = blockers
    for pixel in range(len(rays)):
        height = min(max(rays[pixel, 2] + 0.05, 0.0), 0.6) / 0.6
        t = primitive[pixel]
        if t < 0:
            for i in range(3):
                total[pixel, i] += (1.0 - height) * HORIZON[i] + height * ZENITH[i]
            continue
        cosine = highlight = 0.0
        is_floor = t >= len(colours)
        if in_shadow[pixel] < 0:
            hx, hy, hz = to_sun[pixel] - rays[pixel]
            size = math.sqrt(hx * hx + hy * hy + hz * hz)
            n = shading[pixel]
            cosine = max(n[0] * to_sun[pixel, 0] + n[1] * to_sun[pixel, 1] + n[2] * to_sun[pixel, 2], 0.0)
            if not is_floor and cosine > 0.0:
                highlight = 0.9 * shine[t] * max((n[0] * hx + n[1] * hy + n[2] * hz) / size, 0.0) ** GLOSS
        tile = 1.0
        if is_floor:
            for i in range(2):
                offset = starts[pixel, i] / FLOOR_TILE + 0.5
                if abs(offset - math.floor(offset) - 0.5) < 0.008:
                    tile = 0.8
        fade = 1.0 - math.exp(-((distance[pixel] / horizon) ** 2)) if is_floor else 0.0
        blocker = hidden_by[pixel]
        for i in range(3):
            if blocker < 0:
                sky = SKY_RADIANCE[i] * (0.55 + 0.45 * min(max(to_sky[pixel, 2], 0.0), 1.0))
            elif blocker < len(colours):
                sky = BOUNCED * colours[blocker, i]
            else:
                sky = BOUNCED * FLOOR_COLOUR[i]
            own = tile * FLOOR_COLOUR[i] if is_floor else colours[t, i]
            light = DIFFUSE * own * (cosine * SUN_RADIANCE[i] + sky) + highlight * SUN_RADIANCE[i]
            total[pixel, i] += (1.0 - fade) * light + fade * ((1.0 - height) * HORIZON[i] + height * ZENITH[i])


@cached_njit
def smooth_normals(triangles, is_crack, places, crease, normals):
    """Corner normals (3t, 3): the area-weighted mean of the triangles that meet there without a crease.

    places (3t,): number of each corner's place, equal for corners at the same place; crease: two triangles are smoothed
    only if the cosine between them exceeds it. Crack and outside are never smoothed together.
    """
    # corners are numbered 3 x triangle + corner
    corners, begin = _grouped(places, (places.max() if len(places) else -1) + 1)
    area, length = np.empty((len(triangles), 3)), np.empty(len(triangles))
    for t in range(len(triangles)):
        p, q, r = triangles[t, 0], triangles[t, 1], triangles[t, 2]
        ax, ay, az = q[0] - p[0], q[1] - p[1], q[2] - p[2]
        bx, by, bz = r[0] - p[0], r[1] - p[1], r[2] - p[2]
        x, y, z = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
        area[t, 0], area[t, 1], area[t, 2] = x, y, z
        length[t] = math.sqrt(x * x + y * y + z * z)
    for place in range(len(begin) - 1):
        for a in range(begin[place], begin[place + 1]):
            own = corners[a] // 3
            ax, ay, az = area[own, 0], area[own, 1], area[own, 2]
            x = y = z = 0.0
            for b in range(begin[place], begin[place + 1]):
                other = corners[b] // 3
                dot = ax * area[other, 0] + ay * area[other, 1] + az * area[other, 2]
                if own == other or (is_crack[own] == is_crack[other] and dot > crease * length[own] * length[other]):
                    x, y, z = x + area[other, 0], y + area[other, 1], z + area[other, 2]
            size = max(math.sqrt(x * x + y * y + z * z), 1e-300)
            normals[corners[a], 0], normals[corners[a], 1], normals[corners[a], 2] = x / size, y / size, z / size
