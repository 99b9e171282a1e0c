"""Scenes of uploaded meshes: what is in them, and files that are no mesh, are too large, or would do harm."""

from __future__ import annotations

import io
import pickle
import threading
from pathlib import Path
from queue import Queue
from typing import Any

import numpy as np
import pytest
import trimesh

from fracture_collision import uploaded_scene
from fracture_collision.geometry.generators import brick
from fracture_collision.geometry.surface_files import read_surface
from fracture_collision.geometry.tetrahedra import tetrahedron_volumes
from fracture_collision.lockstep import Lockstep
from fracture_collision.ros.nodes.uploaded_scenes import UploadedScenes, scene_file
from fracture_collision.simulation.scene.scene import load_scene
from fracture_collision.uploaded_scene import LONGEST_SIDE, SceneMaker, UploadRejected
from fracture_collision.viewer.page.page_events import Upload

TORUS = trimesh.creation.torus(0.1, 0.03).export(file_type="obj").encode()
BRICK = brick((0.2, 0.1, 0.06), 0.05)
INVERTED = np.ascontiguousarray(BRICK.tetrahedra[:, [1, 0, 2, 3]])


def npz(**arrays: Any) -> bytes:
    stream = io.BytesIO()
    np.savez(stream, **arrays)
    return stream.getvalue()


class Bomb:
    """Its pickle, once loaded, writes a file."""

    def __init__(self, file: Path) -> None:
        self._file = file

    def __reduce__(self) -> Any:
        return Path.touch, (self._file,)


@pytest.mark.parametrize(
    ("content", "suffix"),
    [
        (TORUS, ".obj"),
        pytest.param(npz(vertices=BRICK.vertices, tetrahedra=INVERTED), ".npz", marks=pytest.mark.slow),
    ],
)
def test_a_scene_has_the_body_standing_on_the_floor(tmp_path: Path, content: bytes, suffix: str) -> None:
    scene = tmp_path / "upload_1.yaml"
    SceneMaker().make(content, suffix, scene)
    assert sorted(file.name for file in tmp_path.iterdir()) == ["upload_1.npz", "upload_1.yaml"]
    floor, body = load_scene(scene).bodies
    assert floor.shape.kind == "plane" and body.material.fracture is not None and not body.linear_velocity.any()
    mesh = body.shape.mesh
    assert np.ptp(mesh.vertices, axis=0).max() == pytest.approx(LONGEST_SIDE, rel=0.02)
    assert tetrahedron_volumes(*mesh).min() > 0.0
    with Lockstep(load_scene(scene)) as run:
        for _ in range(100):
            report = run.step().report
    assert report.fragments == 1 and report.max_speed < 0.01, "it waits for the user"


@pytest.mark.parametrize(
    ("content", "suffix", "words"),
    [
        (b"", ".stl", "no faces"),
        (b"no mesh", ".ply", "cannot be read as PLY"),
        (b"no mesh", ".npz", "cannot be read as .npz"),
        (TORUS[: len(TORUS) // 2], ".obj", "cannot be read as OBJ"),
        (trimesh.creation.icosphere(1).submesh([range(70)])[0].export(file_type="obj").encode(), ".obj", "holes"),
        (pickle.dumps(BRICK.vertices), ".npz", "cannot be read as .npz"),
        (npz(vertices=np.zeros((4, 3)), tetrahedra=[[0, 1, 2, 3]]), ".npz", "1 of the 1 tetrahedra have no volume"),
        (npz(**brick((0.3, 0.3, 0.3), 0.0135)._asdict()), ".npz", "63888 tetrahedra, more than 60000"),
        (npz(vertices=BRICK.vertices, tetrahedra=np.tile(BRICK.tetrahedra, (500, 1))), ".npz", "some overlap"),
        (
            npz(vertices=np.vstack((BRICK.vertices, BRICK.vertices + 1.0)),
                tetrahedra=np.vstack((BRICK.tetrahedra, BRICK.tetrahedra + len(BRICK.vertices)))),
            ".npz", "falls into 2 pieces",
        ),
    ],
)  # fmt: skip
def test_other_files_are_rejected_with_words(tmp_path: Path, content: bytes, suffix: str, words: str) -> None:
    reason = reason_of(tmp_path, content, suffix)
    assert words in reason and str(tmp_path) not in reason, "no folder of this machine is named"


def reason_of(folder: Path, content: bytes, suffix: str) -> str:
    """Why the process that reads rejects a file, in this process; "" if it writes a scene."""
    file = folder / f"{uploaded_scene.INPUT}{suffix}"
    file.write_bytes(content)
    return uploaded_scene._write_scene(file, folder / "upload_1.yaml")


@pytest.mark.parametrize(
    ("content", "suffix", "words"),
    [(b"no mesh", ".obj", "no faces"), (TORUS, ".msh", "none of .obj"), (TORUS, "/../../x.obj", "none of .obj")],
)
def test_rejected_files_leave_nothing_behind(tmp_path: Path, content: bytes, suffix: str, words: str) -> None:
    with pytest.raises(UploadRejected, match=words) as caught:
        SceneMaker().make(content, suffix, tmp_path / "upload_1.yaml")
    assert str(tmp_path) not in str(caught.value)
    assert not list(tmp_path.iterdir())


def test_pickles_are_not_loaded(tmp_path: Path) -> None:
    fired = tmp_path / "fired"
    bomb = np.array([Bomb(fired)], dtype=object)
    for arrays in ({"vertices": bomb, "tetrahedra": BRICK.tetrahedra}, {**BRICK._asdict(), "tetrahedra": bomb}):
        assert "but object" in reason_of(tmp_path, npz(**arrays), ".npz")
    assert not reason_of(tmp_path, npz(**BRICK._asdict(), more=bomb), ".npz")
    assert not fired.exists()
    np.load(io.BytesIO(npz(more=bomb)), allow_pickle=True)["more"]
    assert fired.exists(), "the pickle would have fired"


def test_files_that_a_mesh_names_are_not_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "secret.mtl").write_text("newmtl steel\nmap_Kd secret.png\n")
    file = tmp_path / "torus.obj"
    file.write_bytes(b"mtllib secret.mtl\nusemtl steel\n" + TORUS)
    opened: list[str] = []
    seen = io.open

    def watched(name: Any, *arguments: Any, **options: Any) -> Any:
        opened.append(str(name))
        return seen(name, *arguments, **options)

    monkeypatch.setattr("builtins.open", watched)
    monkeypatch.setattr("io.open", watched)
    assert len(read_surface(file, None).triangles) > 100
    assert any("torus.obj" in name for name in opened) and not any("secret" in name for name in opened)


def test_reading_is_limited_in_time_and_can_be_ended(tmp_path: Path) -> None:
    with pytest.raises(UploadRejected, match="takes more than 1 s of a processor"):
        SceneMaker().make(TORUS, ".obj", tmp_path / "upload_1.yaml", seconds=1)
    told: Queue[str] = Queue()
    uploads = UploadedScenes(tmp_path, lambda name, _upload: told.put(name))
    upload = Upload("torus.obj", TORUS, told.put)
    uploads.add(upload)
    uploads.add(upload)
    assert told.get(timeout=600.0) == "torus.obj: another mesh is being read; try again"
    uploads.close()
    assert "torus.obj: the page is ending" in told.get(timeout=600.0) and told.empty()
    assert not list(tmp_path.iterdir()) and threading.active_count() < 10


@pytest.mark.slow
def test_scenes_are_numbered_and_found_by_name_only(tmp_path: Path) -> None:
    made: Queue[str] = Queue()
    uploads = UploadedScenes(tmp_path / "uploads", lambda name, _upload: made.put(name))
    for name in ("upload_1", "upload_2"):
        uploads.add(Upload("my torus.OBJ", TORUS, made.put))
        assert made.get(timeout=600.0) == name
        uploads._thread.join()
    (tmp_path / "upload_7.yaml").write_text("")
    (tmp_path / "uploads" / "other.yaml").write_text("")
    folder = tmp_path / "uploads"
    assert scene_file(folder, "upload_2") == folder / "upload_2.yaml"
    for name in ("upload_3", "other", "../upload_7", "upload_1.yaml", "upload_1\n", "", str(folder / "upload_1")):
        assert scene_file(folder, name) is None
