"""A surface filled with edges short enough for its walls.

The lattice mesher loses parts that are thinner than an edge, which shows in the volume and the area of the result.
"""

from __future__ import annotations

import numpy as np

from fracture_collision.geometry.generators import TetGeometry
from fracture_collision.geometry.surface_files import Surface
from fracture_collision.geometry.tetrahedra import boundary_triangles, pyramid_volumes, tetrahedron_volumes
from fracture_collision.meshing.lattice_mesher import tetrahedralize_by_lattice
from fracture_collision.portable_math import lengths

EDGES_ALONG = 15  # edges along the longest side, where no length is given: one to three thousand nodes
# A mesh whose volume or area differs by more than this share has lost parts. Rounded edges of a solid cost less.
LOST_VOLUME, LOST_AREA = 0.1, 0.2
SHORTER = 0.8  # the next edge length that is tried
MOST_NODES = 50_000
# Nodes in a volume of an edge length cubed, and on an area of an edge length squared.
NODES_INSIDE, NODES_ON = 1.5, 1.2


def fill_resolved(surface: Surface, edge_length: float | None) -> TetGeometry:
    """Tetrahedra that fill a closed surface, by the lattice mesher.

    edge_length [m]: by default a fifteenth of the longest side, or shorter where walls are thin, until volume and area
    are those of the surface.

    Raises ValueError, with the edge length that works, if parts would be lost at `edge_length`, and where the length
    that works would make more than MOST_NODES nodes.
    """
    volume, area = float(pyramid_volumes(surface.vertices[surface.triangles]).sum()), _area(*surface)
    half_wall = volume / area  # on average
    length, fault = edge_length or float(np.ptp(surface.vertices, axis=0).max()) / EDGES_ALONG, ""
    if edge_length is not None:
        mesh, fault = _filled(surface, length, volume, area)
        if mesh is not None:
            return mesh
        length *= SHORTER
    length = min(length, half_wall)
    length = float(f"{length:.3g}")  # as errors have it
    while (NODES_INSIDE * volume / length + NODES_ON * area) / (length * length) <= MOST_NODES:
        mesh, last = _filled(surface, length, volume, area)
        if mesh is not None and edge_length is None:
            return mesh
        if mesh is not None:
            raise ValueError(f"{fault}; {length:.3g} m works, with {len(mesh.vertices)} nodes")
        fault, length = fault or last, float(f"{SHORTER * length:.3g}")
    raise ValueError(
        f"{fault or 'edge_length: the walls are thin'}; walls of {2.0 * half_wall:.3g} m on average need {length:.3g} "
        f"m or less, which makes more than {MOST_NODES} nodes: thicken them, or use mesher='ftetwild'"
    )


def _filled(surface: Surface, length: float, volume: float, area: float) -> tuple[TetGeometry | None, str]:
    """The mesh if nothing is lost, otherwise what is."""
    try:
        mesh = tetrahedralize_by_lattice(*surface, length)
    except ValueError as error:
        return None, str(error)
    kept_volume = float(tetrahedron_volumes(*mesh).sum()) / volume
    kept_area = _area(mesh.vertices, boundary_triangles(mesh.tetrahedra)) / area
    if abs(kept_volume - 1.0) <= LOST_VOLUME and abs(kept_area - 1.0) <= LOST_AREA:
        return mesh, ""
    return None, (
        f"edge_length: at {length:.3g} m thin parts are lost, the mesh has {kept_volume:.0%} of the surface's volume "
        f"and {kept_area:.0%} of its area"
    )


def _area(vertices: np.ndarray, triangles: np.ndarray) -> float:
    a, b, c = (vertices[triangles[:, i]] for i in range(3))
    return 0.5 * float(lengths(np.cross(b - a, c - a)).sum())
