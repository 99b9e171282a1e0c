"""Tetrahedral meshes of two strongly concave shapes, a ring and an L; without a mesher, as in `generators`."""

from __future__ import annotations

import numpy as np

from fracture_collision.geometry.generators import (
    TetGeometry,
    brick,
    disc,
    oriented,
    prisms,
    require_affordable,
    require_positive,
)
from fracture_collision.portable_math import cosine, sine


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
