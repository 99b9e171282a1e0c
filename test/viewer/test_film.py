"""`fracture-collision film`: files readable by other programs, of the right length; no file on failure."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner, Result
from stages.bag_of_records import write_bag
from worlds.small_run import small_run

from fracture_collision.bag.reader import BagError
from fracture_collision.cli.commands import main
from fracture_collision.run_meshes import read_run_with_meshes
from fracture_collision.viewer.film.film import Cut, FilmError, frame_indices, make_film
from fracture_collision.viewer.film.recorded_run import read_run

pytest.importorskip("embreex", exc_type=ModuleNotFoundError)
SMALL = Cut(width=96, height=64, fps=10.0, samples=1)


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("run") / "small"
    write_bag(folder, small_run())  # 60 states, 0.02 s apart
    return folder


def call(*words: str | Path) -> Result:
    return CliRunner().invoke(main, ["film", *map(str, words)])


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


def test_films_of_each_kind_have_the_right_number_of_frames(bag: Path, tmp_path: Path) -> None:
    # 1.18 s at 10 frames a second, both ends: 12
    assert make_film(read_run(bag), tmp_path / "a.webp", SMALL) == 12
    assert chunks_of_webp((tmp_path / "a.webp").read_bytes()).count(b"ANMF") == 12
    assert make_film(read_run(bag), tmp_path / "a.gif", SMALL) == 12
    images, hundredths = frames_of_gif((tmp_path / "a.gif").read_bytes())
    assert hundredths == 120 and 6 <= images <= 12  # equal frames are merged into one of longer duration
    assert sorted(file.name for file in tmp_path.iterdir()) == ["a.gif", "a.webp"]
    assert (tmp_path / "a.gif").stat().st_mode & 0o444 == 0o444


def test_a_film_shows_a_part_of_a_run_at_a_slower_rate(bag: Path, tmp_path: Path) -> None:
    out = tmp_path / "part.webp"
    done = call(bag, "--out", out, "--begin", "0.5", "--end", "0.7", "--speed", "0.1", "--fps", "5", "--size", "64x48",
                "--samples", "1")  # fmt: skip
    assert done.exit_code == 0, done.output
    assert "part.webp: 11 frames" in done.output.replace("\n", "")
    assert chunks_of_webp(out.read_bytes()).count(b"ANMF") >= 10
    run = read_run(bag)
    steps = [run.states[i].step for i in frame_indices(run, Cut(begin=0.5, end=0.7, speed=0.1, fps=5.0))]
    assert steps == [25, 26, 27, 28, 29, 30, 31, 32, 33, 34, 35]
    assert len(frame_indices(run, Cut(begin=1.18))) == 1


def test_mp4_needs_ffmpeg(bag: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    if shutil.which("ffmpeg") and shutil.which("ffprobe"):
        assert make_film(read_run(bag), tmp_path / "a.mp4", SMALL) == 12
        command = ["ffprobe", "-v", "error", "-count_frames", "-show_streams", "-of", "json", tmp_path / "a.mp4"]
        (stream,) = json.loads(subprocess.run(command, capture_output=True, check=True).stdout)["streams"]
        assert int(stream["nb_read_frames"]) == 12 and (stream["width"], stream["height"]) == (96, 64)
    monkeypatch.setenv("PATH", str(tmp_path))
    done = call(bag, "--out", tmp_path / "b.mp4", "--size", "64x48", "--samples", "1")
    assert done.exit_code == 2 and "apt install ffmpeg" in done.output and "Traceback" not in done.output
    broken = tmp_path / "ffmpeg"
    broken.write_text("#!/bin/sh\necho no such encoder >&2\nexit 3\n")
    broken.chmod(0o755)
    with pytest.raises(FilmError, match="no such encoder"):
        make_film(read_run(bag), tmp_path / "b.mp4", SMALL)
    assert not list(tmp_path.glob("*b*.mp4")) and not list(tmp_path.glob(".*"))


def test_invalid_arguments_are_rejected_with_an_explanation(bag: Path, tmp_path: Path) -> None:
    for words, said, status in (
        (("--out", tmp_path / "a.avi"), ".webp", 2),
        (("--begin", "9"), "the run is 1.18 s long", 2),
        (("--size", "large"), "pass WxH", 2),
    ):
        done = call(bag, *words)
        assert done.exit_code == status and said in done.output.replace("\n", " "), done.output
        assert "Traceback" not in done.output
    done = call(tmp_path)
    assert done.exit_code == 2 and "neither an .mcap file nor a folder" in done.output.replace("\n", " ")
    assert not list(tmp_path.iterdir())


def test_an_interrupted_film_keeps_the_old_one(bag: Path, tmp_path: Path) -> None:
    out = tmp_path / "film.webp"
    out.write_bytes(b"of yesterday")
    command = [sys.executable, "-m", "fracture_collision.cli", "film", bag, "--out", out, "--size", "1280x960",
               "--samples", "64"]  # fmt: skip
    running = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    try:
        watched = os.open(tmp_path, os.O_RDONLY)
        while len(os.listdir(watched)) < 2:  # until the unfinished film appears
            assert running.poll() is None, running.stdout.read()
        running.send_signal(signal.SIGINT)
        said, _ = running.communicate(timeout=120)
    finally:
        running.kill()
        os.close(watched)
    assert running.returncode == 130 and "no film was written" in said and "Traceback" not in said, said
    assert [file.name for file in tmp_path.iterdir()] == ["film.webp"] and out.read_bytes() == b"of yesterday"


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
            assert np.ptp(own.vertices[axis::3]) == pytest.approx(np.ptp(mesh.vertices[axis::3]), abs=0.02)
    no_events = [r for r in small_run(with_meshes=False) if type(r[1]).__name__ != "FractureEvent"]
    write_bag(tmp_path / "eventless", no_events)
    done = call(tmp_path / "eventless", "--out", tmp_path / "x.webp")
    assert done.exit_code == 2 and "contains fragment" in done.output.replace("\n", " ")
    bodies_gone = [r for r in small_run(with_meshes=False) if type(r[1]).__name__ != "CollisionBody"]
    write_bag(tmp_path / "bodiless", bodies_gone)
    with pytest.raises(BagError, match="cannot compute meshes"):
        read_run_with_meshes(tmp_path / "bodiless")
