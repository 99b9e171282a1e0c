"""Tetrahedral meshes of common shapes, without a mesher.

Every mesh is conforming and has a watertight boundary and no duplicate or unused vertices; equal arguments give equal
bytes. Two constructions serve all shapes:

- edgewise subdivision of simplices (Edelsbrunner and Grayson, "Edgewise subdivision of a simplex", 2000; Kuhn cells
  inside each simplex): conforming wherever neighbours list their common vertices in the same order;
- prisms over a triangulated surface, each split into three tetrahedra along the diagonals that rise from the smaller
  to the larger surface vertex: neighbours then agree on every quadrilateral.
"""

from __future__ import annotations

import math
from itertools import permutations
from typing import NamedTuple

import numpy as np

from fracture_collision.geometry.tetrahedra import tetrahedron_volumes
from fracture_collision.portable_math import (
    arccosine,
    arctangent2,
    cosine,
    dots,
    exponential,
    lengths,
    power,
    products,
    sine,
)
from fracture_collision.records import documented

# Beyond this a mesh is an input error (an edge length in millimetres), not a body to simulate.
TETRAHEDRA_LIMIT = 4_000_000


@documented
class TetGeometry(NamedTuple):
    """A tetrahedral mesh in the body frame.

    Fields:
      vertices: (n, 3) float64 [m]
      tetrahedra: (m, 4) int32, positive volume: seen from vertex 3, vertices 0, 1, 2 run counter-clockwise
    """

    vertices: np.ndarray
    tetrahedra: np.ndarray


def ball(radius: float, edge_length: float) -> TetGeometry:
    """A ball about the origin; boundary vertices lie on the sphere of `radius` [m].

    Concentric geodesic layers: the cones from the centre over an icosahedron's faces, subdivided.
    """
    require_positive(radius=radius, edge_length=edge_length)
    frequency = max(1, round(radius / edge_length))
    require_affordable(20 * frequency * frequency * frequency)
    corners, triangles = _icosahedron()
    cones = np.column_stack((np.full(len(triangles), len(corners)), triangles))
    weights, tetrahedra = _edgewise_subdivision(cones, frequency)
    layer = frequency - weights[:, len(corners)]
    directions = products(weights[:, : len(corners)], corners)
    length = lengths(directions)
    scale = radius * layer / (frequency * np.where(layer > 0, length, 1.0))
    return oriented(directions * scale[:, None], tetrahedra)


def shell(outer_radius: float, inner_radius: float, edge_length: float, layers: int | None = None) -> TetGeometry:
    """A hollow sphere about the origin; boundary vertices lie on its two spheres [m].

    `layers` is the number of layers of prisms through the wall; by default the wall divided by the edge length, at
    least two, so that there are nodes inside it.
    """
    require_positive(outer_radius=outer_radius, inner_radius=inner_radius, edge_length=edge_length)
    if inner_radius >= outer_radius:
        raise ValueError(f"inner_radius: {inner_radius} m is not below outer_radius, {outer_radius} m")
    layers = _layer_count(layers, outer_radius - inner_radius, edge_length)
    # The icosahedron's edge spans 1.107 rad of the sphere.
    frequency = max(1, round(1.107 * outer_radius / edge_length))
    require_affordable(60 * frequency * frequency * layers)
    directions, triangles = geodesic_sphere(frequency)
    radii = np.linspace(inner_radius, outer_radius, layers + 1)
    return oriented((radii[:, None, None] * directions).reshape(-1, 3), prisms(triangles, len(directions), layers))


def brick(size_xyz: tuple[float, float, float], edge_length: float) -> TetGeometry:
    """A box of `size_xyz` [m] about the origin, its cells cut into six tetrahedra each (Kuhn)."""
    size = np.asarray(size_xyz, dtype=np.float64)
    if size.shape != (3,):
        raise ValueError(f"size_xyz: needs three lengths, got {size_xyz!r}")
    require_positive(x=size[0], y=size[1], z=size[2], edge_length=edge_length)
    cells = np.maximum(1, np.round(size / edge_length).astype(np.int64))
    require_affordable(6 * int(np.prod(cells.astype(object))))
    axes = [np.linspace(-0.5 * s, 0.5 * s, n + 1) for s, n in zip(size, cells, strict=True)]
    vertices = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    stride = np.array([(cells[1] + 1) * (cells[2] + 1), cells[2] + 1, 1])
    places = np.stack(np.meshgrid(*map(np.arange, cells), indexing="ij"), axis=-1).reshape(-1, 3)
    first = (places * stride).sum(axis=1)[:, None]
    paths = np.array([np.cumsum([0, *(stride[axis] for axis in order)]) for order in permutations(range(3))])
    return oriented(vertices, (first[:, None, :] + paths).reshape(-1, 4))


def plate(
    diameter: float, thickness: float, edge_length: float, rim_height: float, layers: int | None = None
) -> TetGeometry:
    """A dinner plate about the z axis: a flat well, and a rim that rises by `rim_height` to the edge [m].

    The origin is the centre of the bounding box; +z is the side one eats from. The outer edge is a cylinder of
    `diameter`, with vertices exactly on it; thickness is measured along z. `layers` as in `shell`.
    """
    require_positive(diameter=diameter, thickness=thickness, edge_length=edge_length)
    if not (math.isfinite(rim_height) and 0.0 <= rim_height <= 0.5 * diameter):
        raise ValueError(f"rim_height: {rim_height} m is not between 0 and half the diameter, {0.5 * diameter} m")
    layers = _layer_count(layers, thickness, edge_length)
    radius = 0.5 * diameter
    rings = max(2, round(radius / edge_length))
    require_affordable(18 * rings * rings * layers)
    ring, azimuth, triangles = disc(rings)
    r = radius * ring / rings
    # The well is flat to 0.55 of the radius; from there a half cosine leads up to the edge.
    rise = np.clip((r / radius - 0.55) / 0.45, 0.0, 1.0)
    height = rim_height * 0.5 * (1.0 - cosine(np.pi * rise)) - 0.5 * (rim_height + thickness)
    z = height + np.linspace(0.0, thickness, layers + 1)[:, None]
    surface = np.column_stack((r * cosine(azimuth), r * sine(azimuth)))
    vertices = np.column_stack((np.tile(surface, (layers + 1, 1)), z.ravel()))
    return oriented(vertices, prisms(triangles, len(surface), layers))


def bowl(diameter: float, thickness: float, edge_length: float, depth: float, layers: int | None = None) -> TetGeometry:
    """A bowl open towards +z: the cap of a hollow sphere, as deep outside as `depth`, `diameter` wide at the rim [m].

    The outer sphere goes through the rim and the lowest point, the inner one is concentric, `thickness` smaller. The
    origin is the centre of the rim circle; the lowest point is (0, 0, -depth). `layers` as in `shell`.
    """
    require_positive(diameter=diameter, thickness=thickness, edge_length=edge_length, depth=depth)
    if depth > 0.5 * diameter:
        raise ValueError(f"depth: {depth} m is more than half the diameter, {0.5 * diameter} m (a hemisphere)")
    outer = (0.25 * diameter * diameter + depth * depth) / (2.0 * depth)
    if thickness >= 0.9 * min(outer, 0.5 * diameter):
        raise ValueError(f"thickness: {thickness} m leaves no hollow in a bowl of diameter {diameter} m")
    layers = _layer_count(layers, thickness, edge_length)
    opening = float(arctangent2(0.5 * diameter, outer - depth))
    rings = max(2, round(outer * opening / edge_length))
    require_affordable(18 * rings * rings * layers)
    ring, azimuth, triangles = disc(rings)
    polar = opening * ring / rings
    directions = np.column_stack((sine(polar) * cosine(azimuth), sine(polar) * sine(azimuth), -cosine(polar)))
    radii = np.linspace(outer - thickness, outer, layers + 1)
    vertices = (radii[:, None, None] * directions).reshape(-1, 3) + (0.0, 0.0, outer - depth)
    return oriented(vertices, prisms(triangles, len(directions), layers))


def require_positive(**lengths: float) -> None:
    """Raise ValueError, naming the argument, unless all `lengths` [m] are positive and finite."""
    for name, value in lengths.items():
        if not (math.isfinite(value) and value > 0.0):
            raise ValueError(f"{name}: {value} is not a positive length in metres")


def require_affordable(tetrahedron_count: int) -> None:
    """Raise ValueError if a mesh would have more than TETRAHEDRA_LIMIT tetrahedra."""
    if tetrahedron_count > TETRAHEDRA_LIMIT:
        raise ValueError(
            f"edge_length: gives {tetrahedron_count} tetrahedra, more than {TETRAHEDRA_LIMIT}; choose a longer one"
        )


def _layer_count(layers: int | None, wall: float, edge_length: float) -> int:
    if layers is None:
        return max(2, round(wall / edge_length))
    if layers < 1:
        raise ValueError(f"layers: {layers} is not at least 1")
    return int(layers)


def oriented(vertices: np.ndarray, tetrahedra: np.ndarray) -> TetGeometry:
    """A geometry of vertices (n, 3) [m] and tetrahedra (m, 4), those with a negative volume mirrored."""
    vertices = np.ascontiguousarray(vertices, dtype=np.float64)
    tetrahedra = np.array(tetrahedra, dtype=np.int32, order="C")
    mirrored = tetrahedron_volumes(vertices, tetrahedra) < 0.0
    tetrahedra[mirrored, 2:] = tetrahedra[mirrored, :1:-1]
    return TetGeometry(vertices, tetrahedra)


def _edgewise_subdivision(simplices: np.ndarray, frequency: int) -> tuple[np.ndarray, np.ndarray]:
    """Divide each simplex (triangle or tetrahedron) into frequency^dimension.

    Returns the lattice points as integer weights of the old vertices, (points, old vertices), rows ascending and each
    summing to `frequency`, and the new simplices. A lattice point is n >= x1 >= x2 (>= x3) >= 0; a Kuhn cell goes from
    the smallest to the largest corner of a lattice cube, one axis after the other.
    """
    simplices = np.sort(simplices, axis=1)
    dimension = simplices.shape[1] - 1
    corners = np.stack(np.meshgrid(*[np.arange(frequency)] * dimension, indexing="ij"), axis=-1).reshape(-1, dimension)
    steps = [np.cumsum([np.zeros(dimension, dtype=int), *np.eye(dimension, dtype=int)[list(order)]], axis=0)
             for order in permutations(range(dimension))]  # fmt: skip
    cells = (corners[:, None, None, :] + np.array(steps)).reshape(-1, dimension + 1, dimension)
    cells = cells[np.all(cells[..., :-1] >= cells[..., 1:], axis=(1, 2))]
    bounds = np.concatenate((np.full((*cells.shape[:2], 1), frequency), cells, np.zeros((*cells.shape[:2], 1), int)), 2)
    local = bounds[..., :-1] - bounds[..., 1:]
    local_points, local_cells = np.unique(local.reshape(-1, dimension + 1), axis=0, return_inverse=True)
    weights = np.zeros((len(simplices), len(local_points), simplices.max() + 1), dtype=np.int32)
    for i, simplex in enumerate(simplices):
        weights[i][:, simplex] = local_points
    points, numbering = np.unique(weights.reshape(-1, weights.shape[2]), axis=0, return_inverse=True)
    numbering = numbering.reshape(len(simplices), len(local_points))
    return points, numbering[:, local_cells.ravel()].reshape(-1, dimension + 1)


def prisms(triangles: np.ndarray, surface_size: int, layers: int) -> np.ndarray:
    """Tetrahedra of the prisms over `triangles` between layer l (vertices from l * surface_size) and l + 1."""
    a, b, c = np.sort(triangles, axis=1).T
    n = surface_size
    stairs = np.stack([(a, b, c, c + n), (a, b, b + n, c + n), (a, a + n, b + n, c + n)]).transpose(2, 0, 1)
    return (stairs.reshape(-1, 4)[None] + (n * np.arange(layers))[:, None, None]).reshape(-1, 4)


def geodesic_sphere(frequency: int) -> tuple[np.ndarray, np.ndarray]:
    """An icosahedron's faces divided into frequency^2 each: unit vertices (10 frequency^2 + 2, 3), triangles."""
    corners, triangles = _icosahedron()
    weights, triangles = _edgewise_subdivision(triangles, frequency)
    directions = products(weights, corners)
    return directions / lengths(directions)[:, None], triangles


def disc(rings: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A disc of concentric rings, 6 k vertices in ring k: ring and azimuth [rad] of each vertex, and the triangles."""
    ring = np.repeat(np.arange(rings + 1), np.maximum(1, 6 * np.arange(rings + 1)))
    start = np.concatenate(([0], 1 + 3 * np.arange(rings + 1) * np.arange(1, rings + 2)))[: rings + 1]
    within = np.arange(len(ring)) - start[ring]
    azimuth = 2.0 * np.pi * within / np.maximum(1, 6 * ring)
    triangles = []
    for k in range(1, rings + 1):
        sector = np.arange(6)[:, None]
        outer = start[k] + (sector * k + np.arange(k + 1)) % (6 * k)
        inner = start[k - 1] + (sector * (k - 1) + np.arange(k)) % max(1, 6 * (k - 1))
        triangles.append(np.stack((inner, outer[:, :-1], outer[:, 1:]), axis=-1).reshape(-1, 3))
        triangles.append(np.stack((inner[:, :-1], outer[:, 1:-1], inner[:, 1:]), axis=-1).reshape(-1, 3))
    return ring, azimuth, np.concatenate(triangles)


def _icosahedron() -> tuple[np.ndarray, np.ndarray]:
    """Unit vertices (12, 3) and faces (20, 3)."""
    g = 0.5 * (1.0 + math.sqrt(5.0))
    corners = np.array([p for a in (-1, 1) for b in (-g, g) for p in ((0, a, b), (a, b, 0), (b, 0, a))])
    near = lengths(corners[:, None] - corners[None]) < 2.1
    faces = [(i, j, k) for i in range(12) for j in range(i + 1, 12) for k in range(j + 1, 12)
             if near[i, j] and near[j, k] and near[i, k]]  # fmt: skip
    return corners / math.sqrt(1.0 + g * g), np.array(faces)


def torus(major_radius: float, minor_radius: float, edge_length: float) -> TetGeometry:
    """A ring about the z axis; its tube of `minor_radius` has its centre on a circle of `major_radius` [m].

    Boundary vertices lie on the torus. Discs of concentric rings are swept around the axis and closed; prisms fill the
    space between neighbouring discs. Edges are shorter at the inner rim than at the outer, `edge_length` midway.
    """
    require_positive(major_radius=major_radius, minor_radius=minor_radius, edge_length=edge_length)
    if minor_radius >= major_radius:
        raise ValueError(f"minor_radius: {minor_radius} m is not below major_radius, {major_radius} m: no hole is left")
    rings = max(2, round(minor_radius / edge_length))
    around = max(6, round(2.0 * np.pi * major_radius / edge_length))
    require_affordable(18 * rings * rings * around)
    ring, azimuth, triangles = disc(rings)
    distance = minor_radius * ring / rings
    turn = (2.0 * np.pi / around * np.arange(around))[:, None]
    reach = major_radius + distance * cosine(azimuth)
    height = np.broadcast_to(distance * sine(azimuth), (around, len(ring)))
    vertices = np.stack((reach * cosine(turn), reach * sine(turn), height), axis=-1).reshape(-1, 3)
    return oriented(vertices, prisms(triangles, len(ring), around) % len(vertices))


def l_block(size_xyz: tuple[float, float, float], notch_xy: tuple[float, float], edge_length: float) -> TetGeometry:
    """A box of `size_xyz` [m] about the origin less its corner at +x +y, `notch_xy` [m] wide and as high as the box.

    A grid with a plane along each side of the notch; each cell is cut into six tetrahedra.
    """
    size, notch = np.asarray(size_xyz, dtype=np.float64), np.asarray(notch_xy, dtype=np.float64)
    if size.shape != (3,):
        raise ValueError(f"size_xyz: needs three lengths, got {size_xyz!r}")
    if notch.shape != (2,):
        raise ValueError(f"notch_xy: needs two lengths, got {notch_xy!r}")
    require_positive(x=size[0], y=size[1], z=size[2], notch_x=notch[0], notch_y=notch[1], edge_length=edge_length)
    if np.any(notch >= size[:2]):
        raise ValueError(f"notch_xy: {notch_xy} m leaves nothing of a box of {size_xyz} m along x or y")
    arms = np.append(size[:2] - notch, size[2])
    kept = np.maximum(1, np.round(arms / edge_length).astype(np.int64))
    cut = np.maximum(1, np.round(notch / edge_length).astype(np.int64))
    cells = kept + np.append(cut, 0)
    require_affordable(6 * int(np.prod(cells.astype(object))))
    lattice = brick(tuple(cells.astype(float)), 1.0)
    steps = np.round(lattice.vertices + 0.5 * cells)
    middle = steps[lattice.tetrahedra].mean(axis=1)
    tetrahedra = lattice.tetrahedra[~np.all(middle[:, :2] > kept[:2], axis=1)]
    used, tetrahedra = np.unique(tetrahedra, return_inverse=True)
    corner = -0.5 * size
    axes = [
        np.interp(steps[used, k], (0, kept[k], cells[k]), (corner[k], corner[k] + arms[k], -corner[k])) for k in (0, 1)
    ]
    height = np.interp(steps[used, 2], (0, cells[2]), (corner[2], -corner[2]))
    return oriented(np.column_stack((*axes, height)), tetrahedra.reshape(-1, 4))


# The pig is the thin-walled body with ears, snout and legs of Glondu et al. 2014, Fig. 10. Its outside is star-shaped:
# one radius for each direction from the middle, that of an ellipsoid with smooth bumps. Prisms over a geodesic sphere
# fill the wall between it and the hollow, a smaller ellipsoid. Each of a prism's three tetrahedra over directions a, b,
# c has a volume of det(a, b, c) / 6 times two radii and the difference of two along one ray: none is inverted, whatever
# the bumps.
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
