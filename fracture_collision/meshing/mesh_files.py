"""Tetrahedral meshes from the user's files: a mesher's output is read, a surface is filled.

- .npz: arrays `vertices` and `tetrahedra`, as numpy.savez writes them;
- .msh .vtu .vtk .mesh .inp .xdmf .med: tetrahedra of Gmsh, VTK and others, read by meshio;
- .obj .stl .ply .off .glb: a closed surface, filled by `lattice_mesher`, or by fTetWild where it is installed.

The lattice mesher loses parts that are thinner than an edge, which shows in the volume and the area of the result. So a
surface is filled with edges short enough for its walls.
"""

from __future__ import annotations

import contextlib
import io
import math
import os
import warnings
from pathlib import Path
from typing import Any

import numpy as np

from fracture_collision.geometry.generators import TETRAHEDRA_LIMIT, TetGeometry, oriented
from fracture_collision.geometry.stored_meshes import read_tetrahedra
from fracture_collision.geometry.surface_files import SUFFIXES, Surface, read_surface, tetrahedralize_surface
from fracture_collision.geometry.tetrahedra import boundary_triangles, pyramid_volumes, tetrahedron_volumes
from fracture_collision.meshing.lattice_mesher import tetrahedralize_by_lattice
from fracture_collision.portable_math import lengths

MESH_SUFFIXES = (".msh", ".vtu", ".vtk", ".mesh", ".inp", ".xdmf", ".med")
LARGE = 50.0  # [m] a longer body is more likely one in millimetres
LATTICE, FTETWILD = MESHERS = ("lattice", "ftetwild")
CORNERS = {"tetra": 4, "tetra10": 4}  # meshio's names; of quadratic tetrahedra the corners are used


def read_mesh(
    file: str | Path, longest_side: float | None = None, edge_length: float | None = None, mesher: str = LATTICE
) -> TetGeometry:
    """The tetrahedral mesh in `file`, or one that fills the surface in it.

    longest_side [m]: the mesh is moved to a box about the origin and scaled to this longest side; by default its
    coordinates are kept and count as metres. edge_length [m]: of the tetrahedra in a surface, by default a fifteenth of
    its longest side, or shorter where walls are thinner; half of it makes eight times as many nodes. A length at which
    walls would be lost is rejected, with one that works. Where the file holds tetrahedra, it must be left out.

    mesher, of surfaces: "lattice" needs nothing else and gives the same mesh on every machine, but rounds sharp edges
    by up to an edge length. "ftetwild" keeps them. It needs pytetwild[all], 600 MB
    with VTK, and gives a slightly different mesh in each call: keep one for repeatable runs, with
    numpy.savez("mesh.npz", vertices=mesh.vertices, tetrahedra=mesh.tetrahedra).

    Tetrahedra of negative volume are turned, vertices of none are dropped.

    Raises ValueError that names the file and the fault, ModuleNotFoundError with the command that installs what reads
    the format, and TypeError for anything but a path. Warns of a body longer than 50 m without `longest_side`.

    >>> from fracture_collision.meshing import read_mesh
    >>> from fracture_collision.share import share_directory
    >>> bunny = read_mesh(share_directory() / "config" / "meshes" / "bunny.npz", longest_side=0.2)
    >>> bunny.vertices.shape, bunny.tetrahedra.shape
    ((2010, 3), (7954, 4))
    """
    if not isinstance(file, (str, os.PathLike)):
        raise TypeError(
            f"file: needs a path, got {type(file).__name__}; write a mesh object to a file first (trimesh: "
            'mesh.export("part.stl")), or fill its arrays: tetrahedralize_by_lattice(vertices, triangles, edge_length)'
        )
    file = Path(file)
    for name, length in (("longest_side", longest_side), ("edge_length", edge_length)):
        if length is not None and not (math.isfinite(length) and length > 0.0):
            raise ValueError(f"{name}: {length} is not a positive length in metres")
    if mesher not in MESHERS:
        raise ValueError(f"mesher: {mesher!r} is not one of {', '.join(MESHERS)}")
    suffix = file.suffix.lower()
    if suffix not in (".npz", *MESH_SUFFIXES, *SUFFIXES):
        raise ValueError(
            f"{file}: {suffix or 'no suffix'} is none of {', '.join(('.npz', *MESH_SUFFIXES))} (tetrahedra) and "
            f"{', '.join(SUFFIXES)} (surfaces)"
        )
    if not file.is_file():
        raise ValueError(f"{file}: no such file")
    if suffix in SUFFIXES:
        surface = read_surface(file, longest_side)
        _warn_if_large(file, surface.vertices, longest_side)
        try:
            if mesher == LATTICE:
                return fill_resolved(surface, edge_length)
            length = edge_length or float(np.ptp(surface.vertices, axis=0).max()) / EDGES_ALONG
            return tetrahedralize_surface(*surface, length)
        except ValueError as error:
            raise ValueError(f"{file}: {error}") from error
    if edge_length is not None:
        raise ValueError(f"edge_length: {file} holds tetrahedra, whose size is not changed; leave it out")
    mesh = oriented(*read_tetrahedra(file)) if suffix == ".npz" else _read_by_meshio(file)
    if flat := int(np.count_nonzero(tetrahedron_volumes(*mesh) <= 0.0)):
        raise ValueError(f"{file}: {flat} of the {len(mesh.tetrahedra)} tetrahedra have no volume")
    _warn_if_large(file, mesh.vertices, longest_side)
    if longest_side is None:
        return mesh
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    return TetGeometry((mesh.vertices - 0.5 * (low + high)) * (longest_side / (high - low).max()), mesh.tetrahedra)


def _warn_if_large(file: Path, vertices: np.ndarray, longest_side: float | None) -> None:
    longest = float(np.ptp(vertices, axis=0).max())
    if longest_side is None and longest > LARGE:
        warnings.warn(
            f"{file}: {longest:.4g} m long, as coordinates count as metres; if they are millimetres, pass "
            f"longest_side={longest / 1000.0:.6g}",
            stacklevel=3,
        )


def _read_by_meshio(file: Path) -> TetGeometry:
    try:
        import meshio
    except ModuleNotFoundError as missing:
        if missing.name != "meshio":
            raise
        raise ModuleNotFoundError(
            f"{file}: reading {file.suffix} needs meshio: `pip install '.[meshing]'` in a checkout", name=missing.name
        ) from missing
    printed = io.StringIO()  # where meshio has the reason, before it exits
    try:
        with contextlib.redirect_stdout(printed), contextlib.redirect_stderr(printed):
            mesh: Any = meshio.read(file)
        points = np.asarray(mesh.points, dtype=np.float64)
        blocks = [np.asarray(b.data)[:, : CORNERS[b.type]] for b in mesh.cells if b.type in CORNERS]
    except (Exception, SystemExit) as error:  # of any kind, depending on the fault of the file
        reason = " ".join(printed.getvalue().split()) if isinstance(error, SystemExit) else error
        raise ValueError(f"{file}: cannot be read as {file.suffix[1:]}: {reason}") from error
    if not blocks or not sum(map(len, blocks)):
        kinds = ", ".join(sorted({b.type for b in mesh.cells})) or "nothing"
        raise ValueError(f"{file}: has {kinds}, but no tetrahedra; a surface can be filled from {', '.join(SUFFIXES)}")
    tetrahedra = np.concatenate(blocks)
    if len(tetrahedra) > TETRAHEDRA_LIMIT:
        raise ValueError(f"{file}: {len(tetrahedra)} tetrahedra, more than {TETRAHEDRA_LIMIT}")
    if points.ndim != 2 or points.shape[1] != 3 or not np.isfinite(points).all():
        raise ValueError(f"{file}: the points, of shape {points.shape}, are not finite rows of 3")
    if tetrahedra.min() < 0 or tetrahedra.max() >= len(points):
        raise ValueError(f"{file}: a tetrahedron has a corner that is not among the {len(points)} points")
    used, renumbered = np.unique(tetrahedra, return_inverse=True)
    return oriented(points[used], renumbered.reshape(-1, 4))


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
