"""read_mesh: tetrahedra of the package's and of other formats, surfaces where the mesher is installed; its errors."""

from __future__ import annotations

import doctest
import sys
from pathlib import Path

import numpy as np
import pytest
import trimesh

from fracture_collision.geometry.generators import brick
from fracture_collision.geometry.tetrahedra import boundary_triangles, tetrahedron_volumes
from fracture_collision.meshing import mesh_files, read_mesh

BRICK = brick((0.2, 0.1, 0.06), 0.05)


def stored(file: Path) -> Path:
    np.savez(file, vertices=BRICK.vertices, tetrahedra=BRICK.tetrahedra)
    return file


def test_a_stored_mesh_keeps_its_coordinates_or_is_scaled(tmp_path: Path) -> None:
    file = stored(tmp_path / "brick.npz")
    assert np.array_equal(read_mesh(file).vertices, BRICK.vertices)
    scaled = read_mesh(str(file), longest_side=1.0)
    assert np.ptp(scaled.vertices, axis=0) == pytest.approx([1.0, 0.5, 0.3])
    assert scaled.vertices.max(axis=0) == pytest.approx(-scaled.vertices.min(axis=0))


@pytest.mark.parametrize("suffix", ["msh", "vtu", "vtk", "mesh"])
def test_tetrahedra_of_other_programs_are_read(tmp_path: Path, suffix: str) -> None:
    meshio = pytest.importorskip("meshio")
    inverted = BRICK.tetrahedra[:, [1, 0, 2, 3]].astype(np.int64)
    with_loose_point = np.vstack(([(9.0, 9.0, 9.0)], BRICK.vertices))
    cells = [("triangle", np.array([[1, 2, 3]])), ("tetra", 1 + inverted)]
    meshio.write(tmp_path / f"brick.{suffix}", meshio.Mesh(with_loose_point, cells))
    mesh = read_mesh(tmp_path / f"brick.{suffix}")
    assert mesh.vertices.shape == BRICK.vertices.shape
    volumes = tetrahedron_volumes(mesh.vertices, mesh.tetrahedra)
    assert volumes.min() > 0.0 and volumes.sum() == pytest.approx(0.2 * 0.1 * 0.06)


def test_a_file_without_tetrahedra_or_with_damage_is_rejected(tmp_path: Path) -> None:
    meshio = pytest.importorskip("meshio")
    meshio.write(tmp_path / "sheet.vtu", meshio.Mesh(np.eye(3), [("triangle", np.array([[0, 1, 2]]))]))
    with pytest.raises(ValueError, match="has triangle, but no tetrahedra; a surface can be filled from .obj"):
        read_mesh(tmp_path / "sheet.vtu")
    (tmp_path / "noise.msh").write_bytes(b"\x00\x01 no mesh")
    with pytest.raises(ValueError, match="noise.msh: cannot be read as msh"):
        read_mesh(tmp_path / "noise.msh")
    (tmp_path / "noise.vtk").write_bytes(b"\x00\x01 no mesh")
    with pytest.raises(ValueError, match="noise.vtk: cannot be read as vtk: Illegal VTK header"):
        read_mesh(tmp_path / "noise.vtk")


def test_a_body_in_millimetres_is_reported(tmp_path: Path, recwarn: pytest.WarningsRecorder) -> None:
    trimesh.creation.box((80.0, 90.0, 60.0)).export(tmp_path / "part.stl")
    np.savez(tmp_path / "part.npz", vertices=1000.0 * BRICK.vertices, tetrahedra=BRICK.tetrahedra)
    for name, longest_side in (("part.stl", "0.09"), ("part.npz", "0.2")):
        with pytest.warns(UserWarning, match=rf"{name}: \d+ m long.* longest_side={longest_side}") as caught:
            read_mesh(tmp_path / name)
        assert caught[0].filename == __file__
        read_mesh(tmp_path / name, longest_side=float(longest_side))
    assert not recwarn.list


def test_a_mesh_object_is_rejected_with_the_remedy() -> None:
    with pytest.raises(TypeError, match=r"file: needs a path, got Trimesh.*mesh.export\(\"part.stl\"\)"):
        read_mesh(trimesh.creation.box())


def test_without_meshio_the_error_names_the_command(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "meshio", None)
    (tmp_path / "brick.msh").touch()
    with pytest.raises(ModuleNotFoundError, match=r"brick.msh: reading .msh needs meshio: `pip install"):
        read_mesh(tmp_path / "brick.msh")


@pytest.mark.parametrize(("mesher", "accuracy"), [("lattice", 0.06), ("ftetwild", 0.01)])
def test_a_surface_is_filled(tmp_path: Path, mesher: str, accuracy: float) -> None:
    if mesher == "ftetwild":
        pytest.importorskip("pyvista")
        pytest.importorskip("pytetwild")
    trimesh.creation.box((2.0, 1.0, 1.0)).export(tmp_path / "box.stl")
    mesh = read_mesh(tmp_path / "box.stl", longest_side=0.2, edge_length=0.025, mesher=mesher)
    assert tetrahedron_volumes(mesh.vertices, mesh.tetrahedra).sum() == pytest.approx(0.2 * 0.1 * 0.1, rel=accuracy)
    assert len(read_mesh(tmp_path / "box.stl", mesher=mesher).vertices) > len(mesh.vertices)


def cup() -> trimesh.Trimesh:
    """80 x 90 mm, with walls of 5 mm."""
    profile = [(0.0, 0.0), (0.04, 0.0), (0.04, 0.09), (0.035, 0.09), (0.035, 0.005), (0.0, 0.005)]
    return trimesh.creation.revolve(np.array(profile), sections=48)


def test_thin_walls_are_resolved_or_rejected_with_a_length_that_works(tmp_path: Path) -> None:
    whole = cup()
    whole.export(tmp_path / "cup.stl")
    mesh = read_mesh(tmp_path / "cup.stl")
    filled = trimesh.Trimesh(mesh.vertices, boundary_triangles(mesh.tetrahedra), process=False)
    assert filled.volume == pytest.approx(whole.volume, rel=0.05) and filled.euler_number == 2
    assert filled.area == pytest.approx(whole.area, rel=0.05)
    words = r"cup.stl: edge_length: at 0.006 m .*; 0.00\d+ m works, with \d+ nodes"
    with pytest.raises(ValueError, match=words) as caught:
        read_mesh(tmp_path / "cup.stl", edge_length=0.006)
    length = float(str(caught.value).split("; ")[1].split(" m works")[0])
    assert len(read_mesh(tmp_path / "cup.stl", edge_length=length).vertices) > 2000


def test_errors_name_the_argument_or_the_file(tmp_path: Path) -> None:
    file = stored(tmp_path / "brick.npz")
    for name, thickness in (("sheet", 0.01), ("foil", 5e-4)):
        trimesh.creation.box((1.0, 1.0, thickness)).export(tmp_path / f"{name}.stl")
    for arguments, words in (
        ((tmp_path / "sheet.stl", None, 0.5), "sheet.stl: edge_length: 0.5 m is too long, no lattice point"),
        ((tmp_path / "foil.stl",), r"foil.stl: .*walls of 0.0005 m on average need .* more than 50000 nodes"),
        ((file, -1.0), "longest_side: -1.0 is not a positive length in metres"),
        ((file, None, 0.0), "edge_length: 0.0 is not a positive length"),
        ((file, None, 0.01), "edge_length: .*brick.npz holds tetrahedra.* leave it out"),
        ((tmp_path / "brick.blend",), r"brick.blend: .blend is none of .npz, .msh, .* \(tetrahedra\) and .obj"),
        ((tmp_path / "brick",), "brick: no suffix is none of"),
        ((tmp_path / "none.npz",), "none.npz: no such file"),
        ((tmp_path / "none.obj",), "none.obj: no such file"),
        ((file, None, None, "gmsh"), "mesher: 'gmsh' is not one of lattice, ftetwild"),
    ):
        with pytest.raises(ValueError, match=words):
            read_mesh(*arguments)


def test_the_example_in_the_docstring_runs() -> None:
    done = doctest.testmod(mesh_files)
    assert done.attempted and not done.failed
