"""Tetrahedral meshes in files. One comes with the package, because the mesher that made it is not deterministic.

A file holds two arrays, `vertices` and `tetrahedra`, as numpy.savez writes them; origin and licence of the package's
mesh are beside it in config/meshes. Files are plain data: no pickles, and no array is read before its size is checked.
"""

from __future__ import annotations

import zipfile
import zlib
from pathlib import Path

import numpy as np
from numpy.lib import format as npy

from fracture_collision.geometry.generators import TETRAHEDRA_LIMIT, TetGeometry, require_positive
from fracture_collision.share import share_directory

_HEADER_READERS = {(1, 0): npy.read_array_header_1_0, (2, 0): npy.read_array_header_2_0}
MAX_HEADER = 1_000  # bytes of an array's header


def bunny(longest_side: float = 0.2) -> TetGeometry:
    """The Stanford bunny, 2,010 nodes, in a box about the origin; its longest side, along z, is `longest_side` [m]."""
    require_positive(longest_side=longest_side)
    vertices, tetrahedra = read_tetrahedra(share_directory() / "config" / "meshes" / "bunny.npz")
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    scale = longest_side / (high - low).max()
    return TetGeometry((vertices - 0.5 * (low + high)) * scale, tetrahedra)


def stored_mesh(file: str) -> TetGeometry:
    """A mesh [m] read and checked by `read_tetrahedra`.

    Raises ValueError for a file that is not .npz, with the call that makes one of it.
    """
    path = Path(file)
    if path.suffix.lower() != ".npz":
        raise ValueError(
            f"{file}: stored_mesh reads tetrahedra from .npz; make it with mesh = fracture_collision.meshing.read_mesh("
            f"{path.name!r}) and numpy.savez({path.with_suffix('.npz').name!r}, vertices=mesh.vertices, "
            "tetrahedra=mesh.tetrahedra)"
        )
    return read_tetrahedra(path)


def read_tetrahedra(file: Path) -> TetGeometry:
    """Vertices (n, 3) float64 and tetrahedra (m, 4) of a .npz file, in the file's own unit.

    Raises ValueError, naming file and array, for other files, meshes larger than TETRAHEDRA_LIMIT, vertices that are
    not finite, and indices out of range.
    """
    try:
        with zipfile.ZipFile(file) as archive:
            vertices = _read_array(archive, "vertices", 3, "f", 4 * TETRAHEDRA_LIMIT)
            tetrahedra = _read_array(archive, "tetrahedra", 4, "iu", TETRAHEDRA_LIMIT)
    except (zipfile.BadZipFile, OSError, EOFError, NotImplementedError, RuntimeError, zlib.error) as error:
        raise ValueError(f"{file}: cannot be read as .npz: {error}") from error
    except ValueError as error:
        raise ValueError(f"{file}: {error}") from error
    if not np.isfinite(vertices).all():
        raise ValueError(f"{file}: vertices: not all finite")
    if tetrahedra.min() < 0 or tetrahedra.max() >= len(vertices):
        raise ValueError(f"{file}: tetrahedra: an index is not among the {len(vertices)} vertices")
    return TetGeometry(vertices.astype(np.float64), tetrahedra)


def _read_array(archive: zipfile.ZipFile, name: str, columns: int, kinds: str, most_rows: int) -> np.ndarray:
    member = f"{name}.npy"
    if member not in archive.namelist():
        raise ValueError(f"{name}: missing")
    with archive.open(member) as stream:
        try:
            read_header = _HEADER_READERS[npy.read_magic(stream)]
            shape, is_fortran, dtype = read_header(stream, max_header_size=MAX_HEADER)
        except (ValueError, KeyError) as error:
            raise ValueError(f"{name}: not an array: {error}") from error
        if is_fortran:
            raise ValueError(f"{name}: stored by columns; save numpy.ascontiguousarray({name})")
        if dtype.kind not in kinds:
            raise ValueError(f"{name}: not rows of {'floats' if kinds == 'f' else 'integers'} but {dtype}")
        if len(shape) != 2 or shape[1] != columns or not 0 < shape[0] <= most_rows:
            raise ValueError(f"{name}: needs (n, {columns}) numbers, n from 1 to {most_rows}, got {shape}")
        size = shape[0] * columns * dtype.itemsize
        data = stream.read(size + 1)
    if len(data) != size:
        raise ValueError(f"{name}: declares {size} bytes and has {'more' if len(data) > size else len(data)}")
    return np.frombuffer(data, dtype).reshape(shape)
