"""Bodies for studies of resolution: surface resolution and number of interior points are independent.

Glondu et al. 2014, section 7.2 and Fig. 11, compares samplings of a sphere in this way. The mesh is the points'
Delaunay tetrahedralization (Qhull); equal arguments give equal bytes.
"""

from __future__ import annotations

import numpy as np

from fracture_collision.geometry.generators import TetGeometry, geodesic_sphere, oriented, require_positive
from fracture_collision.geometry.tetrahedra import tetrahedron_volumes
from fracture_collision.portable_math import cube_root, lengths

# Points of the grid are moved by up to this part of its spacing: on a regular grid Delaunay meets nothing but ties.
_JITTER = 0.3
# Interior points nearer to the surface than this part of the spacing would make flat tetrahedra there.
_CLEARANCE = 0.45
_SEED = 1


def sampled_ball(radius: float, frequency: int, interior_points: int) -> TetGeometry:
    """A ball about the origin; its surface is a geodesic sphere of 20 frequency^2 triangles and `radius` [m].

    `interior_points` is met to within 2 %. The paper's reference sphere is sampled_ball(1, 11, 4000).
    """
    return sampled_shell(radius, 0.0, frequency, 0, interior_points)


def sampled_shell(
    outer_radius: float, inner_radius: float, outer_frequency: int, inner_frequency: int, interior_points: int
) -> TetGeometry:
    """A hollow sphere about the origin [m]; its two surfaces are sampled as in `sampled_ball`.

    Raises ValueError if the wall is too thin for its sampling: a tetrahedron would bridge the hollow.
    """
    require_positive(outer_radius=outer_radius, frequency=outer_frequency)
    if not 0.0 <= inner_radius < outer_radius:
        raise ValueError(f"inner_radius: {inner_radius} m is not from 0 to outer_radius, {outer_radius} m")
    for name, count in (("inner_frequency", inner_frequency), ("interior_points", interior_points)):
        if count < 0:
            raise ValueError(f"{name}: {count} is less than 0")
    surface = [outer_radius * geodesic_sphere(outer_frequency)[0]]
    if inner_radius > 0.0:
        surface.append(inner_radius * geodesic_sphere(inner_frequency)[0])
    cubes = [radius * radius * radius for radius in (outer_radius, inner_radius)]
    volume = 4.0 / 3.0 * np.pi * (cubes[0] - cubes[1])
    inside = np.empty((0, 3))
    if interior_points > 0:
        inside = _grid_points(outer_radius, inner_radius, cube_root(volume / interior_points), interior_points)
    vertices = np.concatenate([*surface, inside])
    from scipy.spatial import Delaunay  # late: a quarter of a second

    tetrahedra = Delaunay(vertices).simplices
    centres = vertices[tetrahedra].mean(axis=1)
    tetrahedra = tetrahedra[lengths(centres) > inner_radius]
    flat = np.abs(tetrahedron_volumes(vertices, tetrahedra)) < 1e-9 * volume / len(tetrahedra)
    made = oriented(vertices, tetrahedra[~flat])
    if len(np.unique(made.tetrahedra)) != len(vertices):
        raise ValueError("frequency: some surface vertices belong to no tetrahedron; sample more evenly")
    return made


def _grid_points(outer_radius: float, inner_radius: float, spacing: float, wanted: int) -> np.ndarray:
    """A jittered grid (n, 3) between the spheres, refined until it makes up for the points lost to the clearance."""
    for _ in range(20):
        axis = np.arange(-outer_radius, outer_radius, spacing)
        points = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 3)
        points += np.random.default_rng(_SEED).uniform(-_JITTER, _JITTER, points.shape) * spacing
        distance = lengths(points)
        low = inner_radius + _CLEARANCE * spacing if inner_radius > 0.0 else 0.0
        points = points[(distance < outer_radius - _CLEARANCE * spacing) & (distance > low)]
        if abs(len(points) - wanted) <= 0.02 * wanted:
            break
        spacing *= cube_root(max(len(points), 1) / wanted)
    return points
