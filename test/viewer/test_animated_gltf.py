"""A run exported as one animated file, read by a reader of its own, by the glTF 2.0 specification."""

from __future__ import annotations

import io
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from click.testing import CliRunner
from scipy.spatial.transform import Rotation, Slerp
from stages.browser import chromium, opened

from fracture_collision.cli.commands import main
from fracture_collision.run_meshes import read_run_with_meshes
from fracture_collision.viewer.film.animated_gltf import animated_glb
from fracture_collision.viewer.film.recorded_run import RecordedRun
from fracture_collision.viewer.film.run_scene import RunScene
from fracture_collision.viewer.page.bag_player import BagPlayer

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
    done = CliRunner().invoke(main, ["export", str(PLATES), "--out", str(out)])
    assert done.exit_code == 0, done.output
    assert Reader(out.read_bytes()).tracks and list(tmp_path.iterdir()) == [out]
    for arguments, words in (([str(PLATES), "--out", str(tmp_path / "a.gltf")], "ends with .glb"),
                             ([str(tmp_path)], "")):  # fmt: skip
        failed = CliRunner().invoke(main, ["export", *arguments])
        assert failed.exit_code == 2 and words in failed.output


def test_the_page_of_a_recording_offers_it(run: RecordedRun, tmp_path: Path) -> None:
    with chromium() as browser, BagPlayer(run, name="plates") as player, opened(browser, player.page.address) as seen:
        with seen.expect_download() as download:
            seen.get_by_role("button", name="download .glb").click()
        assert download.value.suggested_filename == "plates.glb"
        download.value.save_as(tmp_path / "plates.glb")
        assert (tmp_path / "plates.glb").read_bytes() == animated_glb(run)
