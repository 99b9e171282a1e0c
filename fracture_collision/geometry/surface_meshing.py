"""Tetrahedral meshes of any closed surface, through fTetWild (Hu et al. 2020; MPL-2.0), an optional extra."""

from __future__ import annotations

import math
import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np

from fracture_collision.geometry.generators import TetGeometry
from fracture_collision.geometry.tetrahedra import face_neighbours, pyramid_volumes, tetrahedron_volumes


def tetrahedralize_surface(
    vertices: np.ndarray, triangles: np.ndarray, edge_length: float, surface_tolerance: float = 1e-3
) -> TetGeometry:
    """Fill a closed surface with tetrahedra of about `edge_length` [m].

    vertices (n, 3) [m] and triangles (t, 3), counter-clockwise from outside, closed. The boundary of the result is a
    new triangulation, nowhere farther from the surface than `surface_tolerance` times the diagonal of its box.

    fTetWild is not deterministic: two calls give slightly different meshes. For repeatable runs, mesh once and keep
    the result (as arrays, beside the scene).

    Raises ValueError for a surface that is open, inside out, or has an index out of range, and ModuleNotFoundError
    with the command that installs the mesher.
    """
    vertices = np.require(vertices, np.float64, ("C", "A", "W"))
    triangles = np.require(triangles, np.int32, ("C", "A", "W"))
    require_closed_surface(vertices, triangles)
    if not (math.isfinite(edge_length) and edge_length > 0.0):
        raise ValueError(f"edge_length: {edge_length} is not a positive length in metres")
    if not (math.isfinite(surface_tolerance) and 0.0 < surface_tolerance < 0.5):
        raise ValueError(f"surface_tolerance: {surface_tolerance} is not between 0 and 0.5")
    try:
        import pytetwild
    except ModuleNotFoundError as missing:
        # pytetwild 0.3 and 0.4 import pyvista, which only their extra `all` brings.
        if missing.name not in ("pytetwild", "pyvista"):
            raise
        raise ModuleNotFoundError(
            "meshing a surface needs the optional mesher: pip install 'pytetwild[all]'", name=missing.name
        ) from missing

    with _scratch_folder():
        filled, tetrahedra = pytetwild.tetrahedralize(
            vertices, triangles, edge_length_abs=float(edge_length), epsilon=surface_tolerance, num_threads=1
        )
    used, tetrahedra = np.unique(tetrahedra, return_inverse=True)
    filled = np.ascontiguousarray(filled[used])
    tetrahedra = tetrahedra.reshape(-1, 4).astype(np.int32)
    if not len(tetrahedra):
        raise ValueError("the mesh is empty: the surface may be thinner than surface_tolerance")
    volumes = tetrahedron_volumes(filled, tetrahedra)
    if np.any(volumes == 0.0):
        raise ValueError(f"the mesher gave {np.count_nonzero(volumes == 0.0)} flat tetrahedra; try another edge_length")
    tetrahedra[volumes < 0.0, 2:] = tetrahedra[volumes < 0.0, :1:-1]
    face_neighbours(tetrahedra)  # raises if faces do not match
    return TetGeometry(filled, tetrahedra)


@contextmanager
def _scratch_folder() -> Iterator[None]:
    """A temporary working directory, since fTetWild leaves files in the current one."""
    before = os.getcwd()
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)
        try:
            yield
        finally:
            os.chdir(before)


def require_closed_surface(vertices: np.ndarray, triangles: np.ndarray) -> None:
    """Raise ValueError unless the triangles (t, 3) bound a solid and are counter-clockwise from outside."""
    if vertices.ndim != 2 or vertices.shape[1] != 3 or not np.all(np.isfinite(vertices)):
        raise ValueError(f"vertices: need finite numbers of shape (n, 3), got shape {vertices.shape}")
    if triangles.ndim != 2 or triangles.shape[1] != 3 or not len(triangles):
        raise ValueError(f"triangles: need indices of shape (t, 3), got shape {triangles.shape}")
    if triangles.min() < 0 or triangles.max() >= len(vertices):
        index = triangles.min() if triangles.min() < 0 else triangles.max()
        raise ValueError(f"triangles: index {index} is not among the {len(vertices)} vertices")
    directed = triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2).astype(np.int64)
    forward = directed[:, 0] * len(vertices) + directed[:, 1]
    backward = directed[:, 1] * len(vertices) + directed[:, 0]
    unmatched = ~np.isin(forward, backward)
    if np.any(unmatched):
        a, b = directed[unmatched][0]
        raise ValueError(
            f"triangles: the surface has holes or triangles with the wrong winding: {np.count_nonzero(unmatched)} "
            f"edges lack a neighbour, the first between vertices {a} and {b}"
        )
    if len(np.unique(forward)) < len(forward):
        values, counts = np.unique(forward, return_counts=True)
        a, b = divmod(int(values[counts > 1][0]), len(vertices))
        raise ValueError(f"triangles: more than two share the edge between vertices {a} and {b}")
    if pyramid_volumes(vertices[triangles]).sum() <= 0.0:
        raise ValueError("triangles: clockwise seen from outside (the enclosed volume is not positive); reverse them")
