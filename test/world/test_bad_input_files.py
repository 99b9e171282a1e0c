"""Malicious or broken files: a clear error, quickly, without running code or writing files."""

from __future__ import annotations

import io
import os
import pickle
import re
import zipfile
from pathlib import Path

import numpy as np
import pytest

from fracture_collision.geometry.stored_meshes import bunny, read_tetrahedra
from fracture_collision.simulation.config.scene_fields import MAX_SCENE_BYTES
from fracture_collision.simulation.scene.scene import SceneError, load_scene, scene_files

LAUGHS = "a0: &a0 [lol, lol]\n" + "".join(f"a{i}: &a{i} [*a{i - 1}, *a{i - 1}]\n" for i in range(1, 60))
MERGED = "a0: &a0 {x: 1}\n" + "".join(f"a{i}: &a{i} {{<<: [*a{i - 1}, *a{i - 1}]}}\n" for i in range(1, 60))
SCENE = """
time_step: 0.01
duration: 1.0
materials: {stone: {density: 2000.0, friction: 0.5}}
bodies: [{name: ground, material: stone, static: true, shape: {plane: {coefficients: [0, 0, 1, 0]}}}]
"""

YAML = {
    "many laughs": (LAUGHS, "aliases written out"),
    "merged laughs": (MERGED, "aliases written out"),
    "laughs as a name": (LAUGHS + SCENE.replace("name: ground", "name: *a40"), "aliases written out"),
    "itself": ("a: &a [*a]", "contains itself, line 1"),
    "deep": ("[" * 50_000, "nested too deeply"),
    "an object": ("a: !!python/object/apply:os.system ['touch harmed']", "not YAML: could not determine a constructor"),
    "a module": ("!!python/module:os {}", "not YAML"),
    "a date that is none": ("a: 2001-99-99", "not YAML: month must be in"),
    "a number too long": ("a: " + "9" * 10_000, "not YAML: Exceeds the limit"),
    "too long": ("# " + "x" * MAX_SCENE_BYTES, f"more than {MAX_SCENE_BYTES} bytes"),
    "a long number in base 16": ("a: 0x" + "f" * 10_000, "not YAML: Exceeds the limit"),
    "a number in base 60": (SCENE.replace("0.01", ":".join(["59"] * 300_000)), "time_step: needs a finite number"),
    "a value of another type": ("a: !!bool x", "not YAML: 'x' is not of the type !!bool, line 1"),
    "two documents": ("a: 1\n---\nb: 2", "not YAML"),
    "a key that is a list": ("? [a, b]\n: 1", "not YAML"),
    "binary": ("\0\1\2", "not YAML"),
    "nothing": ("", "scene: needs fields, got None"),
    "an unknown field": (SCENE + "bombs: 3", "bombs: unknown field"),
    "a number beyond doubles": (SCENE.replace("0.01", "1" + "0" * 400), "time_step: needs a finite number"),
    "a text for a number": (SCENE.replace("0.01", "'x'"), "time_step: needs a finite number, got 'x'"),
    "a mapping for a name": (SCENE.replace("name: ground", "name: {a: b}"), r"bodies\[0\].name: needs a text, got"),
    "a list for a material": (SCENE.replace("material: stone", "material: [1]"), r"material: needs a text, got \[1\]"),
    "steps without end": (SCENE.replace("0.01", "1.0e-300"), "duration: 1.0 s are more than 1000000000 steps"),
    "a mesh without end": (
        SCENE.replace("static: true, shape: {plane: {coefficients: [0, 0, 1, 0]}}",
                      "shape: {brick: {size_xyz: [1, 1, 1], edge_length: 1.0e-9}}"),
        r"bodies\[0\].shape.brick.edge_length: gives",
    ),
    "a surface for a stored mesh": (
        SCENE.replace("static: true, shape: {plane: {coefficients: [0, 0, 1, 0]}}",
                      "shape: {stored_mesh: {file: parts/cup.stl}}"),
        r"parts/cup.stl: stored_mesh reads tetrahedra from .npz; make it with .*read_mesh\('cup.stl'\) and "
        r"numpy.savez\('cup.npz'",
    ),
    "a track elsewhere": (SCENE + "hand: {track: ../../../../etc/passwd}", "hand.track: "),
    "a track that never ends": (SCENE + "hand: {track: /dev/zero}", "hand.track: "),
}  # fmt: skip


@pytest.mark.timeout(20)
@pytest.mark.parametrize("harm", YAML)
def test_bad_scene_files_are_rejected(harm: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    text, words = YAML[harm]
    monkeypatch.chdir(tmp_path)
    file = tmp_path / "scene.yaml"
    file.write_text(text, encoding="utf-8")
    with pytest.raises(SceneError, match=words) as refusal:
        load_scene(file)
    assert len(str(refusal.value)) < 1_000
    assert os.listdir(tmp_path) == ["scene.yaml"]


def test_a_scene_file_that_is_not_utf_8_is_rejected(tmp_path: Path) -> None:
    file = tmp_path / "scene.yaml"
    file.write_bytes(b"name: \xff\xfe")
    with pytest.raises(SceneError, match="not UTF-8"):
        load_scene(file)


def test_the_valid_scene_is_read(tmp_path: Path) -> None:
    file = tmp_path / "scene.yaml"
    file.write_text(SCENE, encoding="utf-8")
    assert load_scene(file).step_count == 100
    assert len(scene_files()) > 5


@pytest.mark.parametrize(("content", "words"), [
    (b"time,x,y,z,holds\n" + b"x" * 200_000, "field larger than field limit|needs time"),
    (b"\xff\xfe\0\0", "not UTF-8"),
    (b"time,x,y,z,holds\n0,0,0,0,\n1,nan,0,0,\n", "needs finite numbers"),
    (b"time,x,y,z,holds\n0,0,0,0,\n0,0,0,0,\n", "does not follow"),
    (b"", "does not begin with the columns"),
])  # fmt: skip
def test_bad_tracks_are_rejected(content: bytes, words: str, tmp_path: Path) -> None:
    (tmp_path / "track.csv").write_bytes(content)
    (tmp_path / "scene.yaml").write_text(SCENE + "hand: {track: track.csv}", encoding="utf-8")
    with pytest.raises(SceneError, match=f"hand.track.*({words})"):
        load_scene(tmp_path / "scene.yaml")


def saved(**arrays: np.ndarray) -> bytes:
    stream = io.BytesIO()
    np.savez(stream, **arrays)
    return stream.getvalue()


def with_header(header: str, data: bytes = b"") -> bytes:
    """An archive whose vertices have this header."""
    stream, array = io.BytesIO(), io.BytesIO()
    array.write(b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header.encode() + data)
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("vertices.npy", array.getvalue())
        archive.writestr("tetrahedra.npy", array.getvalue())
    return stream.getvalue()


class Harm:
    def __reduce__(self):
        return os.system, ("touch harmed",)


GOOD = {"vertices": np.eye(4)[:, :3], "tetrahedra": np.array([[0, 1, 2, 3]])}
HEADER = "{'descr': '<f8', 'fortran_order': False, 'shape': (%s,), }"
MESHES = {
    "no archive": (b"no archive", "cannot be read as .npz"),
    "a pickle": (pickle.dumps(Harm()), "cannot be read as .npz"),
    "objects": (saved(**GOOD | {"vertices": np.array([Harm()], dtype=object)}), "vertices: not rows of floats"),
    "cut short": (saved(**GOOD)[:-100], "cannot be read as .npz"),
    "one array": (saved(vertices=GOOD["vertices"]), "tetrahedra: missing"),
    "a size that no memory holds": (with_header(HEADER % "10**12, 3"), "vertices: not an array: "),
    "a size that is announced": (with_header(HEADER % "1000000000000, 3"), "vertices: needs"),
    "more than there is": (with_header(HEADER % "1000, 3", bytes(100)), "vertices: declares 24000 bytes and has 100"),
    "less than there is": (with_header(HEADER % "1, 3", bytes(10**6)), "declares 24 bytes and has more"),
    "a header with code": (with_header("__import__('os').system('touch harmed')"), "vertices: not an array: "),
    "a long header": (with_header("{" + " " * 60_000 + "}"), "Header info length"),
    "flat": (saved(**GOOD | {"vertices": np.zeros(12)}), "vertices: needs"),
    "no vertices": (saved(**GOOD | {"vertices": np.zeros((0, 3))}), "vertices: needs"),
    "not finite": (saved(**GOOD | {"vertices": np.full((4, 3), np.nan)}), "vertices: not all finite"),
    "index too large": (saved(**GOOD | {"tetrahedra": np.array([[0, 1, 2, 4]])}), "tetrahedra: an index"),
    "index negative": (saved(**GOOD | {"tetrahedra": np.array([[0, 1, 2, -1]])}), "tetrahedra: an index"),
    "indices of floats": (saved(**GOOD | {"tetrahedra": np.zeros((1, 4))}), "tetrahedra: not rows of integers"),
}


@pytest.mark.timeout(20)
@pytest.mark.parametrize("harm", MESHES)
def test_bad_mesh_files_are_rejected(harm: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    content, words = MESHES[harm]
    monkeypatch.chdir(tmp_path)
    file = tmp_path / "mesh.npz"
    file.write_bytes(content)
    with pytest.raises(ValueError, match=f"mesh.npz: .*({words})"):
        read_tetrahedra(file)
    assert os.listdir(tmp_path) == ["mesh.npz"]


def test_mesh_files_with_flipped_bits_are_read_or_rejected(tmp_path: Path) -> None:
    random, file, refused = np.random.default_rng(3), tmp_path / "mesh.npz", 0
    content = saved(**GOOD)
    for _ in range(400):
        spoilt = bytearray(content)
        for at in random.integers(0, len(content), 3):
            spoilt[at] ^= 1 << random.integers(0, 8)
        file.write_bytes(spoilt)
        try:
            read_tetrahedra(file)
        except ValueError:
            refused += 1
    assert refused > 200


def test_valid_mesh_files_are_read(tmp_path: Path) -> None:
    (tmp_path / "mesh.npz").write_bytes(saved(**GOOD))
    vertices, tetrahedra = read_tetrahedra(tmp_path / "mesh.npz")
    assert vertices.tolist() == GOOD["vertices"].tolist() and tetrahedra.tolist() == [[0, 1, 2, 3]]
    assert len(bunny().vertices) == 2010


def test_the_package_uses_no_unsafe_loader() -> None:
    package = Path(__file__).parents[2] / "fracture_collision"
    words = ("yaml.load(", "full_load", "unsafe_load", "UnsafeLoader", "FullLoader", "allow_pickle=True")
    for file in package.rglob("*.py"):
        text = file.read_text(encoding="utf-8")
        assert [word for word in words if word in text] == [], file.name


SECRET = "hunter2" * 20
PASSWORDS = f"root:x:0:0:{SECRET}:/root:/bin/bash\n"
NO_SCENES = {
    "a password file": PASSWORDS + PASSWORDS,
    "credentials": f"[default]\naws_secret_access_key = {SECRET}\n",
    "a key": f"-----BEGIN PRIVATE KEY-----\n{SECRET}\n{SECRET}\n",
    "a tag": f"!{SECRET} x",
    "an anchor": f"*{SECRET}",
    "a field": f"{SECRET}: 1\n" + SCENE,
    "a list": f"[{SECRET}, {SECRET}, {SECRET}]",
    "a text for a number": SCENE.replace("0.01", SECRET),
    "kinds of a shape": SCENE.replace("{plane: {coefficients: [0, 0, 1, 0]}}", f"{{{SECRET}: 1, a: 2}}"),
    "a material": SCENE.replace("material: stone", f"material: {SECRET}"),
    "a track": SCENE + f"hand: {{track: {{a: {SECRET}}}}}",
    "a row of a track": SCENE + f"hand: {{track: [[{SECRET}, 1, 2, 3, 4], [0, 0, 0, 0, '']]}}",
}


@pytest.mark.parametrize("kind", NO_SCENES)
def test_errors_quote_little_of_other_files(kind: str, tmp_path: Path) -> None:
    file = tmp_path / "no_scene"
    file.write_text(NO_SCENES[kind], encoding="utf-8")
    with pytest.raises(SceneError) as refusal:
        load_scene(file)
    assert not re.search(r"(hunter2){6}", str(refusal.value)), refusal.value
    assert len(str(refusal.value)) < 300
