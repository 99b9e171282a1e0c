"""One picture of a whole run: moments that matter, side by side, rendered without a display."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from fracture_collision.viewer.ray_picture import Camera, render
from fracture_collision.viewer.recorded_run import RecordedRun, RecordedStates, read_run
from fracture_collision.viewer.run_scene import RunScene

FRACTURE_WEIGHT = 0.75  # of the choice of moments; the rest of it is spread evenly over the run
AFTERMATH = 0.3  # [s] for so long a fracture is worth looking at
OPENING = math.radians(32.0)
GAP = 8  # [px] between frames


def render_film_strip(
    bag_dir: Path | str, png_path: Path | str, frames: int = 6, width: int = 480, height: int = 360, samples: int = 6
) -> None:
    """`draw_film_strip` of the last run in a bag.

    bag_dir: a rosbag2 folder (MCAP), or one .mcap file, with the topics bodies, fracture_events, fragment_states and
    fragment_meshes under any namespace. Raises BagError where something is missing.
    """
    draw_film_strip(read_run(Path(bag_dir)), png_path, frames, width, height, samples)


def draw_film_strip(
    run: RecordedRun, png_path: Path | str, frames: int = 6, width: int = 480, height: int = 360, samples: int = 6
) -> None:
    """Render `frames` moments of a run into one picture, three a row, each with its simulated time.

    The first moment is the first state, the last the last; those between crowd where things break. `width` and `height`
    [px] are one frame's.
    """
    if frames < 1:
        raise ValueError(f"frames: {frames} is not at least 1")
    scene = RunScene(run)
    moments = chosen_moments(run, frames)
    camera = _camera(scene, moments, width / height)
    ahead = camera.target - camera.position
    # The sun stands high behind the viewer's left shoulder.
    sun = np.array([-0.55 * ahead[0] - 0.55 * ahead[1], 0.55 * ahead[0] - 0.55 * ahead[1], 0.0])
    sun = sun / np.linalg.norm(sun) + (0.0, 0.0, 1.25)
    pictures = [render(scene.at(states), camera, width, height, sun, samples) for states in moments]
    _compose(pictures, [f"{states.time:.2f} s" for states in moments], Path(png_path))


def chosen_moments(run: RecordedRun, count: int) -> list[RecordedStates]:
    """`count` states (fewer if the run has fewer), first and last among them, dense where fractures happen."""
    time = np.array([states.time for states in run.states])
    sequence = np.array([states.fracture_sequence for states in run.states])
    share = np.arange(len(time)) / max(1, len(time) - 1)
    broken_at = time[1:][np.diff(sequence) > 0]
    if len(broken_at):
        seen = np.clip((time[:, None] - broken_at) / AFTERMATH, 0.0, 1.0).mean(axis=1)
        share = (1.0 - FRACTURE_WEIGHT) * share + FRACTURE_WEIGHT * seen / max(seen[-1], 1e-9)
    wanted = np.linspace(0.0, 1.0, count) if count > 1 else np.ones(1)
    nearest = np.abs(share[None] - wanted[:, None]).argmin(axis=1)
    nearest[-1] = len(time) - 1
    return [run.states[i] for i in sorted(set(nearest.tolist()))]


def _camera(scene: RunScene, moments: list[RecordedStates], aspect: float) -> Camera:
    """From where the thrown bodies come, a little to the side and above, far enough to see nearly all that moves."""
    centres = [scene.centres(states) for states in moments]
    if not any(map(len, centres)):
        centres = [scene.centres(states, movable_only=False) for states in moments]
    radius = scene.radius(moments[0])
    low, high = _spread(centres, 0.06) - radius, _spread(centres, 0.97) + radius
    target = 0.5 * (low + high)
    front = _front(scene, moments)
    turn, rise = math.radians(24.0), math.radians(17.0)
    flat = np.array([math.cos(turn) * front[0] - math.sin(turn) * front[1],
                     math.sin(turn) * front[0] + math.cos(turn) * front[1]])  # fmt: skip
    back = np.array([*(math.cos(rise) * flat), math.sin(rise)])
    right = np.cross([0.0, 0.0, 1.0], back)
    right /= np.linalg.norm(right)
    up = np.cross(back, right)
    corners = np.array([[x, y, z] for x in (low[0], high[0]) for y in (low[1], high[1]) for z in (low[2], high[2])])
    offset = corners - target
    margin = 1.05
    slope = math.tan(0.5 * OPENING)
    reach = np.maximum(np.abs(offset @ up) / slope, np.abs(offset @ right) / (slope * aspect))
    distance = max(float(np.max(margin * reach + offset @ back)), 0.5)
    # What falls is watched falling: the action goes above the middle.
    target = target - 0.2 * slope * distance * up
    return Camera(target + distance * back, target, OPENING)


def _spread(centres: list[np.ndarray], share: float) -> np.ndarray:
    """(3,) the coordinates below which this share lies, each moment of the same weight: one body counts as its shards
    do later.
    """
    points = np.concatenate(centres)
    weights = np.concatenate([np.full(len(group), 1.0 / max(len(group), 1)) for group in centres])
    result = np.empty(3)
    for axis in range(3):
        order = np.argsort(points[:, axis], kind="stable")
        below = np.cumsum(weights[order]) - 0.5 * weights[order]
        result[axis] = np.interp(share * weights.sum(), below, points[order, axis])
    return result


def _front(scene: RunScene, moments: list[RecordedStates]) -> np.ndarray:
    """Horizontal unit vector from what can break to where what cannot was first seen; else across the long side."""
    first_seen: dict[int, np.ndarray] = {}
    for states in scene.run.states:
        for fragment, position in zip(states.fragment_ids.tolist(), states.positions, strict=True):
            body = scene.run.bodies[scene.run.body_of[fragment]]
            if not body.is_static and fragment == body.fragment_id:
                first_seen.setdefault(fragment, position)
    breakable = [p for f, p in first_seen.items() if scene.is_breakable(f)]
    thrown = [p for f, p in first_seen.items() if not scene.is_breakable(f)]
    if breakable and thrown:
        across = (np.mean(thrown, axis=0) - np.mean(breakable, axis=0))[:2]
        if np.linalg.norm(across) > 1e-3:
            return across / np.linalg.norm(across)
    span = np.ptp(scene.centres(moments[0], movable_only=False), axis=0) if moments else np.ones(3)
    return np.array([0.0, -1.0]) if span[0] >= span[1] else np.array([1.0, 0.0])


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
