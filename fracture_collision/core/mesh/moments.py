"""Exact mass moments of polyhedral pieces: volume, first and second moments about a point near them.

A moment row (10,) is [V, Sx, Sy, Sz, Sxx, Sxy, Sxz, Syy, Syz, Szz] with S_ij = integral of x_i x_j dV [m3, m4, m5],
x from a point of the body (PoolTables.moment_origins). About the origin of a frame that is far away, inertias would be
small differences of large numbers.
Tonon, "Explicit exact formulas for the 3-D tetrahedron inertia tensor" (2004), in its covariance form.
"""

from __future__ import annotations

import math

import numpy as np

from fracture_collision.core.memory.compiled import kernel, query_kernel


def tetrahedron_moments(corners: np.ndarray, origin: np.ndarray) -> np.ndarray:
    """Moment rows (m, 10) about `origin` (3,) [m] of tetrahedra given by `corners` (m, 4, 3) [m]."""
    rows = np.zeros((len(corners), 10))
    _tetrahedra_moments(np.ascontiguousarray(corners), np.ascontiguousarray(origin), rows)
    return rows


@kernel
def _tetrahedra_moments(corners, origin, rows):
    for t in range(len(corners)):
        c = corners[t]
        add_tetrahedron(c[0], c[1], c[2], c[3], origin, rows[t])


@query_kernel
def tetrahedron_terms(o, a, b, c, origin):
    """The signed moment row about `origin` of the tetrahedron (o, a, b, c), ten numbers; all are points (3,) [m].

    The volume is that of the points as they are: relative to an origin they would be rounded by its distance, which is
    not small beside the thickness of a thin body.
    """
    ux, uy, uz = a[0] - o[0], a[1] - o[1], a[2] - o[2]
    vx, vy, vz = b[0] - o[0], b[1] - o[1], b[2] - o[2]
    wx, wy, wz = c[0] - o[0], c[1] - o[1], c[2] - o[2]
    volume = (ux * (vy * wz - vz * wy) + uy * (vz * wx - vx * wz) + uz * (vx * wy - vy * wx)) / 6.0
    ox, oy, oz = o[0] - origin[0], o[1] - origin[1], o[2] - origin[2]
    ax, ay, az = a[0] - origin[0], a[1] - origin[1], a[2] - origin[2]
    bx, by, bz = b[0] - origin[0], b[1] - origin[1], b[2] - origin[2]
    cx, cy, cz = c[0] - origin[0], c[1] - origin[1], c[2] - origin[2]
    sx, sy, sz = ox + ax + bx + cx, oy + ay + by + cy, oz + az + bz + cz
    k = volume / 20.0
    return (
        volume,
        volume * sx / 4.0,
        volume * sy / 4.0,
        volume * sz / 4.0,
        k * (sx * sx + ox * ox + ax * ax + bx * bx + cx * cx),
        k * (sx * sy + ox * oy + ax * ay + bx * by + cx * cy),
        k * (sx * sz + ox * oz + ax * az + bx * bz + cx * cz),
        k * (sy * sy + oy * oy + ay * ay + by * by + cy * cy),
        k * (sy * sz + oy * oz + ay * az + by * bz + cy * cz),
        k * (sz * sz + oz * oz + az * az + bz * bz + cz * cz),
    )


@query_kernel
def add_row(row, s0, s1, s2, s3, s4, s5, s6, s7, s8, s9):
    """Add ten numbers to `row` (10,): all are read before any is written, so that the additions vectorize."""
    s0, s1, s2, s3, s4 = row[0] + s0, row[1] + s1, row[2] + s2, row[3] + s3, row[4] + s4
    s5, s6, s7, s8, s9 = row[5] + s5, row[6] + s6, row[7] + s7, row[8] + s8, row[9] + s9
    row[0], row[1], row[2], row[3], row[4] = s0, s1, s2, s3, s4
    row[5], row[6], row[7], row[8], row[9] = s5, s6, s7, s8, s9


@query_kernel
def add_tetrahedron(o, a, b, c, origin, row):
    """Add the signed moments about `origin` of the tetrahedron (o, a, b, c) to `row` (10,)."""
    m = tetrahedron_terms(o, a, b, c, origin)
    add_row(row, m[0], m[1], m[2], m[3], m[4], m[5], m[6], m[7], m[8], m[9])


def surface_moments(corners: np.ndarray, origin: np.ndarray) -> np.ndarray:
    """Moment row (10,) about `origin` (3,) [m] of the solid in closed triangles (t, 3, 3) [m], seen counter-clockwise.

    The divergence theorem: the tetrahedra over all triangles with one common apex add up to the solid.
    """
    row = np.zeros(10)
    apex = 0.5 * (corners.min(axis=(0, 1)) + corners.max(axis=(0, 1)))
    _pyramid_moments(apex, np.ascontiguousarray(corners), np.ascontiguousarray(origin), row)
    return row


@kernel
def _pyramid_moments(apex, triangles, origin, row):
    for p in triangles:
        add_tetrahedron(apex, p[0], p[1], p[2], origin, row)


def mass_properties(
    moments: np.ndarray, origins: np.ndarray, density: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Masses, centres of mass and inertias of solids with `moments` (n, 10) about `origins` (n, 3), of `density` (n,).

    Returns (masses (n,) [kg], centres (n, 3) [m], inertias (n, 6) [kg m2] about them, body axes: xx xy xz yy yz zz).
    """
    volume = moments[:, :1]
    center = moments[:, 1:4] / volume
    x, y, z = center.T
    products = np.column_stack([x * x, x * y, x * z, y * y, y * z, z * z])
    sxx, sxy, sxz, syy, syz, szz = (moments[:, 4:10] - volume * products).T
    inertia = density[:, None] * np.column_stack([syy + szz, -sxy, -sxz, sxx + szz, -syz, sxx + syy])
    return density * volume[:, 0], center + origins, inertia


def sphere_mass_properties(radius: float, density: float) -> tuple[float, np.ndarray, np.ndarray]:
    """(mass [kg], centre (3,) [m], inertia (6,) [kg m2]) of a ball of `radius` [m] and `density` [kg/m3]."""
    mass = density * 4.0 / 3.0 * math.pi * radius * radius * radius
    moment = 0.4 * mass * radius * radius
    return mass, np.zeros(3), np.array([moment, 0.0, 0.0, moment, 0.0, moment])


def box_mass_properties(half: np.ndarray, density: float) -> tuple[float, np.ndarray, np.ndarray]:
    """(mass [kg], centre (3,) [m], inertia (6,) [kg m2]) of a box of half edges (3,) [m] and `density` [kg/m3]."""
    mass = density * 8.0 * float(np.prod(half))
    xx, yy, zz = half * half * mass / 3.0
    return mass, np.zeros(3), np.array([yy + zz, 0.0, 0.0, xx + zz, 0.0, xx + yy])
