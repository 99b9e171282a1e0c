"""A recorded run as a film, an animated image or an MP4 through the user's ffmpeg, and as a strip of pictures.

Pillow writes GIF and WebP. There is no MP4 encoder here: those that come as wheels are under the GPL or include
libraries that are, and an Apache-2.0 package should not install them. Calling the user's own ffmpeg, with frames on its
standard input, works as well.
"""

from __future__ import annotations

import math
import os
import shutil
import subprocess
import tempfile
from bisect import bisect_right
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib.figure import Figure

from fracture_collision.viewer.film.recorded_run import RecordedRun, read_run
from fracture_collision.viewer.film.run_scene import RunScene, camera_of, chosen_moments, sun_of
from fracture_collision.viewer.pictures.ray_picture import render

ANIMATED = {".gif": "GIF", ".webp": "WEBP"}
MOMENTS = 6  # of the run from which the camera is chosen
GIF_COLOURS = 255  # of one frame, plus one for unchanged pixels
WEBP_QUALITY = 80
MP4_QUALITY = 20  # x264's constant rate factor: lower is better, 18 looks like the original

Progress = Callable[[int, int], None]  # frames done, total; may raise to stop


class FilmError(Exception):
    """No film can be made; the text gives the reason."""


class Cut(NamedTuple):
    """Which part of a run, how large and how fast."""

    begin: float = 0.0  # [s] simulated, since the first states
    end: float = np.inf
    speed: float = 1.0  # simulated seconds a second of film
    fps: float = 25.0
    width: int = 640  # [px]
    height: int = 360
    samples: int = 4  # rays a pixel


def make_film(run: RecordedRun, path: Path, cut: Cut, progress: Progress = lambda done, total: None) -> int:
    """Write the film and return its number of frames. The suffix selects the format: .gif, .webp or .mp4.

    The file appears only when complete; if anything fails, or `progress` raises, an existing file is kept. Raises
    FilmError, and BagError if the run lacks meshes.
    """
    require_format(path)
    suffix = path.suffix.lower()
    indices = frame_indices(run, cut)
    write = _write_mp4 if suffix == ".mp4" else _write_animated
    handle, name = tempfile.mkstemp(suffix=suffix, prefix=f".{path.stem}-", dir=path.parent)
    os.close(handle)
    unfinished = Path(name)
    try:
        write(_frames(run, indices, cut, progress), unfinished, cut)
        unfinished.chmod(0o666 & ~_umask())
        unfinished.replace(path)
    finally:
        unfinished.unlink(missing_ok=True)
    return len(indices)


def require_format(path: Path) -> None:
    """Raise FilmError unless the suffix selects a format that can be written on this machine."""
    suffix = path.suffix.lower()
    if suffix not in (*ANIMATED, ".mp4"):
        raise FilmError(f"{path}: the suffix must be {', '.join(ANIMATED)} or .mp4")
    if suffix == ".mp4" and shutil.which("ffmpeg") is None:
        raise FilmError("an MP4 needs ffmpeg, which is not installed: apt install ffmpeg, or choose a .webp")


def frame_indices(run: RecordedRun, cut: Cut) -> list[int]:
    """Index of the states of each frame: the last that are not later than the frame. Raises FilmError."""
    moments = np.array([states.time for states in run.states]) - run.states[0].time
    end = min(cut.end, float(moments[-1]))
    if not cut.begin <= end:
        raise FilmError(f"no states from {cut.begin:g} s to {cut.end:g} s: the run is {moments[-1]:.2f} s long")
    count = int(np.floor((end - cut.begin) * cut.fps / cut.speed + 1e-6)) + 1
    times = moments.tolist()
    return [max(bisect_right(times, cut.begin + i * cut.speed / cut.fps + 1e-9) - 1, 0) for i in range(count)]


def _frames(run: RecordedRun, indices: list[int], cut: Cut, progress: Progress) -> Iterator[np.ndarray]:
    """Frames (height, width, 3) uint8; frames of the same states are the same array."""
    scene = RunScene(run)
    camera = camera_of(scene, chosen_moments(run, MOMENTS), cut.width / cut.height)
    sun = sun_of(camera)
    picture, shown = np.zeros(0), -1
    for done, index in enumerate(indices):
        progress(done, len(indices))
        if index != shown:
            picture = render(scene.at(run.states[index]), camera, cut.width, cut.height, sun, cut.samples)
            shown = index
        yield picture
    progress(len(indices), len(indices))


def _write_animated(frames: Iterator[np.ndarray], path: Path, cut: Cut) -> None:
    from PIL import Image

    kind = ANIMATED[path.suffix.lower()]
    options = {"WEBP": {"quality": WEBP_QUALITY, "method": 4}, "GIF": {"disposal": 1}}[kind]

    def pictures() -> Iterator[Image.Image]:
        for frame in frames:
            picture = Image.fromarray(frame)
            yield picture.quantize(GIF_COLOURS, dither=Image.Dither.FLOYDSTEINBERG) if kind == "GIF" else picture

    rest = pictures()
    next(rest).save(
        path, kind, save_all=True, append_images=rest, duration=round(1000.0 / cut.fps), loop=0, **options
    )  # fmt: skip


def _write_mp4(frames: Iterator[np.ndarray], path: Path, cut: Cut) -> None:
    command = [
        "ffmpeg", "-y", "-loglevel", "error", "-f", "rawvideo", "-pixel_format", "rgb24",
        "-video_size", f"{cut.width}x{cut.height}", "-framerate", f"{cut.fps:g}", "-i", "-",
        # browsers play yuv420p, which has one colour for two by two pixels
        "-vf", "pad=ceil(iw/2)*2:ceil(ih/2)*2", "-pix_fmt", "yuv420p", "-crf", str(MP4_QUALITY),
        "-movflags", "+faststart", str(path),
    ]  # fmt: skip
    # Ctrl-C goes to this process only, which kills ffmpeg
    with subprocess.Popen(command, stdin=subprocess.PIPE, stderr=subprocess.PIPE, start_new_session=True) as ffmpeg:
        assert ffmpeg.stdin is not None and ffmpeg.stderr is not None  # pipes, see above
        try:
            for frame in frames:
                ffmpeg.stdin.write(frame.tobytes())
            _, words = ffmpeg.communicate()
        except BrokenPipeError:
            words = ffmpeg.stderr.read()
        except BaseException:
            ffmpeg.kill()
            raise
    if ffmpeg.returncode:
        raise FilmError(f"ffmpeg: {words.decode(errors='replace').strip()[-500:]}")


def _umask() -> int:
    mask = os.umask(0o022)
    os.umask(mask)
    return mask


GAP = 8  # [px] between frames


def render_film_strip(
    bag_dir: Path | str, png_path: Path | str, frames: int = 6, width: int = 480, height: int = 360, samples: int = 6
) -> None:
    """`draw_film_strip` of the last run in a bag.

    bag_dir: a rosbag2 folder (MCAP), or one .mcap file, with the topics bodies, fracture_events, fragment_states and
    fragment_meshes under any namespace. Raises BagError if something is missing.
    """
    draw_film_strip(read_run(Path(bag_dir)), png_path, frames, width, height, samples)


def draw_film_strip(
    run: RecordedRun, png_path: Path | str, frames: int = 6, width: int = 480, height: int = 360, samples: int = 6
) -> None:
    """Render `frames` moments of a run into one picture, three a row, each with its simulated time.

    The first and last moments are the first and last states; those between are denser where things break. `width` and
    `height` [px] are those of one frame.
    """
    if frames < 1:
        raise ValueError(f"frames: {frames} is not at least 1")
    scene = RunScene(run)
    moments = chosen_moments(run, frames)
    camera = camera_of(scene, moments, width / height)
    sun = sun_of(camera)
    pictures = [render(scene.at(states), camera, width, height, sun, samples) for states in moments]
    _compose(pictures, [f"{states.time:.2f} s" for states in moments], Path(png_path))


def _compose(pictures: list[np.ndarray], captions: list[str], png_path: Path) -> None:
    columns = min(3, len(pictures))
    rows = math.ceil(len(pictures) / columns)
    height, width = pictures[0].shape[:2]
    total_width = columns * (width + GAP) + GAP
    total_height = rows * (height + GAP) + GAP
    dpi = 100
    figure = Figure(figsize=(total_width / dpi, total_height / dpi), dpi=dpi, facecolor="#15171a")
    for i, (picture, caption) in enumerate(zip(pictures, captions, strict=True)):
        row, column = divmod(i, columns)
        x = GAP + column * (width + GAP)
        y = total_height - (row + 1) * (height + GAP)
        figure.figimage(picture, x, y, origin="upper")
        figure.text((x + 12) / total_width, (y + 12) / total_height, caption, color="white", fontsize=12,
                    bbox={"facecolor": "#15171a", "alpha": 0.65, "edgecolor": "none", "pad": 4})  # fmt: skip
    figure.savefig(png_path, dpi=dpi, facecolor=figure.get_facecolor())
