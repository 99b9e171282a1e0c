"""The preprocess of a body's geometry, which equal geometries share, and mass properties."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fracture_collision.core.glondu2014.paper_geometry import Preprocess
from fracture_collision.core.memory.kinds import BOX, SPHERE
from fracture_collision.core.mesh.moments import box_mass_properties, sphere_mass_properties, surface_moments
from fracture_collision.core.mesh.tet_mesh import TetMesh
from fracture_collision.core.mesh.triangle_field import TriangleMesh, build_triangle_mesh
from fracture_collision.portable_math import lengths


class MassProperties(NamedTuple):
    """Mass properties of a rigid body."""

    mass: float  # [kg]
    center: np.ndarray  # (3,) [m], body frame
    inertia: np.ndarray  # (6,) [kg m2] about the centre, body axes: xx xy xz yy yz zz


class PreparedMesh(NamedTuple):
    """A tetrahedral mesh: the preprocess that equal geometries share."""

    mesh: TetMesh
    paper: list[Preprocess]  # for the method glondu2014; empty until it is first used


class PreparedSurface(NamedTuple):
    """The same preprocess for a rigid body with a closed triangle mesh."""

    mesh: TriangleMesh
    vertices: np.ndarray  # (n, 3) [m] its samples
    paper: list[Preprocess]  # likewise
    moments: np.ndarray  # (10,) about the lower corner of its box, see moments.py
    sampling_gap: float  # [m]


def prepare_mesh(mesh: TetMesh) -> PreparedMesh:
    """Preprocess a mesh; its nodes on the surface are its samples."""
    return PreparedMesh(mesh, [])


def prepare_surface(vertices: np.ndarray, triangles: np.ndarray) -> PreparedSurface:
    """Preprocess a closed mesh (vertices (n, 3) [m], triangles (t, 3)); every vertex is a sample."""
    corners = vertices[triangles]
    longest = lengths(corners - np.roll(corners, -1, axis=1)).max()
    mesh = build_triangle_mesh(vertices, triangles)
    return PreparedSurface(
        mesh,
        np.ascontiguousarray(vertices, dtype=np.float64),
        [],
        surface_moments(corners, mesh.node_box[0, :3]),
        # the corners of a triangle with longest side L cover it with balls of radius L / sqrt(3)
        float(longest / np.sqrt(3.0)),
    )


def mass_of_shape(kind: int, shape: np.ndarray, density: float) -> MassProperties:
    """Mass properties of a PLANE, SPHERE or BOX; shape (4,): of FragmentPool. A plane has no mass."""
    if kind == SPHERE:
        return MassProperties(*sphere_mass_properties(float(shape[0]), density))
    if kind == BOX:
        return MassProperties(*box_mass_properties(shape[:3], density))
    return MassProperties(0.0, np.zeros(3), np.zeros(6))
