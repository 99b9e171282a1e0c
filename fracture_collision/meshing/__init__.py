"""Tetrahedral meshes of the user's own bodies: read from files, or made of closed surfaces."""

from fracture_collision.meshing.lattice_mesher import tetrahedralize_by_lattice
from fracture_collision.meshing.mesh_files import read_mesh

__all__ = ["read_mesh", "tetrahedralize_by_lattice"]
