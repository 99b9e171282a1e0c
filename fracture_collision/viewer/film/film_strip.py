"""One picture of a whole run: important moments side by side, rendered without a display."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from fracture_collision.viewer.film.recorded_run import RecordedRun, read_run
from fracture_collision.viewer.film.run_camera import camera_of, chosen_moments, sun_of
from fracture_collision.viewer.film.run_scene import RunScene
from fracture_collision.viewer.pictures.ray_picture import render

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
