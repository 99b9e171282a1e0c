"""Film strip and plot: made from a small bag and checked by pixels."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from matplotlib.image import imread
from stages.bag_of_records import write_bag
from worlds.small_run import records_of, small_run

from fracture_collision.bag.reader import BagError
from fracture_collision.records import CollisionBody, FragmentStates
from fracture_collision.viewer.film.film import GAP, render_film_strip
from fracture_collision.viewer.film.recorded_run import RecordedRun, RecordedStates, read_run
from fracture_collision.viewer.film.run_scene import chosen_moments
from fracture_collision.viewer.film.times_plot import plot_times
from fracture_collision.viewer.pictures.ray_picture import Camera, TriangleScene, render

WIDTH, HEIGHT = 128, 96


def frames_of(picture: np.ndarray, count: int) -> list[np.ndarray]:
    return [
        picture[GAP + r * (HEIGHT + GAP) :, GAP + c * (WIDTH + GAP) :][:HEIGHT, :WIDTH, :3]
        for r, c in (divmod(i, 3) for i in range(count))
    ]


def test_film_strip_shows_the_run(small_bag: Path, tmp_path: Path) -> None:
    pytest.importorskip("embreex", exc_type=ModuleNotFoundError)
    target = tmp_path / "strip.png"
    render_film_strip(small_bag, target, frames=6, width=WIDTH, height=HEIGHT, samples=2)
    picture = imread(target)
    assert picture.shape[:2] == (2 * (HEIGHT + GAP) + GAP, 3 * (WIDTH + GAP) + GAP)
    frames = frames_of(picture, 6)
    for frame in frames:
        assert frame.std() > 0.1
        red, green, blue = frame[..., 0], frame[..., 1], frame[..., 2]
        # the bricks' colour families: the first is blue, the second red
        assert np.count_nonzero((blue > red + 0.2) & (blue > green)) > 60
        assert np.count_nonzero((red > blue + 0.2) & (red > green + 0.1)) > 60
    for before, after in zip(frames[:-1], frames[1:], strict=True):
        assert np.abs(before - after).max() > 0.2

    # the pale crack faces appear with the fracture
    def pale_blue(frame: np.ndarray) -> int:
        return np.count_nonzero((frame[..., 2] > 0.6) & (frame[..., 2] > frame[..., 0] + 0.08))

    assert pale_blue(frames[-1]) > pale_blue(frames[0])
    again = tmp_path / "again.png"
    render_film_strip(small_bag, again, frames=6, width=WIDTH, height=HEIGHT, samples=2)
    assert again.read_bytes() == target.read_bytes()


def test_pictures_have_light_and_shadow() -> None:
    pytest.importorskip("embreex", exc_type=ModuleNotFoundError)
    square = np.array([[[-1.0, -1, 1], [1, -1, 1], [1, 1, 1]], [[-1, -1, 1], [1, 1, 1], [-1, 1, 1]]])
    up = np.tile([0.0, 0.0, 1.0], (2, 3, 1))
    scene = TriangleScene(square, up, np.full((2, 3), [0.8, 0.1, 0.1]), np.zeros(2), 0.0)
    camera = Camera(np.array([0.0, -0.01, 12.0]), np.zeros(3), 1.0)
    picture = render(scene, camera, 120, 120, np.array([1.0, 0.0, 1.0]), samples=4).astype(float)
    # Height 12 m, half angle 0.5 rad: a pixel is 0.109 m on the floor. The square shades the floor one metre to -x.
    assert picture[60, 60, 0] > picture[60, 60, 1] + 80
    shade, open_floor = picture[55:65, 43:47].mean(), picture[55:65, 74:78].mean()
    assert shade < 0.75 * open_floor
    empty = TriangleScene(np.zeros((0, 3, 3)), np.zeros((0, 3, 3)), np.zeros((0, 3)), np.zeros(0), 0.0)
    assert render(empty, camera, 120, 120, np.array([1.0, 0.0, 1.0]), samples=2)[55:65, 43:47].mean() > shade + 20


def test_a_run_is_read_as_it_was_written(small_bag: Path) -> None:
    run = read_run(small_bag)
    assert sorted(run.bodies) == [1, 2, 3, 4, 5]
    assert [run.body_of[f] for f in (1, 2, 3, 4, 5)] == [1, 2, 3, 4, 5]
    children = [f for f, body in run.body_of.items() if f > 5 and body == 3]
    assert len(children) >= 2 and sorted(run.meshes) == sorted(children)
    assert [s.step for s in run.states] == list(range(60))
    assert run.states[59].time == pytest.approx(1.18)
    for got, sent in zip(run.states, records_of(FragmentStates), strict=True):
        assert np.array_equal(got.positions, sent.positions)
        assert np.array_equal(got.fragment_ids, sent.fragment_ids)


def test_the_last_run_of_several_files_is_the_one_shown(tmp_path: Path) -> None:
    folder = tmp_path / "two"
    write_bag(folder, small_run(steps=10), run_id=1)
    write_bag(folder, small_run(steps=20), run_id=2)
    assert len(read_run(folder).states) == 20
    assert len(read_run(folder / "two_0.mcap").states) == 10


def test_missing_data_is_named(tmp_path: Path) -> None:
    with pytest.raises(BagError, match="neither an .mcap file nor a folder"):
        read_run(tmp_path)
    write_bag(tmp_path / "bodies only", [r for r in small_run() if isinstance(r[1], CollisionBody)])
    with pytest.raises(BagError, match="holds no fracture_collision/msg/FragmentStates"):
        read_run(tmp_path / "bodies only")
    write_bag(tmp_path / "no meshes", small_run(with_meshes=False))
    with pytest.raises(BagError, match="no FragmentMesh of fragment 6"):
        render_film_strip(tmp_path / "no meshes", tmp_path / "x.png")
    write_bag(tmp_path / "no bodies", [r for r in small_run() if not isinstance(r[1], CollisionBody)])
    with pytest.raises(BagError, match="contains fragment 2"):
        render_film_strip(tmp_path / "no bodies", tmp_path / "x.png")
    assert not (tmp_path / "x.png").exists()


def test_moments_of_a_film_strip_are_denser_at_fractures() -> None:
    nothing = (np.zeros(0, dtype=int), np.zeros((0, 3)), np.zeros((0, 4)))
    time = np.arange(1001) * 0.01
    states = [RecordedStates(t, i, int(t >= 2.0) + int(t >= 2.2), *nothing) for i, t in enumerate(time.tolist())]
    moments = [s.time for s in chosen_moments(RecordedRun({}, {}, {}, states), 6)]
    assert moments[0] == 0.0 and moments[-1] == 10.0 and len(moments) == 6
    assert sum(1.9 < t < 2.6 for t in moments) >= 3
    calm = [s._replace(fracture_sequence=0) for s in states]
    assert [s.time for s in chosen_moments(RecordedRun({}, {}, {}, calm), 6)] == pytest.approx([0, 2, 4, 6, 8, 10])
    assert len(chosen_moments(RecordedRun({}, {}, {}, states[:3]), 6)) == 3


def report(steps: int = 400) -> dict[str, list[float]]:
    rng = np.random.default_rng(1)
    time = 0.0025 * np.arange(steps)
    return {
        "step": list(range(steps)),
        "time": time.tolist(),
        "contacts": (2 * np.arange(steps)).tolist(),
        "fragments": np.where(time < 0.5, 4, 60).tolist(),
        "collision_ms": rng.lognormal(1.0, 0.3, steps).tolist(),
        "update_ms": np.where(np.arange(steps) == 200, 25.0, 0.0).tolist(),
        "solver_ms": rng.lognormal(1.5, 0.3, steps).tolist(),
        "ros_ms": rng.lognormal(2.0, 0.3, steps).tolist(),
    }


def test_times_plot_shows_every_series(tmp_path: Path) -> None:
    plot_times(report(), tmp_path / "times.png")
    picture = np.round(255 * imread(tmp_path / "times.png")[..., :3]).astype(int)
    for name, colour in {
        "round trip": "7f7f7f", "collision": "1f77b4", "solver": "d62728", "update": "ff7f0e", "contacts": "2ca02c",
        "fragments": "9467bd",
    }.items():  # fmt: skip
        wanted = [int(colour[i : i + 2], 16) for i in (0, 2, 4)]
        assert np.count_nonzero(np.abs(picture - wanted).max(axis=2) < 12) > 30, name
    plot_times({name: [] for name in report()}, tmp_path / "empty.png")


def test_incomplete_reports_are_rejected(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="lacks solver_ms"):
        plot_times({k: v for k, v in report().items() if k != "solver_ms"}, tmp_path / "x.png")
    with pytest.raises(ValueError, match="different lengths"):
        plot_times(report() | {"contacts": [1, 2]}, tmp_path / "x.png")
