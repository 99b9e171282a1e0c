"""Closed surfaces, from the user's files (OBJ, STL, PLY, OFF, GLB, by trimesh) too, and fTetWild, which fills them.

A surface is checked to bound one solid; the error names what is wrong with a rejected one.
"""

from __future__ import annotations

import math
import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from fracture_collision.extras import need
from fracture_collision.geometry.generators import TetGeometry
from fracture_collision.geometry.tetrahedra import face_neighbours, pyramid_volumes, tetrahedron_volumes
from fracture_collision.portable_math import dots


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


SUFFIXES = (".obj", ".stl", ".ply", ".off", ".glb")
MAX_TRIANGLES = 200_000
# Of the longest side: an open surface's corners that are nearer are one vertex. A rounding of STL's numbers: 6e-8.
MERGED = 1e-7
_PAIRS_AT_ONCE = 2_000_000


class Surface(NamedTuple):
    """A closed surface of triangles."""

    vertices: np.ndarray  # (n, 3) float64 [m]
    triangles: np.ndarray  # (t, 3) int64, closed, counter-clockwise from outside


def read_surface(file: Path, longest_side: float | None) -> Surface:
    """The surface in a file, centred in a box about the origin, scaled to a longest side of `longest_side` [m].

    None: its own coordinates, which count as metres. A surface with all triangles clockwise from outside is turned.

    Raises ValueError that names the file, the fault and its place, in the file's own coordinates.
    """
    if file.suffix.lower() not in SUFFIXES:
        raise ValueError(f"{file}: {file.suffix or 'no suffix'} is none of {', '.join(SUFFIXES)}")
    if not file.is_file():
        raise ValueError(f"{file}: no such file")
    places, triangles = _read(file)
    if not len(triangles):
        raise ValueError(f"{file}: no faces")
    if len(triangles) > MAX_TRIANGLES:
        raise ValueError(f"{file}: {len(triangles)} triangles, more than {MAX_TRIANGLES}")
    if triangles.min() < 0 or triangles.max() >= len(places):
        raise ValueError(f"{file}: a face refers to a vertex that is not among the {len(places)}")
    if not np.all(np.isfinite(places[triangles])):
        raise ValueError(f"{file}: some vertices are not finite")
    vertices, triangles = _merged(places, triangles)
    if pyramid_volumes(vertices[triangles]).sum() < 0.0:
        triangles = np.ascontiguousarray(triangles[:, ::-1])
    try:
        require_solid(vertices, triangles)
    except ValueError as error:
        raise ValueError(f"{file}: {error}") from error
    if longest_side is None:
        return Surface(vertices, triangles)
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    return Surface((vertices - 0.5 * (low + high)) * (longest_side / (high - low).max()), triangles)


def _read(file: Path) -> tuple[np.ndarray, np.ndarray]:
    """Vertices and triangles of a file as it has them."""
    need("meshing", f"reading {file}")
    import trimesh  # late: the import is slow

    try:
        data = BytesIO(file.read_bytes())  # of a path, trimesh would also read materials and pictures that it names
        kind = file.suffix[1:].lower()
        mesh: Any = trimesh.load(data, file_type=kind, force="mesh", process=False, skip_materials=True)
        places, triangles = np.asarray(mesh.vertices, np.float64), np.asarray(mesh.faces, np.int64)
    except Exception as error:  # of any kind, depending on the fault of the file
        raise ValueError(f"{file}: cannot be read as {file.suffix[1:].upper()}: {error}") from error
    return places.reshape(-1, 3), triangles.reshape(-1, 3)


def _merged(places: np.ndarray, triangles: np.ndarray) -> Surface:
    """The surface with vertices at equal places merged and, if that leaves holes, those nearer than MERGED.

    Triangles with a repeated vertex are dropped.
    """
    vertices, number = np.unique(places[triangles.ravel()], axis=0, return_inverse=True)
    triangles = _with_area(number.reshape(-1, 3))
    if not np.any(_edges(triangles)[2] == 1):
        return Surface(vertices, triangles)
    from scipy.spatial import KDTree  # late: of an extra

    near = KDTree(vertices).query_pairs(MERGED * np.ptp(vertices, axis=0).max(), output_type="ndarray")
    group = _components(near, len(vertices))
    return Surface(vertices[np.unique(group, return_index=True)[1]], _with_area(group[triangles]))


def _with_area(triangles: np.ndarray) -> np.ndarray:
    """The triangles of three different vertices."""
    a, b, c = triangles.T
    return np.ascontiguousarray(triangles[(a != b) & (b != c) & (c != a)], dtype=np.int64)


def _edges(triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Edges (e, 2), the smaller end first; of each side (3 t,) its edge; the number of sides of each edge (e,)."""
    ends = np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    base = int(triangles.max(initial=0)) + 1
    key, edge_of, sides = np.unique(ends[:, 0] * base + ends[:, 1], return_inverse=True, return_counts=True)
    return np.column_stack((key // base, key % base)), edge_of, sides


def _components(links: np.ndarray, count: int) -> np.ndarray:
    """(count,) the connected component of each of 0 .. count - 1, numbered in the order of their smallest members."""
    from scipy.sparse import coo_array  # late: of an extra
    from scipy.sparse.csgraph import connected_components

    return connected_components(coo_array((np.ones(len(links)), links.T), shape=(count, count)), directed=False)[1]


def require_solid(vertices: np.ndarray, triangles: np.ndarray) -> None:
    """Raise ValueError unless the triangles (t, 3) bound one solid, hollow or not, and meet nowhere but at their edges.

    The winding is counter-clockwise seen from outside.
    """
    ends, edge_of, faces = _edges(triangles)

    def refuse_edges(bad: np.ndarray, words: str) -> None:
        if np.any(bad):
            a, b = (_place(vertices[i]) for i in ends[np.flatnonzero(bad)[0]])
            count = int(np.count_nonzero(bad))
            raise ValueError(f"{count} edge{'s' * (count > 1)} {words}, the first between {a} and {b}")

    refuse_edges(faces == 1, "with only one face: the surface has holes")
    refuse_edges(faces > 2, "with more than two faces: the surface bounds no solid there")
    is_forward = (triangles < np.roll(triangles, -1, axis=1)).ravel()
    forward = np.bincount(edge_of[is_forward], minlength=len(ends))
    refuse_edges(forward != 1, "whose two faces have opposite winding: reverse some of the triangles")

    part = _components(np.argsort(edge_of, kind="stable").reshape(-1, 2) // 3, len(triangles))
    volumes = np.bincount(part, pyramid_volumes(vertices[triangles]))
    if not np.any(volumes > 0.0):
        raise ValueError("the surface encloses no volume: give the body a thickness")
    if np.count_nonzero(volumes > 0.0) > 1:
        sizes = ", ".join(map(str, np.sort(np.bincount(part))[::-1][:5]))
        raise ValueError(
            f"{len(volumes)} separate parts, of {sizes} triangles: a body needs a single one; join parts that touch in "
            "a modelling program (Boolean union), or save each in a file of its own, as a body of its own"
        )
    crossing = _first_crossing(vertices, triangles)
    if crossing is not None:
        raise ValueError(f"the surface intersects itself, first near {_place(crossing)}")


def _place(point: np.ndarray) -> str:
    return "(" + ", ".join(f"{x:.6g}" for x in point) + ")"


def _first_crossing(vertices: np.ndarray, triangles: np.ndarray) -> np.ndarray | None:
    """Middle of an edge of one triangle that crosses another without a common vertex; None if there is none."""
    corners = vertices[triangles]
    order = np.argsort(corners[:, :, 0].min(axis=1), kind="stable")
    triangles, corners = triangles[order], corners[order]
    low, high = corners.min(axis=1), corners.max(axis=1)
    until = np.searchsorted(low[:, 0], high[:, 0], side="right")  # boxes that begin before this one ends, along x
    counts = until - np.arange(len(triangles)) - 1
    ends = np.cumsum(counts)
    begin = 0
    while begin < len(triangles):
        done = ends[begin - 1] if begin else 0
        stop = max(int(np.searchsorted(ends, done + _PAIRS_AT_ONCE, side="right")), begin + 1)
        first = np.repeat(np.arange(begin, stop), counts[begin:stop])
        second = np.arange(len(first)) - np.repeat(ends[begin:stop] - counts[begin:stop] - done, counts[begin:stop])
        second += first + 1
        near = np.all((low[first] <= high[second]) & (low[second] <= high[first]), axis=1)
        first, second = first[near], second[near]
        apart = ~np.any(triangles[first][:, :, None] == triangles[second][:, None, :], axis=(1, 2))
        first, second = first[apart], second[apart]
        for one, other in ((first, second), (second, first)):
            for k in range(3):
                start, end = corners[one, k], corners[one, (k + 1) % 3]
                hit = _runs_through(start, end, corners[other])
                if np.any(hit):
                    at = np.flatnonzero(hit)[0]
                    return 0.5 * (start[at] + end[at])
        begin = stop
    return None


def _runs_through(start: np.ndarray, end: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Whether segments (n, 3) cross triangles (n, 3, 3); touching does not count."""
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]

    def volume(p: np.ndarray, q: np.ndarray, r: np.ndarray, s: np.ndarray) -> np.ndarray:
        return dots(np.cross(q - p, r - p), s - p)

    sides = np.stack((volume(start, end, a, b), volume(start, end, b, c), volume(start, end, c, a)))
    across = volume(a, b, c, start) * volume(a, b, c, end) < 0.0
    return across & (np.all(sides > 0.0, axis=0) | np.all(sides < 0.0, axis=0))
