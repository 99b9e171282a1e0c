"""Surface files: valid ones are read, invalid ones raise errors that name the problem and its place."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh
from PIL import Image

from fracture_collision.geometry.surface_files import read_surface

BOX = trimesh.creation.box((2.0, 1.0, 1.0))


def stored(mesh: trimesh.Trimesh, file: Path) -> Path:
    mesh.export(file)
    return file


@pytest.mark.parametrize("suffix", ["obj", "stl", "ply", "off", "glb"])
def test_closed_surfaces_of_every_format_are_read(tmp_path: Path, suffix: str) -> None:
    ring = trimesh.creation.torus(0.5, 0.2)
    vertices, triangles = read_surface(stored(ring, tmp_path / f"ring.{suffix}"), 0.3)
    assert np.ptp(vertices, axis=0).max() == pytest.approx(0.3)
    assert np.allclose(vertices.max(axis=0), -vertices.min(axis=0))
    mesh = trimesh.Trimesh(vertices, triangles, process=False)
    assert mesh.is_volume and mesh.euler_number == 0
    assert mesh.volume == pytest.approx(ring.volume * (0.3 / ring.extents.max()) ** 3, rel=1e-4)


@pytest.mark.parametrize("inverted", [False, True])
@pytest.mark.parametrize("place", [0.0, -9e3])
def test_a_hollow_body_is_read_and_turned_if_inverted(tmp_path: Path, inverted: bool, place: float) -> None:
    inside = trimesh.creation.icosphere(subdivisions=1, radius=0.2)
    inside.invert()
    hollow = trimesh.util.concatenate(BOX, inside).apply_translation([place] * 3)
    volume = hollow.volume
    if inverted:
        hollow.invert()
    read = read_surface(stored(hollow, tmp_path / "hollow.obj"), None)
    assert len(read.triangles) == len(hollow.faces)
    assert trimesh.Trimesh(*read, process=False).volume == pytest.approx(volume, rel=1e-3 if place else 1e-6)


def test_materials_and_pictures_in_a_file_are_not_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    ball = trimesh.creation.icosphere(subdivisions=1)
    ball.visual = trimesh.visual.TextureVisuals(uv=ball.vertices[:, :2], image=Image.new("RGB", (4, 4)))
    stored(ball, tmp_path / "ball.glb")
    opened: list[object] = []
    monkeypatch.setattr(Image, "open", opened.append)
    assert len(read_surface(tmp_path / "ball.glb", None).triangles) == len(ball.faces) and not opened


@pytest.mark.parametrize("apart", [5e-16, 3e-8])
def test_corners_that_differ_by_rounding_are_merged(tmp_path: Path, apart: float) -> None:
    """Each triangle has corners of its own, as in STL, all of them moved; 3e-8 of the size is what STL rounds off."""
    ball = trimesh.creation.icosphere(subdivisions=3, radius=0.5)
    corners = ball.triangles + np.random.default_rng(1).uniform(-apart, apart, ball.triangles.shape)
    lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in corners.reshape(-1, 3).tolist()]  # trimesh writes fewer digits
    lines += [f"f {3 * i + 1} {3 * i + 2} {3 * i + 3}" for i in range(len(corners))]
    (tmp_path / "ball.obj").write_text("\n".join(lines))
    read = read_surface(tmp_path / "ball.obj", None)
    assert len(read.vertices) == len(ball.vertices) and len(read.triangles) == len(ball.faces)
    assert trimesh.Trimesh(*read, process=False).is_volume


def test_small_features_of_a_closed_surface_are_kept(tmp_path: Path) -> None:
    """Where equal corners close the surface, nothing else is merged."""
    sheet = trimesh.creation.box((1.0, 1.0, 1e-8))
    assert len(read_surface(stored(sheet, tmp_path / "sheet.ply"), None).vertices) == 8


def holes() -> trimesh.Trimesh:
    return trimesh.Trimesh(BOX.vertices, BOX.faces[1:], process=False)


def one_turned() -> trimesh.Trimesh:
    return trimesh.Trimesh(BOX.vertices, np.vstack((BOX.faces[:1, ::-1], BOX.faces[1:])), process=False)


def flat() -> trimesh.Trimesh:
    """A square with two sides."""
    corners = [(0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (1.0, 1.0, 0.0), (0.0, 1.0, 0.0)]
    return trimesh.Trimesh(corners, [[0, 1, 2], [0, 2, 3], [0, 3, 1], [1, 3, 2]], process=False)


def two_parts() -> trimesh.Trimesh:
    return trimesh.util.concatenate(BOX, BOX.copy().apply_translation((5.0, 0.0, 0.0)))


def fin() -> trimesh.Trimesh:
    """A tetrahedron on an edge that already has two faces of the box."""
    a, b = BOX.vertices[BOX.faces[0, :2]]
    apart = np.array([(0.0, 0.0, 9.0), (0.0, 5.0, 9.0)])
    tip = trimesh.Trimesh(np.vstack(([a, b], apart)), [[0, 1, 2], [0, 3, 1], [0, 2, 3], [1, 3, 2]], process=False)
    if tip.volume < 0.0:
        tip.invert()
    return trimesh.util.concatenate(BOX, tip)


def cut_through() -> trimesh.Trimesh:
    """A ball with a vertex pulled through the other side."""
    ball = trimesh.creation.icosphere(subdivisions=2, radius=1.0)
    vertices = np.array(ball.vertices)
    top = np.argmax(vertices[:, 2])
    vertices[top] = (0.05, 0.03, -1.5)
    return trimesh.Trimesh(vertices, ball.faces, process=False)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (holes, r"3 edges with only one face: the surface has holes, the first between \(-1, -0.5, -0.5\) and"),
        (one_turned, r"3 edges whose two faces have opposite winding"),
        (flat, r"the surface encloses no volume: give the body a thickness"),
        (two_parts, r"2 separate parts, of 12, 12 triangles: .*save each in a file of its own"),
        (fin, r"1 edge with more than two faces"),
        (cut_through, r"the surface intersects itself, first near \("),
    ],
)
def test_surfaces_that_bound_no_solid_are_rejected(tmp_path: Path, make, words: str) -> None:
    with pytest.raises(ValueError, match=r"bad\.ply: " + words):
        read_surface(stored(make(), tmp_path / "bad.ply"), 1.0)


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("points.obj", "v 0 0 0\nv 1 0 0\n", "no faces|cannot be read"),
        ("text.stl", "no mesh at all", "cannot be read as STL|no faces"),
        ("text.txt", "", r"\.txt is none of"),
        ("nan.off", "OFF\n3 1 0\n0 0 nan\n1 0 0\n0 1 0\n3 0 1 2\n", "not finite|cannot be read"),
        (None, "", "no such file"),
    ],
)
def test_files_without_a_surface_are_rejected(tmp_path: Path, name: str | None, content: str, words: str) -> None:
    file = tmp_path / (name or "missing.obj")
    if name:
        file.write_text(content)
    with pytest.raises(ValueError, match=words):
        read_surface(file, 1.0)
