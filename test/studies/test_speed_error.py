"""Speed against error: mean errors of depths, the CSV's content, and pictures from synthetic rows."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from matplotlib.image import imread
from test_peers import OVERLAP, blocks, placed  # noqa: F401 - blocks is a fixture

from benchmarks.peers.judging.score import FrameTruth, score
from benchmarks.peers.judging.truth import Solids
from benchmarks.peers.libraries.ours import setting_methods
from benchmarks.peers.libraries.ours_settings import DEFAULTS, RESOLUTION, SAME_MESHES, SETTINGS, named
from benchmarks.peers.method import contacts_of
from benchmarks.peers.worlds import EDGES, break_body, clustered_seeds
from benchmarks.speed_error.measure import _body, resampled
from benchmarks.speed_error.overview import draw_overview
from benchmarks.speed_error.picture import SETTINGS as DRAWN
from benchmarks.speed_error.picture import draw, draw_update
from benchmarks.speed_error.points import family, peer_label, points_of, setting_lines

INTO = (1.0 - OVERLAP, 0.05, 0.05)


def test_more_false_contacts_never_make_the_mean_better(blocks: Solids) -> None:  # noqa: F811
    three = Solids([*blocks.surfaces, blocks.surfaces[0]])
    positions = np.array([(0.0, 0.0, 0.0), INTO, (0.0, 0.0, -1.0 - OVERLAP)])
    frame = placed(INTO)._replace(positions=positions, rotations=np.tile(np.eye(3), (3, 1, 1)))
    truth = FrameTruth(frame, three.truth(frame), {(0, 1), (0, 2)}, {})
    x = np.zeros(3)
    one = contacts_of([0], [1], x, x, [1.0, 0.0, 0.0], [3 * OVERLAP])
    two = contacts_of([0, 0], [1, 2], [x, x], [x, x], np.eye(3)[:2], [3 * OVERLAP, OVERLAP])
    assert score(three, [truth], [one]).pair_error_mean == pytest.approx(OVERLAP, abs=1e-9)
    assert score(three, [truth], [two]).pair_error_mean == pytest.approx(1.5 * OVERLAP, abs=1e-9)


def line(world: str, method: str, time: float, error: float) -> dict[str, str]:
    cells = {
        f"{kind}_{name}": str(value)
        for kind in ("jitter", "pile")
        for name, value in (("query", time), ("solver_error_mean", error), ("solver_error_max", 5.0 * error))
    }
    times = {"update": str(10.0 * time), "first_query": str(2.0 * time)}
    return {"world": world, "method": method, "fragments": "20", "cpu": "a processor", "cores": "1", **times, **cells}


@pytest.fixture
def lines() -> list[dict[str, str]]:
    made = []
    for world in ("shell20w", "shell20"):
        made += [line(world, "ours", 2.0, 0.001), line(world, "rapier hull", 0.5, 0.04)]
        made.append(line(world, "fcl mesh", 9.0, 0.02))
        made += [line(world, "exact vertices (warp)", 30.0, 0.0), line(world, named(RESOLUTION, 6), 1.0, 0.003)]
        made += [line(world, named("contacts_per_pair", n), 2.0 + 0.1 * n, 0.001 + 0.001 / n) for n in (32, 1, 2)]
        made += [line(world, named("method", "glondu2014"), 1.5, 0.001), line(world, SAME_MESHES, 1.4, 0.001)]
        silent = dict.fromkeys(made[0], "")  # has an update only
        made.append(silent | {"world": world, "method": "exact field at nodes (libigl)", "update": "50"})
    return made


def test_points_and_settings_of_the_csv(lines: list[dict[str, str]]) -> None:
    points = points_of(lines, "shell20", "jitter", ["update", "first_query"])
    assert [p.method for p in points].count("ours") == 1 and not any("field" in p.method for p in points)
    assert points[0].time == pytest.approx(24.0) and points[0].mean == pytest.approx(0.1)
    contacts = setting_lines(points)["contacts_per_pair"]
    assert [words for words, _ in contacts] == ["1", "2", "", "32"]  # empty: the default, 8
    assert contacts[2][1].method == DEFAULTS
    assert [(family(p), peer_label(p)) for p in points[1:4]] == [
        ("convex hulls", "rapier"), ("triangle meshes", "fcl"), ("exact distances", "warp"),
    ]  # fmt: skip


@pytest.mark.slow
def test_pictures_are_drawn_from_csv_lines(lines: list[dict[str, str]], tmp_path: Path) -> None:
    draw(lines, tmp_path / "queries.png")
    draw_update(lines, tmp_path / "updates.png")
    draw_overview(lines, tmp_path / "overview.png")
    for name in ("queries", "updates", "overview"):
        image = imread(tmp_path / f"{name}.png")[..., :3]
        assert image.shape[1] >= 900
        # our method, hulls and meshes are drawn, each in its colour
        for color in ((0x00, 0x72, 0xB2), (0xD5, 0x5E, 0x00), (0xE6, 0x9F, 0x00)):
            assert np.any(np.all(np.abs(image - np.array(color) / 255.0) < 0.01, axis=-1))


def test_every_setting_is_a_method_and_has_a_style() -> None:
    names = [method.name for method in setting_methods()]
    assert len(set(names)) == len(names) == 1 + sum(map(len, SETTINGS.values()))
    assert set(DRAWN) == {*SETTINGS, RESOLUTION}


def test_other_resolutions_are_broken_by_the_same_seeds() -> None:
    geometry = _body(0.0, 5)
    seeds = clustered_seeds(geometry.vertices, 0.0, 4)
    world = break_body("ball4", geometry, seeds, False, EDGES)
    fine = resampled(world, 7)
    assert fine.body.vertices.size > 1.5 * world.body.vertices.size
    assert len(fine.fragments) == len(world.fragments)
    for coarse_one, fine_one in zip(world.fragments, fine.fragments, strict=True):
        np.testing.assert_allclose(coarse_one.centre, fine_one.centre, atol=0.15)
