"""`film` and `export`: files readable by other programs and by the glTF 2.0 specification; no file on failure."""

from __future__ import annotations

import io
import json
import os
import shutil
import signal
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation, Slerp
from stages.bag_of_records import write_bag
from stages.browser import chromium, opened
from stages.typed_command import begun, call
from worlds.small_run import small_run

from fracture_collision.bag.reader import BagError
from fracture_collision.run_meshes import read_run_with_meshes
from fracture_collision.viewer.film.animated_gltf import animated_glb
from fracture_collision.viewer.film.film import Cut, FilmError, frame_indices, make_film
from fracture_collision.viewer.film.recorded_run import RecordedRun, read_run
from fracture_collision.viewer.film.run_scene import RunScene
from fracture_collision.viewer.page.bag_player import BagPlayer

pytest.importorskip("embreex", exc_type=ModuleNotFoundError)
SMALL = Cut(width=96, height=64, fps=10.0, samples=1)


def chunks_of_webp(data: bytes) -> list[bytes]:
    """Names of the chunks of a RIFF file, in order (the WebP container specification)."""
    assert data[:4] == b"RIFF" and data[8:12] == b"WEBP" and int.from_bytes(data[4:8], "little") == len(data) - 8
    names, at = [], 12
    while at < len(data):
        names.append(data[at : at + 4])
        size = int.from_bytes(data[at + 4 : at + 8], "little")
        at += 8 + size + size % 2
    return names


def frames_of_gif(data: bytes) -> tuple[int, int]:
    """Number of images, and total duration in hundredths of a second (the GIF 89a specification)."""
    assert data[:6] == b"GIF89a"
    at = 13 + (3 << (data[10] % 8 + 1)) * (data[10] >> 7)
    images = hundredths = 0
    while data[at] != 0x3B:
        if data[at] == 0x21:
            hundredths += int.from_bytes(data[at + 4 : at + 6], "little") * (data[at + 1] == 0xF9)
            at += 2
        else:
            assert data[at] == 0x2C
            images += 1
            at += 11 + (3 << (data[at + 9] % 8 + 1)) * (data[at + 9] >> 7)
        while data[at]:
            at += 1 + data[at]
        at += 1
    return images, hundredths


def test_films_of_each_kind_have_the_right_number_of_frames(small_bag: Path, tmp_path: Path) -> None:
    # 1.18 s at 10 frames a second, both ends: 12
    assert make_film(read_run(small_bag), tmp_path / "a.webp", SMALL) == 12
    assert chunks_of_webp((tmp_path / "a.webp").read_bytes()).count(b"ANMF") == 12
    assert make_film(read_run(small_bag), tmp_path / "a.gif", SMALL) == 12
    images, hundredths = frames_of_gif((tmp_path / "a.gif").read_bytes())
    assert hundredths == 120 and 6 <= images <= 12  # equal frames are merged into one of longer duration
    assert sorted(file.name for file in tmp_path.iterdir()) == ["a.gif", "a.webp"]
    assert (tmp_path / "a.gif").stat().st_mode & 0o444 == 0o444


def test_a_film_shows_a_part_of_a_run_at_a_slower_rate(small_bag: Path, tmp_path: Path) -> None:
    out = tmp_path / "part.webp"
    part = ("--begin", 0.5, "--end", 0.7, "--speed", 0.1, "--fps", 5)
    done = call("film", small_bag, "--out", out, *part, "--size", "64x48", "--samples", 1)
    assert done.status == 0, done.output
    assert "part.webp: 11 frames" in done.output.replace("\n", "")
    assert chunks_of_webp(out.read_bytes()).count(b"ANMF") >= 10
    run = read_run(small_bag)
    steps = [run.states[i].step for i in frame_indices(run, Cut(begin=0.5, end=0.7, speed=0.1, fps=5.0))]
    assert steps == [25, 26, 27, 28, 29, 30, 31, 32, 33, 34, 35]
    assert len(frame_indices(run, Cut(begin=1.18))) == 1


def test_mp4_needs_ffmpeg(small_bag: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    if shutil.which("ffmpeg") and shutil.which("ffprobe"):
        assert make_film(read_run(small_bag), tmp_path / "a.mp4", SMALL) == 12
        command = ["ffprobe", "-v", "error", "-count_frames", "-show_streams", "-of", "json", tmp_path / "a.mp4"]
        (stream,) = json.loads(subprocess.run(command, capture_output=True, check=True).stdout)["streams"]
        assert int(stream["nb_read_frames"]) == 12 and (stream["width"], stream["height"]) == (96, 64)
    monkeypatch.setenv("PATH", str(tmp_path))
    done = call("film", small_bag, "--out", tmp_path / "b.mp4", "--size", "64x48", "--samples", "1")
    assert done.status == 2 and "apt install ffmpeg" in done.text
    broken = tmp_path / "ffmpeg"
    broken.write_text("#!/bin/sh\necho no such encoder >&2\nexit 3\n")
    broken.chmod(0o755)
    with pytest.raises(FilmError, match="no such encoder"):
        make_film(read_run(small_bag), tmp_path / "b.mp4", SMALL)
    assert not list(tmp_path.glob("*b*.mp4")) and not list(tmp_path.glob(".*"))


def test_invalid_arguments_are_rejected_with_an_explanation(small_bag: Path, tmp_path: Path) -> None:
    for words, said in (
        ((small_bag, "--out", tmp_path / "a.avi"), ".webp"),
        ((small_bag, "--begin", "9"), "the run is 1.18 s long"),
        ((small_bag, "--size", "large"), "pass WxH"),
        ((tmp_path,), "neither an .mcap file nor a folder"),
    ):
        done = call("film", *words)
        assert done.status == 2 and said in done.text, words
    assert not list(tmp_path.iterdir())


def test_an_interrupted_film_keeps_the_old_one(small_bag: Path, tmp_path: Path) -> None:
    folder = tmp_path / "films"
    folder.mkdir()
    out = folder / "film.webp"
    out.write_bytes(b"of yesterday")
    with begun(tmp_path, "film", small_bag, "--out", out, "--size", "1280x960", "--samples", "64") as process:
        process.until(lambda: len(os.listdir(folder)) > 1)  # until the unfinished film appears
        process.stop(signal.SIGINT)
    assert "no film was written" in process.text
    assert [file.name for file in folder.iterdir()] == ["film.webp"] and out.read_bytes() == b"of yesterday"


def test_meshes_that_were_not_recorded_are_computed(tmp_path: Path) -> None:
    write_bag(tmp_path / "whole", small_run())
    write_bag(tmp_path / "bare", small_run(with_meshes=False))
    whole = read_run_with_meshes(tmp_path / "whole")
    asked: list[tuple[int, int]] = []
    made = read_run_with_meshes(tmp_path / "bare", progress=lambda *at: asked.append(at))
    assert sorted(made.meshes) == sorted(whole.meshes) and asked[-1] == (1, 1)
    for fragment_id, mesh in whole.meshes.items():
        own = made.meshes[fragment_id]
        assert own.is_crack.any()
        for axis in range(3):
            assert np.ptp(own.vertices[:, axis]) == pytest.approx(np.ptp(mesh.vertices[:, axis]), abs=0.02)
    no_events = [r for r in small_run(with_meshes=False) if type(r[1]).__name__ != "FractureEvent"]
    write_bag(tmp_path / "eventless", no_events)
    done = call("film", tmp_path / "eventless", "--out", tmp_path / "x.webp")
    assert done.status == 2 and "contains fragment" in done.text
    bodies_gone = [r for r in small_run(with_meshes=False) if type(r[1]).__name__ != "CollisionBody"]
    write_bag(tmp_path / "bodiless", bodies_gone)
    with pytest.raises(BagError, match="cannot compute meshes"):
        read_run_with_meshes(tmp_path / "bodiless")


PLATES = Path(__file__).parents[2] / "bags" / "plates"
TYPES = {5126: "<f4", 5125: "<u4", 5121: "u1"}
WIDTHS = {"SCALAR": 1, "VEC3": 3, "VEC4": 4}


class Reader:
    def __init__(self, data: bytes) -> None:
        assert data[:4] == b"glTF" and int.from_bytes(data[4:8], "little") == 2
        assert int.from_bytes(data[8:12], "little") == len(data)
        length = int.from_bytes(data[12:16], "little")
        assert data[16:20] == b"JSON" and data[24 + length : 28 + length] == b"BIN\0"
        self.told: dict[str, Any] = json.loads(data[20 : 20 + length])
        self._buffer = data[28 + length :]
        assert len(self._buffer) == int.from_bytes(data[20 + length : 24 + length], "little")
        (animation,) = self.told["animations"]
        self.tracks: dict[tuple[int, str], tuple[np.ndarray, np.ndarray, str]] = {}
        for channel in animation["channels"]:
            sampler = animation["samplers"][channel["sampler"]]
            key = channel["target"]["node"], channel["target"]["path"]
            assert key not in self.tracks
            times = self.array(sampler["input"])[:, 0]
            assert np.all(np.diff(times) > 0.0) or len(times) == 1
            limits = self.told["accessors"][sampler["input"]]
            assert [limits["min"], limits["max"]] == [[times[0]], [times[-1]]]
            self.tracks[key] = times, self.array(sampler["output"]), sampler["interpolation"]
            assert len(self.tracks[key][1]) == len(times)

    def array(self, number: int) -> np.ndarray:
        accessor = self.told["accessors"][number]
        view = self.told["bufferViews"][accessor["bufferView"]]
        width = WIDTHS[accessor["type"]]
        kind, count = TYPES[accessor["componentType"]], accessor["count"] * width
        values = np.frombuffer(self._buffer, kind, count, view["byteOffset"])
        assert values.nbytes == view["byteLength"] and view["byteOffset"] % 4 == 0
        return values.reshape(-1, width)

    def value(self, node: int, path: str, default: Any, moment: float) -> np.ndarray:
        if (node, path) not in self.tracks:
            return np.array(self.told["nodes"][node].get(path, default), dtype=float)
        times, values, how = self.tracks[node, path]
        moment = min(max(np.float32(moment), times[0]), times[-1])  # as times are in the file
        if how == "STEP":
            return values[np.searchsorted(times, moment, side="right") - 1]
        if path == "rotation":
            return Slerp(times, Rotation.from_quat(values))([moment]).as_quat()[0] if len(times) > 1 else values[0]
        return np.array([np.interp(moment, times, column) for column in values.T])

    def node(self, name: str) -> int:
        return next(i for i, node in enumerate(self.told["nodes"]) if node["name"] == name)

    def place(self, name: str, moment: float) -> tuple[np.ndarray, Rotation, float]:
        """Position and turn in the run's world, and the scale, at `moment` [s]."""
        node = self.node(name)
        scale = self.value(node, "scale", (1.0, 1.0, 1.0), moment)
        turn = Rotation.from_quat(self.value(node, "rotation", (0.0, 0.0, 0.0, 1.0), moment))
        return self.value(node, "translation", (0.0, 0.0, 0.0), moment), turn, float(scale[0])


@pytest.fixture(scope="module")
def run() -> RecordedRun:
    return read_run_with_meshes(PLATES)


def test_each_fragment_is_where_it_was_recorded_and_only_while_it_was(run: RecordedRun) -> None:
    file = Reader(animated_glb(run))
    begin = run.states[0].time
    everything = {f for states in run.states for f in states.fragment_ids.tolist()}
    everything = {f for f in everything if not np.any(run.bodies[run.body_of[f]].plane)}
    assert len(everything) > 40
    for states in run.states:
        for i, fragment_id in enumerate(states.fragment_ids.tolist()):
            if fragment_id in everything:
                position, turn, scale = file.place(f"fragment {fragment_id}", states.time - begin)
                assert scale == 1.0 and np.allclose(position, states.positions[i], atol=1e-5)
                assert (turn.inv() * Rotation.from_quat(states.orientations[i])).magnitude() < 1e-5
        for fragment_id in everything - set(states.fragment_ids.tolist()):
            assert file.place(f"fragment {fragment_id}", states.time - begin)[2] == 0.0
    up = Rotation.from_quat(file.told["nodes"][file.node("run")]["rotation"]).apply([0.0, 0.0, 1.0])
    assert np.allclose(up, [0.0, 1.0, 0.0], atol=1e-12)


def test_its_meshes_are_those_of_the_run_by_another_reader(run: RecordedRun) -> None:
    data = animated_glb(run)
    file, scene = Reader(data), RunScene(run)
    read = trimesh.load(io.BytesIO(data), file_type="glb")
    assert sum(len(mesh.faces) for mesh in read.geometry.values()) > 1000
    for fragment_id in (run.states[-1].fragment_ids.tolist()):
        if np.any(run.bodies[run.body_of[fragment_id]].plane):
            continue
        node = file.told["nodes"][file.node(f"fragment {fragment_id}")]
        corners = [file.array(p["attributes"]["POSITION"])[file.array(p["indices"])[:, 0]]
                   for p in file.told["meshes"][node["mesh"]]["primitives"]]  # fmt: skip
        mesh = scene.mesh(fragment_id)
        assert sum(map(len, corners)) == 3 * len(mesh.triangles)
        assert np.allclose(np.concatenate(corners).mean(axis=0), mesh.triangles.reshape(-1, 3).mean(axis=0), atol=1e-6)


def test_fewer_poses_keep_the_moments_of_fractures(run: RecordedRun) -> None:
    few, all_of_it = Reader(animated_glb(run, fps=2.0)), Reader(animated_glb(run))
    assert len(animated_glb(run, fps=2.0)) < len(animated_glb(run))
    for (node, path), (times, *_) in all_of_it.tracks.items():
        if path == "scale":
            assert np.array_equal(few.tracks[node, path][0], times)


def test_the_command_writes_a_file_that_replaces_an_earlier_one(tmp_path: Path) -> None:
    out = tmp_path / "plates.glb"
    out.write_bytes(b"earlier")
    done = call("export", PLATES, "--out", out)
    assert done.status == 0, done.output
    assert Reader(out.read_bytes()).tracks and list(tmp_path.iterdir()) == [out]
    for words, said in (((PLATES, "--out", tmp_path / "a.gltf"), "ends with .glb"), ((tmp_path,), "neither")):
        failed = call("export", *words)
        assert failed.status == 2 and said in failed.text


@pytest.mark.slow
def test_the_page_of_a_recording_offers_it(run: RecordedRun, tmp_path: Path) -> None:
    with chromium() as browser, BagPlayer(run, name="plates") as player, opened(browser, player.page.address) as seen:
        with seen.expect_download() as download:
            seen.get_by_role("button", name="download .glb").click()
        assert download.value.suggested_filename == "plates.glb"
        download.value.save_as(tmp_path / "plates.glb")
        assert (tmp_path / "plates.glb").read_bytes() == animated_glb(run)
